"""The service: bytes of the board -> samples -> zenoh and MCAP, and commands back."""
