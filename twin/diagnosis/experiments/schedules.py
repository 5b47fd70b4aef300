"""The experiments of the menu for fitting, tick by tick for a simulation of this rig.

Rule 1: the simulation is shorter than the experiment: a periodic signal is simulated for a few periods, and its
        information is multiplied.
Rule 2: between two holds the reference moves at SLEW_M_S, as on the board.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from protocol import experiments
from protocol.experiments import Experiment, Signal, Wave
from twin.diagnosis.experiments.virtual_recordings import Schedule
from twin.estimation.record import FloatArray

SLEW_M_S = 20e-3  # the emulated board's, protocol/README.md
_PLAYED_S = 4.0  # simulated time of a signal, or one period if that is longer
_HELD_S = 1.0  # simulated time of a hold: 80 time constants of the unstable pole
_HARMONICS = range(1, 9)
MENU = tuple(experiment for experiment in experiments.MENU if experiment.use == "fit")


def schedule_of(experiment: Experiment, *, lift_off_v: float, travel_m: float, tick_s: float) -> tuple[Schedule, float]:
    """Return (the simulated commands, duration of the experiment over that of the simulation).

    Args:
        experiment: of the menu.
        lift_off_v: lift-off input, the unit of inputs, V.
        travel_m: travel, the unit of positions, m.
        tick_s: T_s, s.
    """
    unit = travel_m if experiment.closed_loop else lift_off_v
    played = [_shortened(part) if experiment.stationary else part for part in experiment.signals]
    pieces: list[FloatArray] = []
    for part in played:
        values = _values(part, tick_s) * unit
        if experiment.closed_loop and not isinstance(part, Wave) and pieces:
            values = _approached(float(pieces[-1][-1]), values, SLEW_M_S * tick_s)
        pieces.append(values)
    schedule = Schedule(
        name=experiment.name,
        kind=experiment.kind,
        command=np.concatenate(pieces) if pieces else np.empty(0),
        closed_loop=experiment.closed_loop,
        clamped_m=0.0 if experiment.expects == "is-clamped" else None,
        bursts=tuple((u_from * unit, u_to * unit) for u_from, u_to in experiment.captures),
    )
    simulated_s = sum(part.duration_s for part in played)
    flown_s = sum(part.duration_s for part in experiment.signals)
    return schedule, flown_s / simulated_s if simulated_s > 0.0 else 1.0


def sentence(experiment: Experiment, *, lift_off_v: float, travel_m: float) -> str:
    """The instruction for the user, with the values for this rig; arguments as in `schedule_of`."""
    values = [value for pair in experiment.captures for value in pair]
    for part in experiment.signals:
        values += [part.low, part.high] if isinstance(part, Wave) else [part.value]
    scale, unit = (1e3 * travel_m, "mm") if experiment.closed_loop else (lift_off_v, "V")
    low, high = (f"{end * scale:.2g} {unit}" for end in (min(values), max(values)))
    return experiment.instruction.format(low=low, high=high, duration=f"{experiment.duration_s:.0f} s")


def _shortened(part: Signal) -> Signal:
    if not isinstance(part, Wave):
        return replace(part, duration_s=min(part.duration_s, _HELD_S))
    longest_s = part.period_s if part.shape == "sawtooth" else max(_PLAYED_S, part.period_s)
    return replace(part, duration_s=min(part.duration_s, longest_s))


def _values(part: Signal, tick_s: float) -> FloatArray:
    n = round(part.duration_s / tick_s)
    if not isinstance(part, Wave):
        return np.full(n, part.value)
    t = tick_s * np.arange(n, dtype=np.float64)
    middle, half = 0.5 * (part.low + part.high), 0.5 * (part.high - part.low)
    turns = t / part.period_s
    match part.shape:
        case "rectangle":
            wave = np.where(turns % 1.0 < 0.5, 1.0, -1.0)
        case "sawtooth":
            wave = 2.0 * (turns % 1.0) - 1.0
        case "prbs":
            chips = np.random.default_rng(1).integers(0, 2, int(turns[-1]) + 1) if n else np.empty(0, np.int64)
            wave = 2.0 * chips[turns.astype(int)] - 1.0
        case "multisine":
            # Phases by M. R. Schroeder, Synthesis of low-peak-factor signals and binary sequences with low
            # autocorrelation, 1970.  With equal phases all harmonics would peak at once.
            wave = sum((np.sin(2.0 * math.pi * (h * turns - h * (h - 1) / 16.0)) for h in _HARMONICS), np.zeros(n))
            wave /= np.max(np.abs(wave))
        case "chirp":
            # The frequency rises linearly, so the phase is its integral: half of the rise counts.
            rate = 1.0 / part.period_s + (1.0 / part.period_end_s - 1.0 / part.period_s) * t / (2.0 * part.duration_s)
            wave = np.sin(2.0 * math.pi * rate * t)
    return np.asarray(middle + half * wave)


def _approached(start: float, values: FloatArray, max_step: float) -> FloatArray:
    """The constant `values`, approached from `start` in steps of at most `max_step`."""
    ramp = np.sign(values[0] - start) * max_step * np.arange(1, len(values) + 1) + start
    return np.asarray(np.minimum(ramp, values) if values[0] > start else np.maximum(ramp, values))
