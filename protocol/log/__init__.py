"""Reading of logs: MCAP files with the messages of the bus, complete or damaged.

Reading order: `scan` with `chunk` (bytes of a file into messages), `reader` (messages into records).
"""
