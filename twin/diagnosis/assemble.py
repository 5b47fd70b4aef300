"""Turn a finished search into a diagnosis: findings, next experiments, prediction improvement, verdict, sentence."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace

from protocol.campaign import Campaign, Plant
from twin.diagnosis.checks.change_point import Change
from twin.diagnosis.checks.consistency import beginnings, contradictions
from twin.diagnosis.experiments.design import propose
from twin.diagnosis.findings import findings_of, with_change, with_rival
from twin.diagnosis.judge import judgement
from twin.diagnosis.judge.account import account_of, exceeds_floor
from twin.diagnosis.judge.choice import Choice, at_20_ms, worse
from twin.diagnosis.judge.prediction_gain import Bench, Gain
from twin.diagnosis.lines import lines_of, with_sizes
from twin.diagnosis.options import Options
from twin.diagnosis.remainder.remainder import Remainder, remainder_of
from twin.diagnosis.remainder.rivals import Rival, rivals_of
from twin.diagnosis.report.choice import choice_sentence, harm_sentence, written_model
from twin.diagnosis.report.model_file import model_of
from twin.diagnosis.report.other_causes import (
    absorbed_suspect,
    minor_effects_of,
    missing_channels,
    not_testable,
    ruled_out,
)
from twin.diagnosis.report.page_remainder import answer_with
from twin.diagnosis.report.sentences import (
    answer_sentence,
    beginning_sentence,
    beyond_sentence,
    contradiction_sentence,
    rival_sentence,
)
from twin.diagnosis.result import Diagnosis, Finding, Proposal
from twin.diagnosis.search.state import Selection
from twin.diagnosis.search.stated_values import StatedValues, examine, with_members
from twin.estimation.record import Record
from twin.evidence.gather import Evidence
from twin.evidence.sample_loss import lost_samples
from twin.inference.adequacy import where_left
from twin.inference.budget import Budget, Spent
from twin.inference.fisher_scoring import Fit, spreads
from twin.inference.likelihood import Criterion
from twin.inference.noise_floor import Floor
from twin.inference.theta import Theta
from twin.model.causes.catalogue import BY_NAME, CATALOGUE
from twin.model.causes.cause import Cause
from twin.settings import diagnosis as settings


@dataclass(kw_only=True)
class SearchResult:
    """Result of the search; with a change point, criterion and selection are those of the change."""

    criterion: Criterion
    base: Fit
    floor: Floor
    selection: Selection
    is_adequate: bool  # whether only noise is left
    why_not: str
    change: Change | None
    budget: Budget  # of all questions
    stages_s: dict[str, float]


@dataclass(frozen=True, kw_only=True)
class Inputs:
    """The inputs of a diagnosis."""

    campaign: Campaign
    records: Sequence[Record]  # for fitting
    judges: Sequence[Record]
    evidence: Evidence  # of `records`
    judge: Evidence | None  # of `judges`; None: there are none


@contextmanager
def timed(stages: dict[str, float], name: str) -> Iterator[None]:
    """Add the duration of the block to the stage `name`, s."""
    began = time.perf_counter()
    yield
    stages[name] = stages.get(name, 0.0) + time.perf_counter() - began


def testable_causes(records: Sequence[Record], without: Sequence[str]) -> tuple[Cause, ...]:
    """The causes whose channels are in the recordings, except those `without` and those not found by fitting."""
    return tuple(
        cause
        for cause in CATALOGUE
        if cause.name not in without
        and not cause.not_testable
        and cause.detector != "gaps"
        and not missing_channels(cause, records)
    )


def assemble(inputs: Inputs, search: SearchResult, options: Options) -> Diagnosis:
    """Assemble the diagnosis, with the warnings from here on and the stages from the search on."""
    records, judge, plant = inputs.records, inputs.judge, inputs.campaign.plant
    stages = dict(search.stages_s)
    criterion, floor = search.criterion, search.floor
    finished = not search.budget.unanswered  # questions left open from here on do not change the verdict
    search.budget.reopen()
    selection = search.selection
    with timed(stages, "stated values"):
        stated = _stated_values(search)
        selection = with_members(selection, stated)
        fit, line_errors = with_sizes(criterion, selection.fit)
        selection = replace(selection, fit=fit)
    with timed(stages, "rivals"):
        rivals = _rivals(search, options)
    with timed(stages, "what is left"):
        under = floor.under(criterion, selection.fit.theta)
        account = account_of(selection, under.excess(selection.fit.loglik), search.is_adequate, rivals)
        where = "" if search.is_adequate else where_left(criterion, selection.fit, under)
        spread = spreads(criterion, selection.fit, stated.slopes) | line_errors
        warnings = _inconsistent(search) + [rival_sentence(rival) for rival in rivals.values()]
    with timed(stages, "next experiments"):
        proposals = _proposals(search, inputs.campaign, options) | _measurements(search.selection, stated)
    with timed(stages, "gain"):
        lost = lost_samples([*records, *inputs.judges])
        bench = _bench(search, judge, plant, options)
        outcome = judgement.judge(
            selection,
            options.model,
            bench,
            account,
            is_adequate=search.is_adequate,
            finished=finished,
            counted=lost is not None,
        )
        verdict, choice, whole = outcome.verdict, outcome.choice, outcome.whole
        warnings += [outcome.off] if outcome.off else []
    with timed(stages, "remainder"):
        remainder = _remainder(inputs, search, whole, choice, options, rivals)
        if not _harmless(bench, outcome.before, choice, remainder):
            warnings.append("a curve for the rest was tried and refused: the judge recordings get worse with it")
            remainder = None
    final = choice.fit if remainder is None else remainder.fit
    final_spread = spread if final is selection.fit else {} if final is None else spreads(criterion, final)
    if verdict == "partly-explained" and remainder is not None and remainder.extends == "paper":
        verdict = "unknown-cause"
    findings = findings_of(selection, account, spread, proposals, verdict, lost, plant)
    findings = [with_rival(finding, selection, rivals) for finding in findings]
    lines = lines_of(findings, criterion, selection.fit.theta)
    warnings += [line.sentence for line in lines if not line.cause]
    if search.change is not None:
        findings = [with_change(finding, search.change) for finding in findings]
    if search.is_adequate and verdict == "unknown-cause" and choice.refused and choice.refused[0].worse:
        where = harm_sentence(choice.refused[0])
    elif search.is_adequate and whole is not None and exceeds_floor(whole):
        where = beyond_sentence(whole)
    warnings += [f"not everything is explained {where}"] * bool(where) if search.is_adequate else [search.why_not]
    minor_effects = (
        tuple(minor_effects_of(criterion, selection)) if search.is_adequate and search.change is None else ()
    )
    lacked = under.excess(search.base.loglik)
    paper = model_of(inputs.campaign, search.base, {}, records, lacked, "the paper's model at its best")
    baseline = options.model or paper
    diagnosis = Diagnosis(
        verdict=verdict,
        sentence="",
        causes=tuple(findings),
        not_testable=(*not_testable(selection, records), *map(absorbed_suspect, stated.absorbed)),
        minor_effects=minor_effects,
        ruled_out=tuple(ruled_out(selection, {*_names(findings), *(effect.name for effect in minor_effects)}))
        if finished
        else (),
        account=account,
        unexplained_where=where,
        gains=choice.gains,
        gain=at_20_ms(choice.gains),
        baseline=baseline,
        extended=written_model(
            choice,
            baseline
            if final is None
            else model_of(inputs.campaign, final, final_spread, records, under.excess(final.loglik), ""),
        ),
        choice=choice,
        warnings=tuple(warnings),
        quick=options.quick or options.share < settings.MIN_SHARE,
        stages_s=stages,
        selection=selection,
        floor=floor,
        fit_evidence=inputs.evidence,
        judge_evidence=judge,
        before=outcome.before,
        after=outcome.before if choice.fit is None else choice.fit.theta,
        tick_s=criterion.tick_s,
        remainder=remainder,
        budget=search.budget,
        lines=lines,
    )
    sentence = answer_sentence(diagnosis, blind=not any(r.has("x") for r in records), off=outcome.off)
    return replace(diagnosis, sentence=answer_with(diagnosis, sentence) + choice_sentence(diagnosis))


def _inconsistent(search: SearchResult) -> list[str]:
    """Return the warnings about effects that are not the same in all recordings, or begin in the middle of one."""
    criterion, fit = search.criterion, search.selection.fit
    always = [
        name for name in search.selection.causes if "line" not in BY_NAME[name].detector and search.change is None
    ]
    return [contradiction_sentence(contradiction) for contradiction in contradictions(criterion, fit)] + [
        beginning_sentence(beginning) for beginning in beginnings(criterion, fit, always)
    ]


def _remainder(
    inputs: Inputs,
    search: SearchResult,
    whole: Gain | None,
    choice: Choice,
    options: Options,
    rivals: Mapping[str, Rival],
) -> Remainder | None:
    """Model what is left; None if nothing is left, nobody asked, or no recording can choose the curve."""
    judge = inputs.judge
    has_remainder = not search.is_adequate or (whole is not None and exceeds_floor(whole))
    rival = max(rivals.values(), key=lambda rival: rival.lead, default=None)
    is_requested = has_remainder and not options.quick if options.free_form is None else options.free_form
    is_requested = is_requested or rival is not None
    if not is_requested or judge is None or whole is None or choice.fit is None or search.change is not None:
        return None
    options.say("what is left, as a curve?")
    question = search.budget.question("what is left, as a curve")
    with suppress(Spent), question, search.criterion.charging(search.budget):
        candidates = testable_causes(inputs.records, options.without)
        return remainder_of(
            search.criterion,
            choice.fit,
            search.base if has_remainder else None,
            judge,
            search.floor,
            candidates,
            rival=rival,
            seed=options.seed,
        )
    return None


def _rivals(search: SearchResult, options: Options) -> Mapping[str, Rival]:
    """Return the names that a curve would replace; none where a change point splits the recordings."""
    if search.change is not None or not search.selection.causes:
        return {}
    options.say("does anything unknown explain more than the names?")
    question = search.budget.question("whether something unknown explains more than the names")
    with suppress(Spent), question, search.criterion.charging(search.budget):
        return rivals_of(search.criterion, search.selection)
    return {}


def _bench(search: SearchResult, judge: Evidence | None, plant: Plant, options: Options) -> Bench | None:
    if judge is None or not len(judge.series):
        return None
    return Bench(
        judge=judge,
        floor=search.floor,
        plant=plant,
        tick_s=search.criterion.tick_s,
        seed=options.seed,
        workers=options.workers,
        budget=search.budget,
    )


def _harmless(bench: Bench | None, before: Theta, choice: Choice, left: Remainder | None) -> bool:
    """Return whether the model with a curve for what is left is no worse than the reference on the judge recordings."""
    return left is None or bench is None or left.fit is choice.fit or not worse(bench.gains(before, left.fit.theta))


def _stated_values(search: SearchResult) -> StatedValues:
    """Return the stated values that may be wrong; none if the budget does not suffice."""
    question = search.budget.question("which values that the campaign states may be wrong")
    with suppress(Spent), question, search.criterion.charging(search.budget):
        return examine(search.criterion, search.selection)
    return StatedValues(classes={}, absorbed=())


def _measurements(selection: Selection, stated: StatedValues) -> dict[str, Proposal]:
    """Return what to measure beside the board, for causes that share their class with stated values alone."""
    return {
        cause: Proposal(what="; ".join(BY_NAME[trial.cause].confirm for trial in trials), separation_z=0.0)
        for cause, trials in stated.classes.items()
        if trials and not selection.classes.get(cause)
    }


def _names(findings: Sequence[Finding]) -> set[str]:
    """Return the names of the causes and of the other members of their equivalence classes."""
    return {finding.name for finding in findings} | {
        member.name for finding in findings for member in finding.indistinguishable_from
    }


def _proposals(search: SearchResult, campaign: Campaign, options: Options) -> dict[str, Proposal]:
    """Propose for each equivalence class the experiment that splits it best, or a measurement if none does."""
    criterion, selection, result = search.criterion, search.selection, {}
    for cause in selection.causes if options.proposes else ():
        members = selection.classes.get(cause, ())
        if not members:
            continue
        question = f"which experiment separates {cause} from {', '.join(trial.cause for trial in members)}"
        options.say(f"{question}?")
        ranked = []
        with suppress(Spent), search.budget.question(question):
            ranked = propose(criterion, selection.fit, cause, members, campaign.controller, search.budget)
        if not ranked:
            continue
        best = ranked[0]
        outside = tuple(
            f"{pair.cause} and {pair.confounder}: no experiment on this rig separates them; {pair.measurement}"
            for pair in best.pairs
            if not pair.separable
        )
        result[cause] = Proposal(
            what=best.what if best.separable else " ".join(outside) or best.what,
            separation_z=best.separation_z,
            command=best.command if best.separable else "",
            outside=outside,
            next_best=tuple((proposal.name, proposal.separation_z) for proposal in ranked[1:4]),
            now_z={pair.confounder: pair.now_z for pair in best.pairs},
            experiments=tuple(
                (proposal.name, {pair.confounder: pair.separation_z for pair in proposal.pairs}) for proposal in ranked
            ),
        )
    return result
