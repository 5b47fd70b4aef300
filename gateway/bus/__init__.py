"""The gateway on the bus: publishers and the command queryable."""
