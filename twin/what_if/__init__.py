"""Prediction of a flight under another control law, from a flight that was recorded."""
