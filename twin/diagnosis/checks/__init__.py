"""Checks of an answer: consistent recordings, no change during the campaign, no outlying recording."""
