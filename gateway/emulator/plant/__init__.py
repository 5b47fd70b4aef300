"""The emulated plant: ball, coil, amplifier, sensors and what may be wrong with them."""
