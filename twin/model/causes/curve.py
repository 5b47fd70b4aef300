"""The curves for what no cause explains: smooth functions of one quantity each.

    g(s) = sum over j of k_j B_j(s),   cubic B-splines, uniform knots over the range of the recordings    (S 12)

Rule 1: a curve without a range is exactly absent; the extended model is then the one with the causes alone.
Rule 2: outside its range a curve fades to 0 within three knots: nothing is extrapolated.
Rule 3: g is a share of the weight, the magnetic force, the current that holds the ball at mid-travel, the current, or
        the travel.  A drag is a share of the weight at DRAG_AT_M_S.  So one prior serves all rigs.

B-splines with a prior on their coefficients are a Gaussian process of few numbers (P. H. C. Eilers, B. D. Marx,
Statistical Science 11(2), 1996, doi:10.1214/ss/1038425655).
A curve is not a cause: it says where and how large, not why.
"""

from __future__ import annotations

import math

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, Family, Vector

COEFFICIENTS = 8  # of a curve, which takes ten places with the two ends of its range
SPREAD = 0.1  # prior of a coefficient, one standard deviation: a tenth of the weight, of the magnetic force, ...
FIRST = 49  # place in the vector c of the first curve
FORCE_OVER_X, FORCE_OVER_V, PULL_OVER_X, PULL_OVER_I, DRIVE_OVER_U, SENSOR_OVER_X = range(FIRST, FIRST + 60, 10)
DRAG_OVER_X, READING_OVER_I = 130, 140
DRAG_AT_M_S = 0.1  # the speed at which a drag over the height is a share of the weight


def _curve(
    name: str, index: int, family: Family, title: str, over: tuple[str, str], acts_on: str, equation: str
) -> Cause:
    symbol, unit = over
    ends = [
        CauseParameter(
            name=f"{end}_{symbol}", symbol=f"{end} {symbol}", unit=unit, index=n, low=-1e3, high=1e3, probes=(1e-3,)
        )
        for n, end in enumerate(("from", "to"), index)
    ]
    coefficients = [
        CauseParameter(
            name=f"k_{j}", symbol=f"k_{j}", index=index + 1 + j, low=-2.0, high=2.0, probes=(0.01,), spread=SPREAD
        )
        for j in range(1, COEFFICIENTS + 1)
    ]
    return Cause(
        name=name,
        family=family,
        title=title,
        acts_on=acts_on,
        equation=f"{equation}, g = sum of k_j B_j({symbol})",
        source="none: a curve through what is left",
        parameters=(*ends, *coefficients),
        signature="what no cause of the catalogue explains",
        shows_in=(),
        confirm="",
        cure="find its cause; until then the extended model carries the curve",
        detector="remainder",
    )


CURVES: tuple[Cause, ...] = (
    _curve(
        "force-over-height",
        FORCE_OVER_X,
        "force",
        "a force that depends on the height alone",
        ("x", "m"),
        "of the weight",
        "m x'' = ... + m g g(x)",
    ),
    _curve(
        "force-over-speed",
        FORCE_OVER_V,
        "motion",
        "a force that depends on the speed alone",
        ("v", "m/s"),
        "of the weight",
        "m x'' = ... + m g g(x')",
    ),
    _curve(
        "drag-over-height",
        DRAG_OVER_X,
        "motion",
        "a drag that depends on the height",
        ("x", "m"),
        "of the weight at a speed of 0.1 m/s",
        "m x'' = ... - m g g(x) x' / (0.1 m/s)",
    ),
    _curve(
        "pull-over-height",
        PULL_OVER_X,
        "force",
        "a share of the magnetic force that depends on the height",
        ("x", "m"),
        "of the magnetic force",
        "F_m -> F_m (1 + g(x))",
    ),
    _curve(
        "pull-over-current",
        PULL_OVER_I,
        "force",
        "a share of the magnetic force that depends on the current",
        ("i", "A"),
        "of the magnetic force",
        "F_m -> F_m (1 + g(i))",
    ),
    _curve(
        "drive-over-input",
        DRIVE_OVER_U,
        "amplifier",
        "a current that depends on u_c beside K_A u_c",
        ("u", "V"),
        "of the current that holds the ball in the middle",
        "K_A u_c -> K_A u_c + i_0 g(u_c), i_0 holds the ball in the middle",
    ),
    _curve(
        "sensor-over-height",
        SENSOR_OVER_X,
        "sensing",
        "an error of the position sensor that depends on the height",
        ("x", "m"),
        "of the travel",
        "x_measured = ... + l g(x)",
    ),
    _curve(
        "reading-over-current",
        READING_OVER_I,
        "sensing",
        "an error of the current sensor that depends on the current",
        ("i", "A"),
        "of the current",
        "i_measured = i (1 + g(i))",
    ),
)
# A curve may be the free form of the causes that act on one of these (`Cause.acts_on`).
FREE_FORM_OF = {
    "force-over-height": ("net force of (6)",),
    "force-over-speed": ("net force of (6)", "drag (5)"),
    "drag-over-height": ("drag (5)",),
    "pull-over-height": ("magnetic force (3)",),
    "pull-over-current": ("magnetic force (3)",),
    "drive-over-input": ("input of (1)", "target current of (1)"),
    "sensor-over-height": ("position sensor",),
    "reading-over-current": ("current sensor",),
}


@inlined
def value(c: Vector, curve: int, at: float) -> float:
    """The curve whose range begins at `curve` in c, at one place."""
    low, high = c[curve], c[curve + 1]
    if high <= low:
        return 0.0
    s = (at - low) / (high - low) * (COEFFICIENTS - 3)
    # Beyond its last knots a curve is 0, not its last value: nothing is known there (rule 2).
    if s <= -3.0 or s >= COEFFICIENTS:
        return 0.0
    first = math.floor(s)
    f = s - first
    r = 1.0 - f
    # Six times the four cubic B-splines that are not 0 here (C. de Boor, A Practical Guide to Splines, 1978).
    weights = (r * r * r, (3.0 * f - 6.0) * f * f + 4.0, (3.0 * r - 6.0) * r * r + 4.0, f * f * f)
    total = 0.0
    for n in range(4):
        j = int(first) + n
        if 0 <= j < COEFFICIENTS:
            total += weights[n] * c[curve + 2 + j]
    return total / 6.0


@inlined
def slope(c: Vector, curve: int, at: float) -> float:
    """The derivative of that curve by its quantity."""
    low, high = c[curve], c[curve + 1]
    if high <= low:
        return 0.0
    knots_per_unit = (COEFFICIENTS - 3) / (high - low)
    s = (at - low) * knots_per_unit
    if s <= -3.0 or s >= COEFFICIENTS:
        return 0.0
    first = math.floor(s)
    f = s - first
    r = 1.0 - f
    # Twice the derivatives of the four B-splines by s.
    weights = (-r * r, (3.0 * f - 4.0) * f, (4.0 - 3.0 * r) * r, f * f)
    total = 0.0
    for n in range(4):
        j = int(first) + n
        if 0 <= j < COEFFICIENTS:
            total += weights[n] * c[curve + 2 + j]
    return 0.5 * total * knots_per_unit
