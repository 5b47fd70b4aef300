"""From recordings to a model: campaign data, fits, uncertainty.  Start with README.md, then `pipeline.py`."""
