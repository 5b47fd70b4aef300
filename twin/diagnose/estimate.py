"""Maximum likelihood of the innovations of the extended model: one parameter set for the whole campaign.

Fisher scoring with Levenberg damping, as in `twin/identify/fit.py`, over coordinates of any causes.

Rule 1: a coordinate moves in units in which 1 is a moderate change: logarithms, b / m in 1/s, stops in 10 um, causes in
        units of their first probe.
Rule 2: bounds are physical: b is not negative, a cause stays within its range.  A coordinate at its bound that wants
        further out is left there.
Rule 3: sums over samples do not depend on the number of workers: each worker computes whole derivatives.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocol.campaign import Plant
from twin.diagnose.evidence import Evidence
from twin.diagnose.filter import OUT_COLUMNS, run_extended
from twin.identify.innovations import information, whiten
from twin.identify.liftoff import LiftOff
from twin.identify.record import FloatArray
from twin.model.causes.catalogue import BY_NAME, neutral
from twin.model.causes.cause import CauseParameter
from twin.model.extended import STATES, Base, magnetic_force

PARAMETERS = ("K_A", "T_A", "K_c", "b")
NOISES = ("sigma_i_c_a", "sigma_x_m", "process_i_c_a", "process_a_m_s2")
STOPS = ("stop_low_m", "stop_high_m")
BASE = PARAMETERS + NOISES
FLOORS = {"process_i_c_a": 1e-6, "process_a_m_s2": 1e-3}
_ROUSED_M_S2 = 0.3
STOP_STD_M = 2e-5  # how well anybody knows where a stop is
STOP_UNIT_M = 1e-5
DONE = 0.02  # of a standard error
NEAR = 0.3
CLOSE = 3.0  # standard errors from the maximum: the derivatives are as good as those of the next point
PASSES = 30
_NO_STATE = np.empty((0, STATES))


@dataclass(frozen=True, slots=True, kw_only=True)
class Theta:
    """All numbers of the extended model, in SI units; causes by `name.parameter`."""

    K_A: float
    T_A: float
    K_c: float
    b: float
    sigma_i_c_a: float
    sigma_x_m: float
    process_i_c_a: float
    process_a_m_s2: float
    stop_low_m: float = 0.0
    stop_high_m: float = 0.0
    causes: tuple[tuple[str, float], ...] = ()  # (coordinate, value), in the order of acceptance
    least_i_c_a: float = 1e-6  # the sensors are not better than this: a noise level at 0 finds no way back
    least_x_m: float = 1e-8

    def value(self, name: str) -> float:
        """One number; a cause's that is not in `causes` is neutral."""
        if "." not in name:
            return float(getattr(self, name))
        return dict(self.causes).get(name, parameter_of(name).neutral)

    def having(self, name: str, value: float) -> Theta:
        """With one number changed."""
        if "." not in name:
            return self._with(name, value)
        causes = dict(self.causes)
        causes[name] = value
        return replace(self, causes=tuple(causes.items()))

    def _with(self, name: str, value: float) -> Theta:
        number: dict[str, Any] = {name: value}
        return replace(self, **number)

    def without(self, cause: str) -> Theta:
        """The same without one cause."""
        return replace(self, causes=tuple(pair for pair in self.causes if not pair[0].startswith(cause + ".")))

    def vector(self) -> NDArray[np.float64]:
        """c, as the kernels take it."""
        c = neutral()
        for name, value in self.causes:
            c[parameter_of(name).place] = value
        return c

    def base(self, plant: Plant) -> Base:
        """The paper's parameters, as the kernels take them."""
        return Base(
            K_A=self.K_A,
            T_A=self.T_A,
            K_c=self.K_c,
            b=self.b,
            mass_kg=plant.mass_kg,
            gravity_m_s2=plant.gravity_m_s2,
            x_max_m=plant.x_max_m,
            travel_m=plant.travel_m,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """A maximum and what is known about it."""

    theta: Theta
    loglik: float
    free: tuple[str, ...]
    covariance: FloatArray  # of the coordinates
    converged: bool
    ahead: float = 0.0  # log-likelihood that the slope here still promises, were it a parabola

    def std(self, name: str, plant: Plant) -> float:
        """Standard error in the number's own unit; inf where it was not free."""
        if name not in self.free:
            return math.inf
        place = self.free.index(name)
        spread = math.sqrt(max(float(self.covariance[place, place]), 0.0))
        here = self.theta.value(name)
        beyond = moved(self.theta, name, 1e-3, plant).value(name)
        if beyond == here:
            beyond = moved(self.theta, name, -1e-3, plant).value(name)
        return spread * abs(beyond - here) / 1e-3


def spreads(criterion: Criterion, fit: Fit) -> dict[str, float]:
    """Standard errors of all free numbers, in their own units, at fresh derivatives."""
    _, score, fisher = criterion.gradient(fit.theta, fit.free)
    active = _active(fit.theta, fit.free, score, criterion.plant)
    covariance = np.zeros_like(fisher)
    if active.any():
        covariance[np.ix_(active, active)] = inverse(fisher[np.ix_(active, active)])
    at = replace(fit, covariance=covariance)
    return {name: at.std(name, criterion.plant) for name in fit.free}


def parameter_of(name: str) -> CauseParameter:
    """The parameter behind `cause.parameter`."""
    cause, _, parameter = name.partition(".")
    return next(entry for entry in BY_NAME[cause].parameters if entry.name == parameter)


def coordinates_of(cause: str) -> tuple[str, ...]:
    """The coordinates of a cause: all its parameters."""
    return tuple(f"{cause}.{entry.name}" for entry in BY_NAME[cause].parameters)


def unit_of(parameter: CauseParameter) -> float:
    """The change of a cause's coordinate that counts as 1."""
    scale = abs(parameter.coordinate(parameter.probes[0]))
    return scale if scale > 0.0 else 0.3 * abs(parameter.neutral)


def moved(theta: Theta, name: str, by: float, plant: Plant) -> Theta:
    """One coordinate moved, kept within its bounds."""
    value = theta.value(name)
    if "." in name:
        parameter = parameter_of(name)
        coordinate = parameter.coordinate(value) + by * unit_of(parameter)
        return theta.having(name, parameter.value(coordinate))
    if name == "b":
        return replace(theta, b=min(max(value + by * plant.mass_kg, 0.0), most_drag(plant)))
    if name in STOPS:
        return theta.having(name, value + by * STOP_UNIT_M)
    return theta.having(name, max(value * math.exp(by), _floor(theta, name)))


def _floor(theta: Theta, name: str) -> float:
    return {"sigma_i_c_a": theta.least_i_c_a, "sigma_x_m": theta.least_x_m}.get(name, FLOORS.get(name, 0.0))


def roused(theta: Theta) -> Theta:
    """With process noise to climb from: at its floor the likelihood is flat, a model made worse would stay there."""
    return replace(
        theta,
        process_i_c_a=max(theta.process_i_c_a, 0.3 * theta.sigma_i_c_a),
        process_a_m_s2=max(theta.process_a_m_s2, _ROUSED_M_S2),
    )


def most_drag(plant: Plant) -> float:
    """B that equals the unstable pole in the middle of the travel, N s/m: no ball in air has it."""
    return plant.mass_kg * math.sqrt(2.0 * plant.gravity_m_s2 / (plant.x_max_m - 0.5 * plant.travel_m))


class Criterion:
    """The likelihood of one evidence.

    Args:
        evidence: of `gather`.
        plant: mass, travel, x_max, gravity.
        tick_s: the interval that process noise refers to.
        workers: threads; the kernels run outside the interpreter's lock.
    """

    def __init__(self, evidence: Evidence, plant: Plant, tick_s: float, *, workers: int = 2) -> None:
        self.evidence, self.plant, self.tick_s = evidence, plant, tick_s
        self.shift_s: FloatArray = np.zeros(len(evidence.series))  # phases of a periodic cause, `periodic.py`
        self._pool = ThreadPoolExecutor(max_workers=workers)
        self.evaluations = 0

    def close(self) -> None:
        """End the workers."""
        self._pool.shutdown()

    def outputs(
        self, theta: Theta, state: NDArray[np.float64] = _NO_STATE, shift_s: FloatArray | None = None
    ) -> FloatArray:
        """Innovations and their covariance, shape (n, 5); `shift_s` as `self.shift_s`, for once."""
        s = self.evidence.series
        out = np.empty((len(s), OUT_COLUMNS))
        noise = (theta.sigma_i_c_a, theta.sigma_x_m, theta.process_i_c_a, theta.process_a_m_s2, self.tick_s)
        run_extended(
            tuple(theta.base(self.plant)),
            theta.vector(),
            noise,
            (theta.stop_low_m, theta.stop_high_m),
            self.evidence.t + (self.shift_s if shift_s is None else shift_s),
            s.step,
            s.u,
            s.i,
            s.x,
            s.flags,
            out,
            state,
        )
        self.evaluations += 1
        return out

    def several(self, thetas: Sequence[Theta]) -> list[FloatArray]:
        """`outputs` of each."""
        return list(self._pool.map(self.outputs, thetas))

    def value(self, theta: Theta) -> float:
        """Log-likelihood with the priors; -inf for impossible parameters."""
        return self.loglik(self.outputs(theta)) + self.outside(theta)

    @staticmethod
    def loglik(out: FloatArray) -> float:
        """Of innovations."""
        return float(whiten(out, np.empty(len(out)), np.empty((len(out), 2))))

    def values(self, thetas: Sequence[Theta]) -> list[float]:
        """`value` of each, -inf for those that are not finite."""
        return [value if math.isfinite(value) else -math.inf for value in self._pool.map(self.value, thetas)]

    def white(self, theta: Theta) -> tuple[FloatArray, FloatArray]:
        """(log-likelihood of each sample, shape (n,); whitened innovations, shape (n, 2))."""
        out = self.outputs(theta)
        loglik, white = np.zeros(len(out)), np.full((len(out), 2), np.nan)
        whiten(out, loglik, white)
        return loglik, white

    def outside(self, theta: Theta) -> float:
        """What is not in the series: priors of the stops, lift-off points, equilibria."""
        total = -0.5 * ((theta.stop_low_m / STOP_STD_M) ** 2 + (theta.stop_high_m / STOP_STD_M) ** 2)
        for point in self.evidence.statics:
            residual, sigma = self._static(theta, point)
            total -= 0.5 * (residual / sigma) ** 2
        return total

    def _static(self, theta: Theta, point: LiftOff) -> tuple[float, float]:
        p, c = theta.base(self.plant), theta.vector()
        x = self.plant.x_max_m - point.gap_m
        sigma = 0.5 * point.relative_error
        force = magnetic_force(p, c, point.i_c_a, x)
        weight = self.plant.mass_kg * self.plant.gravity_m_s2
        return 0.5 * math.log(max(force, 1e-12) / weight), max(sigma, 0.003)

    def derivatives(self, theta: Theta, names: Sequence[str]) -> tuple[FloatArray, FloatArray]:
        """(outputs, shape (n, 5); their derivatives by the coordinates, shape (count, n, 5))."""
        steps = [derivative_step(theta, name, self.plant) for name in names]
        thetas = [theta, *(moved(theta, name, by, self.plant) for name, by in zip(names, steps, strict=True))]
        base, *outs = self.several(thetas)
        change = np.empty((len(names), *base.shape))
        for place, (out, by) in enumerate(zip(outs, steps, strict=True)):
            np.subtract(out, base, out=change[place])
            change[place] /= by
        return base, change

    def gradient(self, theta: Theta, names: Sequence[str]) -> tuple[float, FloatArray, FloatArray]:
        """(log-likelihood, score, Fisher information) in the coordinates `names`."""
        base, change = self.derivatives(theta, names)
        return self.slopes(theta, names, base, change)

    def slopes(
        self, theta: Theta, names: Sequence[str], base: FloatArray, change: FloatArray
    ) -> tuple[float, FloatArray, FloatArray]:
        """`gradient` from outputs and derivatives; those of a point nearby will do for the last steps of a climb."""
        n, count = len(base), len(names)
        fisher, each = np.zeros((count, count)), np.empty((n, count))
        here = self.outside(theta)
        total = whiten(base, np.empty(n), np.empty((n, 2))) + here
        information(base, change, each, fisher)
        score = each.sum(axis=0)
        steps = [derivative_step(theta, name, self.plant) for name in names]
        for place, (name, by) in enumerate(zip(names, steps, strict=True)):
            # The few terms outside the series: differences and a curvature of the same kind.
            score[place] += (self.outside(moved(theta, name, by, self.plant)) - here) / by
            if name in STOPS:
                fisher[place, place] += (STOP_UNIT_M / STOP_STD_M) ** 2
        if self.evidence.statics:
            rows = np.array(
                [
                    [
                        (self._ratio(moved(theta, name, by, self.plant), point) - self._ratio(theta, point)) / by
                        for name, by in zip(names, steps, strict=True)
                    ]
                    for point in self.evidence.statics
                ]
            )
            fisher += rows.T @ rows
        return total, score, fisher

    def _ratio(self, theta: Theta, point: LiftOff) -> float:
        residual, sigma = self._static(theta, point)
        return residual / sigma


def derivative_step(theta: Theta, name: str, plant: Plant) -> float:
    """A step for differences in that coordinate, inwards at a bound."""
    by = 1e-2 if name == "b" else 0.05 if name in STOPS else 1e-3 if "." in name else 1e-4
    return by if moved(theta, name, by, plant) != theta else -by


def climb(criterion: Criterion, start: Theta, free: Sequence[str], *, passes: int = PASSES, done: float = DONE) -> Fit:
    """Climb to the maximum from `start`; coordinates not in `free` stay."""
    plant = criterion.plant
    theta, damping, converged, slow = start, 1e-3, False, 0
    base, change = criterion.derivatives(theta, free)
    loglik, score, fisher = criterion.slopes(theta, free, base, change)
    decrement, fresh = math.inf, True
    for _ in range(passes):
        active = _active(theta, free, score, plant)
        step, decrement = _newton(score, fisher, active, damping)
        if decrement < done or (slow >= 2 and decrement < NEAR):
            converged = True
            break
        most = np.array([most_step(name) for name in free])
        # One factor for the physics: the direction stays.  A noise level near its floor has no slope and asks for any
        # step: it is cut by itself, or it would hold back all the others.
        physics = np.array([name not in NOISES for name in free])
        shorter = min([1.0, *(most / np.maximum(np.abs(step), 1e-300))[physics]])
        step = np.where(physics, step * shorter, np.clip(step, -most, most))
        trial = theta
        for place, name in enumerate(free):
            trial = moved(trial, name, step[place], plant)
        out = criterion.outputs(trial)
        value = criterion.loglik(out) + criterion.outside(trial)
        if math.isfinite(value) and value > loglik - 1e-9 * abs(loglik):
            slow = slow + 1 if value - loglik < 0.05 else 0
            theta, damping, base = trial, max(damping * 0.1, 1e-9), out
            fresh = decrement > CLOSE
            if fresh:
                base, change = criterion.derivatives(theta, free)
        elif not fresh:
            base, change = criterion.derivatives(theta, free)
            fresh = True
        else:
            damping = max(damping, 1e-4) * 10.0
            if damping > 1e8:
                break
            continue
        loglik, score, fisher = criterion.slopes(theta, free, base, change)
    active = _active(theta, free, score, plant)
    covariance = np.zeros((len(free), len(free)))
    if active.any():
        covariance[np.ix_(active, active)] = inverse(fisher[np.ix_(active, active)])
    _, left = _newton(score, fisher, active, damping)
    return Fit(
        theta=theta,
        loglik=loglik,
        free=tuple(free),
        covariance=covariance,
        converged=converged or decrement < NEAR,
        ahead=0.5 * left * left,
    )


def _active(theta: Theta, free: Sequence[str], score: FloatArray, plant: Plant) -> NDArray[np.bool_]:
    """Which coordinates may move: not one at its bound whose score points outwards."""
    return np.array(
        [
            moved(theta, name, 1e-3 * (1.0 if score[place] > 0.0 else -1.0), plant) != theta
            for place, name in enumerate(free)
        ],
        np.bool_,
    )


def most_step(name: str) -> float:
    """The largest move of a coordinate in one pass."""
    if name == "b":
        return 20.0
    if name in STOPS:
        return 10.0
    if "." in name:
        return 5.0
    return 1.5 if name in NOISES or name == "T_A" else 0.5


def _newton(
    score: FloatArray, fisher: FloatArray, active: NDArray[np.bool_], damping: float
) -> tuple[FloatArray, float]:
    step = np.zeros(len(score))
    if not active.any():
        return step, 0.0
    g, F = score[active], fisher[np.ix_(active, active)]
    if not (np.isfinite(g).all() and np.isfinite(F).all()):
        return step, math.inf
    scale = np.sqrt(np.maximum(np.diag(F), 1e-12))
    scaled = F / np.outer(scale, scale)
    step[active] = np.linalg.lstsq(scaled + damping * np.eye(len(g)), g / scale, rcond=1e-14)[0] / scale
    whole = np.linalg.lstsq(scaled, g / scale, rcond=1e-14)[0] / scale
    return step, float(np.sqrt(max(float(whole @ g), 0.0)))


def inverse(matrix: FloatArray) -> FloatArray:
    """Inverse of an information matrix, scaled for rounding."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return np.asarray(np.linalg.pinv(matrix / np.outer(scale, scale), rcond=1e-13) / np.outer(scale, scale))


def as_mapping(theta: Theta) -> Mapping[str, float]:
    """The causes' parameters by coordinate."""
    return dict(theta.causes)
