"""One board as numbers: counts and SI units, what may be commanded, which conditions hold.  Pure."""
