"""The numbers by which the live twin decides: those that a user may choose, and the others.

They stand apart from the numerics, so that `--help` need not import those.  The origins are marked as in
`twin/settings/diagnosis.py`.  *level* follows from an error rate, which is stated.  *reasoned* is an engineer's
judgement.

The alarms have one error rate: `false_alarms_per_day` of each of the three under a right model, so together at most
three times that a day.  The probability of one decision is that rate over the number of windows in a day.  The
thresholds are quantiles at that probability (docs/theory/statistics.md, 8).
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """Window, rate of false alarms, longest bridge, patience."""

    window_s: float = 1.0  # of the rolling figures, and of one alarm decision
    false_alarms_per_day: float = 0.1  # of each alarm, under a right model
    bridge_ticks_max: int = 10
    diagnosis_after_s: float = 30.0  # an alarm that lasts so long asks for a diagnosis; 0: never


# Level.  Probability under a right model that a window is above the threshold at which an alarm clears: it decides how
# fast an alarm clears, not whether it is false.
OFF_PROBABILITY = 0.05
# Reasoned.  Without a sample for so long, a flight has ended, s.
SILENT_S = 1.0
# Checked.  T_s for which the steps of the kernels were compared with finer ones, s.
SAMPLE_TIME_RANGE_S = (1e-4, 2e-2)
# Reasoned.  Share of a difference at the start that is left when the twin counts as settled: 1 mm has become 0.1 um.
SETTLING_SHARE = 1e-4
SETTLE_MIN_S, SETTLE_MAX_S = 0.1, 5.0
# Reasoned.  The same with the coil idle or in open loop: a ball dropped from the top stop is down after 0.05 s and
# still after 0.3 s.
SETTLE_DRIVEN_S = 0.3
# Reasoned.  Linearisations of the loop: how many over the travel, the share of it left out at either end, and the
# spectral radius below which one is stable.
POSITIONS = 9
EDGE_SHARE = 0.05
STABLE = 1.0 - 1e-9
