"""Diagnosis of a campaign: the steps in order.

    recordings -> evidence -> fit of the paper's model -> deviance above the noise floor
               -> causes by stepwise selection, equivalence classes -> adequacy, change point
               -> prediction improvement on the judge recordings

Rule 1: only the campaign, its recordings and the given model are read.
Rule 2: causes are selected on the recordings for fitting, and the improvement is measured on the judge recordings.
Rule 3: the same seed gives the same diagnosis for any number of workers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np

from protocol.campaign import Campaign, Plant
from protocol.errors import DataError
from twin.diagnosis.assemble import Inputs, SearchResult, assemble, testable_causes, timed
from twin.diagnosis.checks.change_point import find_change
from twin.diagnosis.checks.outlier_recording import Outlier, find_outlier
from twin.diagnosis.judge.reference_model import check_plant
from twin.diagnosis.options import Options, Progress
from twin.diagnosis.remainder.rivals import best_curve
from twin.diagnosis.report.sentences import change_sentence, outlier_sentence
from twin.diagnosis.result import Diagnosis
from twin.diagnosis.search.stepwise import select
from twin.diagnosis.search.task import Search
from twin.estimation.innovations import FLIES, FOLLOWS
from twin.estimation.record import Record
from twin.evidence.checks.dead_channels import without_dead
from twin.evidence.checks.plausibility import inspect
from twin.evidence.gather import Evidence, gather
from twin.evidence.instruments import instruments, with_noise
from twin.evidence.noise_levels import Noise
from twin.evidence.outliers import without_outliers
from twin.inference.adequacy import adequate
from twin.inference.budget import Budget, Spent, millions
from twin.inference.fisher_scoring import climb
from twin.inference.initial_guess import start_theta, with_noise_bounds
from twin.inference.likelihood import Criterion
from twin.inference.noise_floor import floor_of
from twin.inference.theta import BASE, STOPS, Theta, parameter_of
from twin.model.assumed import assumption_warning
from twin.readers.campaign import read_campaign
from twin.settings import diagnosis as settings

UNASKED = "--quick did not examine whether an effect begins or ends in the middle of the campaign"
_LONG = ("closed-loop", "prbs", "free")  # kinds with long flights, of which --quick uses the beginning


def diagnose(campaign: Campaign, options: Options | None = None, *, data: Path | None = None) -> Diagnosis:
    """Diagnose a campaign, whose recordings are in the folder `data` if not in its own.

    Raises:
        DataError: there is no recording for fitting or too little data; a recording is implausible; the model is of
            another plant, or the budget is too small to fit the paper's model.
    """
    records = read_campaign(campaign, data=data)
    judges = read_campaign(campaign, use="judge", data=data)
    if not records:
        raise DataError(
            f'{campaign.where}: no recording has use = "fit"',
            remedy='Give at least one [[recording]] with use = "fit"; judge recordings cannot also choose the model',
        )
    return diagnose_records(campaign, records, judges, options or Options())


def diagnose_records(
    campaign: Campaign,
    everything: Sequence[Record],
    judges: Sequence[Record],
    options: Options,
    *,
    budget: Budget | None = None,
    look_for_outlier: bool = True,
) -> Diagnosis:
    """Diagnose recordings in memory, within a part of a budget where one is given.

    With `look_for_outlier`, a recording that contradicts all others is left out.  Raises DataError.
    """
    plant, budget = campaign.plant, budget or Budget(options.limit, settings.BUDGET_RESERVED)
    options = replace(options, say=_with_share(options.say, budget))
    if options.model is not None:
        check_plant(options.model, plant)
    records, warnings = _prepared(campaign, everything, options.quick)
    stages: dict[str, float] = {}
    with timed(stages, "evidence"):
        evidence, judge, noise = _evidence(records, judges, plant)
        warnings += evidence.notes
    warnings += _missing(records, judges)
    start = with_noise_bounds(start_theta(records, plant), evidence)
    check_flight_time(evidence)
    criterion = Criterion(evidence, plant, tick_of(records), workers=options.workers, budget=budget)
    with ExitStack() as closing:
        closing.callback(criterion.close)
        search = _search(criterion, start, records, options)
        if not search.is_adequate and options.quick:
            warnings.append(UNASKED)
        # An offset that wanders from recording to recording also explains one of another rig.
        wanders = _wanders(search.selection.fit.theta)
        if look_for_outlier and (wanders or not search.is_adequate) and (outlier := _outlier(criterion, search)):
            rest = _diagnose_others(campaign, everything, judges, options, budget, outlier)
            if rest is not None:
                return rest
        if (change := search.change) is not None:
            closing.callback(search.criterion.close)
            warnings.append(change_sentence(change))
            stops = evidence.low_m, evidence.high_m
            evidence = with_noise(
                gather([record for record in records if record.name in change.recordings], plant, stops), noise
            )
            if judge is not None and (later := change.of(judges)):
                judge = with_noise(without_outliers(gather(later, plant, stops)), noise)
        inputs = Inputs(campaign=campaign, records=records, judges=judges, evidence=evidence, judge=judge)
        with criterion.free(), search.criterion.free():
            result = assemble(inputs, search, options)
    return replace(
        result,
        warnings=tuple(dict.fromkeys((*warnings, *result.warnings))),
        stages_s={**stages, **result.stages_s},
    )


def _diagnose_others(
    campaign: Campaign,
    everything: Sequence[Record],
    judges: Sequence[Record],
    options: Options,
    budget: Budget,
    outlier: Outlier,
) -> Diagnosis | None:
    """Diagnose all recordings but the outlier; None if they do not agree with each other either."""
    options.say(f"{outlier.name} contradicts the others: repeating without it")
    (remaining,) = budget.shares(1)
    others = [record for index, record in enumerate(everything) if index != outlier.recording]
    rest = diagnose_records(campaign, others, judges, options, budget=remaining, look_for_outlier=False)
    budget.settle([remaining])
    if rest.verdict == "unfinished":
        budget.unanswered.append(f"whether the others agree without {outlier.name}")
        return None
    # The others have to be explained without it.  If they are not, the recording that was left out is no more wrong
    # than they are.
    agree = rest.verdict != "unknown-cause" and not _wanders(rest.after)
    return without_outlier(replace(rest, budget=budget), outlier) if agree else None


def _evidence(
    records: Sequence[Record], judges: Sequence[Record], plant: Plant
) -> tuple[Evidence, Evidence | None, Noise]:
    """Return (evidence for fitting, evidence for judging, noise of the instruments), without outliers."""
    evidence = gather(records, plant)
    judge = gather(judges, plant, (evidence.low_m, evidence.high_m)) if judges else None
    evidence, judge = without_outliers(evidence), judge and without_outliers(judge)
    # From both uses together: no model is involved, and an instrument is the same in both.
    noise = instruments([evidence, *([judge] if judge else [])])
    return with_noise(evidence, noise), judge and with_noise(judge, noise), noise


def _missing(records: Sequence[Record], judges: Sequence[Record]) -> list[str]:
    """Return the warnings about missing recordings."""
    warnings = []
    if not judges:
        warnings.append('no recording has use = "judge": the gain cannot be measured on data that were not used')
    if not any(record.has("x") for record in records):
        warnings.append("no recording has x: only the amplifier was judged; K_c and b of the model files are guesses")
    return warnings


def _with_share(say: Progress, budget: Budget) -> Progress:
    return lambda line: say(f"{100.0 * budget.used:3.0f} %  {line}")


def _outlier(criterion: Criterion, search: SearchResult) -> Outlier | None:
    with suppress(Spent), criterion.budget.question("whether one recording contradicts all others"):
        return find_outlier(criterion, search.base, search.floor)
    return None


def _wanders(theta: Theta) -> bool:
    return any(parameter_of(name).walks and value > 0.0 for name, value in theta.causes)


def _prepared(campaign: Campaign, records: Sequence[Record], quick: bool) -> tuple[list[Record], list[str]]:
    """Return (recordings without dead channels, shortened for `quick`; warnings)."""
    warnings = [assumption_warning(campaign.plant)] if campaign.plant.assumed else []
    warnings += [note for record in records for note in record.notes]
    warnings += inspect(list(records), campaign.plant, campaign.controller)
    retained: list[Record] = []
    for record in records:
        # In other kinds the ball may be at rest, or beyond the range of its sensor.
        flight = [record] if record.kind in ("closed-loop", "prbs") else []
        alive, dead = without_dead(flight, campaign.plant)
        retained += alive or [record]
        warnings += dead
    if quick:
        retained, note = shortened(retained)
        warnings += [note] if note else []
    return retained, warnings


def shortened(records: Sequence[Record]) -> tuple[list[Record], str]:
    """Return (the recordings, long ones cut to their beginning; a sentence about it, empty if none was).

    With very many flights each is shorter, as the budget of `--quick` covers a search over `QUICK_SAMPLES`.
    """
    result, cut = [], 0
    max_samples, all_samples = settings.QUICK_FLIGHT_SAMPLES, settings.QUICK_SAMPLES
    flights = [min(len(record.t), max_samples) for record in records if record.kind in _LONG]
    # Less of each flight, not fewer flights: recordings differ more from one another than their parts do.
    if sum(flights) > all_samples:
        max_samples = all_samples // len(flights)
    for record in records:
        if record.kind in _LONG and len(record.t) > max_samples:
            cut += 1
            record = record.part(slice(0, max_samples))
        result.append(record)
    sentence = (
        f"--quick: only the first {max_samples} samples of {cut} recordings were used for selection" if cut else ""
    )
    return result, sentence


def _search(criterion: Criterion, start: Theta, records: Sequence[Record], options: Options) -> SearchResult:
    """Fit the paper's model, select causes, and if more than noise is left, look for a change point."""
    say, budget = options.say, criterion.budget
    stages: dict[str, float] = {}
    with timed(stages, "base fit"):
        say(f"{len(records)} recordings, {len(criterion.evidence.series)} samples; fitting the paper's model")
        try:
            base = climb(criterion, start, (*BASE, *start.colours, *STOPS))
            floor = floor_of(criterion, base.theta)
        except Spent:
            raise DataError(
                f"the budget of {millions(budget.limit)} does not fit even the paper's model to "
                f"{len(criterion.evidence.series)} samples",
                remedy="Give fewer or shorter recordings, or more with --budget",
            ) from None
        say(f"lacks {max(floor.excess(base.loglik), 0.0):.0f} of log-likelihood against sensor noise alone")
    search = Search(
        criterion=criterion,
        floor=floor,
        candidates=testable_causes(records, options.without),
        max_candidates=settings.CANDIDATES_QUICK if options.quick else settings.CANDIDATES,
        min_share=options.share,
        quick=options.quick,
        curve=cache(partial(best_curve, criterion, base)),
        report=say,
    )
    with timed(stages, "search"):
        selection = select(search, base)
    with timed(stages, "what is left"):
        with criterion.free():
            is_adequate, why_not = adequate(criterion, selection.fit, floor.under(criterion, selection.fit.theta))
    change = None
    # Only where what acts always does not suffice, a cause or an unknown curve: a change has more freedom, and would
    # explain what they do.
    if not is_adequate and not options.quick:
        question = "whether an effect begins or ends in the middle of the campaign"
        with timed(stages, "change"), suppress(Spent), budget.question(question):
            curve = search.curve()
            if curve is None or not adequate(criterion, curve, floor.under(criterion, curve.theta))[0]:
                change = find_change(search, selection, workers=options.workers)
    if change is not None:
        criterion, selection, is_adequate, why_not = change.criterion, change.selection, True, ""
    return SearchResult(
        criterion=criterion,
        base=base,
        floor=floor,
        selection=selection,
        is_adequate=is_adequate,
        why_not=why_not,
        change=change,
        budget=budget,
        stages_s=stages,
    )


def without_outlier(rest: Diagnosis, outlier: Outlier) -> Diagnosis:
    """The diagnosis of the other recordings, with a sentence on the outlier."""
    text = outlier_sentence(outlier)
    return replace(rest, sentence=f"{rest.sentence} But {text}.", warnings=(text, *rest.warnings))


def tick_of(records: Sequence[Record]) -> float:
    """The sampling interval of the flights, s; 2 ms if it is unknown."""
    for kinds in (_LONG, ("sawtooth",)):
        steps = [r.interval_s for r in records if r.kind in kinds and len(r.t) > 1]
        good = [step for step in steps if math.isfinite(step)]
        if good:
            return float(np.median(good))
    return 2e-3


def check_flight_time(evidence: Evidence) -> None:
    """Check that the flights are long enough to distinguish causes.

    Raises:
        DataError: they are too short; the message gives their length and the required one.
    """
    series = evidence.series
    # Time in flight, not the length of the recordings: a ball at rest shows no cause of the motion.
    flown_s = float(series.step[series.flags & (FLIES | FOLLOWS) == FLIES | FOLLOWS].sum())
    if any(record.has("x") for record in evidence.records) and flown_s < settings.MIN_FLIGHT_S:
        raise DataError(
            f"the recordings for fitting hold {flown_s:.2g} s of flight: too little to tell one cause from another",
            remedy=f"Record at least {settings.MIN_FLIGHT_S:g} s of flight, preferably a minute with steps of x_ref",
        )
