"""Logs: MCAP files with the messages of the bus, read by gateway and twin, whatever became of them.

Reading order: `scan` with `chunk` (bytes of a file into messages), `reader` (messages into records).
"""
