"""Validation of a model on a campaign: the paper's figures with their numbers, and a verdict."""
