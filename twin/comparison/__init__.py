"""Comparison of two models on the same flights, of two flights under one model, and of models over time."""
