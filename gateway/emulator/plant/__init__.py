"""The emulated plant: ball, coil, amplifier, sensors and their effects.

Reading order: `rig.py` (numbers), `effects.py` (what the model does not know), `physics.py` (equations of motion),
`levitation.py` (the rig, as connected to a board), `secret.py` (secret effects for blind tests).
"""
