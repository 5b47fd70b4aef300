"""A controller for the board from a model file: gains, what they are worth, and how sure that is."""

import sys

from twin.verb import Verb

sys.modules[__name__].__class__ = Verb
