"""For all tests: hypothesis takes the same examples on every run, with no deadline that a busy machine could miss, and
the programs that tests start hear a SIGHUP, also where this run itself was told to ignore it (nohup).
"""

import signal

from hypothesis import settings

settings.register_profile("board51", derandomize=True, deadline=None, database=None)
settings.load_profile("board51")
signal.signal(signal.SIGHUP, signal.SIG_DFL)
