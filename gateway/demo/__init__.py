"""The parts of `board51 demo`: processes as a user starts them, a view of the bus, and an evaluation of the log.

It does not import the emulator or the twin; it uses their commands only.
"""
