"""A recorded campaign as other instruments would have shown it: noise, outliers and counts on top of its readings.

    worse(folder, "step_*", i_c=Instrument(noise=4e-3))

Nothing is shared with the twin: what is added is drawn here.
"""

from __future__ import annotations

import gzip
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Instrument:
    """The errors that an instrument adds to a channel, in the channel's unit."""

    noise: float = 0.0  # standard deviation, on top of the recorded one
    tail: float = np.inf  # degrees of freedom of Student's t, scaled to that standard deviation
    colour: float = 0.0  # autocorrelation from reading to reading
    slope: float = 0.0  # noise per metre of x, beside `noise`
    outlier_share: float = 0.0  # of the readings
    outlier_size: float = 0.0
    count: float = 0.0  # step of the converter
    lowest: float = -np.inf  # that it shows


def worse(folder: Path, files: str, *, seed: int = 0, **channels: Instrument) -> None:
    """Write the recordings whose names match `files` anew, as read by these instruments; i_c and x by name."""
    for path in sorted(folder.glob(f"{files}.csv.gz")):
        rng = np.random.default_rng([seed, *path.name.encode()])
        lines = gzip.decompress(path.read_bytes()).decode().splitlines()
        names = lines[0].replace('"', "").split(",")
        rows = np.array([[float(cell or "nan") for cell in line.split(",")] for line in lines[1:]])
        height = rows[:, names.index("x")] if "x" in names else np.zeros(len(rows))
        for channel, instrument in channels.items():
            if channel in names:
                index = names.index(channel)
                rows[:, index] = _read(rows[:, index], height, instrument, rng)
        text = "\n".join([",".join(names), *(",".join(f"{cell:.9g}" for cell in row) for row in rows)])
        path.write_bytes(gzip.compress(text.encode(), mtime=0))


def _read(values: FloatArray, height: FloatArray, instrument: Instrument, rng: np.random.Generator) -> FloatArray:
    n = len(values)
    white = rng.standard_normal(n)
    if np.isfinite(instrument.tail):
        white = rng.standard_t(instrument.tail, n) * np.sqrt((instrument.tail - 2.0) / instrument.tail)
    if instrument.colour:
        for k in range(1, n):
            white[k] = instrument.colour * white[k - 1] + np.sqrt(1.0 - instrument.colour**2) * white[k]
    readings = values + white * (instrument.noise + instrument.slope * height)
    wild = rng.random(n) < instrument.outlier_share
    readings[wild] += instrument.outlier_size * rng.choice((-1.0, 1.0), int(wild.sum()))
    readings = np.maximum(readings, instrument.lowest)
    return np.asarray(instrument.count * np.round(readings / instrument.count) if instrument.count else readings)
