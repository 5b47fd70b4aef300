"""Turn a finished search into a diagnosis: findings, next experiments, prediction improvement, verdict, sentence."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace

from protocol.campaign import Campaign, Plant
from twin.diagnosis.checks.change_point import Change
from twin.diagnosis.checks.consistency import beginnings, contradictions
from twin.diagnosis.findings import findings_of, measurements_of, proposals_of, with_change, with_rival
from twin.diagnosis.judge import judgement
from twin.diagnosis.judge.account import Account, Verdict, account_of, exceeds_floor
from twin.diagnosis.judge.choice import Choice, at_20_ms, worse
from twin.diagnosis.judge.judgement import Judgement
from twin.diagnosis.judge.prediction_gain import Bench, Gain
from twin.diagnosis.lines import lines_of, with_sizes
from twin.diagnosis.options import Options
from twin.diagnosis.remainder.remainder import CurveJudge, Remainder, remainder_of
from twin.diagnosis.remainder.rivals import Rival, rivals_of
from twin.diagnosis.report.choice import choice_sentence, harm_sentence, written_model
from twin.diagnosis.report.headline import headline_of
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
    overlap_sentence,
    rival_sentence,
)
from twin.diagnosis.result import Diagnosis, Finding, MinorEffect, SpectralLine
from twin.diagnosis.search.state import Selection
from twin.diagnosis.search.stated_values import StatedValues, examine, with_members
from twin.estimation.record import Record
from twin.evidence.gather import Evidence
from twin.evidence.sample_loss import lost_samples
from twin.inference.adequacy import where_left
from twin.inference.budget import Budget, Spent
from twin.inference.fisher_scoring import Fit, spreads, with_covariance
from twin.inference.likelihood import Criterion
from twin.inference.noise_floor import Floor
from twin.inference.theta import Theta
from twin.inference.trade_offs import TradeOff, trade_offs
from twin.model.causes.catalogue import BY_NAME, SEARCHED
from twin.model.causes.cause import Cause
from twin.model.parameters import Model
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
    """The causes whose channels are in the recordings, except those `without`."""
    return tuple(cause for cause in SEARCHED if cause.name not in without and not missing_channels(cause, records))


def assemble(inputs: Inputs, search: SearchResult, options: Options) -> Diagnosis:
    """Assemble the diagnosis, with the warnings from here on and the stages from the search on."""
    records, judge, plant = inputs.records, inputs.judge, inputs.campaign.plant
    stages = dict(search.stages_s)
    finished = not search.budget.unanswered  # questions left open from here on do not change the verdict
    search.budget.reopen()
    names = _examined(search, options, stages)
    selection, account = names.selection, names.account
    with timed(stages, "next experiments"):
        proposals = proposals_of(search.criterion, search.selection, inputs.campaign.controller, search.budget, options)
        proposals |= measurements_of(search.selection, names.stated)
    with timed(stages, "gain"):
        lost = lost_samples([*records, *inputs.judges])
        bench = _bench(search, judge, plant, options)
        state = {"is_adequate": search.is_adequate, "finished": finished, "counted": lost is not None}
        outcome = judgement.judge(selection, options.model, bench, account, **state)
    choice = outcome.choice
    with timed(stages, "remainder"):
        remainder = _remainder(inputs, search, outcome.whole, choice, options, names.rivals)
        harms = not _harmless(bench, outcome.before, choice, remainder)
        remainder = None if harms else remainder
    verdict = outcome.verdict
    findings = findings_of(selection, account, names.spread, proposals, verdict, lost, plant)
    findings = [_qualified(finding, search, names) for finding in findings]
    lines = lines_of(findings, search.criterion, selection.fit.theta)
    where = _where(search, names, outcome, verdict)
    is_whole = search.is_adequate and search.change is None
    minor_effects = minor_effects_of(search.criterion, selection) if is_whole else ()
    baseline, extended = _models(inputs, search, options, names, choice, remainder)
    diagnosis = Diagnosis(
        verdict=verdict,
        headline="",
        sentence="",
        causes=tuple(findings),
        not_testable=(*not_testable(selection, records), *map(absorbed_suspect, names.stated.absorbed)),
        minor_effects=minor_effects,
        ruled_out=tuple(ruled_out(selection, _listed(findings, minor_effects))) if finished else (),
        account=account,
        unexplained_where=where,
        gains=choice.gains,
        gain=at_20_ms(choice.gains),
        baseline=baseline,
        extended=extended,
        choice=choice,
        warnings=tuple(_warnings(search, names, outcome, where, lines, harms=harms)),
        quick=options.quick or options.share < settings.MIN_SHARE,
        stages_s=stages,
        selection=selection,
        floor=search.floor,
        fit_evidence=inputs.evidence,
        judge_evidence=judge,
        before=outcome.before,
        after=outcome.before if choice.fit is None else choice.fit.theta,
        tick_s=search.criterion.tick_s,
        remainder=remainder,
        budget=search.budget,
        lines=lines,
        trade_offs=names.trade_offs,
    )
    return _with_answer(diagnosis, blind=not any(r.has("x") for r in records), off=outcome.off)


def _with_answer(diagnosis: Diagnosis, *, blind: bool, off: str) -> Diagnosis:
    """Return a copy with its headline and its sentence; the arguments as in `answer_sentence`."""
    sentence = answer_sentence(diagnosis, blind=blind, off=off)
    return replace(
        diagnosis,
        headline=headline_of(diagnosis, blind=blind, off=off),
        sentence=answer_with(diagnosis, sentence) + choice_sentence(diagnosis),
    )


@dataclass(frozen=True, kw_only=True)
class _Names:
    """The selected names, with what else would explain the recordings and what is left."""

    selection: Selection  # with the stated values in its classes
    stated: StatedValues
    rivals: Mapping[str, Rival]
    under: Floor  # of the final model
    account: Account
    where: str  # most is left; "" if nothing is
    spread: dict[str, float]  # standard errors of the parameters
    trade_offs: tuple[TradeOff, ...]


def _examined(search: SearchResult, options: Options, stages: dict[str, float]) -> _Names:
    """Compare the selected names with stated values and unknown curves, and account for what is left."""
    criterion, selection = search.criterion, search.selection
    with timed(stages, "stated values"):
        stated = _stated_values(search)
        # After the search and as members of classes: an error of the campaign file never takes the place of a named
        # cause.
        selection = with_members(selection, stated)
        fit, line_errors = with_sizes(criterion, selection.fit)
        selection = replace(selection, fit=fit)
    with timed(stages, "rivals"):
        rivals = _rivals(search, options)
    with timed(stages, "what is left"):
        # One floor, that of the final model, for the paper's model as well: under two floors the parts would not add
        # up.
        under = search.floor.under(criterion, selection.fit.theta)
        maximum = with_covariance(criterion, selection.fit, stated.slopes)
        return _Names(
            selection=selection,
            stated=stated,
            rivals=rivals,
            under=under,
            account=account_of(selection, under.excess(selection.fit.loglik), search.is_adequate, rivals),
            where="" if search.is_adequate else where_left(criterion, selection.fit, under),
            spread=spreads(maximum, criterion.plant) | line_errors,
            trade_offs=trade_offs(criterion, maximum),
        )


def _qualified(finding: Finding, search: SearchResult, names: _Names) -> Finding:
    """Return the finding with the curve that would replace it and the recording in which it begins or ends."""
    finding = with_rival(finding, names.selection, names.rivals)
    return finding if search.change is None else with_change(finding, search.change)


def _where(search: SearchResult, names: _Names, outcome: Judgement, verdict: Verdict) -> str:
    """Say where most is left; "" if nothing is."""
    refused = outcome.choice.refused
    if search.is_adequate and verdict == "unknown-cause" and refused and refused[0].worse:
        return harm_sentence(refused[0])
    if search.is_adequate and outcome.whole is not None and exceeds_floor(outcome.whole):
        return beyond_sentence(outcome.whole)
    return names.where


def _warnings(
    search: SearchResult,
    names: _Names,
    outcome: Judgement,
    where: str,
    lines: Sequence[SpectralLine],
    *,
    harms: bool,
) -> list[str]:
    """Return the warnings; `harms`: whether a curve for the rest was refused."""
    warnings = _inconsistent(search) + [rival_sentence(rival) for rival in names.rivals.values()]
    warnings += [sentence for sentence in (overlap_sentence(names.account), outcome.off) if sentence]
    if harms:
        warnings.append("a curve for the rest was tried and refused: the judge recordings get worse with it")
    if not search.is_adequate:
        warnings.append(search.why_not)
    elif where:
        warnings.append(f"not everything is explained {where}")
    return warnings + [line.sentence for line in lines if not line.cause]


def _models(
    inputs: Inputs, search: SearchResult, options: Options, names: _Names, choice: Choice, remainder: Remainder | None
) -> tuple[Model, Model]:
    """Return (the reference model, the extended model)."""
    campaign, records, under = inputs.campaign, inputs.records, names.under
    paper = model_of(
        campaign, search.base, {}, records, under.excess(search.base.loglik), "the paper's model at its best"
    )
    # The user's model as it is, not fitted anew: the report is to say what that simulation gets wrong.
    baseline = options.model or paper
    final = choice.fit if remainder is None else remainder.fit
    if final is None:
        return baseline, written_model(choice, baseline)
    spread = (
        names.spread
        if final is names.selection.fit
        else spreads(with_covariance(search.criterion, final), campaign.plant)
    )
    extended = model_of(campaign, final, spread, records, under.excess(final.loglik), "")
    return baseline, written_model(choice, extended)


def _inconsistent(search: SearchResult) -> list[str]:
    """Return the warnings about effects that are not the same in all recordings, or begin in the middle of one."""
    criterion, fit = search.criterion, search.selection.fit
    # Not where a change splits the recordings: the cause is absent in some of them anyway.
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
    # The one with the largest lead: the fits of the others still have the name that this one replaces.
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
            CurveJudge(search.criterion, judge, options.seed),
            choice.fit,
            search.floor,
            candidates,
            rival=rival,
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


def _listed(findings: Sequence[Finding], minor_effects: Sequence[MinorEffect]) -> set[str]:
    """Return the names of the causes, of the other members of their equivalence classes, and of minor effects."""
    members = {member.name for finding in findings for member in finding.indistinguishable_from}
    return {finding.name for finding in findings} | members | {effect.name for effect in minor_effects}
