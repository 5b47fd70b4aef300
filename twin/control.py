"""The control law of the board in SI units, and the model linearised and discretised around a position.

Written from `protocol/README.md` rules 6, 9 and 14 alone, in float64.  It shares nothing with the firmware's fixed
point, so a mistake in one shows as divergence of the other.

Rule: u(k) comes from the sum *before* this tick's error is added; where u is limited and the error would drive it
      further, the sum stands still.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from protocol.bus import board51_pb2 as pb
from twin.compiled import kernel
from twin.model import linear
from twin.model.equilibrium import equilibrium
from twin.model.parameters import Model

SUM_COUNTS_MAX = (1 << 23) - 1  # the board's integrator is a saturating 24-bit integer (rule 9)


class LawNumbers(NamedTuple):
    """A law as the kernel takes it: LQI and PID are one expression with other coefficients; made by `law_numbers`.

    u = u_0 - k_i (i - i_0) - k_x (x - x_0) + k_p (x_ref - x) - k_v (x - x_prev)/T_s + k_s s,
    s = integral of (x_ref - x) dt
    """

    u_0: float  # V
    i_0: float  # A
    x_0: float  # m
    k_i: float  # V/A
    k_x: float  # V/m
    k_p: float  # V/m
    k_v: float  # V s/m
    k_s: float  # V/(m s)
    u_low: float  # V
    u_high: float  # V
    s_max: float  # m s
    sample_time_s: float


def law_numbers(parameters: pb.Parameters) -> LawNumbers | None:
    """The law of a board, or None where the message holds none (no gains, T_s or input range that is not a range)."""
    p = parameters
    numbers = [*p.gains, p.i_0_a, p.x_0_m, p.u_0_v, p.u_min_v, p.u_max_v, p.sample_time_s, p.x_lsb_m]
    if len(p.gains) != 4 or not np.all(np.isfinite(numbers)) or p.sample_time_s <= 0.0 or p.u_max_v == p.u_min_v:
        return None
    if p.law == pb.LAW_LQI:
        k_i, k_x, k_v, k_int = p.gains
        k_p, k_s = 0.0, -k_int
    elif p.law == pb.LAW_PID:
        k_p, k_s, k_v, _ = p.gains
        k_i = k_x = 0.0
    else:
        return None
    lsb = abs(p.x_lsb_m)
    return LawNumbers(
        u_0=p.u_0_v,
        i_0=p.i_0_a,
        x_0=p.x_0_m,
        k_i=k_i,
        k_x=k_x,
        k_p=k_p,
        k_v=k_v,
        k_s=k_s,
        u_low=min(p.u_min_v, p.u_max_v),
        u_high=max(p.u_min_v, p.u_max_v),
        s_max=SUM_COUNTS_MAX * lsb * p.sample_time_s if lsb > 0.0 else np.inf,
        sample_time_s=p.sample_time_s,
    )


@kernel
def law(c: LawNumbers, i: float, x: float, x_prev: float, s: float, x_ref: float) -> tuple[float, float]:
    """Return (u_c, s after this tick) of rule 9: V, m s."""
    e = x_ref - x
    u = (
        c.u_0
        - c.k_i * (i - c.i_0)
        - c.k_x * (x - c.x_0)
        + c.k_p * e
        - c.k_v * (x - x_prev) / c.sample_time_s
        + c.k_s * s
    )
    push = c.k_s * e
    if u > c.u_high:
        u = c.u_high
        winding = push > 0.0
    elif u < c.u_low:
        u = c.u_low
        winding = push < 0.0
    else:
        winding = False
    if not winding:
        s = min(max(s + e * c.sample_time_s, -c.s_max), c.s_max)
    return u, s


@kernel
def rounded(value: float, lsb: float) -> float:
    """Round to whole counts of `lsb`, halves upwards as the firmware does (`law_run`); lsb 0: no rounding."""
    return math.floor(value / lsb + 0.5) * lsb if lsb > 0.0 else value


def integral_behind(c: LawNumbers, *, i: float, x: float, x_prev: float, x_ref: float, u: float) -> float | None:
    """The integral s with which the law gives the measured `u`; None where u is limited, so that it tells nothing.

    The board computed u from the very samples it reports, so their noise cancels: what remains is rounding.
    """
    span = c.u_high - c.u_low
    if u <= c.u_low + 1e-3 * span or u >= c.u_high - 1e-3 * span:
        return None
    if c.k_s == 0.0:
        return 0.0
    without, _ = law(c._replace(u_low=-np.inf, u_high=np.inf), i, x, x_prev, 0.0, x_ref)
    return float(min(max((u - without) / c.k_s, -c.s_max), c.s_max))


def linearise(model: Model, x_m: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the Jacobians of (1), (6) at rest at `x_m`, the paper's (14).

    Returns:
        A, shape (3, 3), and B, shape (3, 1), for the state [i_c, x, x'] in A, m, m/s and the input u_c in V.  With
        causes these three are readings, and states of the causes follow them: see `linear.linearise`.
    """
    if model.causes:
        return linear.linearise(model, x_m)
    i, _ = equilibrium(model, x_m)
    gap = model.plant.x_max_m - x_m
    m = model.plant.mass_kg
    A = np.array(
        [
            [-1.0 / model.T_A, 0.0, 0.0],
            [0.0, 0.0, 1.0],
            [2.0 * model.K_c * i / (m * gap**2), 2.0 * model.K_c * i**2 / (m * gap**3), -model.b / m],
        ]
    )
    return A, np.array([[model.K_A / model.T_A], [0.0], [0.0]])


def discrete(model: Model, x_m: float, sample_time_s: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Discretise the model at rest at `x_m` by (15), the delays of the model as states behind those of `linearise`."""
    if model.causes:
        return linear.discretised(*linear.linearise(model, x_m), linear.delay_s(model), sample_time_s)
    return linear.c2d(*linearise(model, x_m), sample_time_s)
