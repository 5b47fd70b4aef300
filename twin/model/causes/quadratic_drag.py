"""quadratic-drag: the ball feels a drag that grows with the square of its speed."""

from __future__ import annotations

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, Form, Vector

C, POWER = 14, 36
V_0_M_S = 0.1  # at which c means the same whatever the power

CAUSE = Cause(
    name="quadratic-drag",
    family="motion",
    title="the ball feels a drag that grows with the square of its speed",
    sentence="the ball feels a drag of {c_n_s2_m2} times the square of its speed",
    acts_on="drag (5)",
    equation="F_d = b x' + c |x'| x' (|x'| / v_0)^(p - 2), v_0 = 0.1 m/s",
    source="the paper neglects it on purpose; air alone gives 4e-5 N s^2/m^2, a narrow guide tube far more",
    parameters=(
        CauseParameter(name="c_n_s2_m2", symbol="c", unit="N s^2/m^2", index=C, low=0.0, high=20.0, probes=(0.2, 2.0)),
        CauseParameter(
            name="power", symbol="p", index=POWER, neutral=2.0, low=1.2, high=3.0, probes=(2.1,), spread=0.5
        ),
    ),
    signature="fast flights are braked more than b from slow ones predicts, by the square of the speed",
    shows_in=("prbs-open-loop", "wide-steps"),
    confirm="let the ball drop with the coil off and time it; repeat it without the guide tube",
    cure="a wider or vented guide; for control the term hardly matters near an equilibrium",
    usual="square of the speed",
    forms=(
        Form(
            name="power of the speed between 1 and 2",
            values={"power": 1.5},
            source="H. Schlichting, Boundary-Layer Theory, 1979: between creeping and turbulent flow",
        ),
    ),
)


@inlined
def drag_n(c: Vector, v: float) -> float:
    """The force against the motion, N."""
    # At rest a power below 2 would be infinity times 0.
    if c[POWER] == 2.0 or v == 0.0:
        return c[C] * abs(v) * v
    return float(c[C] * abs(v) * v * (abs(v) / V_0_M_S) ** (c[POWER] - 2.0))
