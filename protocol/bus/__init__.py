"""Messages on the zenoh bus and in logs, in SI units.  Start with `topics.py`."""
