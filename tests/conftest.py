"""Hypothesis for all tests: the same examples on every run, and no deadline that a busy machine could miss."""

from hypothesis import settings

settings.register_profile("board51", derandomize=True, deadline=None, database=None)
settings.load_profile("board51")
