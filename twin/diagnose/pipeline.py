"""From a campaign to a diagnosis: the steps in order, and what is said on the way.

    recordings -> evidence -> the paper's model at its best -> what does it lack against sensor noise alone?
               -> causes: forward, backward, classes -> is what is left noise? -> gain on the judge recordings

Rule 1: nothing but the campaign folder (and the model file, where one is given) is read.
Rule 2: choosing sees the recordings for fitting only; measuring sees the judge recordings only.
Rule 3: the same seed gives the same diagnosis, whatever the number of workers.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from protocol.campaign import Campaign, Plant
from protocol.errors import DataError
from twin.diagnose.adequacy import adequate, where_left
from twin.diagnose.begin import no_better, start_theta
from twin.diagnose.change import find_change, late_finding
from twin.diagnose.confidence import confidence_of
from twin.diagnose.consistency import beginnings, contradictions
from twin.diagnose.estimate import BASE, STOPS, Criterion, Fit, Theta, climb, spreads
from twin.diagnose.evidence import Evidence, gather
from twin.diagnose.experiments import propose
from twin.diagnose.floor import Floor, floor_of
from twin.diagnose.given import check_plant, off_sentence, theta_of
from twin.diagnose.lost import Lost, lost_samples
from twin.diagnose.measure import HORIZONS_S, Gain, gain
from twin.diagnose.models import model_of
from twin.diagnose.odd import Odd, odd_one
from twin.diagnose.quick import shortened
from twin.diagnose.result import Diagnosis, Finding, Member, NotTestable, Proposal, RuledOut, Verdict, fit_parameters
from twin.diagnose.select import SHARE, Selection, Trial, select
from twin.diagnose.words import bound_sentence, finding_sentence, summary_sentence
from twin.identify.checks import inspect
from twin.identify.dead import without_dead
from twin.identify.innovations import FLIES, FOLLOWS
from twin.identify.reading import read_campaign
from twin.identify.record import Record
from twin.model.causes.catalogue import BY_NAME, CATALOGUE
from twin.model.causes.cause import Cause
from twin.model.parameters import Model, Parameter

Say = Callable[[str], None]
LOST = "lost-samples"
FLIGHT_LEAST_S = 2.0  # 120 time constants of the unstable pole
PERIODIC = "periodic-disturbance"


def diagnose(
    campaign: Campaign,
    *,
    data: Path | None = None,
    model: Model | None = None,
    quick: bool = False,
    share: float = SHARE,
    seed: int = 0,
    workers: int = 2,
    say: Say = lambda line: None,
) -> Diagnosis:
    """Diagnose a campaign.

    Args:
        campaign: of `protocol.campaign.load`.
        data: folder of recordings that are not beside the campaign.
        model: the simulation to be judged; default: the paper's model, identified from the campaign itself.
        quick: fewer candidates are fitted, and none is asked for a stand-in: confidence is not calibrated.
        share: least part of what is left that a cause must explain; with a smaller one confidence is not calibrated.
        seed: of the bootstrap.
        workers: threads.
        say: takes lines of progress.

    Raises:
        DataError: no recording for fitting, too little data, a recording that is not what it says it is, a model of
            another plant.
    """
    records = read_campaign(campaign, data=data)
    judges = read_campaign(campaign, use="judge", data=data)
    if not records:
        raise DataError(
            f'{campaign.where}: no recording has use = "fit"',
            remedy='Give at least one [[recording]] with use = "fit"; choosing on judge recordings would spoil them',
        )
    return diagnose_records(
        campaign, records, judges, model=model, quick=quick, share=share, seed=seed, workers=workers, say=say
    )


def diagnose_records(
    campaign: Campaign,
    records: Sequence[Record],
    judges: Sequence[Record],
    *,
    model: Model | None = None,
    quick: bool = False,
    share: float = SHARE,
    seed: int = 0,
    workers: int = 2,
    look_for_odd: bool = True,
    say: Say = lambda line: None,
) -> Diagnosis:
    """As `diagnose`, on recordings in memory; one that contradicts all others is left out, where asked for."""
    plant = campaign.plant
    if model is not None:
        check_plant(model, plant)
    warnings = [note for record in records for note in record.notes]
    warnings += inspect(list(records), plant, campaign.controller)
    alive, dead = without_dead(list(records), plant)
    records = [
        live if record.kind in ("closed-loop", "prbs") else record for live, record in zip(alive, records, strict=True)
    ]
    warnings += dead
    if quick:
        records, said = shortened(records)
        warnings += [said] if said else []
    stages: dict[str, float] = {}
    with _timed(stages, "evidence"):
        evidence = gather(records, plant)
        judge = gather(judges, plant, (evidence.low_m, evidence.high_m)) if judges else None
        warnings += evidence.notes
        tick_s = tick_of(records)
    if not judges:
        warnings.append('no recording has use = "judge": the gain cannot be measured on data that were not used')
    if not any(record.has("x") for record in records):
        warnings.append("no recording has x: only the amplifier was judged; K_c and b of the model files are guesses")
    start = no_better(start_theta(records, plant), evidence)
    enough(evidence)
    criterion = Criterion(evidence, plant, tick_s, workers=workers)
    try:
        with _timed(stages, "base fit"):
            say(f"{len(records)} recordings, {len(evidence.series)} samples; the paper's model first")
            base = climb(criterion, start, (*BASE, *STOPS))
            floor = floor_of(criterion, base.theta)
            say(f"lacks {max(floor.excess(base.loglik), 0.0):.0f} of log-likelihood against sensor noise alone")
        with _timed(stages, "search"):
            candidates = testable_causes(records)
            few = 3 if quick else 6
            found = select(criterion, base, floor, candidates=candidates, few=few, quick=quick, share=share, say=say)
        with _timed(stages, "what is left"):
            fine, why_not = adequate(criterion, found.fit, floor)
        with _timed(stages, "change"):
            change = (
                None
                if fine
                else find_change(
                    criterion, found, floor, candidates=candidates, few=3 if quick else 6, workers=workers, say=say
                )
            )
            if change is not None:
                criterion.close()
                criterion, found, fine, why_not = change.criterion, change.selection, True, ""
                warnings.append(change.sentence)
                stops = evidence.low_m, evidence.high_m
                evidence = gather([one for one in records if one.name in change.recordings], plant, stops)
                if judge is not None and (later := change.of(judges)):
                    judge = gather(later, plant, stops)
        if not fine and look_for_odd and (odd := odd_one(criterion, base, floor)) is not None:
            say(f"{odd.name} contradicts the others: once more without it")
            rest = diagnose_records(
                campaign,
                [record for place, record in enumerate(records) if place != odd.recording],
                judges,
                model=model,
                quick=quick,
                share=share,
                seed=seed,
                workers=workers,
                look_for_odd=False,
                say=say,
            )
            if rest.verdict != "unknown-cause":
                return without_odd(rest, odd)
        with _timed(stages, "what is left"):
            where = "" if fine else where_left(criterion, found.fit)
            spread = spreads(criterion, found.fit)
            warnings += contradictions(criterion, found.fit)
            always = [name for name in found.causes if name != PERIODIC and change is None]
            began = beginnings(criterion, found.fit, always)
            warnings += [
                f"{late.cause} is not there from the start: it begins in {late.recording} at about {late.t_s:.0f} s"
                for late in began
            ]
        with _timed(stages, "next experiments"):
            proposals = {} if quick else _proposals(criterion, found, campaign, say)
    finally:
        criterion.close()
    lost = lost_samples([*records, *judges])
    with _timed(stages, "gain"):
        before, after = base.theta if model is None else theta_of(model, base.theta), found.fit.theta
        gains = _gains(judge, before, after, floor, plant, tick_s, seed)
        at_20_ms = next((one for one in gains if abs(one.horizon_s - 0.02) < 0.5 * tick_s), None)
        off = ""
        if model is not None and judge is not None and at_20_ms is not None:
            anew = gain(judge, base.theta, after, floor, plant, tick_s, at_20_ms.samples, seed)
            off = off_sentence(model, base.theta, at_20_ms, anew)
            warnings += [off] if off else []
    findings = _findings(found, floor, spread, proposals, fine, quick, lost)
    if change is not None:
        findings = [late_finding(one, change) for one in findings]
    verdict: Verdict = "causes-found" if findings else "model-adequate"
    if not fine:
        verdict = "unknown-cause"
        warnings.append(why_not)
    baseline = model or model_of(campaign, base, {}, records, floor, "the paper's model at its best")
    extended = model_of(campaign, found.fit, spread, records, floor, "extended by board51 diagnose")
    total = max(floor.excess(base.loglik), base_gain(found), 1e-9)
    left = max(floor.excess(found.fit.loglik), 0.0) / max(total, floor.readings * 1e-3)
    diagnosis = Diagnosis(
        verdict=verdict,
        sentence="",
        causes=tuple(findings),
        not_testable=tuple(_not_testable(found, records)),
        ruled_out=tuple(_ruled_out(found, findings)),
        unexplained_share=0.0 if fine else min(left, 1.0),
        unexplained_where=where,
        gains=tuple(gains),
        gain=at_20_ms,
        baseline=baseline,
        extended=extended,
        warnings=tuple(dict.fromkeys(warnings)),
        quick=quick or share < SHARE,
        stages_s=stages,
        selection=found,
        floor=floor,
        fit_evidence=evidence,
        judge_evidence=judge,
        before=before,
        after=after,
        tick_s=tick_s,
    )
    sentence = summary_sentence(diagnosis)
    if not any(record.has("x") for record in records):
        sentence = f"Of the amplifier alone, as no recording has x: {sentence}"
    if off and diagnosis.verdict == "model-adequate":
        sentence = f"The form of the model is adequate, but {off}."
    return replace(diagnosis, sentence=sentence)


def without_odd(rest: Diagnosis, odd: Odd) -> Diagnosis:
    """The diagnosis of the others, with what was left out."""
    return replace(rest, sentence=f"{rest.sentence} But {odd.sentence}.", warnings=(odd.sentence, *rest.warnings))


def tick_of(records: Sequence[Record]) -> float:
    """The sampling interval of the flights."""
    for kinds in (("closed-loop", "prbs", "free"), ("sawtooth",)):
        steps = [r.interval_s for r in records if r.kind in kinds and len(r.t) > 1]
        good = [step for step in steps if math.isfinite(step)]
        if good:
            return float(np.median(good))
    return 2e-3


def enough(evidence: Evidence) -> None:
    """Whether the flights are long enough to tell one cause from another.

    Raises:
        DataError: with what there is and what is asked for.
    """
    series = evidence.series
    flown_s = float(series.step[series.flags & (FLIES | FOLLOWS) == FLIES | FOLLOWS].sum())
    if any(record.has("x") for record in evidence.records) and flown_s < FLIGHT_LEAST_S:
        raise DataError(
            f"the recordings for fitting hold {flown_s:.2g} s of flight: too little to tell one cause from another",
            remedy=f"Record at least {FLIGHT_LEAST_S:g} s with the ball in flight, better a minute with steps of x_ref",
        )


def testable_causes(records: Sequence[Record]) -> tuple[Cause, ...]:
    """The causes whose channels the recordings have."""
    return tuple(
        cause
        for cause in CATALOGUE
        if not cause.not_testable and cause.name != LOST and not missing_channels(cause, records)
    )


def missing_channels(cause: Cause, records: Sequence[Record]) -> list[str]:
    """Channels that a cause needs and no recording has."""
    return [channel for channel in cause.needs if not any(record.has(channel) for record in records)]


def base_gain(found: Selection) -> float:
    """Log-likelihood that all causes together gain."""
    return found.fit.loglik - found.base.loglik


def _gains(
    judge: Evidence | None, before: Theta, after: Theta, floor: Floor, plant: Plant, tick_s: float, seed: int
) -> list[Gain]:
    if judge is None or not len(judge.series):
        return []
    found = []
    for samples in sorted({max(round(horizon / tick_s), 1) for horizon in HORIZONS_S}):
        one = gain(judge, before, after, floor, plant, tick_s, samples, seed)
        if one is not None:
            found.append(one)
    return found


def _findings(
    found: Selection,
    floor: Floor,
    spread: dict[str, float],
    proposals: dict[str, Proposal],
    fine: bool,
    quick: bool,
    lost: Lost | None,
) -> list[Finding]:
    total = max(floor.excess(found.base.loglik), base_gain(found), 1e-9)
    findings = []
    for cause in found.causes:
        near = found.classes.get(cause, ())
        parameters = fit_parameters(found.fit, cause, spread)
        findings.append(
            Finding(
                name=cause,
                sentence=finding_sentence(cause, parameters),
                parameters=parameters,
                confidence=confidence_of(found, cause, fine, quick),
                indistinguishable_from=tuple(_member(trial) for trial in near),
                share_of_excess_explained=min(found.gains[cause] / total, 1.0),
                loglik_gain=found.gains[cause],
                next_experiment=proposals.get(cause),
            )
        )
    if lost is not None:
        value = Parameter(value=lost.probability, unit="", ci95=lost.ci95, verdict="identified", method="gaps counted")
        findings.append(
            Finding(
                name=LOST,
                sentence=f"{100 * lost.probability:.2g} % of the samples are missing, most in {lost.worst}",
                parameters={"probability": value},
                confidence=0.99,
                indistinguishable_from=(),
                share_of_excess_explained=0.0,
                loglik_gain=0.0,
            )
        )
    return findings


def _proposals(criterion: Criterion, found: Selection, campaign: Campaign, say: Say) -> dict[str, Proposal]:
    """For each cause with a class, the experiment that splits it best, or why none can."""
    result = {}
    for cause in found.causes:
        near = found.classes.get(cause, ())
        if not near:
            continue
        say(f"which experiment tells {cause} from {', '.join(trial.cause for trial in near)}?")
        ranked = propose(criterion, found.fit, cause, near, campaign.controller)
        if not ranked:
            continue
        best = ranked[0]
        outside = tuple(
            f"{pair.own} and {pair.rival}: no experiment on this rig tells them apart; {pair.measurement}"
            for pair in best.pairs
            if not pair.separable
        )
        result[cause] = Proposal(
            what=best.what if best.separable else " ".join(outside) or best.what,
            separation_z=best.separation_z,
            command=best.command if best.separable else "",
            outside=outside,
            others=tuple((one.name, one.separation_z) for one in ranked[1:4]),
        )
    return result


def _member(trial: Trial) -> Member:
    return Member(name=trial.cause, parameters=fit_parameters(trial.fit, trial.cause, _own_spread(trial.fit)))


def _own_spread(fit: Fit) -> dict[str, float]:
    return {name: math.nan for name in fit.free}


def _not_testable(found: Selection, records: Sequence[Record]) -> list[NotTestable]:
    entries = []
    last = {score.cause: score for score in found.rounds[-1].scores} if found.rounds else {}
    for cause in CATALOGUE:
        missing = missing_channels(cause, records)
        score = last.get(cause.name)
        if cause.not_testable:
            entries.append(NotTestable(name=cause.name, why=cause.not_testable))
        elif missing:
            entries.append(NotTestable(name=cause.name, why=f"no recording has {' and '.join(missing)}"))
        elif score is not None and not score.testable:
            shows = ", ".join(cause.shows_in) or "no experiment"
            why = f"these recordings would not show it ({shows} would): what it does, the other parameters can do"
            entries.append(NotTestable(name=cause.name, why=why))
    return entries


def _ruled_out(found: Selection, findings: Sequence[Finding]) -> list[RuledOut]:
    """Every other cause, with the size that it has at most."""
    named = {finding.name for finding in findings}
    named |= {member.name for finding in findings for member in finding.indistinguishable_from}
    entries = []
    for score in found.rounds[-1].scores if found.rounds else ():
        if score.cause not in named and score.testable:
            entries.append(RuledOut(name=score.cause, why=bound_sentence(BY_NAME[score.cause], score)))
    return entries


@contextmanager
def _timed(stages: dict[str, float], name: str) -> Iterator[None]:
    began = time.perf_counter()
    yield
    stages[name] = stages.get(name, 0.0) + time.perf_counter() - began
