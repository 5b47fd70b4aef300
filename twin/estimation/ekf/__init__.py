"""The extended Kalman filter: one run along a series, predict, start, correct, and its memory."""
