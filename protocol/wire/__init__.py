"""The UART: one frame, one body, a stream of them.  Start at `framing.py`."""
