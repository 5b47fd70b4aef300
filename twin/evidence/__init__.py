"""The evidence of a campaign: its recordings as a series of flagged samples, and their noise, without a model."""
