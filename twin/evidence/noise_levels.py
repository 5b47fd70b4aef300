"""The noise of each reading: a level for each instrument and channel, and its dependence on height."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyval

from twin.estimation.contact import partly_cut_off
from twin.estimation.innovations import FLIES, FOLLOWS, RESTS_HIGH, RESTS_LOW, RESTS_UNSEEN, USE_I, USE_X, Series
from twin.estimation.prepare import captured
from twin.estimation.record import BoolArray, FloatArray, Record, runs

RESTS = RESTS_LOW | RESTS_HIGH | RESTS_UNSEEN  # flags of a ball at rest


@dataclass(frozen=True, slots=True, kw_only=True)
class Colour:
    """The colour of noise: a part is white, the rest is forgotten exponentially."""

    tau_s: float  # correlation time of that rest
    white: float  # share of the variance that is white
    sigma: float  # standard deviation of both together, A or m
    readings: int  # number of readings behind the estimate


@dataclass(frozen=True, slots=True, kw_only=True)
class Level:
    """The noise level of instruments in one channel."""

    sources: tuple[str, ...]
    flies: bool  # in flight; otherwise at rest, or a capture
    ratio: float  # of its standard deviation to the reference level
    error: float  # standard error of its logarithm


@dataclass(frozen=True, slots=True, kw_only=True)
class Channel:
    """The noise of a channel: its levels, and its dependence on height."""

    levels: tuple[Level, ...] = ()
    bend: tuple[float, ...] = ()  # polynomial of ln sigma over height, without the constant; 1/m, 1/m^2
    range_m: tuple[float, float] = (0.0, 0.0)  # outside of it the noise is constant
    reference: float = 0.0  # value of this polynomial for the ball at rest
    sigma: float = math.nan  # the reference level, if no ball at rest gives it: A or m

    def log_at(self, height_m: FloatArray) -> FloatArray:
        """Return ln of the ratio of the standard deviation at each height to that of the ball at rest, shape (n,)."""
        return np.asarray(polyval(np.clip(height_m, *self.range_m), (-self.reference, *self.bend)))


@dataclass(frozen=True, slots=True)
class Noise:
    """The noise of i_c and x."""

    channels: tuple[Channel, Channel] = (Channel(), Channel())
    colours: tuple[Colour | None, Colour | None, Colour | None] = (None, None, None)  # of i_c, x, and i_c in captures

    @property
    def plain(self) -> bool:
        """Tell whether each channel has a single noise level."""
        return not any(channel.bend or any(level.ratio != 1.0 for level in channel.levels) for channel in self.channels)

    def noise_ratio(self, records: Sequence[Record], series: Series) -> FloatArray:
        """Return the noise variance of each reading of i_c and x over its channel's reference, shape (n, 2)."""
        # Sums of logarithms: the factors of instrument and height multiply.
        ratio, flies = np.zeros((len(series), 2)), series.flags & FLIES != 0
        for column, channel in enumerate(self.channels):
            for name, samples in parts_of(records, series):
                for level in channel.levels:
                    if name in level.sources:
                        ratio[samples, column][flies[samples] == level.flies] = math.log(level.ratio)
            ratio[:, column] += channel.log_at(series.x)
        return np.asarray(np.exp(2.0 * ratio))

    def error(self, records: Sequence[Record], series: Series, column: int) -> float:
        """Return the standard error of ln sigma due to the ratios, averaged over a channel (0: i_c, 1: x)."""
        used = series.flags & (USE_I, USE_X)[column] != 0
        flies = series.flags & FLIES != 0
        # The mean error by readings: the level of an instrument with few of them is badly known, and matters little.
        total = sum(
            level.error * np.count_nonzero(used[samples] & (flies[samples] == level.flies))
            for name, samples in parts_of(records, series)
            for level in self.channels[column].levels
            if name in level.sources and (level.ratio != 1.0 or math.isfinite(self.channels[column].sigma))
        )
        return float(total) / max(int(np.count_nonzero(used)), 1)


def colours_json(noise: Noise | None) -> dict[str, Any]:
    """The colours for diagnosis.json, by channel; empty where all noise is white."""
    names = ("i_c", "x", "i_c in captures")
    return {
        name: {
            "correlation_time_s": colour.tau_s,
            "white_share_of_variance": colour.white,
            "sigma": colour.sigma,
            "readings": colour.readings,
        }
        for name, colour in zip(names, noise.colours if noise is not None else (), strict=False)
        if colour is not None
    }


def to_json(noise: Noise | None, sigmas: tuple[float, float]) -> dict[str, Any]:
    """The noise for diagnosis.json; `sigmas` are the reference levels of i_c, A, and x, m."""
    channels = noise.channels if noise is not None and not noise.plain else (Channel(), Channel())
    return {
        name: {
            "sigma": sigma,
            "unit": unit,
            "instruments": [
                {
                    "recordings": list(level.sources),
                    "in_flight": level.flies,
                    "sigma": sigma * level.ratio,
                    "relative_std": level.error,
                }
                for level in channel.levels
            ],
            "over_height": [
                {"x_m": float(x_m), "sigma": float(sigma * np.exp(log))}
                for x_m, log in zip(heights, channel.log_at(heights), strict=True)
            ],
        }
        for name, unit, sigma, channel in zip(("i_c", "x"), ("A", "m"), sigmas, channels, strict=True)
        for heights in [np.linspace(*channel.range_m, 5) if channel.bend else np.empty(0)]
    }


def uncut(series: Series, values: FloatArray, among: BoolArray) -> BoolArray:
    """Return a mask without those `among` the readings whose noise the end of a converter cuts off, shape (n,)."""
    whole = np.ones(len(values), np.bool_)
    for number in np.unique(series.recording):
        readings = np.flatnonzero(among & (series.recording == number))
        whole[readings[partly_cut_off(values[readings])]] = False
    return whole


def parts_of(records: Sequence[Record], series: Series) -> list[tuple[str, slice]]:
    """Return (source, its samples) of each recording without its captures, and of each capture.

    The source is the `instrument` of the campaign file, otherwise the recording's name.
    """
    result: list[tuple[str, slice]] = []
    for number, record in enumerate(records):
        for whole in runs(np.asarray(series.recording == number)):
            begin = whole.stop - captured(record)
            chains = np.flatnonzero(series.flags[begin : whole.stop] & FOLLOWS == 0) + begin
            name = record.instrument or record.name
            result += [(name, slice(whole.start, begin))] if begin > whole.start else []
            result += [(f"{name}, captures", slice(a, b)) for a, b in pairwise([*chains.tolist(), whole.stop])]
    return result
