"""Checks of the recordings before they are fitted; `plausibility` runs most of them."""
