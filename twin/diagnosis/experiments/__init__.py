"""Experiment design: the recording or measurement to make next, simulated in advance with the fitted model."""
