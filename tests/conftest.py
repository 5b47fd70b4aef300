"""For all tests: hypothesis takes the same examples on every run, with no deadline that a busy machine could miss, and
the programs that tests start hear SIGHUP and SIGINT, also where this run itself was told to ignore them (nohup, &).
"""

import signal

from hypothesis import settings

settings.register_profile("board51", derandomize=True, deadline=None, database=None)
settings.load_profile("board51")
signal.signal(signal.SIGHUP, signal.SIG_DFL)
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
