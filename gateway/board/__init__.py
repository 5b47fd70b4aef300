"""Scaling, command limits and alarm conditions of one board.  Pure."""
