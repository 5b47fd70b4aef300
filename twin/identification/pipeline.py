"""Identification of a model from a campaign: the steps in order.

    recordings -> checks -> levels, step responses, lift-off -> starting values -> maximum likelihood of all innovations
               -> fit again without outliers -> fit again without unnecessary process noise
               -> whiteness, covariance, intervals -> verdicts

Rule 1: one parameter set explains the whole campaign.
Rule 2: each parameter has a verdict; one that cannot be estimated is marked as not identifiable.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from protocol.campaign import Campaign
from protocol.errors import DataError
from twin.estimation.gate import gate
from twin.estimation.innovations import FLIES, USE_I, USE_X
from twin.estimation.prepare import Usage, prepare
from twin.estimation.record import Record, day_of
from twin.estimation.structures import NOISES
from twin.estimation.whiteness import Whiteness, whiteness
from twin.evidence.checks.dead_channels import FLYING, without_dead
from twin.evidence.checks.plausibility import inspect
from twin.evidence.dead_time import delayed
from twin.evidence.starting.regression import BallStart
from twin.identification import verdicts
from twin.identification.delays import AMPLIFIER, LoopDelay, find_loop_delay, input_delay
from twin.identification.fit import Blocks, bare, fit
from twin.identification.horizon import Horizon, error_at
from twin.identification.intervals import Interval, quadratic_or_profile
from twin.identification.result import Identification, noise_of, provenance_of
from twin.identification.starts import find_starts
from twin.inference.likelihood import Criterion
from twin.inference.optimiser import Fit
from twin.inference.theta import BASE, FLOORS, Theta, max_drag
from twin.model.assumed import assumption_warning, mark
from twin.model.parameters import Model
from twin.readers.campaign import read_campaign
from twin.settings import identification as settings

_TICK_S = 2e-3


def identify(
    campaign: Campaign, *, data: Path | None = None, progress: Callable[[str], None] = lambda line: None
) -> Identification:
    """Identify the model of a campaign from its recordings for fitting; `progress` is called with lines.

    Raises:
        DataError: a recording is missing, unreadable or implausible, or none has use = "fit".
    """
    records = read_campaign(campaign, data=data)
    if not records:
        raise DataError(
            f'{campaign.where}: no recording has use = "fit"',
            remedy='Give at least one [[recording]] with use = "fit"',
        )
    progress(f"{len(records)} recordings, {sum(len(r.t) for r in records)} samples")
    return identify_records(campaign, records, progress=progress)


def identify_records(
    campaign: Campaign, records: list[Record], *, progress: Callable[[str], None] = lambda line: None
) -> Identification:
    """Run `identify` with recordings in memory.  Raises DataError."""
    plant = campaign.plant
    records, warnings = _prepared(campaign, records)
    delays = [input_delay(record, plant) for record in records]
    records = _aligned(records, delays, warnings)
    starts = find_starts(records, plant)
    progress("start values: " + starts.text(plant.mass_kg))

    # Not near x_max: (3) is too steep there for a linearisation, and three samples dominated a campaign.
    series, usages = prepare(records, plant, min_gap_m=settings.POLE_DISTANCE * plant.travel_m)
    for usage, samples in zip(usages, delays, strict=True):
        usage.input_delay = samples
    tick_s = _tick(records)
    estimate = _Estimate()
    flying = bool(((series.flags & (FLIES | USE_X)) == (FLIES | USE_X)).any())
    if starts.amplifier is not None and starts.amplifier.K_A > 0 and (series.flags & USE_I).any():
        free, start = BASE if flying else AMPLIFIER, starts.theta(starts.amplifier, plant.mass_kg)
        with closing(Criterion(bare(series), plant, tick_s)) as criterion:
            likelihood, top = _fitted(Blocks(criterion), start, free, usages, progress)
            if flying and top.theta.b >= 0.999 * max_drag(plant):
                top = _possible_drag(likelihood, top, starts.ball, warnings)
            progress("covariance and intervals")
            estimate = _estimated(likelihood, top, warnings)
    warnings += _left_out(usages)

    fitted, white = estimate.fit, estimate.white
    coloured = white is not None and not white.white
    ahead = None if white is None or not coloured else _misfit(records, campaign, fitted, white, tick_s, warnings)
    levels, shape, force, ball = starts.levels, starts.shape, starts.force, starts.ball
    held = fitted.theta.b if flying and fitted is not None else None
    intervals, loop_delay = estimate.intervals, estimate.loop_delay
    parameters = {
        "K_A": verdicts.gain(intervals.get("K_A"), levels, shape, warnings),
        "T_A": verdicts.time_constant(intervals.get("T_A"), shape, tick_s, warnings),
        "K_c": verdicts.force_constant(intervals.get("K_c"), force, ball, plant, warnings),
        "b": verdicts.drag(intervals.get("b"), held, ball, plant, warnings, coloured=coloured, loop_delay=loop_delay),
    }
    provenance = day_of(records) | provenance_of(campaign, fitted, white, usages, warnings, starts)
    noise = noise_of(fitted, records)
    model = Model(plant=plant, parameters=mark(parameters, plant), noise=noise, provenance=provenance)
    return Identification(
        model=model,
        converged=fitted is None or fitted.converged,
        warnings=tuple(dict.fromkeys(warnings)),
        usages=tuple(usages),
        levels=levels,
        shape=shape,
        force=force,
        fit=fitted,
        whiteness=white,
        ahead=ahead,
        tick_s=tick_s,
    )


def _prepared(campaign: Campaign, records: list[Record]) -> tuple[list[Record], list[str]]:
    """Return (the recordings without dead channels, warnings)."""
    warnings = [assumption_warning(campaign.plant)] if campaign.plant.assumed else []
    warnings += [note for record in records for note in record.notes]
    messages = inspect(records, campaign.plant, campaign.controller)
    records, left_out = without_dead(records, campaign.plant)
    return records, warnings + grouped(messages + left_out, [record.name for record in records])


def _aligned(records: list[Record], delays: list[int], warnings: list[str]) -> list[Record]:
    """The recordings with u_c shifted by its delay; `warnings` receives a sentence."""
    aligned = [delayed(record, samples) for record, samples in zip(records, delays, strict=True)]
    for samples in sorted(set(delays) - {0}):
        names = [record.name for record, delay in zip(aligned, delays, strict=True) if delay == samples]
        listed = names[0] + (f" and {len(names) - 1} more" if len(names) > 1 else "")
        warnings.append(
            f"{listed}: u_c acts {samples} sample(s) later than recorded, by the response of i_c; corrected in the "
            "fit. The model has no delay: shift the column, or let board51 diagnose confirm it"
        )
    return aligned


def _fitted(
    likelihood: Blocks,
    start: Theta,
    free: tuple[str, ...],
    usages: Sequence[Usage],
    progress: Callable[[str], None],
) -> tuple[Blocks, Fit]:
    """Return (the likelihood without outliers, its maximum); their number is added to `usages`."""
    fitted = fit(likelihood, start, free)
    progress(f"fit: {fitted.passes} passes over {len(likelihood.series)} samples")
    # Once, by the innovations of the first fit: every further round would cost a fit.
    gated, dropped = gate(likelihood.series, likelihood.white(fitted.theta), len(usages))
    if dropped.any():
        for usage, count in zip(usages, dropped, strict=True):
            usage.outliers += int(count)
        likelihood = Blocks(likelihood.whole.over(bare(gated)))
        fitted = fit(likelihood, fitted.theta, free)
    return likelihood, _parsimonious(likelihood, fitted)


@dataclass(frozen=True, kw_only=True)
class _Estimate:
    """The maximum of the likelihood, and what it is worth; without a fit where no recording shows the amplifier."""

    fit: Fit | None = None
    white: Whiteness | None = None
    intervals: Mapping[str, Interval] = field(default_factory=dict)
    loop_delay: LoopDelay | None = None


def _estimated(likelihood: Blocks, fitted: Fit, warnings: list[str]) -> _Estimate:
    if not fitted.converged:
        warnings.append(
            f"the fit has not converged after {fitted.passes} passes ({fitted.decrement:.2g} standard errors from "
            "a maximum): these numbers are the best so far. Check the recordings named above"
        )
    white = whiteness(likelihood.series, likelihood.white(fitted.theta))
    # The sandwich where residuals are coloured: the Fisher information is the error of a right model only.
    robust = None if white.white else likelihood.sandwich(fitted)
    return _Estimate(
        fit=fitted,
        white=white,
        intervals=quadratic_or_profile(likelihood, fitted, robust),
        # A delay colours the residuals: where they are white there is none to look for.
        loop_delay=find_loop_delay(likelihood, robust) if robust is not None and "b" in fitted.free else None,
    )


def _possible_drag(likelihood: Blocks, fitted: Fit, ball: BallStart | None, warnings: list[str]) -> Fit:
    """The fit with b held at a possible value, for a likelihood whose maximum has an impossible drag."""
    plant = likelihood.plant
    free = tuple(name for name in fitted.free if name != "b")
    possible = ball is not None and 0.0 <= ball.d * plant.mass_kg <= max_drag(plant)
    steady = ball.d * plant.mass_kg if ball is not None and possible else 0.0
    warnings.append(
        f"the best fit has more drag than b/m = {max_drag(plant) / plant.mass_kg:.0f} 1/s, the unstable pole: a ball "
        "in air has far less, so it replaces an effect that (6) lacks. "
        + ("b is from a regression over 60 ms windows instead" if possible else "b is left at 0, a placeholder")
        + "; board51 diagnose looks for the reason"
    )
    # Not left at the bound, where b replaces another effect: other numbers would be those beside an impossible drag.
    return fit(likelihood, replace(fitted.theta, b=steady), free)


def _misfit(
    records: list[Record], campaign: Campaign, fitted: Fit | None, white: Whiteness, tick_s: float, warnings: list[str]
) -> Horizon | None:
    """The prediction error of a model with coloured residuals; `warnings` receives sentences."""
    warnings.append(
        f"the residuals are not white (autocorrelation up to {white.worst:.2f}): not everything is explained. "
        "The intervals are those of its best approximation, and b is the least reliable; board51 diagnose looks "
        "for the cause"
    )
    flown = [record for record in records if record.kind in FLYING and record.has("x", "u_c")]
    if fitted is None or not flown or "K_c" not in fitted.free:
        return None
    ahead = error_at(settings.AHEAD_S, flown, campaign.plant, fitted.theta, tick_s)
    # Colour alone says little about the use of a model, so its prediction is compared with the simplest one.
    if ahead is not None and ahead.rmse_m > ahead.constant_m:
        warnings.append(
            f"{ahead.horizon_s * 1e3:.0f} ms ahead the model misses x by {ahead.rmse_m * 1e6:.0f} um rms, a constant "
            f"x by {ahead.constant_m * 1e6:.0f} um: it cannot be used for "
            "predictions. board51 diagnose extends it by what is missing"
        )
    return ahead


def grouped(messages: list[str], names: list[str]) -> list[str]:
    """Join lines "recording: text" with the same text into one line; other lines are unchanged."""
    lines: dict[str, list[str]] = {}
    for line in messages:
        name = next((name for name in names if line.startswith(f"{name}: ")), "")
        lines.setdefault(line.removeprefix(f"{name}: ") if name else line, []).append(name)
    result = []
    for text, owners in lines.items():
        more = f" and {len(owners) - 1} more" if len(owners) > 1 else ""
        result.append(f"{owners[0]}{more}: {text}" if owners[0] else text)
    return result


def _left_out(usages: list[Usage]) -> list[str]:
    messages = []
    for count, what in (
        ([u.outliers for u in usages], "outlying readings were left out"),
        ([u.gaps for u in usages], "gaps; the filter starts anew after each"),
        ([u.clipped for u in usages], "readings of i_c at the converter's end were left out"),
        (
            [u.steep_samples for u in usages],
            "samples so near to x_max that the force (3) is too steep to follow were left out; if the coil's plane is "
            "higher than that on this rig, correct x_max_m",
        ),
    ):
        where = [f"{usage.name} {n}" for usage, n in zip(usages, count, strict=True) if n]
        if where:
            listed = ", ".join(where[:3]) + (f" and {len(where) - 3} more recordings" if len(where) > 3 else "")
            messages.append(f"{sum(count)} {what} ({listed})")
    return messages


def _tick(records: list[Record]) -> float:
    flown = [r.interval_s for r in records if r.kind in FLYING and r.has("x", "u_c")]
    other = [r.interval_s for r in records if r.kind != "equilibria" and len(r.t) > 1]
    chosen = [step for step in (flown or other) if np.isfinite(step)]
    return float(np.median(chosen)) if chosen else _TICK_S


def _parsimonious(likelihood: Blocks, fitted: Fit) -> Fit:
    """The fit without process noises that do not improve the likelihood significantly.

    An unnecessary process noise widens the intervals.  If T_A is far below the sampling interval, a disturbance of the
    current cannot be distinguished from noise of its sensor.
    """
    for name in NOISES[2:]:
        # A noise level that is known so well is present; a fit without it would take long and be rejected.
        relative = fitted.std(name, likelihood.plant) / fitted.theta.value(name)
        if name not in fitted.free or (fitted.converged and 0.0 < relative < settings.NOISE_KNOWN):
            continue
        free = tuple(other for other in fitted.free if other != name)
        # Fitted without it, not tested by its standard error: 0 is the end of its range, where the likelihood is no
        # parabola.
        smaller = fit(likelihood, fitted.theta.having(name, FLOORS[name]), free)
        if smaller.loglik > fitted.loglik - settings.PROCESS_NOISE_GAIN:
            fitted = smaller
    return fitted
