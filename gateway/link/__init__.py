"""Bytes <-> boards.  Read `driver.py` (one board, no I/O), then `loop.py` (the thread that serves all of them)."""
