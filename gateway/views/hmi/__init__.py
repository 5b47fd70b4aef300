"""The control room in a browser: one process, a client of the bus, that serves pages and a stream of frames."""
