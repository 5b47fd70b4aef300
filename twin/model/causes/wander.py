"""An offset that wanders: a random walk about its mean, as of a sensor that warms up.

d(t) = offset + w(t), w' = white noise, standard deviation of w after a minute: `wander`

Rule 1: w is a state of the filter, one for each such offset; a simulation has w = 0.
Rule 2: a recording begins a minute after the one before it: nothing says how long the pause was.
"""

from __future__ import annotations

from twin.model.causes.cause import CauseParameter, Form

MINUTE_S = 60.0
SOURCE = "random walk: D. W. Allan, Proceedings of the IEEE 54, 1966; A. Gelb, Applied Optimal Estimation, 1974, ch. 3"


def wander(index: int, *, unit: str, high: float, probe: float) -> CauseParameter:
    """The shape of an offset: how far it wanders in a minute (standard deviation), in its unit."""
    return CauseParameter(
        name=f"wander_{unit.lower()}",
        symbol="w",
        unit=unit,
        index=index,
        low=0.0,
        high=high,
        probes=(probe,),
        spread=0.3 * high,
        walks=True,
        random=True,
    )


def wandering(unit: str, probe: float) -> Form:
    """The form of an offset that does not stay."""
    return Form(name="wandering", values={f"wander_{unit.lower()}": probe}, source=SOURCE, probed=True)
