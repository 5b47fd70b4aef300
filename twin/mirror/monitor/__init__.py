"""Measured against twin: expected statistics, errors, alarms."""
