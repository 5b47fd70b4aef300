"""The control room in a browser: a client of the bus that serves pages and a stream of frames."""
