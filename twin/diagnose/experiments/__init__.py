"""What to record or to measure next, simulated beforehand with the fitted model."""
