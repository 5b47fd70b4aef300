"""position-dependent-inductance: the current follows more slowly the nearer the ball is to the coil."""

from __future__ import annotations

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, Form, Vector

GROWTH, REACH, VOLTAGE = 6, 38, 43
MIN_GAP_SHARE = 0.02  # of the middle gap: nearer to the coil the inductance stays

CAUSE = Cause(
    name="position-dependent-inductance",
    family="amplifier",
    title="the current follows more slowly the nearer the ball is to the coil",
    sentence="the current follows more slowly the nearer the ball is: T_A is {growth:%} longer with the ball in "
    "the middle than at the bottom",
    acts_on="time constant of (1)",
    equation="T_A (1 + growth (1/g - 1/g_bottom) / (1/g_mid - 1/g_bottom)), g = gap + a gap_mid; "
    "and e times the voltage i_c x' dL/dx of this inductance",
    source="L = L_0 + 2 K_c / gap follows from (3) by energy; the paper neglects it on purpose",
    parameters=(
        CauseParameter(name="growth", symbol="growth", index=GROWTH, low=0.0, high=10.0, probes=(0.3, 1.5)),
        CauseParameter(name="reach", symbol="a", index=REACH, low=-0.5, high=5.0, probes=(0.3,), spread=1.0),
        CauseParameter(name="voltage", symbol="e", index=VOLTAGE, low=0.0, high=1.5, probes=(0.3,), spread=0.5),
    ),
    signature="i_c settles more slowly with the ball high than with the ball low, at the same step of u_c",
    shows_in=("blocked-ball", "wide-steps"),
    traits=frozenset({"of-the-gap"}),
    confirm="the same u_c step at 25 kHz with the ball at the bottom and with the ball blocked at the top",
    cure="a current loop in the amplifier, or T_A scheduled with x",
    usual="L_0 + 2 K_c / gap, in the time constant alone",
    forms=(
        Form(
            name="L_0 + 2 K_c / gap, with the voltage that its change induces",
            values={"voltage": 1.0},
            source="H. H. Woodson, J. R. Melcher, Electromechanical Dynamics I, 1968: i x' dL/dx belongs to L(x)",
            probed=True,
        ),
        Form(
            name="L_inf + L_1 / (1 + gap / a), with the voltage that its change induces",
            values={"reach": 1.0, "voltage": 1.0},
            source="H. H. Woodson, J. R. Melcher, Electromechanical Dynamics I, 1968",
        ),
    ),
)


@inlined
def time_constant(c: Vector, T_A: float, gap: float, gap_bottom: float, gap_mid: float) -> float:
    """Return T_A at this gap, s."""
    if c[GROWTH] == 0.0:
        return T_A
    a = c[REACH] * gap_mid
    bottom = 1.0 / (gap_bottom + a)
    inverse_gap = 1.0 / max(gap + a, MIN_GAP_SHARE * gap_mid)
    # T_A = L / R with L = L_0 + 2 K_c / gap.  Growth is that from the bottom to the middle of the travel.
    return T_A * (1.0 + c[GROWTH] * (inverse_gap - bottom) / (1.0 / (gap_mid + a) - bottom))


@inlined
def per_speed(c: Vector, T_A: float, gap: float, gap_bottom: float, gap_mid: float) -> float:
    """The voltage that the change of inductance induces, over that at the resistance, per speed of the ball, s/m."""
    if c[GROWTH] == 0.0 or c[VOLTAGE] == 0.0:
        return 0.0
    a = c[REACH] * gap_mid
    inverse_gap = 1.0 / max(gap + a, MIN_GAP_SHARE * gap_mid)
    # The derivative of `time_constant` by x, which is dL/dx over the resistance.
    return c[VOLTAGE] * T_A * c[GROWTH] * inverse_gap * inverse_gap / (1.0 / (gap_mid + a) - 1.0 / (gap_bottom + a))
