"""The search for the causes of the model: score tests, starts, fits, forward and backward steps, equivalences."""
