"""An emulated rig: the plant as it 'really' is, and the board that controls it.

Reading order: `plant/` (ball and coil), `firmware/` (the board); around them `faults.py`, `ports.py`, `line.py`,
`serve.py`.

Rule: nothing here is imported by the daemon, and nothing here imports the twin.  The emulator owns its physics, so that
a diagnosis is never compared with itself.
"""
