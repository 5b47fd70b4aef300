"""air-gap-offset: the coil's plane is higher than x_max."""

from __future__ import annotations

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, Vector
from twin.model.causes.instruments import SCALE, SHIM

D = 9

CAUSE = Cause(
    name="air-gap-offset",
    family="force",
    title="the coil's plane is higher than x_max",
    sentence="the coil sits {d_m} higher than in the model",
    opposite="the coil sits {d_m} lower than in the model",
    acts_on="magnetic force (3)",
    equation="F_m = K_c i_c^2 / (x_max + d - x)^2",
    source="(3) counts the gap from x_max, taken for the top of the travel; four published equilibria of a CE "
    "152 give d = 2.4 mm",
    parameters=(CauseParameter(name="d_m", symbol="d", unit="m", index=D, low=-0.002, high=0.03, probes=(0.0002,)),),
    signature="the current that holds the ball is a straight line in x that meets 0 A at x_max + d, not at x_max",
    shows_in=("holds", "lift-off", "wide-steps"),
    confirm="hold the ball at six heights, plot i_c over x and extend the line to 0 A; or measure from rest to core",
    cure="x_max + d in place of x_max, in the model and in the design",
    deciding_measurements={
        "position-sensor-offset": SHIM,
        "position-sensor-gain": SHIM,
        "position-sensor-nonlinearity": SHIM,
        "force-exponent": SCALE,
        "constant-force": SCALE,
    },
    traits=frozenset({"displaces"}),
    at_rest="balance",
)


@inlined
def gap_m(c: Vector, gap: float) -> float:
    """Return the distance to the effective plane of the coil, m."""
    return gap + c[D]
