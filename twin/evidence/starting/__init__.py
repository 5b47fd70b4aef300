"""Estimates without the likelihood: starting values of the fit, and checks of its result."""
