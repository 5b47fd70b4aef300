"""Where the extended model can be at rest, and the law that keeps it there.

Rule 1: rest is found from the equations themselves, whatever causes are in them: the current that carries the ball by
        bisection, then the input that gives that current.
Rule 2: a law that nobody has told is designed as `board51 design` does it, (14)-(18) with the weights of its
        inexperienced user, on the extended model linearised by differences over a tick.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, solve_discrete_are

from protocol.campaign import Controller, OperatingPoint, Plant
from twin.control import LawNumbers
from twin.design.gains import LARGEST_U_SHARE, LARGEST_X_SHARE, TIME_CONSTANTS, augmented
from twin.diagnose.inference.theta import Theta
from twin.identify.checks.control_law import WIDE_V, numbers_of
from twin.model.causes.catalogue import absent
from twin.model.extended import (
    FIELD,
    I_C,
    SENSOR,
    STATES,
    WARMTH,
    V,
    X,
    acceleration,
    advance,
    drive,
    position_of_reading,
    position_reading,
)

_DELTA = (1e-5, 1e-7, 1e-5)  # A, m, m/s
_MOST_V = 1e3
_SETTLING, _SETTLING_STEP_S = 2000, 5e-3


def carrying_current(theta: Theta, plant: Plant, x_m: float) -> float:
    """The coil current that holds the ball at x (true, not as the sensor shows it), A; inf where none does."""
    p, c = theta.base(plant), theta.vector()
    weight = plant.mass_kg * plant.gravity_m_s2
    top = 2.0 * math.sqrt(weight / theta.K_c) * plant.x_max_m
    while acceleration(p, c, top, x_m, 0.0, 0.0) <= 0.0:
        top *= 2.0
        if top > 1e6:
            return math.inf
    return _bisected(lambda i: acceleration(p, c, i, x_m, 0.0, 0.0) > 0.0, top)


def settled_current(theta: Theta, plant: Plant, u_v: float, x_m: float = 0.0) -> float:
    """What i_c comes to under a constant u_c, A, the ball held at x and the coil as warm as that current makes it.

    Played, not solved: whatever bends the amplifier's response is in the equations of motion alone.
    """
    base, c = tuple(theta.base(plant)), theta.vector()
    y = np.zeros(STATES)
    y[I_C] = y[FIELD] = drive(theta.base(plant), c, u_v, 0.0)
    for _ in range(_SETTLING):
        before = float(y[I_C])
        y[X], y[V], y[WARMTH] = x_m, 0.0, before**2
        advance(base, c, y, u_v, 0.0, _SETTLING_STEP_S, True)
        if abs(y[I_C] - before) <= 1e-12:
            break
    return float(y[I_C])


def carrying_input(theta: Theta, plant: Plant, i_a: float, warmth_a2: float | None = None) -> float:
    """The u_c behind a steady current, V; inf where the amplifier cannot give it."""
    if not math.isfinite(i_a):
        return math.inf
    p, c = theta.base(plant), theta.vector()
    w = i_a * i_a if warmth_a2 is None else warmth_a2
    if drive(p, c, _MOST_V, w) <= i_a:
        return math.inf
    return _bisected(lambda u: drive(p, c, u, w) >= i_a, _MOST_V)


def lift_off_input(theta: Theta, plant: Plant) -> float:
    """The u_c at which the ball leaves the lower stop, V; the unit of the menu of experiments."""
    return carrying_input(theta, plant, carrying_current(theta, plant, max(theta.stop_low_m, 0.0)))


def at_rest(theta: Theta, plant: Plant, x_m: float) -> tuple[NDArray[np.float64], float]:
    """(state, u_c in V) of a ball that floats at x (true).

    Returns:
        The state, shape (6,); where nothing holds the ball, one without current, and u_c is inf.
    """
    i = carrying_current(theta, plant, x_m)
    held = math.isfinite(i)
    i = i if held else 0.0
    y = np.zeros(STATES)
    y[I_C] = y[FIELD] = i
    y[X] = x_m
    y[SENSOR] = position_reading(theta.base(plant), theta.vector(), x_m, i)
    y[WARMTH] = i * i
    return y, carrying_input(theta, plant, i) if held else math.inf


def position_shown_as(theta: Theta, plant: Plant, reading_m: float) -> float:
    """Where the ball floats when the sensor shows so much, m: crosstalk makes that a matter of the current."""
    p, c = theta.base(plant), theta.vector()
    x = reading_m
    for _ in range(20):
        i = carrying_current(theta, plant, x)
        x = position_of_reading(p, c, reading_m, i if math.isfinite(i) else 0.0)
    return x


def law_of(controller: Controller | None, theta: Theta, plant: Plant, tick_s: float, u_max_v: float) -> LawNumbers:
    """The law as the kernels take it; designed for `theta` where there is none."""
    numbers, top = None, min(u_max_v, WIDE_V)
    if controller is not None:
        numbers = numbers_of(controller, tick_s, u_low=0.0, u_high=top)
    if numbers is None:
        numbers = numbers_of(designed(theta, plant, tick_s), tick_s, u_low=0.0, u_high=top)
    assert numbers is not None, "a designed law has its numbers"
    return numbers


def designed(theta: Theta, plant: Plant, tick_s: float) -> Controller:
    """LQI for the middle of the travel, (13)-(18), with Bryson's weights as in `twin/design/gains.py`."""
    x_0 = 0.5 * plant.travel_m
    y, u_0 = at_rest(theta, plant, x_0)
    phi, gamma = _over_a_tick(theta, plant, y, u_0, tick_s)
    unstable = max(math.log(max(float(np.max(np.abs(np.linalg.eigvals(phi)))), 1.0 + 1e-6)) / tick_s, 1.0)
    time_s, x, u = TIME_CONSTANTS / unstable, LARGEST_X_SHARE * plant.travel_m, LARGEST_U_SHARE * u_0
    Q = np.diag([(theta.K_A * u) ** -2, x**-2, (x / time_s) ** -2, (x * time_s) ** -2])
    A, B = augmented(phi, gamma, tick_s)
    R = np.array([[u**-2]])
    try:
        P = solve_discrete_are(A, B, Q, R)
        K = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)[0]
    except (LinAlgError, ValueError):
        K = np.zeros(4)  # a rig that cannot be controlled: the ball will not fly, and the caller sees that it does not
    return Controller(
        kind="lqi",
        gains=(float(K[0]), float(K[1]), float(K[2]), float(K[3])),
        operating_point=OperatingPoint(i_c_a=float(y[I_C]), x_m=x_0, u_c_v=u_0),
    )


def _over_a_tick(
    theta: Theta, plant: Plant, y: NDArray[np.float64], u: float, tick_s: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(15) by differences, for [i_c, x, x'] and u_c: shapes (3, 3), (3, 1)."""
    # Friction would hold the ball against any difference.
    base, c = tuple(theta.base(plant)), absent(theta.vector(), "sticks")
    rows = (I_C, X, V)

    def end(state: int | None, by: float, du: float) -> NDArray[np.float64]:
        z = y.copy()
        if state is not None:
            z[state] += by
            z[FIELD] = z[I_C]
        advance(base, c, z, u + du, 0.0, tick_s, False)
        return z[list(rows)]

    here = end(None, 0.0, 0.0)
    phi = np.column_stack([(end(k, by, 0.0) - here) / by for k, by in zip(rows, _DELTA, strict=True)])
    du = 1e-4 * max(u, 1e-3)
    return phi, ((end(None, 0.0, du) - here) / du)[:, None]


def _bisected(enough: Callable[[float], bool], high: float) -> float:
    low = 0.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if enough(middle) else (middle, high)
    return high
