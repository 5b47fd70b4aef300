"""Readers of recordings: MCAP logs, and campaigns of CSV, MATLAB and MCAP files."""
