"""From a finished search to the diagnosis: findings, next experiments, prediction improvement, verdict, sentence."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace

from protocol.campaign import Campaign, Plant
from twin.diagnose import settings
from twin.diagnose.checks.change_point import Change
from twin.diagnose.checks.confidence import confidence_of
from twin.diagnose.checks.consistency import beginnings, contradictions
from twin.diagnose.evidence import sample_loss
from twin.diagnose.evidence.gather import Evidence
from twin.diagnose.evidence.sample_loss import Lost, lost_samples
from twin.diagnose.experiments.design import propose
from twin.diagnose.inference.adequacy import where_left
from twin.diagnose.inference.budget import Budget, Spent
from twin.diagnose.inference.fisher_scoring import Fit, spreads
from twin.diagnose.inference.likelihood import Criterion
from twin.diagnose.inference.noise_floor import Floor
from twin.diagnose.inference.theta import Theta
from twin.diagnose.judge.account import Account, Verdict, account_of, beyond_floor, verdict_of
from twin.diagnose.judge.prediction_gain import HORIZONS_S, Gain, gain
from twin.diagnose.judge.reference_model import off_sentence, theta_of
from twin.diagnose.remainder.remainder import Remainder, remainder_of
from twin.diagnose.report.model_file import model_of
from twin.diagnose.report.other_causes import minor_effects_of, missing_channels, not_testable, ruled_out
from twin.diagnose.report.page_remainder import answer_with
from twin.diagnose.report.sentences import (
    answer_sentence,
    beginning_sentence,
    beyond_sentence,
    contradiction_sentence,
    finding_sentence,
    form_of,
)
from twin.diagnose.result import (
    Diagnosis,
    Finding,
    Member,
    Proposal,
    fit_parameters,
)
from twin.diagnose.search.candidate_fits import Trial
from twin.diagnose.search.state import Selection
from twin.estimation.pace import pace_of
from twin.estimation.record import Record
from twin.model.causes.catalogue import BY_NAME, CATALOGUE
from twin.model.causes.cause import Cause
from twin.model.parameters import Model, Parameter

Say = Callable[[str], None]


@dataclass(kw_only=True)
class Searched:
    """Result of the search; with a change point, criterion and selection are those of the change."""

    criterion: Criterion
    base: Fit
    floor: Floor
    found: Selection
    fine: bool  # whether only noise is left
    why_not: str
    change: Change | None


@dataclass(frozen=True, kw_only=True)
class Asked:
    """The options of the user."""

    model: Model | None
    quick: bool
    share: float
    experiments: bool  # whether to find experiments that split equivalence classes
    free_form: bool | None  # whether to model what is left; None: if more than noise is, and not with `quick`
    seed: int
    workers: int
    budget: Budget
    say: Say


@contextmanager
def timed(stages: dict[str, float], name: str) -> Iterator[None]:
    """Add the duration of the block to the stage `name`, s."""
    began = time.perf_counter()
    yield
    stages[name] = stages.get(name, 0.0) + time.perf_counter() - began


def testable_causes(records: Sequence[Record]) -> tuple[Cause, ...]:
    """The causes whose channels are in the recordings, without those that are not found by fitting."""
    return tuple(
        cause
        for cause in CATALOGUE
        if not cause.not_testable and cause.found_by != "gaps" and not missing_channels(cause, records)
    )


def told(
    campaign: Campaign,
    done: Searched,
    records: Sequence[Record],
    judges: Sequence[Record],
    evidence: Evidence,
    judge: Evidence | None,
    warnings: list[str],
    asked: Asked,
    stages: dict[str, float],
) -> Diagnosis:
    """Assemble the diagnosis.

    Args:
        campaign: plant and controller.
        done: result of the search.
        records: recordings for fitting.
        judges: recordings for judging.
        evidence: prepared recordings for fitting.
        judge: prepared recordings for judging; None: there are none.
        warnings: receives further warnings.
        asked: options of the user.
        stages: receives the duration of each stage, s.
    """
    criterion, found, floor = done.criterion, done.found, done.floor
    finished = not asked.budget.unanswered  # questions left open from here on do not change the verdict
    asked.budget.reopen()
    with timed(stages, "what is left"):
        under = floor.under(criterion, found.fit.theta)
        account = account_of(found, under.excess(found.fit.loglik), done.fine)
        where = "" if done.fine else where_left(criterion, found.fit, under)
        spread = spreads(criterion, found.fit)
        warnings += _inconsistent(done)
    with timed(stages, "next experiments"):
        proposals = _proposals(criterion, found, campaign, asked) if asked.experiments else {}
    with timed(stages, "gain"):
        worth = _worth(done, judge, campaign.plant, asked)
        at_20_ms = worth.at_20_ms
        warnings += [worth.off] if worth.off else []
    with timed(stages, "remainder"):
        remainder = _remainder(done, records, judge, at_20_ms, asked)
    final, final_spread = found.fit, spread
    if remainder is not None and remainder.fit is not found.fit:
        final, final_spread = remainder.fit, spreads(criterion, remainder.fit)
    lost = lost_samples([*records, *judges])
    verdict = _verdict(done, account, lost, at_20_ms, finished=finished)
    if verdict == "partly-explained" and remainder is not None and remainder.beside == "paper":
        verdict = "unknown-cause"
    findings = _findings(found, account, spread, proposals, verdict, lost)
    if done.change is not None:
        findings = [_late(one, done.change) for one in findings]
    if done.fine and at_20_ms is not None and beyond_floor(at_20_ms):
        where = beyond_sentence(at_20_ms)
    warnings += [f"not all is explained {where}"] * bool(where) if done.fine else [done.why_not]
    minor_effects = tuple(minor_effects_of(criterion, found)) if done.fine and done.change is None else ()
    diagnosis = Diagnosis(
        verdict=verdict,
        sentence="",
        causes=tuple(findings),
        not_testable=tuple(not_testable(found, records)),
        minor_effects=minor_effects,
        ruled_out=tuple(ruled_out(found, {*_names(findings), *(one.name for one in minor_effects)}))
        if finished
        else (),
        account=account,
        unexplained_where=where,
        gains=worth.gains,
        gain=at_20_ms,
        baseline=asked.model or _paper(campaign, done, records, under),
        extended=model_of(
            campaign, final, final_spread, records, under.excess(final.loglik), "extended by board51 diagnose"
        ),
        warnings=tuple(dict.fromkeys(warnings)),
        quick=asked.quick or asked.share < settings.LEAST_SHARE,
        stages_s=stages,
        selection=found,
        floor=floor,
        fit_evidence=evidence,
        judge_evidence=judge,
        before=worth.before,
        after=found.fit.theta,
        tick_s=criterion.tick_s,
        remainder=remainder,
        budget=asked.budget,
    )
    sentence = answer_sentence(diagnosis, blind=not any(r.has("x") for r in records), off=worth.off)
    return replace(diagnosis, sentence=answer_with(diagnosis, sentence))


def _inconsistent(done: Searched) -> list[str]:
    """Warnings about effects that are not the same in all recordings, or begin in the middle of one."""
    criterion, fit = done.criterion, done.found.fit
    always = [name for name in done.found.causes if BY_NAME[name].found_by != "spectral-line" and done.change is None]
    return [contradiction_sentence(one) for one in contradictions(criterion, fit)] + [
        beginning_sentence(late) for late in beginnings(criterion, fit, always)
    ]


def _verdict(done: Searched, account: Account, lost: Lost | None, at_20_ms: Gain | None, *, finished: bool) -> Verdict:
    return verdict_of(
        named=bool(done.found.causes) or lost is not None,
        fine=done.fine,
        finished=finished,
        gain=at_20_ms,
        leading=(done.fine and lost is not None) or any(account.leads(name) for name in done.found.causes),
    )


def _remainder(
    done: Searched, records: Sequence[Record], judge: Evidence | None, at_20_ms: Gain | None, asked: Asked
) -> Remainder | None:
    """What is left, modelled; None where nothing is, nobody asked, or there is nothing to choose by."""
    more = not done.fine or (at_20_ms is not None and beyond_floor(at_20_ms))
    wanted = more and not asked.quick if asked.free_form is None else asked.free_form
    if not wanted or judge is None or at_20_ms is None or done.change is not None:
        return None
    asked.say("what is left, as a curve?")
    question = asked.budget.question("what is left, as a curve")
    with suppress(Spent), question, done.criterion.charging(asked.budget):
        candidates = testable_causes(records)
        paper = done.base if more else None
        return remainder_of(done.criterion, done.found.fit, paper, judge, done.floor, candidates, seed=asked.seed)
    return None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Worth:
    """Prediction improvement of the extended model on the judge recordings."""

    before: Theta  # of the reference model, or of the fitted paper's model
    gains: tuple[Gain, ...]
    at_20_ms: Gain | None
    off: str  # a sentence on wrong parameters of the reference model; "" if there are none


def _worth(done: Searched, judge: Evidence | None, plant: Plant, asked: Asked) -> _Worth:
    model, base, after, tick_s = asked.model, done.base.theta, done.found.fit.theta, done.criterion.tick_s
    before = base if model is None else theta_of(model, base)
    gains = _gains(judge, before, after, done.floor, plant, tick_s, asked)
    at_20_ms = next((one for one in gains if abs(one.horizon_s - 0.02) < 0.5 * tick_s), None)
    off = ""
    if model is not None and judge is not None and at_20_ms is not None:
        anew = gain(judge, base, after, done.floor, plant, tick_s, at_20_ms.samples, asked.seed)
        off = off_sentence(model, base, at_20_ms, anew)
    return _Worth(before=before, gains=tuple(gains), at_20_ms=at_20_ms, off=off)


def _paper(campaign: Campaign, done: Searched, records: Sequence[Record], under: Floor) -> Model:
    lacks = under.excess(done.base.loglik)
    return model_of(campaign, done.base, {}, records, lacks, "the paper's model at its best")


def _gains(
    judge: Evidence | None, before: Theta, after: Theta, floor: Floor, plant: Plant, tick_s: float, asked: Asked
) -> list[Gain]:
    if judge is None or not len(judge.series):
        return []

    def at(samples: int) -> Gain | None:
        return gain(judge, before, after, floor, plant, tick_s, samples, asked.seed)

    # The longest first, as it takes most time.
    horizons = sorted({max(round(horizon / tick_s), 1) for horizon in HORIZONS_S}, reverse=True)
    horizons = _affordable(horizons, judge, (before, after), plant, tick_s, asked.budget)
    with ThreadPoolExecutor(max_workers=asked.workers) as pool:
        found = [one for one in pool.map(at, horizons) if one is not None]
    return found[::-1]


def _affordable(
    horizons: Sequence[int], judge: Evidence, thetas: Sequence[Theta], plant: Plant, tick_s: float, budget: Budget
) -> list[int]:
    """The horizons within the budget; that of the answer has priority."""
    pace, paid = pace_of(judge.series), set()
    for samples in sorted(horizons, key=lambda samples: abs(samples * tick_s - settings.BENEFIT_HORIZON_S)):
        with suppress(Spent), budget.question(f"the error of x {1e3 * samples * tick_s:.0f} ms ahead"):
            budget.take(sum(pace.steps_ahead(theta.base(plant), theta.vector(), samples) for theta in thetas))
            paid.add(samples)
    return [samples for samples in horizons if samples in paid]


def _findings(
    found: Selection,
    account: Account,
    spread: dict[str, float],
    proposals: dict[str, Proposal],
    verdict: Verdict,
    lost: Lost | None,
) -> list[Finding]:
    findings = []
    for cause in found.causes:
        near = found.classes.get(cause, ())
        parameters = fit_parameters(found.fit, cause, spread)
        findings.append(
            Finding(
                name=cause,
                sentence=finding_sentence(cause, parameters),
                form=form_of(BY_NAME[cause], parameters),
                parameters=parameters,
                confidence=confidence_of(
                    found,
                    cause,
                    verdict if verdict == "causes-found" or account.leads(cause) else "unknown-cause",
                ),
                indistinguishable_from=tuple(_member(trial) for trial in near),
                share_of_excess_explained=account.by_cause[cause],
                loglik_gain=account.gains[cause],
                next_experiment=proposals.get(cause),
            )
        )
    if lost is not None:
        value = Parameter(value=lost.probability, unit="", ci95=lost.ci95, verdict="identified", method="gaps counted")
        findings.append(
            Finding(
                name=sample_loss.CAUSE.name,
                sentence=f"{100 * lost.probability:.2g} % of the samples are missing, most in {lost.worst}",
                parameters={sample_loss.CAUSE.strength.name: value},
                confidence=0.99,
                indistinguishable_from=(),
                share_of_excess_explained=0.0,
                loglik_gain=0.0,
            )
        )
    return findings


def _late(finding: Finding, change: Change) -> Finding:
    """The finding with the recording in which it begins or after which it ends."""
    if finding.name not in change.selection.causes:
        return finding
    if change.begins:
        return replace(finding, sentence=f"{finding.sentence}, from {change.after} on", begins_in=change.after)
    return replace(finding, sentence=f"{finding.sentence}, up to {change.before}", ends_after=change.before)


def _names(findings: Sequence[Finding]) -> set[str]:
    """Names of the causes and of the other members of their equivalence classes."""
    return {finding.name for finding in findings} | {
        member.name for finding in findings for member in finding.indistinguishable_from
    }


def _proposals(criterion: Criterion, found: Selection, campaign: Campaign, asked: Asked) -> dict[str, Proposal]:
    """For each cause with an equivalence class, the experiment that splits it best, or a measurement if none does."""
    result = {}
    for cause in found.causes:
        near = found.classes.get(cause, ())
        if not near:
            continue
        question = f"which experiment tells {cause} from {', '.join(trial.cause for trial in near)}"
        asked.say(f"{question}?")
        ranked = []
        with suppress(Spent), asked.budget.question(question):
            ranked = propose(criterion, found.fit, cause, near, campaign.controller, asked.budget)
        if not ranked:
            continue
        best = ranked[0]
        outside = tuple(
            f"{pair.own} and {pair.confounder}: no experiment on this rig tells them apart; {pair.measurement}"
            for pair in best.pairs
            if not pair.separable
        )
        result[cause] = Proposal(
            what=best.what if best.separable else " ".join(outside) or best.what,
            separation_z=best.separation_z,
            command=best.command if best.separable else "",
            outside=outside,
            others=tuple((one.name, one.separation_z) for one in ranked[1:4]),
            now_z={pair.confounder: pair.now_z for pair in best.pairs},
            experiments=tuple((one.name, {pair.confounder: pair.separation_z for pair in one.pairs}) for one in ranked),
        )
    return result


def _member(trial: Trial) -> Member:
    return Member(name=trial.cause, parameters=fit_parameters(trial.fit, trial.cause, _own_spread(trial.fit)))


def _own_spread(fit: Fit) -> dict[str, float]:
    return {name: math.nan for name in fit.free}
