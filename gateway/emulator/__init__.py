"""An emulated rig: the plant with its unmodelled effects, and the board that controls it.

Reading order: `plant/` (ball and coil), `firmware_model/` (the board), `native/` (the same in C); around them
`faults.py`, `wiring.py`, `ports.py`, `line.py`, `serve.py`.

Rule: the daemon does not import the emulator, and the emulator does not import the twin.  The emulator has its own
physics, so that a diagnosis is tested against independent code.
"""
