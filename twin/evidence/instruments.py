"""The noise of each instrument, by channel and height, from the recordings alone without a model.

A reading is a smooth signal plus noise.  Its fifth difference passes white noise with a gain of sqrt(252) and reduces
the ball's motion to a few percent; from i_c, the output of a linear filter of the previous u_c is subtracted first.
The levels are means of the logarithms of mean squares over windows of 25 readings; the scatter of these logarithms
gives the errors for any distribution of the noise.

Rule 1: a source is one instrument: all recordings with the same `instrument` in the campaign file, otherwise one
        recording.  Captures are a source of their own.
Rule 2: flights are compared with flights only, and recordings at rest or captures with each other.  In flight the loop
        responds to the noise of x, and crosstalk shows the current.  A tenth of the noise or more may be due to that,
        equally in all flights.
Rule 3: sources share a level unless they differ significantly and by more than the floor's tolerance.  So a common
        level has its full precision.  The test is false in one campaign of a thousand, over all pairs.
Rule 4: noise depends on height if it does so within flights, by the criteria of rule 3.  The ball at rest, as one more
        height, must also fit the shape of the flights.
Rule 5: the reference level is that of the ball at rest (`sensor_noise.py`).  The flights with the nearest level are
        assumed to have the same.  Without a ball at rest it is that of the flights.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from twin.distributions import chi2_above, normal_exceeded
from twin.estimation.innovations import FLIES, FOLLOWS, LOST, USE_I, USE_X, Series
from twin.estimation.low_pass import low_pass
from twin.estimation.prediction_floor import TOLERANCE
from twin.estimation.record import BoolArray, FloatArray
from twin.estimation.structures import EQUAL_NOISE
from twin.evidence.colour import colours_of, expected_gain, is_fast
from twin.evidence.gather import Evidence
from twin.evidence.noise_levels import RESTS, Channel, Colour, Level, Noise, parts_of
from twin.evidence.rest_lines import without_lines
from twin.settings import diagnosis as settings

IntArray = np.ndarray[tuple[int], np.dtype[np.int64]]
ORDER = 5  # of the difference; the third leaves five times as much of a step of the acceleration
_GAIN = math.comb(2 * ORDER, ORDER)  # sum of its squared weights
_DIFFERENCE = np.array([(-1.0) ** k * math.comb(ORDER, k) for k in range(ORDER + 1)])
_TIMES = (2.0, 6.0, 20.0, 60.0)  # samples: first-order lags for what the response has after `INPUT_SHOWS` samples


@dataclass(frozen=True, slots=True, kw_only=True)
class _Windows:
    """Windows of one channel; arrays of shape (n,)."""

    log: FloatArray  # ln of the standard deviation
    height_m: FloatArray
    source: IntArray
    flies: BoolArray
    rests: BoolArray

    def where(self, mask: BoolArray) -> _Windows:
        return _Windows(**{name: getattr(self, name)[mask] for name in _Windows.__slots__})


def instruments(evidences: Sequence[Evidence]) -> Noise:
    """The noise of these recordings; those for fitting and judging may be joined, as no model is used."""
    names = sorted({name for evidence in evidences for name, _ in parts_of(evidence.records, evidence.series)})
    colours = colours_of(evidences)
    channels = [_channel(_windows(evidences, names, column, colours), names, bends=column == 1) for column in range(2)]
    return Noise((channels[0], channels[1]), colours)


def with_noise(evidence: Evidence, noise: Noise | None) -> Evidence:
    """The evidence with the noise of each reading; unchanged if each channel has a single level."""
    if noise is None:
        return evidence
    ratio = EQUAL_NOISE if noise.plain else noise.noise_ratio(evidence.records, evidence.series)
    return replace(evidence, noise=noise, noise_ratio=ratio)


def _windows(
    evidences: Sequence[Evidence], names: Sequence[str], column: int, colours: Sequence[Colour | None]
) -> _Windows:
    rows: list[tuple[float, float, int, bool, bool]] = []
    length = settings.INSTRUMENT_WINDOW
    for evidence in evidences:
        series, captured = without_lines(evidence.series), is_fast(evidence.series)
        flies = series.flags & FLIES != 0
        rests = series.flags & RESTS != 0
        for name, part in parts_of(evidence.records, evidence.series):
            # Fifth differences, not residuals of a model: a wrong model would make every instrument seem noisy.
            rough = differences(series.part(part), column)
            colour = colours[2 if column == 0 and captured[part.start] else column]
            if colour is not None:  # scale to the level of white noise of the same variance
                rough /= math.sqrt(expected_gain(colour, float(np.median(series.step[part][1:])), _DIFFERENCE))
            windows = [
                window
                for window in _windows_of(np.isfinite(rough), series.part(part).flags & FOLLOWS == 0, length)
                if flies[part][window].all() or not flies[part][window].any()
            ]
            squares = [float(np.mean(rough[window] ** 2)) / _GAIN for window in windows]
            windows = [part.start + window for window in windows]
            for kind in (True, False):
                usual = [index for index, window in enumerate(windows) if flies[window[0]] == kind]
                max_square = settings.RESTLESS * float(np.median([squares[index] for index in usual])) if usual else 0.0
                rows += [
                    (
                        # Logarithms: their scatter between windows is their error, whatever the tails of the noise are.
                        0.5 * math.log(squares[index]),
                        float(np.mean(series.x[windows[index]])),
                        names.index(name),
                        kind,
                        bool(rests[windows[index]].all()),
                    )
                    for index in usual
                    if 0.0 < squares[index] <= max_square
                ]
    table = np.array(rows).reshape(-1, 5)
    return _Windows(
        log=table[:, 0],
        height_m=table[:, 1],
        source=table[:, 2].astype(np.int64),
        flies=table[:, 3].astype(np.bool_),
        rests=table[:, 4].astype(np.bool_),
    )


def _windows_of(present: BoolArray, begins: BoolArray, length: int) -> list[IntArray]:
    """Return windows of `length` samples that are `present`, within the chains that begin at `begins`."""
    windows = []
    for chain in np.split(np.arange(len(present)), np.flatnonzero(begins)):
        rows = chain[present[chain]]
        candidates = [rows[start : start + length] for start in range(0, len(rows) - length + 1, length)]
        # A lost sample leaves out the differences over it.  With more left out, the ball would move on too far.
        windows += [window for window in candidates if window[-1] - window[0] < 2 * length]
    return windows


def differences(series: Series, column: int) -> FloatArray:
    """Return the fifth differences of i_c (column 0) or x of one recording, shape (n,); NaN if a reading is missing."""
    values, whole = smooth(series, column, before=ORDER)
    result = np.full(len(values), np.nan)
    result[ORDER:] = np.diff(values, ORDER)
    result[~whole] = np.nan
    return result


def smooth(series: Series, column: int, *, before: int = 0, around: int = 0) -> tuple[FloatArray, BoolArray]:
    """Prepare a channel (0: i_c, 1: x) of one recording for differences.

    A difference uses `before` readings before its sample, or `around` readings on each side of it.

    Returns:
        (i_c without the response to u_c, or x; whether all readings of the difference are present), both of shape (n,).
    """
    used = series.flags & (USE_I, USE_X)[column] != 0
    chain = np.cumsum(series.flags & FOLLOWS == 0)
    # For some samples i_c depends on the unknown u_c of a lost sample, or on that before the first sample of a chain.
    input_known = np.ones(len(used), np.bool_)
    unknown = series.flags & (LOST | FLIES) == LOST | FLIES  # at rest u_c was the same before and after
    for at in np.flatnonzero(unknown | (np.diff(chain, prepend=1) != 0)):
        input_known[at : at + settings.INPUT_SHOWS] = False
    known = used & input_known if column == 0 else used
    if np.count_nonzero(known) < settings.INSTRUMENT_WINDOWS * settings.INSTRUMENT_WINDOW:
        return series.x, np.zeros(len(used), np.bool_)
    whole = known.copy()
    for lag in range(1, before + 2 * around + 1):
        whole[lag:] &= known[:-lag] & (chain[lag:] == chain[:-lag])
        whole[:lag] = False
    if around:
        whole = np.concatenate((whole[around:], np.zeros(around, np.bool_)))
    return without_input(series.i, series.u, known) if column == 0 else series.x, whole


def without_input(i: FloatArray, u: FloatArray, used: BoolArray) -> FloatArray:
    """Return i_c minus its linear regression on filtered u_c, over the samples `used`; all of shape (n,)."""
    lagged = [np.concatenate((np.full(lag, u[0]), u[:-lag])) for lag in range(1, settings.INPUT_SHOWS + 1)]
    # A few fixed lags in place of a fit of T_A: the regression stays linear, and no model of the amplifier is needed.
    slow = [u[0] + low_pass(u - u[0], math.exp(-1.0 / time)) for time in _TIMES]
    regressors = np.column_stack([np.ones(len(u)), *lagged, *slow])
    return np.asarray(i - regressors @ np.linalg.lstsq(regressors[used], i[used], rcond=None)[0])


def _channel(windows: _Windows, names: Sequence[str], *, bends: bool) -> Channel:
    curve = _curve(windows) if bends else Channel()
    windows = replace(windows, log=windows.log - curve.log_at(windows.height_m))
    levels: list[Level] = []
    rests = bool(windows.rests.any())
    reference = sigma = math.nan
    # Rest first where there is one: in flight the loop responds to the noise, so a level there may be a tenth too high.
    for flies in (False, True) if rests else (True, False):
        flown = windows.where(windows.flies == flies)
        groups = _groups(flown)
        if not groups:
            continue
        if math.isnan(reference):
            group = _reference(groups, flown)
            reference, sigma = group.level, group.sigma
        elif rests:
            reference = min((group.level for group in groups), key=lambda level: abs(level - reference))
        levels += [
            Level(
                sources=tuple(names[source] for source in sorted(group.sources)),
                flies=flies,
                ratio=math.exp(group.level - reference),
                error=group.error,
            )
            for group in groups
        ]
    return replace(curve, levels=tuple(levels), sigma=math.nan if rests else sigma)


def _reference(groups: Sequence[_Group], windows: _Windows) -> _Group:
    """The group of the reference level: that of the ball at rest, otherwise that with most windows."""
    if windows.rests.any():
        rests = [np.count_nonzero(windows.rests & np.isin(windows.source, group.sources)) for group in groups]
        return groups[int(np.argmax(rests))]
    return groups[0]


@dataclass(frozen=True, eq=False)
class _Group:
    """Sources that share a level, and their windows."""

    sources: tuple[int, ...]
    log: FloatArray

    @cached_property
    def level(self) -> float:
        return float(np.mean(self.log))

    @cached_property
    def error(self) -> float:
        return float(np.std(self.log, ddof=1)) / math.sqrt(len(self.log))

    @property
    def sigma(self) -> float:
        """Return the standard deviation; the mean of the logarithms is 5 % below it, the same for all groups."""
        return float(np.sqrt(np.mean(np.exp(2.0 * self.log))))

    def separation(self, other: _Group) -> float:
        """Return the difference of the levels in standard errors."""
        return abs(self.level - other.level) / math.hypot(self.error, other.error)


def _groups(windows: _Windows) -> list[_Group]:
    """Return the groups of sources that do not differ significantly (hierarchical merging); most windows first."""
    present, counts = np.unique(windows.source, return_counts=True)
    # Levels are compared as logarithms of squares: their scatter is the same for any level, and nearly normal for
    # windows of this length.  An F test of the squares would rely on Gaussian tails.
    present = present[counts >= settings.INSTRUMENT_WINDOWS]
    groups = [_Group((int(first),), windows.log[windows.source == first]) for first in present]
    surely = normal_exceeded(0.5 * settings.INSTRUMENT_CHANCE / max(math.comb(len(groups), 2), 1))
    while len(groups) > 1:
        # Merging from below, not splitting: with no difference all recordings end in one group, the simplest answer.
        # The level is that of all pairs together (Bonferroni).
        separation, first, second = min(
            ((a.separation(b), a, b) for a, b in combinations(groups, 2)), key=lambda pair: pair[0]
        )
        if separation > surely and abs(first.level - second.level) > math.log(TOLERANCE):
            break
        groups = [group for group in groups if group not in (first, second)]
        groups.append(_Group(first.sources + second.sources, np.concatenate((first.log, second.log))))
    return sorted(groups, key=lambda group: -len(group.log))


def _curve(windows: _Windows) -> Channel:
    """Test whether the noise depends on height, within flights first: recordings may differ by instrument."""
    flown = windows.where(windows.flies)
    fewest = settings.INSTRUMENT_WINDOWS * (settings.NOISE_BENDS + 1)
    if len(flown.log) < fewest or not _fitted(flown, flown.source).bend:
        return Channel()
    groups = _groups(flown)
    # Flights of one instrument alone: a difference between instruments would look like one between heights.
    comparable = windows.where(windows.rests | (windows.flies & np.isin(windows.source, groups[0].sources)))
    curve = _fitted(comparable, np.zeros(len(comparable.log), np.int64))
    if comparable.rests.any() and not _follows(comparable.where(comparable.flies), curve):
        return Channel()
    at = comparable.height_m[comparable.rests] if comparable.rests.any() else comparable.height_m
    return replace(curve, reference=float(np.mean(curve.log_at(at))))


def _follows(flown: _Windows, curve: Channel) -> bool:
    """Tell whether the flights agree with a curve through the ball at rest: no parabola fits significantly better.

    Crosstalk increases the apparent noise of all flights, and a curve from there to the ball at rest would be steep.
    """
    left = flown.log - curve.log_at(flown.height_m)
    height = flown.height_m - float(np.mean(flown.height_m))
    powers = np.column_stack([height**n for n in range(settings.NOISE_BENDS + 1)])
    after = left - powers @ np.linalg.lstsq(powers, left, rcond=None)[0]
    left = left - float(np.mean(left))
    gained = float(left @ left - after @ after) / float(np.var(after, ddof=settings.NOISE_BENDS + 1))
    return bool(chi2_above(gained, settings.NOISE_BENDS) > settings.INSTRUMENT_CHANCE)


def _fitted(windows: _Windows, group: IntArray) -> Channel:
    """Fit a polynomial over height, with a separate level for each group; `group` has shape (n,)."""
    low, high = (float(end) for end in np.quantile(windows.height_m, (0.01, 0.99)))
    height = np.clip(windows.height_m, low, high)
    log, curve = _within(windows.log, group), Channel()
    left = log
    for bends in range(1, settings.NOISE_BENDS + 1):
        powers = np.column_stack([_within(height**n, group) for n in range(1, bends + 1)])
        bend = np.linalg.lstsq(powers, log, rcond=None)[0]
        after = log - powers @ bend
        gained = float(left @ left - after @ after) / float(np.var(after, ddof=bends))
        change = float(np.std(left - after))
        # Significant and large: with many windows a bend of 1 % is significant, but does not matter.
        if chi2_above(gained, 1) > settings.INSTRUMENT_CHANCE or change < math.log(TOLERANCE):
            break
        curve, left = Channel(bend=tuple(bend.tolist()), range_m=(low, high)), after
    return curve


def _within(values: FloatArray, group: IntArray) -> FloatArray:
    """Return the values minus the mean of their group, shape (n,)."""
    means = np.bincount(group, values) / np.maximum(np.bincount(group), 1)
    return np.asarray(values - means[group])
