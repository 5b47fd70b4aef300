"""Measured against twin as pictures."""
