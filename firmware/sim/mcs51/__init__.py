"""A simulated ADuC841 that runs the image of `firmware/mcs51`: `build.py`, `library.py`, `board.py`."""
