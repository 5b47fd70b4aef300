"""What travels on zenoh and lies in logs, after calibration.  Start at `topics.py`."""
