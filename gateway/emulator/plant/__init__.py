"""The emulated plant: ball, coil, amplifier, sensors and their effects.

Reading order: `rig.py` (numbers), `effects.py` (what the model does not know), `physics.py` (equations of motion),
`levitation.py` (a rig one can connect a board to), `secret.py` (effects nobody is told).
"""
