"""The parts of a validation, and its verdict in one sentence.

Rule: a part that the campaign cannot test is a string with the reason; it is never counted as passed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from protocol.campaign import Campaign
from protocol.errors import DataError
from twin.estimation.step_figures import (
    FIGURES,
    Compared,
    LoopRun,
    Response,
    RigFigure,
    compare_steps,
    definition,
    responses,
    rig_figures,
)
from twin.model.assumed import assumption_warning
from twin.model.parameters import Model
from twin.model.simulate import left_out
from twin.validation.amplifier import Amplifier, amplifier, fit_percent
from twin.validation.ball import Ahead, Windows, multi_step, windows
from twin.validation.loop import closed_loops, measured_loops
from twin.validation.residuals import Channel, residuals
from twin.validation.source import FLYING, Filtered, Source, chosen, filtered

RMSE_TOLERANCE = 1.5  # of a simulation's error over that of noise alone: a smaller one is not visible in the figure


@dataclass(frozen=True, slots=True, kw_only=True)
class ClosedLoop:
    """Figures 11 and 12 in numbers."""

    runs: tuple[LoopRun, ...]
    fit_percent: float  # of the noise-free simulation
    rmse_m: float
    expected_m: float  # rmse of a right model due to noise; NaN if the model's loop is unstable
    steps: tuple[Compared, ...]
    responses: tuple[Response, ...]
    without: tuple[str, ...]  # reasons why recordings could not be simulated


@dataclass(frozen=True, slots=True, kw_only=True)
class Validation:
    """The result; a part that is a string gives the reason why it is not testable."""

    model: Model
    amplifier: Amplifier | str
    windows: Windows | str
    ahead: tuple[Ahead, ...]
    channels: tuple[Channel, ...] | str
    loop: ClosedLoop | str
    measured: tuple[LoopRun, ...]  # closed loops that could not be simulated
    rig_figures: tuple[RigFigure, ...]  # of the rig's steps in `measured`
    flown: tuple[str, ...]  # names of the recordings in flight
    notes: tuple[str, ...]

    @property
    def passed(self) -> bool | None:
        """Return whether all testable parts agree with the model; None without a flight that is long enough."""
        if isinstance(self.channels, str) and isinstance(self.loop, str):
            return None
        return not self.failures()

    def failures(self) -> list[str]:
        """Return the clauses on the contradictions to the model, most important first."""
        messages = []
        if bad := [row for row in self.ahead if not row.at_floor]:
            row = max(bad, key=lambda r: r.ratio)
            messages.append(
                f"its error {row.horizon_s * 1e3:.0f} ms ahead is {row.rmse_m * 1e6:.3g} µm, "
                f"{row.ratio:.3g} times what noise alone leaves"
            )
        # Only where no horizon beats a constant x: 40 ms ahead a right model of a noisy rig does not, either.
        if self.ahead and not any(row.beats_still for row in self.ahead):
            row = self.ahead[0]
            messages.append(
                f"it predicts nothing: {row.horizon_s * 1e3:.0f} ms ahead its error is {row.rmse_m * 1e6:.3g} µm, more "
                f"than the {row.still_m * 1e6:.3g} µm of a constant x"
            )
        if not isinstance(self.channels, str):
            for channel in self.channels:
                faults = [
                    text
                    for text, right in (
                        ("are correlated in time", channel.white),
                        ("depend on u_c", channel.independent),
                        (f"are {np.sqrt(channel.chi2):.3g} times the stated size", channel.size_right),
                    )
                    if not right
                ]
                if faults:
                    messages.append(f"the residuals of {channel.name} {' and '.join(faults)}")
        if not isinstance(self.loop, str):
            ratio = self.loop.rmse_m / self.loop.expected_m
            # `not <=`, because a ratio that is not a number fails, too.
            if not ratio <= RMSE_TOLERANCE:
                messages.append(
                    "its closed loop is unstable"
                    if not np.isfinite(ratio)
                    else f"the closed loop differs by {self.loop.rmse_m * 1e6:.3g} µm rms, {ratio:.2g} times the noise"
                )
        if not isinstance(self.amplifier, str) and self.amplifier.from_steps:
            ratio = self.amplifier.rmse_a / self.amplifier.noise_a
            if not ratio <= RMSE_TOLERANCE:
                messages.append(f"(1) misses the amplifier's current by {ratio:.2g} times the sensor's noise")
        return messages

    def answer(self) -> str:
        """Return at most two short sentences: the verdict with its largest number, and the next thing to know."""
        if self.passed is None:
            return "The model of the ball could not be tested on this campaign."
        if not self.passed:
            verdict = f"The model does not explain these recordings: {self.failures()[0]}."
            return f"{verdict} `board51 diagnose` looks for the cause."
        first = "The model explains these recordings"
        if self.ahead:
            row = max((row for row in self.ahead if row.beats_still), key=lambda r: r.horizon_s)
            first += f": {row.horizon_s * 1e3:.0f} ms ahead its error is {row.ratio:.2f} times the noise floor"
        if isinstance(self.loop, str):  # the page names where
            return f"{first}. The closed loop could not be compared: {self.loop.rsplit(' (', 1)[0]}."
        differing = sorted((row for row in self.loop.steps if row.significant), key=_weight, reverse=True)
        if not differing:
            return f"{first}. The closed loop agrees."
        largest = differing[0]
        _, unit, factor = FIGURES[largest.name]
        rig, simulation = (f"{value * factor:.4g} {unit}" for value in (largest.rig, largest.simulation))
        return f"{first}. The {definition(largest.name, largest.bands)} is {rig}, simulated {simulation}."

    def pace(self) -> str:
        """A sentence on the differences of the steps of rig and simulation, largest first; '' without steps.

        It quantifies the paper's remark that the rig takes longer to reach the reference.
        """
        if isinstance(self.loop, str) or not self.loop.steps:
            return ""
        rows = self.loop.steps
        messages = [_difference(row) for row in sorted(rows, key=_weight, reverse=True) if row.significant]
        count = max(row.count for row in rows)
        if messages:
            more = f"; {len(messages) - MAX_DIFFERENCES} more below" if len(messages) > MAX_DIFFERENCES else ""
            listed = "; ".join(messages[:MAX_DIFFERENCES])
            text = f"The steps of rig and simulation differ, over {count} steps: {listed}{more}."
        elif all(row.ci95 is None for row in rows):
            intervals = [_difference(row) for row in rows if row.count and row.name in _PACE]
            text = f"In the one step {'; '.join(intervals)} (no interval)."
        else:
            intervals = [_difference(row) for row in rows if row.ci95 is not None and row.name in _PACE]
            text = f"The {count} steps of rig and simulation do not differ measurably"
            text += f": {'; '.join(intervals)}." if intervals else "."
        settling = next(row for row in rows if row.name == "settling_s")
        tried = settling.steps - settling.too_small
        if min(settling.rig_count, settling.simulation_count) < tried:
            text += (
                f" Within its dwell the rig settled in {settling.rig_count} of {tried} steps, the simulation in "
                f"{settling.simulation_count}."
            )
        return text


MAX_DIFFERENCES = 3
_PACE = ("rise_s", "settling_s")


def _weight(row: Compared) -> float:
    """Return the relative difference: overshoot as a share of the step, others as a share of the larger value."""
    if row.name == "overshoot":
        return abs(row.difference)
    # Of the larger value: as a share of one side it would depend on which side that is, and be infinite for 0.
    larger = max(abs(row.rig), abs(row.simulation))
    return abs(row.difference) / larger if larger > 0.0 else 0.0


def _difference(row: Compared) -> str:
    """A clause on one figure of rig and simulation, with its definition and the interval of the difference."""
    _, unit, factor = FIGURES[row.name]
    text = (
        f"{definition(row.name, row.bands)} {row.rig * factor:.4g} {unit} for the rig, {row.simulation * factor:.4g} "
        f"{unit} simulated"
    )
    if row.ci95 is None:
        return text
    low, high = (end * factor for end in row.ci95)
    return f"{text} (difference {low:+.3g} to {high:+.3g} {unit})"


def check_same_rig(campaign: Campaign, model: Model) -> None:
    """Raise DataError if the model is of another rig than the campaign."""
    for name in ("mass_kg", "travel_m", "x_max_m"):
        in_model, in_campaign = getattr(model.plant, name), getattr(campaign.plant, name)
        # A thousandth: typed and computed numbers differ in the last digits, two rigs by more.
        if abs(in_model - in_campaign) > 1e-3 * abs(in_campaign):
            raise DataError(
                f"The model has {name} = {in_model:g}, the campaign {in_campaign:g}: they describe different rigs",
                remedy=f"Give a model of the campaign's rig ({campaign.plant.name}), e.g. of `board51 identify`",
            )


def validate_sources(
    sources: Sequence[Source],
    model: Model,
    *,
    messages: Sequence[str] = (),
    progress: Callable[[str], None] = lambda _: None,
) -> Validation:
    """Validate a model on recordings; the notes begin with `messages`, and `progress` is called with lines."""
    notes = [assumption_warning(model.plant)] if model.plant.assumed else []
    notes += [*messages, *(note for source in sources for note in source.record.notes), *left_out(model)]
    notes += [
        f"{name} = {p.value:.4g} {p.unit} is not identified: {p.method or 'the model gives no interval'}"
        for name, p in model.parameters.items()
        if p.verdict == "not-identifiable"
    ]
    judges, fitted = chosen([s for s in sources if s.record.kind in FLYING])
    if fitted and judges:
        notes.append("no flight is for judging: the model may have been fitted to these, and then looks too good")
    for delay in sorted({source.delay for source in judges} - {0}):
        count = sum(source.delay == delay for source in judges)
        notes.append(
            f"in {count} recording(s) u_c acts {delay} sample(s) later than recorded, as in those that the model was "
            "made from: corrected here as there"
        )
    for source in judges:
        if source.unknown_delay:
            more = "" if not source.delay else "still "
            notes.append(
                f"{source.record.name}: u_c acts {source.unknown_delay} sample(s) {more}later than recorded, by the "
                "response of i_c; the model has no such delay"
            )
    progress("filtering")
    runs: list[Filtered] = [run for source in judges if (run := filtered(source, model)) is not None]
    if sum(run.wild for run in runs):
        where = ", ".join(f"{run.source.record.name} {run.wild}" for run in runs if run.wild)
        notes.append(f"{sum(run.wild for run in runs)} outlying readings were left out ({where})")
    unflown = "no recording shows the ball in flight with u_c and i_c"
    progress("predicting")
    shortest = windows(runs) if runs else None
    channels = residuals(runs)
    progress("simulating the closed loop")
    loop = _closed_loop(runs, model, unflown)
    measured: tuple[LoopRun, ...] = ()
    if isinstance(loop, str):
        measured = tuple(
            part for run in runs if run.source.record.kind == "closed-loop" for part in measured_loops(run)
        )
    return Validation(
        model=model,
        amplifier=amplifier(sources, model),
        windows=shortest or (unflown if not runs else "no flight is long enough for a window of 40 ms"),
        ahead=multi_step(runs),
        channels=channels or (unflown if not runs else "too few samples in flight"),
        loop=loop,
        measured=measured,
        rig_figures=rig_figures(measured, float(runs[0].system.noise.sigma_x_m)) if measured else (),
        flown=tuple(run.source.record.name for run in runs),
        notes=tuple(dict.fromkeys(notes)),
    )


def _closed_loop(runs: list[Filtered], model: Model, unflown: str) -> ClosedLoop | str:
    flown = [run for run in runs if run.source.record.kind == "closed-loop"]
    if not flown:
        return "no recording in closed loop" if runs else unflown
    loops, without = closed_loops(flown, model)
    if not loops:
        return "; ".join(dict.fromkeys(without))
    measured, quiet = (np.concatenate(parts) for parts in ([r.x_m for r in loops], [r.quiet_x_m for r in loops]))
    known = np.isfinite(measured)
    error = (measured - quiet)[known]
    # Weighted by samples, as the rmse is: the expected error differs between heights.
    expected = [r.expected_std_m**2 * len(r.x_m) for r in loops]
    sigma = float(runs[0].system.noise.sigma_x_m)
    return ClosedLoop(
        runs=tuple(loops),
        fit_percent=fit_percent(error, measured[known] - measured[known].mean()),
        rmse_m=float(np.sqrt(np.mean(error**2))),
        expected_m=float(np.sqrt(sum(expected) / len(measured))),
        steps=compare_steps(loops, sigma),
        responses=tuple(responses(loops, sigma)),
        without=tuple(without),
    )
