"""Controller design from a model: gains, analysis of the loop, robustness."""

import sys

from twin.verb import Verb

sys.modules[__name__].__class__ = Verb
