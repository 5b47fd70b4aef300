"""The gateway's side of the bus: what it publishes, which queries it answers."""
