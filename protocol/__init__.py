"""The vocabulary: what crosses the UART (`wire`) and the bus (`bus`), and the errors.  No clock, socket or thread."""
