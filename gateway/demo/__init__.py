"""The evaluation of the log of `board51 demo`.

The demo does not import the emulator or the twin; it uses their commands only.
"""
