"""Which causes belong into the model: score tests, starts, fits, forward and backward steps, equivalences."""
