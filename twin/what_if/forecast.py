"""The forecast: a flight under another law or another reference, with intervals.

Each draw takes parameters from their intervals, splits the recorded flight with them, and replays blocks of its
disturbances.  So the spread of the draws holds the uncertainty of the parameters, the noise, and what the model does
not explain.

Rule 1: parameters are drawn independently, as a model file has no covariances.  The disturbances of the split make up
        for most of a wrong draw.
Rule 2: disturbances are drawn in blocks, which keeps their colour (H. R. Kuensch, The Jackknife and the Bootstrap for
        General Stationary Observations, Annals of Statistics 17 (1989)).  They do not follow x: a disturbance that
        belongs to one position is spread over the flight.
Rule 3: the blocks are drawn twice.  The recorded flight is one sample of the noise and the predicted flight another:
        the interval of a prediction has both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.control import LawNumbers
from twin.estimation.record import FloatArray, Record
from twin.estimation.step_figures import FIGURES, find_steps, measure
from twin.model.assumed import assumption_warning
from twin.model.causes.catalogue import BY_NAME
from twin.model.parameters import PARAMETERS, Model, Parameter
from twin.validation.source import Source
from twin.what_if.flight import Flight, fly, split
from twin.what_if.replay import NEVER, Reference

DRAWS = 100
BLOCK_S = 0.2
ROUNDED = 0.02  # share by which rounding to the board's numbers may change a law
CI = (0.025, 0.5, 0.975)
# Besides those of each step: from the first step on.
WHOLE = {"rms_m": ("rms of x_ref - x", "µm", 1e6), "at_limit": ("time with u_c at a limit", "%", 100.0)}
ALL_FIGURES = FIGURES | WHOLE


@dataclass(frozen=True, slots=True, kw_only=True)
class Expected:
    """A figure of the flight, SI units."""

    name: str  # of ALL_FIGURES
    recorded: float  # mean over the steps of the recorded flight; NaN: not every step has it
    value: float  # median of the draws
    ci95: tuple[float, float]
    draws: int  # that have it
    flown: float = math.nan  # of the flight that followed

    @property
    def held(self) -> bool:
        """Return whether the interval holds the flight that followed."""
        return self.ci95[0] <= self.flown <= self.ci95[1]


@dataclass(frozen=True, slots=True, kw_only=True)
class Forecast:
    """A forecast; arrays have shape (n,), those of the draws' quantiles 2.5, 50 and 97.5 % shape (3, n)."""

    recording: str
    model: str
    t_s: FloatArray
    x_ref_m: FloatArray
    recorded_x_m: FloatArray  # empty under another reference
    recorded_u_v: FloatArray
    x_m: FloatArray
    u_v: FloatArray
    figures: tuple[Expected, ...]
    steps: int
    lost: int  # draws in which the ball reaches a stop
    draws: int
    notes: tuple[str, ...]
    flown_x_m: FloatArray  # of the flight that followed, from the same first step on; empty without one
    flown_u_v: FloatArray

    def answer(self) -> str:
        """Return at most three sentences: whether the ball stays in flight, a figure that changes, what was flown."""
        known = [figure for figure in self.figures if math.isfinite(figure.flown) and figure.draws]
        if not known:
            return self._expected()
        held = sum(figure.held for figure in known)
        return f"{self._expected()} Of {len(known)} figures of the flight that followed, {held} are in their intervals."

    def _expected(self) -> str:
        if self.lost == self.draws:
            return "The ball is lost in every draw: do not fly this law."
        if self.lost:
            return f"The ball is lost in {self.lost} of {self.draws} draws: do not fly this law on the rig."
        known = [figure for figure in self.figures if math.isfinite(figure.recorded) and figure.draws]
        changed = [figure for figure in known if not figure.ci95[0] <= figure.recorded <= figure.ci95[1]]
        if not changed:
            return "The ball stays in flight. No figure is expected to differ from the recorded flight."
        return f"The ball stays in flight. Expected: {sentence(changed[0])}."


def sentence(figure: Expected) -> str:
    """Write a figure with its interval and its recorded value."""
    title, unit, factor = ALL_FIGURES[figure.name]
    value, low, high, recorded = (f"{factor * v:.3g}" for v in (figure.value, *figure.ci95, figure.recorded))
    return f"{title} {value} {unit} ({low} to {high}), recorded {recorded} {unit}"


def forecast(
    source: Source,
    model: Model,
    law: LawNumbers,
    *,
    x_ref_m: FloatArray | None = None,
    then: Source | None = None,
    seed: int = 1,
    draws: int = DRAWS,
) -> Forecast:
    """Predict the recorded flight under another law, or another reference.

    Args:
        source: the recorded flight.
        model: of the rig, with its causes.
        law: to fly with.
        x_ref_m: reference by tick, m; None: the recorded one.
        then: the flight that followed under `law`, to be compared with the forecast; None: it was not flown.
        seed: of the draws.
        draws: their number.

    Raises:
        DataError: the recording has no flight that is long enough.
    """
    rng = np.random.default_rng(seed)
    flight = split(source, model)
    recorded = flight.record
    other = x_ref_m is not None
    x_ref = np.ascontiguousarray(recorded.x_ref if x_ref_m is None else x_ref_m)
    # The first draw has the parameters of the model itself, whose flight is split already.
    flown = [_draw(flight if n == 0 else split(source, drawn(model, rng)), law, x_ref, rng) for n in range(draws)]
    flights = [out for out, lost in flown if lost == NEVER]
    shape = (3, len(x_ref))
    none = np.zeros(0)
    sigma_m = model.noise.sigma_x_m
    rows = [figures_of(x_ref, out[1], out[2], law, sigma_m) for out in flights]
    own = [] if other else figures_of(x_ref, recorded.x, recorded.u_c, law, sigma_m)
    followed = None if then is None else split(then, model).record
    after = [] if followed is None else figures_of(followed.x_ref, followed.x, followed.u_c, law, sigma_m)
    return Forecast(
        recording=recorded.name,
        model=model.name,
        t_s=np.arange(0.0, len(x_ref)) * law.sample_time_s,
        x_ref_m=x_ref,
        recorded_x_m=none if other else recorded.x,
        recorded_u_v=none if other else recorded.u_c,
        x_m=np.quantile([out[1] for out in flights], CI, axis=0) if flights else np.full(shape, np.nan),
        u_v=np.quantile([out[2] for out in flights], CI, axis=0) if flights else np.full(shape, np.nan),
        figures=_expected(rows, own, after),
        steps=len(find_steps(x_ref, law.sample_time_s, sigma_m)),
        lost=draws - len(flights),
        draws=draws,
        notes=(*recorded.notes, *_cautions(source, model), *(_same_law(then, law) if then is not None else ())),
        flown_x_m=none if followed is None else _beside(followed, followed.x, x_ref),
        flown_u_v=none if followed is None else _beside(followed, followed.u_c, x_ref),
    )


def _beside(record: Record, values: FloatArray, x_ref: FloatArray) -> FloatArray:
    """Shift values so that the first change of the reference is at that of `x_ref`; NaN where there are none."""
    shift = first_change(record.x_ref) - first_change(x_ref)
    at = np.arange(len(x_ref)) + shift
    known = (at >= 0) & (at < len(values))
    return np.where(known, values[np.clip(at, 0, len(values) - 1)], np.nan)


def first_change(x_ref: FloatArray) -> int:
    """Return the index of the first sample before a change of the reference; 0: it does not change."""
    moves = np.flatnonzero(np.abs(np.diff(x_ref)) > 0.0)
    return int(moves[0]) if len(moves) else 0


def _same_law(then: Source, law: LawNumbers) -> list[str]:
    """Return a sentence where the flight that followed was flown under another law."""
    # Operating point and gains: limits and T_s do not make another law.
    if then.law is None or np.allclose(then.law[:8], law[:8], rtol=ROUNDED, atol=0.0):
        return []
    return [f"{then.record.name} was flown under another law than that of the forecast"]


def _cautions(source: Source, model: Model) -> list[str]:
    """Return the sentences on what makes the forecast doubtful."""
    notes = [assumption_warning(model.plant)] if model.plant.assumed else []
    if source.unknown_delay:
        notes.append(
            f"u_c acts {source.unknown_delay} sample(s) later than recorded, which the model does not include: a law "
            "with higher gains may lose the ball although this forecast does not"
        )
    return notes


def drawn(model: Model, rng: np.random.Generator) -> Model:
    """The model with its parameters drawn from normal distributions within their physical ranges."""
    causes = []
    for cause in model.causes:
        ranges = {known.name: (known.low, known.high) for known in BY_NAME[cause.name].parameters}
        parameters = {name: _drawn(p, *ranges[name], rng) for name, p in cause.parameters.items()}
        causes.append(replace(cause, parameters=parameters))
    parameters = {name: _drawn(p, *PARAMETERS[name][1:], rng) for name, p in model.parameters.items()}
    return replace(model, parameters=parameters, causes=tuple(causes))


def _drawn(parameter: Parameter, low: float, high: float, rng: np.random.Generator) -> Parameter:
    if parameter.std is None:
        return parameter
    # Clipped, not drawn again: so each draw takes as many random numbers, and a seed gives one flight.
    return replace(parameter, value=float(np.clip(rng.normal(parameter.value, parameter.std), low, high)))


def _draw(flight: Flight, law: LawNumbers, x_ref: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, int]:
    step = np.full(len(x_ref), law.sample_time_s)
    length = max(round(BLOCK_S / law.sample_time_s), 1)
    order = _blocks(len(flight.disturbed.readings), len(x_ref), length, rng)
    return fly(flight, law, Reference(x_ref, step, order))


def _blocks(available: int, wanted: int, length: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return the disturbance of each sample: blocks drawn from a drawn sample of blocks, circularly."""
    pool = rng.integers(available, size=-(-available // length))
    begins = rng.choice(pool, size=-(-wanted // length))
    # Circular: samples near the ends are drawn as often as others (D. N. Politis, J. P. Romano, 1992).
    order: NDArray[np.int64] = ((begins[:, None] + np.arange(length)) % available).ravel()[:wanted]
    return order


def figures_of(x_ref: FloatArray, x: FloatArray, u: FloatArray, law: LawNumbers, sigma_x_m: float) -> list[float]:
    """Return the figures of a flight in the order of ALL_FIGURES; NaN where not every step has one."""
    steps = find_steps(x_ref, law.sample_time_s, sigma_x_m)
    table = [measure(x, u, x_ref, step, law.sample_time_s, sigma_x_m) for step in steps]
    means = np.mean(table, axis=0).tolist() if table else [math.nan] * len(FIGURES)
    # Before the first step the loop still settles from the state in which the recording began.
    part = slice(steps[0].begin if steps else 0, None)
    # Near the limit counts as at it: rounding to the converter's counts keeps u_c from being exactly there.
    margin = 1e-3 * (law.u_high - law.u_low)
    limited = (u[part] <= law.u_low + margin) | (u[part] >= law.u_high - margin)
    return [*means, float(np.sqrt(np.nanmean((x_ref - x)[part] ** 2))), float(np.mean(limited))]


def _expected(
    rows: Sequence[Sequence[float]], recorded: Sequence[float], flown: Sequence[float]
) -> tuple[Expected, ...]:
    figures = []
    for n, name in enumerate(ALL_FIGURES):
        values = np.array([row[n] for row in rows])
        known = values[np.isfinite(values)]
        low, middle, high = np.quantile(known, CI).tolist() if len(known) else (math.nan,) * 3
        figures.append(
            Expected(
                name=name,
                recorded=recorded[n] if recorded else math.nan,
                value=middle,
                ci95=(low, high),
                draws=len(known),
                flown=flown[n] if flown else math.nan,
            )
        )
    return tuple(figures)
