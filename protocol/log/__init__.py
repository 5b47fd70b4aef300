"""A log: MCAP files with the messages of the bus, read whatever became of them."""
