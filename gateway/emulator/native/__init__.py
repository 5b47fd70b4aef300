"""The firmware in C (`firmware/` of the repository), compiled for this machine, in the place of the Python one.

Reading order: `build.py` (the compiler), `library.py` (its functions), `board.py`.
"""
