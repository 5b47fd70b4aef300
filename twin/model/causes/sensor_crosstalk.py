"""sensor-crosstalk: the coil's current shows in x."""

from __future__ import annotations

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, Vector

COUPLING = 23

CAUSE = Cause(
    name="sensor-crosstalk",
    family="sensing",
    title="the coil's current shows in x",
    sentence="the coil's current shows in x: each ampere raises the reading by {coupling_m_a}",
    opposite="the coil's current shows in x: each ampere lowers the reading by {coupling_m_a}",
    acts_on="position sensor",
    equation="x_measured = x + coupling i_c",
    source="an inductive sensor in the coil's stray field, or a common ground wire",
    parameters=(
        CauseParameter(
            name="coupling_m_a", symbol="coupling", unit="m/A", index=COUPLING, low=-0.002, high=0.002, probes=(2e-05,)
        ),
    ),
    signature="x of the resting ball moves with i_c",
    shows_in=("rest", "lift-off"),
    confirm="raise the current slowly, stop below lift-off, and watch x of the ball at rest",
    cure="shield the sensor, part the grounds, or take coupling i_c off the reading on the board",
    at_rest="balance",
)


@inlined
def disturbed(c: Vector, reading: float, i: float) -> float:
    """The reading with the coil's field, m."""
    return reading + c[COUPLING] * i
