"""The UART protocol: frames, message bodies and the stream of both.  Start with `framing.py`."""
