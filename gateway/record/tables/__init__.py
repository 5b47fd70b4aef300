"""Logs to and from tables: CSV, MATLAB, Parquet."""
