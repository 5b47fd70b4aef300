"""Identification of a model from recordings, with uncertainty.  Start with README.md, then `pipeline.py`."""
