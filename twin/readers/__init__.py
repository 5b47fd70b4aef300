"""Recordings from their files: MCAP logs and campaigns of CSV, MATLAB, MCAP."""
