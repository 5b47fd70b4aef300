"""Errors of the baseline and the extended model: over the horizon, by regime, by frequency, as force, in steps.

Rule 1: errors are those of the judge recordings.  Without any, the recordings for fitting are used and `from_judges` is
        False; their errors are optimistic.
Rule 2: residual force and current are of the recordings for fitting, because open-loop flights reach states that the
        closed loop does not.
Rule 3: baseline and extended model are compared on the same samples with the same bootstrap blocks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from protocol.campaign import Controller, Plant
from twin.diagnosis.judge.prediction_gain import Gain, Yardstick
from twin.diagnosis.residuals.force import Curve, Filtered, current_curves, filtered, force_curves
from twin.diagnosis.residuals.groups import sorted_errors
from twin.diagnosis.residuals.regimes import Blocks, Estimate, Regime, blocks_of, estimate, means
from twin.diagnosis.residuals.spectrum import Spectrum, spectrum
from twin.diagnosis.residuals.step_response import Steps, step_responses
from twin.estimation.family import chance_of_worse, holm
from twin.estimation.record import FloatArray, runs
from twin.evidence.gather import Evidence
from twin.page.plain import plain

if TYPE_CHECKING:
    from twin.diagnosis.result import Diagnosis

HORIZON_S = 0.02  # horizon of the regimes
PIECE_S = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Ahead:
    """Root mean square errors at one horizon, m."""

    horizon_s: float
    baseline: Estimate
    extended: Estimate
    floor_m: float
    ratio: tuple[float, float]  # 95 % interval of extended over baseline
    removed: float  # removed part of the mean square above the floor; NaN if there was none
    count: int
    chance: float  # p value of the extended model's error being larger; NaN without a spread
    worse: bool = False  # whether it is, by `family.holm` over all groups and horizons


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """A stretch of one recording: x, and the predictions of both models 20 ms ahead; shape (n,)."""

    recording: str
    t_s: FloatArray
    x_m: FloatArray
    baseline_m: FloatArray
    extended_m: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """The numbers of the report's figures."""

    from_judges: bool  # whether errors are of judge recordings
    ahead: tuple[Ahead, ...]
    piece: Piece | None
    regimes: tuple[Regime, ...]
    spectrum: Spectrum | None
    force: tuple[Curve, ...]
    current: tuple[Curve, ...]
    steps: Steps | str  # a string: the reason why there are none
    floor_m: float  # at HORIZON_S

    def worse(self) -> list[str]:
        """Return the horizons and groups in which the extended model is significantly worse."""
        horizons = [f"{entry.horizon_s * 1e3:.3g} ms ahead" for entry in self.ahead if entry.worse]
        return horizons + [
            f"{regime.title}: {entry.label}" for regime in self.regimes for entry in regime.bins if entry.worse
        ]


def summarise(diagnosis: Diagnosis, controller: Controller | None, *, quick: bool = False, seed: int = 0) -> Summary:
    """Compute the residuals of a diagnosis.

    Args:
        diagnosis: of `diagnose`.
        controller: the law of the closed-loop recordings.
        quick: whether to leave out the closed-loop simulation.
        seed: of the bootstrap.
    """
    plant = diagnosis.extended.plant
    judge = diagnosis.judge_evidence
    from_judges = judge is not None and bool(diagnosis.gains)
    # Without judges the recordings for fitting serve, marked as such.  Without any errors the report could not say
    # where the model fails.
    evidence = judge if judge is not None and from_judges else diagnosis.fit_evidence
    gains = diagnosis.gains if from_judges else _gains_on(diagnosis, evidence, plant, seed)
    blocks = blocks_of(evidence.series.recording, diagnosis.tick_s, seed)
    models = _models(diagnosis, evidence, plant)
    at_20_ms = _at_horizon(gains, HORIZON_S)
    bins: tuple[Regime, ...] = ()
    piece = None
    if at_20_ms is not None:
        bins = sorted_errors(at_20_ms.errors_m, evidence, models[1], blocks)
        piece = _piece(at_20_ms.errors_m, evidence, diagnosis.tick_s)
    next_sample = _at_horizon(gains, diagnosis.tick_s)
    ahead, bins = _with_holm(tuple(_ahead(gain_, blocks) for gain_ in gains), bins)
    return Summary(
        from_judges=from_judges,
        ahead=ahead,
        piece=piece,
        regimes=bins,
        spectrum=spectrum(next_sample.errors_m, next_sample.floor_m, diagnosis.tick_s)
        if next_sample is not None
        else None,
        **_residuals(diagnosis, evidence, models, plant, seed),
        steps="left out by --quick"
        if quick
        else step_responses(
            evidence.records, diagnosis.before, diagnosis.after, diagnosis.floor, plant, controller, diagnosis.tick_s
        ),
        floor_m=at_20_ms.floor_m if at_20_ms is not None else math.nan,
    )


def to_dict(summary: Summary) -> dict[str, Any]:
    """The numbers for diagnosis.json, in SI units; traces are left out, and NaN becomes None."""
    parts: dict[str, object] = {"judged": summary.from_judges}
    parts |= {name: value for name, value in asdict(summary).items() if name not in ("from_judges", "piece")}
    if isinstance(summary.steps, Steps):
        figures = [(asdict(first), asdict(second)) for first, second in summary.steps.figures]
        parts["steps"] = {"count": summary.steps.count, "baseline_and_extended": figures}
    else:
        parts["steps"] = {"not_testable": summary.steps}
    return plain(parts, 6)


def _models(diagnosis: Diagnosis, evidence: Evidence, plant: Plant) -> tuple[Filtered, Filtered]:
    return (
        filtered(evidence, diagnosis.before, plant, diagnosis.tick_s),
        filtered(evidence, diagnosis.after, plant, diagnosis.tick_s),
    )


def _gains_on(diagnosis: Diagnosis, evidence: Evidence, plant: Plant, seed: int) -> tuple[Gain, ...]:
    yardstick = Yardstick(judge=evidence, floor=diagnosis.floor, plant=plant, tick_s=diagnosis.tick_s, seed=seed)
    results = (
        yardstick.gain(diagnosis.before, diagnosis.after, samples)
        for samples in sorted({1, max(round(HORIZON_S / diagnosis.tick_s), 1)})
    )
    return tuple(result for result in results if result is not None)


def _at_horizon(gains: Sequence[Gain], horizon_s: float) -> Gain | None:
    return min(gains, key=lambda result: abs(result.horizon_s - horizon_s), default=None)


def _ahead(result: Gain, blocks: Blocks) -> Ahead:
    known = np.isfinite(result.errors_m).all(axis=0)
    labels = np.where(known, 0, -1).astype(np.int64)
    sides, draws = [], []
    for errors in result.errors_m:
        mean, square_draws, _, _ = means(np.where(known, errors**2, 0.0), labels, 1, blocks)
        draws.append(np.sqrt(square_draws[:, 0]))
        sides.append(estimate(float(np.sqrt(mean[0])), draws[-1]))
    return Ahead(
        horizon_s=result.horizon_s,
        baseline=sides[0],
        extended=sides[1],
        floor_m=result.floor_m,
        ratio=result.ci95_ratio,
        removed=result.removed,
        count=result.count,
        chance=chance_of_worse(result.ratio, draws[1] / np.maximum(draws[0], 1e-300)),
    )


def _with_holm(ahead: tuple[Ahead, ...], regimes: tuple[Regime, ...]) -> tuple[tuple[Ahead, ...], tuple[Regime, ...]]:
    """The same with `worse` decided over all of them as one family of tests."""
    bins = [entry for regime in regimes for entry in regime.bins]
    # Over all horizons and groups together: each at 5 %, a right model would fail in one of fifty on most pages.
    significant = iter(holm([*(entry.chance for entry in ahead), *(entry.chance for entry in bins)]))
    return (
        tuple(replace(entry, worse=next(significant)) for entry in ahead),
        tuple(
            replace(regime, bins=tuple(replace(entry, worse=next(significant)) for entry in regime.bins))
            for regime in regimes
        ),
    )


def _piece(errors_m: FloatArray, evidence: Evidence, tick_s: float) -> Piece | None:
    """The two seconds (or half a second) with the largest error of the baseline and predictions throughout."""
    s = evidence.series
    known = np.asarray(np.isfinite(errors_m).all(axis=0))
    best: tuple[float, slice] | None = None
    for shorter in (1.0, 0.25):
        length = max(round(shorter * PIECE_S / tick_s), 2)
        for piece in runs(known, length):
            sums = np.concatenate(([0.0], np.cumsum(errors_m[0, piece] ** 2)))
            # The worst stretch and not a typical one: there the reader sees what the model gets wrong.
            totals = sums[length:] - sums[:-length]
            start = int(np.argmax(totals))
            if best is None or totals[start] > best[0]:
                best = float(totals[start]), slice(piece.start + start, piece.start + start + length)
        if best is not None:
            break
    if best is None:
        return None
    part = best[1]
    return Piece(
        recording=evidence.records[int(s.recording[part.start])].name,
        t_s=evidence.t[part],
        x_m=s.x[part],
        baseline_m=s.x[part] + errors_m[0, part],
        extended_m=s.x[part] + errors_m[1, part],
    )


def _residuals(
    diagnosis: Diagnosis, evidence: Evidence, models: tuple[Filtered, Filtered], plant: Plant, seed: int
) -> dict[str, Any]:
    """Return the residual curves of the recordings for fitting."""
    force: tuple[Curve, ...] = ()
    current: tuple[Curve, ...] = ()
    fit = diagnosis.fit_evidence
    if len(fit.series):
        fit_models = models if evidence is fit else _models(diagnosis, fit, plant)
        blocks = blocks_of(fit.series.recording, diagnosis.tick_s, seed)
        force = tuple(force_curves(fit_models, fit, blocks))
        current = tuple(current_curves(fit_models, fit, diagnosis.tick_s, blocks))
    return {"force": force, "current": current}
