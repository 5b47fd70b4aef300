"""An emulated rig: the plant as it 'really' is, and the board that controls it.

Reading order: `rig.py` (numbers), `effects.py` (what the model does not know), `physics.py` (equations of motion),
`plant.py` (a rig one can connect a board to), `secret.py` (effects nobody is told).  The board: `arithmetic.py`,
`law.py`, `flash.py`, `loop.py`, `commands.py`, `uart.py`, `firmware.py`.  Around it: `faults.py`, `ports.py`,
`line.py`, `serve.py`.

Rule: nothing here is imported by the daemon, and nothing here imports the twin.  The emulator owns its physics, so that
a diagnosis is never compared with itself.
"""
