"""Residuals of the baseline and the extended model: by state, by frequency, as force, in step responses."""
