"""The numbers by which a cause is named while the rig flies.  The origins are marked as in `mirror.py`."""

from __future__ import annotations

# Reasoned.  From one window to the next, s: a medium effect is named after two of them, within 10 s.
WINDOW_S = 3.3
# Reasoned.  Most samples of a window: they set the cost of a board that is faster than 500 Hz.
MAX_SAMPLES = 1000
# Reasoned.  Windows over which evidence is added up: 40 s of flight.  In two minutes small errors of the model, too,
# add up to a name.
WINDOWS = 12
# Level.  False names a week of flight under a right model, all causes together.
FALSE_NAMES_PER_WEEK = 1.0
# Reasoned.  Log-likelihood by which the newest windows must contradict a name to end it.
GONE = 5.0
# Reasoned.  Without a window for so long a flight has ended, and its evidence with it, s.
FORGOTTEN_S = 30.0
# Reasoned.  Passes of the fit of the twin's model to a window.
PASSES = 6
# Reasoned.  Least share of a signature that the parameters of the model do not take up.
VISIBLE = 1e-7
# Checked.  Causes whose gain is this share of the best are not told apart (tests/twin/live/naming).
SAME_SHARE = 0.7
# Reasoned.  Probability that the cause is in the catalogue at all.
CONFIDENCE = 0.9
# Reasoned.  Less information shows a cause only at a hundred times its probe, where nothing is linear any longer.
MIN_INFORMATION = 1e-4
# Reasoned.  Noise levels that stay those of the model: two seconds do not show the process noise of i_c.
FIXED = ("process_i_c_a",)
# Reasoned.  Standard deviation of x in a window, as a share of the travel, below which the ball rests.
MOVES_SHARE = 0.01
