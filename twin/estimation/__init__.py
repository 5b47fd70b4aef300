"""Estimation, shared by identify, validate, diagnose and the live twin: records, filter, predictions, noise floor."""
