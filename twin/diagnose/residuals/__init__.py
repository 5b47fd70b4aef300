"""What the simulation gets wrong, as numbers: by state, by frequency, as force, in steps."""
