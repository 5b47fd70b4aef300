"""Serial links to the boards.  Read `driver.py` (one board, no I/O), then `io_thread.py` (the thread of all boards)."""
