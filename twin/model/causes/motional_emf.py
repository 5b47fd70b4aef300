"""motional-emf: a moving ball induces a voltage that pushes the current."""

from __future__ import annotations

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, Form, Vector

COUPLING, REACH = 7, 39
MIN_GAP_SHARE = 0.02  # of the middle gap: nearer to the coil the inductance stays
MIN_LEAD = 0.05  # a falling ball does not turn the coil into a generator that drives itself
MAX_CHANGE = 0.25  # of the lead in the time that the current takes: beyond, the series is none

CAUSE = Cause(
    name="motional-emf",
    family="amplifier",
    title="a moving ball induces a voltage that pushes the current",
    sentence="the moving ball induces a voltage that pushes the current: {coupling_s_m:%} of it per m/s of rise, "
    "in the middle",
    opposite="the moving ball pushes the current the wrong way: {coupling_s_m:%} of it per m/s of fall, in the middle",
    acts_on="rate of the current in (1)",
    equation="T_A i_c' + i_c = K_A u_c - coupling i_c x' (g_mid / g)^2, g = gap + a gap_mid",
    source="i x' dL/dx over the resistance, with dL/dx = 2 K_c / gap^2; about 0.04 s/m at 10 ohm",
    parameters=(
        CauseParameter(
            name="coupling_s_m", symbol="coupling", unit="s/m", index=COUPLING, low=-1.0, high=10.0, probes=(0.05,)
        ),
        CauseParameter(name="reach", symbol="a", index=REACH, low=-0.5, high=5.0, probes=(0.3,), spread=1.0),
    ),
    signature="at constant u_c, i_c dips while the ball rises and swells while it falls",
    shows_in=("prbs-open-loop", "wide-steps"),
    traits=frozenset({"of-the-gap"}),
    confirm="move the ball quickly by hand at constant u_c and watch i_c",
    cure="a current loop in the amplifier",
    usual="of an inductance 2 K_c / gap",
    forms=(
        Form(
            name="of an inductance L_inf + L_1 / (1 + gap / a)",
            values={"reach": 1.0},
            source="H. H. Woodson, J. R. Melcher, Electromechanical Dynamics I, 1968",
        ),
    ),
)


@inlined
def per_speed(c: Vector, gap: float, gap_mid: float) -> float:
    """The induced voltage over that at the coil's resistance, per speed of the ball, s/m: coupling (g_mid / g)^2."""
    if c[COUPLING] == 0.0:
        return 0.0
    a = c[REACH] * gap_mid
    # dL/dx = 2 K_c / gap^2, by energy from (3).
    ratio = (gap_mid + a) / max(gap + a, MIN_GAP_SHARE * gap_mid)
    return c[COUPLING] * ratio * ratio


@inlined
def lead(swing: float) -> float:
    """Return how much faster and lower the current settles if the ball rises; `swing`: `per_speed` times its speed.

    The voltage is proportional to i_c itself, so the equation is solved for i_c.  With the current at the beginning of
    a step, a jump of u_c would meet the voltage of the old current.
    """
    return max(1.0 + swing, MIN_LEAD)


@inlined
def steady_lead(lead: float, change: float) -> float:
    """Return m for which the current settles at target / m once u_c stands.  m lags a lead that changes.

    T_A i' + lead i = target with i = target / m gives m = lead - T_A m' / m.  The result has two terms of its series
    in `change`, by how much the lead changes in T_A.
    """
    # Bounded where the terms of the series would no longer fall.
    part = min(max(change / (lead * lead), -MAX_CHANGE), MAX_CHANGE)
    return lead * (1.0 - part - 2.0 * part * part)
