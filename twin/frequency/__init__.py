"""The frequency domain: measured responses with bands, those of a model, and whether the model explains the loop."""
