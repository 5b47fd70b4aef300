"""Stability margins of the loop, broken at the plant's input.

Gain and delay margin are the nearest factor or delay at which a pole leaves the unit circle.  So they are also right
for loops that are stable only between two gains, as every loop around an unstable plant is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.control_design.loop import Controller, Plant, radius, seeing
from twin.model.linear import discretised

GAIN_MAX = 1000.0
DELAY_MAX_TICKS = 25
FREQUENCIES = 2000


@dataclass(frozen=True, slots=True, kw_only=True)
class Margins:
    """Margins of a stable loop."""

    gain_low: float  # factor below 1 at which it becomes unstable; 0: none down to 1/GAIN_MAX
    gain_high: float  # factor above 1 at which it becomes unstable; inf: none up to GAIN_MAX
    phase_deg: float
    delay_s: float  # in addition to the model's delay; inf: none up to DELAY_MAX_TICKS


def margins(
    A: NDArray[np.float64],
    B: NDArray[np.float64],
    controller: Controller,
    sample_time_s: float,
    *,
    model_delay_s: float = 0.0,
) -> Margins | None:
    """Return the margins of `controller` on the continuous plant (14) `A`, `B`; None if the loop is unstable.

    Args:
        A: shape (n, n).
        B: shape (n, 1).
        controller: on the first three states.
        sample_time_s: T_s, s.
        model_delay_s: delay of the model, s; the delay margin is in addition to it.
    """
    plant = Plant(*discretised(A, B, model_delay_s, sample_time_s))
    if radius(plant, controller) >= 1.0:
        return None

    def with_gain(factor: float) -> bool:
        # At the plant's input: the factor is on all of u_c, the integral's part too.
        scaled = controller._replace(C=controller.C * factor, D=controller.D * factor)
        return radius(plant, scaled) < 1.0

    def with_delay(delay_s: float) -> bool:
        return radius(Plant(*discretised(A, B, model_delay_s + delay_s, sample_time_s)), controller) < 1.0

    # Steps of 5 %, and bisection within one: stability is not monotonic in the gain, and bisection alone could miss a
    # loss.
    factors = np.geomspace(1.0, GAIN_MAX, 150)[1:].tolist()
    low = _first_loss(lambda inverse: with_gain(1.0 / inverse), 1.0, factors)
    delays = (0.2 * sample_time_s * n for n in range(1, 5 * DELAY_MAX_TICKS + 1))
    return Margins(
        gain_low=1.0 / low,
        gain_high=_first_loss(with_gain, 1.0, factors),
        phase_deg=phase_margin_deg(plant, controller),
        delay_s=_first_loss(with_delay, 0.0, delays),
    )


def _first_loss(holds: Callable[[float], bool], start: float, values: Iterable[float]) -> float:
    """Return the value at which `holds`, true at `start`, becomes false along the rising `values`; inf: at none."""
    stable = start
    for value in values:
        if holds(value):
            stable = value
            continue
        unstable = value
        while unstable - stable > 1e-6 * unstable:
            middle = 0.5 * (stable + unstable)
            stable, unstable = (middle, unstable) if holds(middle) else (stable, middle)
        return stable
    return math.inf


def phase_margin_deg(plant: Plant, controller: Controller) -> float:
    """Return the smallest |180 deg + arg L| where |L| = 1, L the loop broken at the plant's input, below Nyquist."""
    omega = np.geomspace(1e-3, np.pi, FREQUENCIES)  # rad per tick
    size = np.abs(_loop_gain(plant, controller, omega))
    k = np.flatnonzero((size[1:] > 1.0) != (size[:-1] > 1.0))
    # In logarithms, in which gain over frequency is nearly straight.
    share = np.log(size[k]) / np.log(size[k] / size[k + 1])
    crossings = omega[k] * (omega[k + 1] / omega[k]) ** share
    if not len(crossings):
        return math.inf
    return float(np.min(np.abs(np.degrees(np.angle(-_loop_gain(plant, controller, crossings))))))


def _loop_gain(plant: Plant, controller: Controller, omega: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Return L at `omega` rad per tick, shape of `omega`."""
    z = np.exp(1j * omega)[:, None, None]
    A, B, read, direct = seeing(plant, controller)
    y = np.linalg.solve(z * np.eye(len(plant.phi)) - plant.phi, plant.gamma[None].astype(complex))
    u = read @ np.linalg.solve(z * np.eye(len(A)) - A, B @ y) + direct @ y
    return np.asarray(-u[:, 0, 0])
