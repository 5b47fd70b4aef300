"""Bytes <-> boards.  Read `driver.py` (one board, no I/O), then `io_thread.py` (the thread that serves all of them)."""
