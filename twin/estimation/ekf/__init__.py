"""The extended Kalman filter: prediction, initialisation, correction, its memory, and a run along a series."""
