"""Definitions shared by all parts: UART messages (`wire`), bus messages (`bus`), log files (`log`) and exceptions.

Nothing here uses a clock, a socket or a thread.
"""
