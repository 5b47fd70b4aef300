"""What the simulation gets wrong, which physical cause explains it, and what the extended model gains."""

import sys

from twin.verb import Verb

sys.modules[__name__].__class__ = Verb
