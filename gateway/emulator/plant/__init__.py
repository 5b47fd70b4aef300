"""The emulated plant: ball, coil, amplifier, sensors and their effects.

Reading order: `constants.py` (numbers), `effects.py` (effects that the model does not have), `physics.py` (equations of
motion).  Then `levitation.py` (the rig, as connected to a board) and `secret.py` (secret effects for blind tests).
"""
