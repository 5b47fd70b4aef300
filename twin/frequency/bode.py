"""Frequency responses of a campaign's flights, measured and of a model, by height.

    recordings ─> parts (excitation) ─> Spectra ─> Measured, Deviations ─> Verdict
    model ─> Curve, simulation of the parts ────────────┘

Rule 1: all recordings in closed loop are used, those that the model was fitted to as well: the notes name them.
Rule 2: u_c is the one that the board sent.  A delay of it that the identification corrected belongs to the model.
Rule 3: without the law there is neither loop gain nor simulation; amplifier, ball and plant remain.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TypeVar

import numpy as np

from twin.control import LawNumbers
from twin.estimation.prepare import flights
from twin.estimation.record import BoolArray, FloatArray, intervals
from twin.evidence.checks.control_law import law_gap
from twin.frequency.compare import Deviations, deviations
from twin.frequency.excitation import parts
from twin.frequency.margins import DRAWS, Margin, with_intervals
from twin.frequency.residual_psd import ResidualSpectrum, residual_spectra
from twin.frequency.responses import Curve, Name, Setting, curves, linear_responses, pairs
from twin.frequency.simulated import simulated
from twin.frequency.spectra import ComplexArray, Spectra, spectra
from twin.frequency.verdict import Verdict, judge
from twin.identification.pipeline import grouped
from twin.model.parameters import Model
from twin.model.simulate import left_out
from twin.validation.source import Source, filtered

SAME_HEIGHT = 0.05  # of the travel: parts nearer than that are of one height
CURVE_POINTS = 200
USABLE = 0.5  # standard deviation of L over its size, up to which it takes part in the margins
CERTAIN = 0.3  # standard deviation of a response over its size: a smaller one is a measurement


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """A measured response; arrays of shape (F,), by rising frequency."""

    f_hz: FloatArray
    value: ComplexArray
    std: FloatArray  # sqrt(E|error|^2)
    dof: FloatArray  # complex degrees of freedom of std
    coherence: FloatArray  # of the numerator with the reference

    @property
    def certain(self) -> BoolArray:
        """The frequencies at which this is a measurement."""
        return np.asarray(self.std < CERTAIN * np.abs(self.value))


T = TypeVar("T", Measured, Deviations)


@dataclass(frozen=True, slots=True, kw_only=True)
class Height:
    """The responses around one height."""

    x_m: float
    recordings: tuple[str, ...]
    measured: Mapping[Name, Measured]
    model: Mapping[Name, Curve]
    deviations: Mapping[Name, Deviations]
    margins: Mapping[str, Margin]  # measured; empty without a law
    model_margins: Mapping[str, Margin]


@dataclass(frozen=True, slots=True, kw_only=True)
class Bode:
    """The result."""

    model: Model
    heights: tuple[Height, ...]
    residuals: tuple[ResidualSpectrum, ...]
    verdict: Verdict
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Flown:
    """A part of a flight with its coefficients and those of the model's simulation."""

    name: str
    setting: Setting
    spectra: Spectra
    quiet: Spectra | None


def bode_of(sources: Sequence[Source], model: Model, *, messages: Sequence[str] = ()) -> Bode:
    """Compare the responses of recordings in memory with those of a model; the notes begin with `messages`."""
    notes = [*messages, *left_out(model)]
    flown = [part for source in sources for part in _flown(source, model, notes)]
    used = {part.name for part in flown}
    if fitted := [s.record.name for s in sources if s.record.use == "fit" and s.record.name in used]:
        notes.append(f"used to fit a model, which then looks too good if this is the model: {', '.join(fitted)}")
    heights = tuple(_height(group, model) for group in _grouped(flown, SAME_HEIGHT * model.plant.travel_m))
    runs = [run for s in sources if s.record.name in used and (run := filtered(s, model)) is not None]
    verdict = judge([(h.x_m, h.deviations, {n: m.certain for n, m in h.measured.items()}) for h in heights])
    return Bode(
        model=model,
        heights=heights,
        residuals=residual_spectra(runs),
        verdict=verdict,
        notes=tuple(grouped(list(dict.fromkeys(notes)), [s.record.name for s in sources])),
    )


def _flown(source: Source, model: Model, notes: list[str]) -> list[_Flown]:
    r = source.record
    if not r.has("u_c", "i_c", "x", "x_ref"):
        return []
    T_s = r.interval_s
    law = _law_of(source, model, notes)
    signals = np.stack((r.x_ref, r.u_c, r.i_c, r.x))
    step, follows = intervals(r.t)
    # Equal steps only: a transform has one sampling interval.
    usable = np.isfinite(signals).all(axis=0) & follows & (np.abs(step - T_s) < 0.05 * T_s)
    flying = np.zeros(len(r.t), np.bool_)
    for piece in flights(r, model.plant):
        flying[piece] = True
    result = []
    for part in parts(r.x_ref, np.asarray(usable & flying), T_s, model.plant.travel_m, lsb=r.lsb[1]):
        measured = signals[:, part.samples]
        made = spectra(measured, part, T_s)
        if made is None:
            continue
        setting = Setting(law=law, x_m=float(np.mean(measured[0])), sample_time_s=T_s, delay=source.delay)
        quiet = None
        if law is not None:
            driven_model = simulated(measured[0], model, law, delay=source.delay)
            quiet = None if driven_model is None else spectra(driven_model, part, T_s)
            if quiet is None:
                notes.append(
                    f"{r.name}: the model's loop does not hold the ball there; compared with its linearisation"
                )
        result.append(_Flown(name=r.name, setting=setting, spectra=made, quiet=quiet))
    return result


def _law_of(source: Source, model: Model, notes: list[str]) -> LawNumbers | None:
    r, law = source.record, source.law
    why = source.without_law
    if law is not None and abs(r.interval_s - law.sample_time_s) > 0.05 * law.sample_time_s:
        law, why = None, f"it is sampled every {r.interval_s * 1e3:.3g} ms, the law runs every other time"
    if law is not None and (gap := law_gap(r, model.plant, law)) is not None and gap.contradicted:
        law, why = None, f"the law does not give the recorded u_c: {gap.text()}"
    if law is None:
        notes.append(f"{r.name}: no loop gain, because {why}")
    return law


def _grouped(flown: Sequence[_Flown], reach_m: float) -> list[list[_Flown]]:
    groups: list[list[_Flown]] = []
    for part in sorted(flown, key=lambda item: item.setting.x_m):
        # From the first of the group, not from the last: a chain of near heights would become one group.
        if groups and part.setting.x_m - groups[-1][0].setting.x_m < reach_m:
            groups[-1].append(part)
        else:
            groups.append([part])
    return groups


def _height(group: Sequence[_Flown], model: Model) -> Height:
    measured: dict[Name, list[Measured]] = {}
    differing: dict[Name, list[Deviations]] = {}
    for part in group:
        for name, (item, difference) in _compared(part, model).items():
            measured.setdefault(name, []).append(item)
            differing.setdefault(name, []).append(difference)
    joined = {name: _joined(several) for name, several in measured.items()}
    x_m = float(np.mean([part.setting.x_m for part in group]))
    law = next((part.setting.law for part in group if part.setting.law is not None), None)
    # Curves and margins at the mean height.  The tests do not use them: each part was compared at its own height.
    setting = replace(group[0].setting, law=law, x_m=x_m)
    every = np.concatenate([m.f_hz for m in joined.values()] or [np.array([1.0])])
    # Below half the sampling rate, at which a sampled response has no phase.
    top = min(2.0 * every.max(), 0.49 / setting.sample_time_s)
    dense = np.geomspace(0.5 * every.min(), top, CURVE_POINTS)
    measured_margins, model_margins = _margins(joined.get("loop"), model, setting)
    return Height(
        x_m=x_m,
        recordings=tuple(dict.fromkeys(part.name for part in group)),
        measured=joined,
        model=curves(model, setting, dense),
        # S and T are functions of L: with them one difference would be tested three times.
        deviations={name: _joined(several) for name, several in differing.items() if name not in ("S", "T")},
        margins=measured_margins,
        model_margins=model_margins,
    )


def _compared(part: _Flown, model: Model) -> dict[Name, tuple[Measured, Deviations]]:
    s, law = part.spectra, part.setting.law
    at_bins = linear_responses(model, part.setting, s.bins_hz.ravel())
    middle = curves(model, part.setting, s.f_hz)
    model_pairs = {} if part.quiet is None else pairs(part.quiet, law)
    result: dict[Name, tuple[Measured, Deviations]] = {}
    for name, (top, bottom) in pairs(s, law).items():
        if name not in at_bins:
            continue
        h = at_bins[name].reshape(s.bins_hz.shape)
        expected = (
            s.on_r(model_pairs[name][0] - h * model_pairs[name][1]) if name in model_pairs else np.zeros(len(s.f_hz))
        )
        # Within a band the response has the model's shape; its size is measured.
        shaped = bottom * h / middle[name].value
        driven = s.on_r(shaped)
        # What the estimate adds by itself, such as leakage, is in the simulation as well, and is taken off.
        value = (s.on_r(top) - expected) / driven
        measured = Measured(
            f_hz=s.f_hz,
            value=value,
            std=np.sqrt(s.variance(top - value * shaped)) / np.abs(driven),
            dof=np.full(len(s.f_hz), s.dof),
            coherence=s.coherence(top),
        )
        difference = deviations(
            s, top - h * bottom, bottom, middle[name].value, middle[name].slopes, np.asarray(expected)
        )
        result[name] = (measured, difference)
    return result


def _joined(several: Sequence[T]) -> T:
    """Join the numbers of several parts, by rising frequency."""
    order = np.argsort(np.concatenate([part.f_hz for part in several]), kind="stable")
    names = [field.name for field in fields(several[0])]
    return replace(several[0], **{name: np.concatenate([getattr(p, name) for p in several])[order] for name in names})


def _margins(loop: Measured | None, model: Model, setting: Setting) -> tuple[dict[str, Margin], dict[str, Margin]]:
    """Return the margins of the measured loop gain, and those of the model's over all frequencies."""
    if loop is None or setting.law is None:
        return {}, {}
    rng = np.random.default_rng(1)
    f_hz, value, std = _merged(loop)
    # Half of the variance for either part: std^2 is that of the complex error.
    noise = rng.standard_normal((DRAWS, 2, len(f_hz))) * std / np.sqrt(2.0)
    measured = with_intervals(f_hz, value, list(value + noise[:, 0] + 1j * noise[:, 1]))
    # Not within the measured frequencies alone: the model is known at all of them.
    dense = np.geomspace(0.1, 0.49 / setting.sample_time_s, 2 * CURVE_POINTS)
    curve = curves(model, setting, dense).get("loop")
    if curve is None:
        return measured, {}
    relative = curve.slopes / curve.value[:, None]
    # Factors, not summands: ln |L| and the phase are drawn, in which the delta method is nearly right.
    drawn = [curve.value * np.exp(relative @ rng.standard_normal(relative.shape[1])) for _ in range(DRAWS // 2)]
    return measured, with_intervals(dense, curve.value, drawn)


def _merged(loop: Measured) -> tuple[FloatArray, ComplexArray, FloatArray]:
    """Return (frequencies, L, its standard deviation) of what is known; equal frequencies once, weighted."""
    keep = loop.std < USABLE * np.abs(loop.value)
    # Parts of one height share frequencies up to rounding, and the interpolation takes each once.
    f_hz = np.unique(np.round(loop.f_hz[keep], 6))
    value, std = np.empty(len(f_hz), dtype=complex), np.empty(len(f_hz))
    for k, f in enumerate(f_hz):
        same = keep & (np.abs(loop.f_hz - f) < 1e-5)
        # 1 / variance: of all weighted means of independent values this has the smallest variance.
        weight = loop.std[same] ** -2.0
        value[k], std[k] = np.sum(weight * loop.value[same]) / weight.sum(), weight.sum() ** -0.5
    return f_hz, value, std
