"""Gains from a model and weights: operating point (13), linearisation (14), c2d (15), integral (16), LQI (17)-(18).

Rule 1: signs and order are the board's (protocol/README.md, rules 9 and 14): delta u = -K [i - i_0, x - x_0, x', s].
        With s = integral of (x_ref - x) dt the gain of s is negative.
Rule 2: as on the board, s is advanced after u is computed; the augmented model includes this.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from protocol.errors import UsageError
from twin.control import discrete, linearise
from twin.control_design.loop import Gains, Plant, backward, closed_loop
from twin.mirror.monitor.expected import discrete_lyapunov
from twin.model.causes.catalogue import with_trait
from twin.model.equilibrium import equilibrium
from twin.model.linear import c2d
from twin.model.parameters import Model

Law = Literal["lqi", "pid"]
LARGEST_X_SHARE = 0.1  # of the travel
LARGEST_U_SHARE = 0.5  # of u_c0
TIME_CONSTANTS = 4.0  # of the unstable pole: longest duration of a position error


@dataclass(frozen=True, slots=True, kw_only=True)
class OperatingPoint:
    """The equilibrium (13) at `x_m`; i_a and x_m are readings."""

    i_a: float
    x_m: float
    u_v: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Weights:
    """Diagonals of the quadratic cost (17): sum of xi' Q xi + R u^2, xi = [i_c, x, x', s] as deviations."""

    Q: tuple[float, float, float, float]  # 1/A^2, 1/m^2, s^2/m^2, 1/(m s)^2
    R: float  # 1/V^2

    def __post_init__(self) -> None:
        for name, value in (*zip(("i_c", "x", "speed", "integral"), self.Q, strict=True), ("u_c", self.R)):
            if not math.isfinite(value) or value < 0.0:
                raise UsageError(f"the weight of {name} is {value:g}", remedy="Give weights that are positive")
        if self.R == 0.0:
            raise UsageError("the weight R is 0", remedy="Give R > 0: an input that costs nothing has no bound")
        if self.Q[3] == 0.0:
            raise UsageError(
                "the weight of the integral is 0", remedy="Give Q[4] > 0: without it no gain acts on the integral"
            )


def operating_point(model: Model, x_m: float | None, *, u_max_v: float) -> OperatingPoint:
    """The equilibrium (13) at `x_m`; None: mid-travel.

    Raises:
        UsageError: x is not between the stops, has no equilibrium, or needs an input of `u_max_v` or more.
    """
    travel = model.plant.travel_m
    x = 0.5 * travel if x_m is None else x_m
    if not 0.0 < x < travel:
        raise UsageError(
            f"operating point x = {x:g} m is not between the stops",
            remedy=f"Choose 0 < x < {travel:g} m; it is in metres, up from the bottom stop",
        )
    i, u = equilibrium(model, x)
    if not math.isfinite(u):
        raise UsageError(
            f"no equilibrium at x = {x:g} m: with the causes of this model no input holds the ball there",
            remedy="Choose a higher x",
        )
    if not u < u_max_v:
        raise UsageError(
            f"no equilibrium at x = {x:g} m: it takes u_c = {u:.3g} V, and the input ends at {u_max_v:g} V",
            remedy="Choose a higher x, or give the range of the input with --u-max",
        )
    return OperatingPoint(i_a=i, x_m=x, u_v=u)


def bryson(model: Model, point: OperatingPoint, *, settling_time_s: float | None = None) -> Weights:
    """Return the default weights by Bryson's rule: each is 1 / (largest acceptable deviation)^2.

    The deviations are a tenth of the travel in x, half of u_c0 in u_c, and in i_c the change due to that u_c.  With T
    the longest acceptable duration of an error, they are x / T in speed and x T in the integral.

    Args:
        model: the plant.
        point: operating point.
        settling_time_s: T, s; None: 4 / p with p the unstable pole of (14).

    Raises:
        UsageError: the settling time is not positive and finite.
    """
    if settling_time_s is not None and not (math.isfinite(settling_time_s) and settling_time_s > 0.0):
        raise UsageError(f"settling time {settling_time_s:g} s", remedy="Give a positive number of seconds")
    A, _ = linearise(model, point.x_m)
    unstable = float(np.max(np.linalg.eigvals(A).real))
    time_s = TIME_CONSTANTS / unstable if settling_time_s is None else settling_time_s
    # A. E. Bryson, Y.-C. Ho, Applied Optimal Control, 1975.
    x = LARGEST_X_SHARE * model.plant.travel_m
    u = LARGEST_U_SHARE * point.u_v
    # (1) at rest.
    i = model.K_A * u
    return Weights(Q=(i**-2, x**-2, (x / time_s) ** -2, (x * time_s) ** -2), R=u**-2)


def augmented(
    phi: NDArray[np.float64], gamma: NDArray[np.float64], sample_time_s: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Augment n states, x last but one, by (16): s(k+1) = s(k) - T_s x(k); shapes (n+1, n+1), (n+1, 1)."""
    n = len(phi)
    A = np.zeros((n + 1, n + 1))
    A[:n, :n] = phi
    A[n, n - 2], A[n, n] = -sample_time_s, 1.0
    return A, np.vstack([gamma, [[0.0]]])


def design_gains(
    model: Model, point: OperatingPoint, weights: Weights, *, sample_time_s: float, law: Law
) -> tuple[float, float, float, float]:
    """Return K of (18) as [k_i, k_x, k_v, k_int]: V/A, V/m, V s/m, V/(m s).

    A PID does not use the current: k_i is 0, and the gains are those of (15) without the row and column of i_c.  This
    assumes that the current follows u_c within a tick, which holds for T_A well below T_s.  The loop is analysed with
    the complete model.

    Delays and lags add states that the board does not measure.  Then (18) is solved without them, and `refined`
    improves the result.

    Raises:
        UsageError: the Riccati equation has no solution in floating point; the weights are too far apart.
    """
    import control  # here because the import takes 2 s

    # Not of the complete model: `dlqr` gives a gain for each state, and the board does not have these.
    prompt = without_lags(model)
    phi, gamma = c2d(*linearise(prompt, point.x_m), sample_time_s)
    first = 1 if law == "pid" else 0
    A, B = augmented(phi[first:, first:], gamma[first:], sample_time_s)
    try:
        # (17), (18) of the discrete model: a continuous law that is sampled afterwards would ignore the hold of T_s.
        K, _, poles = control.dlqr(A, B, np.diag(weights.Q[first:]), np.array([[weights.R]]))
    except (np.linalg.LinAlgError, ValueError) as error:
        raise UsageError(
            f"no gains for Q = {weights.Q}, R = {weights.R:g} ({error})", remedy="Choose weights less far apart"
        ) from error
    numbers = [float(k) for k in np.asarray(K).ravel()]
    # Tested, because the solver may return gains that do not stabilise, without an error.
    if not np.all(np.isfinite(numbers)) or np.max(np.abs(poles)) >= 1.0:
        raise UsageError(
            f"the gains for Q = {weights.Q}, R = {weights.R:g} do not even stabilise their own model",
            remedy="Choose weights less far apart",
        )
    k_i, k_x, k_v, k_int = [0.0, *numbers] if law == "pid" else numbers
    if prompt is not model:
        return refined(model, point, weights, (k_i, k_x, k_v, k_int), sample_time_s)
    return k_i, k_x, k_v, k_int


def without_lags(model: Model) -> Model:
    """The model without the causes that add states or delays; equilibria are the same."""
    prompt = tuple(cause for cause in model.causes if cause.name not in with_trait("hidden-state"))
    return model if len(prompt) == len(model.causes) else replace(model, causes=prompt)


def refined(
    model: Model, point: OperatingPoint, weights: Weights, K: Gains, sample_time_s: float
) -> tuple[float, float, float, float]:
    """The four gains with the lowest cost (17) on the complete model with the backward difference, starting from `K`.

    (18) is optimal only if all states are measured; otherwise the gains are found by numerical search (Nelder-Mead).
    The cost is the sum over two initial states: a deviation in x of a tenth of the travel, and one in speed.
    """
    from scipy.optimize import minimize

    plant = Plant(*discrete(model, point.x_m, sample_time_s))
    n = len(plant.phi)
    start = np.array(K)
    free = start != 0.0
    x = LARGEST_X_SHARE * model.plant.travel_m
    # The speed that a deviation x has along the fastest mode of the ball.
    speed = x * float(np.max(np.abs(np.linalg.eigvals(linearise(without_lags(model), point.x_m)[0][1:, 1:]))))

    def cost(change: NDArray[np.float64]) -> float:
        gains = start.copy()
        # In logarithms: the signs stay, and gains per metre and per ampere differ by powers of ten.
        gains[free] *= np.exp(np.clip(change, -3.0, 3.0))
        law = backward((gains[0], gains[1], gains[2], gains[3]), sample_time_s)
        F = closed_loop(plant, law)
        pole = float(np.max(np.abs(np.linalg.eigvals(F))))
        if pole >= 1.0:
            # By the pole, not infinity: so the search finds its way out of unstable gains.
            return 1e6 * pole
        to_u = np.hstack([law.D, np.zeros((1, n - 3)), law.C])
        spent = np.zeros((n + 2, n + 2))
        for index, weight in zip((0, 1, 2, n + 1), weights.Q, strict=True):
            spent[index, index] = weight
        P = discrete_lyapunov(F.T, spent + weights.R * to_u.T @ to_u)
        # x_prev, the state after those of the plant, gets the same deviation as x, so the initial speed is 0.
        moved = np.zeros((n + 2, 2))
        moved[[1, n], 0], moved[2, 1] = x, speed
        return float(np.trace(moved.T @ P @ moved))

    # Nelder-Mead needs no gradient, which the cost does not have at the edge of stability.
    optimum = minimize(cost, np.zeros(int(free.sum())), method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-4})
    gains = start.copy()
    gains[free] *= np.exp(np.clip(optimum.x, -3.0, 3.0))
    return float(gains[0]), float(gains[1]), float(gains[2]), float(gains[3])


def in_order_of(law: Law, K: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    """Return `K` in the order of SET_GAINS: LQI [k_i, k_x, k_v, k_int], PID [k_p, k_int, k_d, 0] (rule 9)."""
    k_i, k_x, k_v, k_int = K
    return (k_x, -k_int, k_v, 0.0) if law == "pid" else (k_i, k_x, k_v, k_int)
