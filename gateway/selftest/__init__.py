"""A test of a board on its own serial port, for the person who has just soldered it.

Read `verdict.py` (a line of output), `connection.py` (the board at the other end), `bench.py` (what the checks share),
`table.py` (all checks) and `runner.py` (their order, and the coil off at each end).

Rule 1: the board is known from its line alone: whether it is a real one or an emulated one makes no difference.
Rule 2: current flows only in checks that say so in the table, and its duration is counted by the board itself, so
        that a host that dies leaves nothing on.
Rule 3: time comes from the `Wire`.  So the tests run in the emulator's own time, faster than the clock.
"""
