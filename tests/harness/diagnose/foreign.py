"""Recordings of rigs that are not the paper's: other equations, other drivers, other sensors, other clocks.

    hall_campaign(folder)      a coil driven by a voltage, a Hall sensor, a PID faster than its logger; 2 to 5 ms
    inteco_campaign(folder, data)     flights of the INTECO rig, thinned to 2 to 5 ms and read with a bent scale

Nothing here is written for the model of `twin`: the force is that of an inductance L(gap), the coil has an induced
voltage and a resistance, u_c is the voltage that the logger happens to see.
"""

from __future__ import annotations

import csv
import gzip
import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
STEP_S = 5e-5
LAW_STEPS = 10  # of the PID: 0.5 ms
INTERVALS_MS = (2, 2, 3, 4, 5, 5)
SAMPLES = 3461  # of each recording


class Rig(NamedTuple):
    """A ball below a coil; SI units."""

    mass: float = 0.0571
    gravity: float = 9.81
    travel: float = 0.016
    inductance: float = 0.22  # that the ball adds at the coil
    depth: float = 0.0075  # gap at which half of it is left
    coil: float = 0.31  # inductance without the ball
    resistance: float = 4.3
    drag: float = 0.04
    i_noise: float = 4e-3
    x_noise: float = 18e-6
    hall_bend: float = 0.35  # of the travel: how far the field's decay bends the scale


def force(rig: Rig, i: float, gap: float) -> float:
    """Half i^2 dL/dgap, N, upwards."""
    return 0.5 * i * i * rig.inductance / rig.depth / (1.0 + gap / rig.depth) ** 2


def hall(rig: Rig, x: float) -> float:
    """Return the reading of the sensor, right at both ends: the field of the ball's magnet falls exponentially."""
    bend = rig.hall_bend * 4.0
    return rig.travel * math.expm1(bend * x / rig.travel) / math.expm1(bend)


def flight(rig: Rig, interval_ms: int, samples: int, seed: int, shape: str) -> FloatArray:
    """Rows t, u, i, x, x_ref of the logger, shape (samples, 5)."""
    rng = np.random.default_rng(seed)
    every = round(interval_ms * 1e-3 / STEP_S)
    x, v, height = 0.5 * rig.travel, 0.0, 0.5 * rig.travel
    gap = rig.travel - x + 1e-3
    i_0 = math.sqrt(rig.mass * rig.gravity / force(rig, 1.0, gap))
    i, integral, u, demand = i_0, 0.0, rig.resistance * i_0, i_0
    pole2 = 2.0 * rig.gravity / (rig.depth + gap)
    per_a = 2.0 * rig.gravity / i_0
    rows = np.empty((samples, 5))
    noise = rng.standard_normal((samples, 2)) * (rig.i_noise, rig.x_noise)
    for k in range(samples * every):
        t = k * STEP_S
        if k % LAW_STEPS == 0:
            if shape == "steps":
                height = (0.5 + 0.12 * (1.0 if t % 2.4 < 1.2 else -1.0)) * rig.travel
            elif shape == "sines":
                height = (0.5 + 0.1 * math.sin(2.0 * t) + 0.05 * math.sin(7.3 * t)) * rig.travel
            else:
                height = (0.5 + 0.15 * (abs(t / 3.0 % 2.0 - 1.0) * 2.0 - 1.0)) * rig.travel
            e = height - x
            integral += e * STEP_S * LAW_STEPS
            demand = i_0 + ((pole2 + 900.0) * e - 60.0 * v + 800.0 * integral) / per_a
            u = min(max(rig.resistance * demand + 90.0 * (demand - i), 0.0), 12.0)
        if k % every == 0:
            n = k // every
            rows[n] = t, u, i + noise[n, 0], hall(rig, x) + noise[n, 1], height
        gap = rig.travel - x + 1e-3
        shared = 1.0 + gap / rig.depth
        slope = rig.inductance / rig.depth / shared**2
        i += STEP_S * (u - rig.resistance * i - slope * i * v) / (rig.coil + rig.inductance / shared)
        i = max(i, 0.0)
        v += STEP_S * ((force(rig, i, gap) - rig.drag * v) / rig.mass - rig.gravity)
        x += STEP_S * v
        if not 0.0 < x < rig.travel:
            x, v = min(max(x, 0.0), rig.travel), 0.0
    return rows


def hall_campaign(folder: Path, *, intervals_ms: Sequence[int] = INTERVALS_MS, samples: int = SAMPLES) -> Path:
    """A campaign of flights, the last one judges."""
    rig = Rig()
    shapes = ("steps", "sines", "ramps")
    flights = [flight(rig, ms, samples, n, shapes[n % 3]) for n, ms in enumerate((*intervals_ms, 2))]
    plant = f'name = "hall"\nmass_kg = {rig.mass}\ntravel_m = {rig.travel}\nx_max_m = {rig.travel + 4e-3}\n'
    return _written(folder, plant, flights)


def inteco_campaign(folder: Path, data: Path, *, intervals_ms: Sequence[int] = INTERVALS_MS) -> Path:
    """Flights of the INTECO rig, thinned; x read on a bent scale, u_c the duty in volts of a nominal supply."""
    files = [file for file in sorted((data / "inteco-mls2em").glob("cl_*.csv.gz")) if "step__" not in file.name]
    flights = []
    for n, ms in enumerate((*intervals_ms, 2)):
        with gzip.open(files[n % len(files)], "rt", encoding="utf-8") as text:
            table = list(csv.DictReader(text))[3000 + n :: ms]
        t, ref, gap, i, duty = (
            np.array([float(row[name]) for row in table]) for name in ("t_s", "ref_m", "gap_meas_m", "i1_A", "duty1")
        )
        x = 0.02 - gap
        flights.append(np.stack([t, 12.0 * duty, i, x + 0.1 * x * (1.0 - x / 0.02), 0.02 - ref], axis=1))
    return _written(folder, 'name = "thin"\nmass_kg = 0.0615\ntravel_m = 0.02\nx_max_m = 0.02\n', flights)


def _written(folder: Path, plant: str, flights: Sequence[FloatArray]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    lines = ["[plant]", plant]
    for n, rows in enumerate(flights):
        name, use = f"flight_{n}.csv", "judge" if n == len(flights) - 1 else "fit"
        np.savetxt(folder / name, rows, fmt="%.7g", delimiter=",", header="t,u_c,i_c,x,x_ref", comments="")
        lines += ["[[recording]]", f'file = "{name}"', 'kind = "closed-loop"', f'use = "{use}"', ""]
    (folder / "campaign.toml").write_text("\n".join(lines), encoding="utf-8")
    return folder
