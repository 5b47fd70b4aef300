"""The vocabulary: what crosses the UART (`wire`) and the bus (`bus`), how logs are read (`log`), and the errors.

No clock, socket or thread.
"""
