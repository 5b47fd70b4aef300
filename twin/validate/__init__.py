"""Is a model good enough?  The paper's figures from any campaign, with a number under each."""

import sys

from twin.verb import Verb

sys.modules[__name__].__class__ = Verb
