"""The findings of a diagnosis: each selected cause with its size, confidence, class and next experiment."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace

from protocol.campaign import Controller, Plant
from twin.diagnosis.checks.change_point import Change
from twin.diagnosis.experiments.design import propose
from twin.diagnosis.judge.account import Account, Verdict, confidence_of
from twin.diagnosis.options import Options
from twin.diagnosis.remainder.rivals import Rival
from twin.diagnosis.report.sentences import cause_sentence, finding_sentence, form_of
from twin.diagnosis.result import Finding, Member, Proposal, fit_parameters
from twin.diagnosis.search.candidate_fits import Trial
from twin.diagnosis.search.state import Selection
from twin.diagnosis.search.stated_values import StatedValues
from twin.evidence import sample_loss
from twin.evidence.sample_loss import Lost
from twin.inference.budget import Budget, Spent
from twin.inference.likelihood import Criterion
from twin.inference.theta import coordinates_of
from twin.model.assumed import assumption, rests_on_plant
from twin.model.causes.catalogue import BY_NAME
from twin.model.parameters import Parameter


def findings_of(
    selection: Selection,
    account: Account,
    spread: dict[str, float],
    proposals: dict[str, Proposal],
    verdict: Verdict,
    lost: Lost | None,
    plant: Plant,
) -> list[Finding]:
    """Return a finding for each selected cause, and one for lost samples.

    Args:
        selection: the result of the search.
        account: of the shares.
        spread: standard errors of the parameters, in their units.
        proposals: the next experiment of each cause that has one.
        verdict: of the diagnosis.
        lost: the samples that were lost; None: none were.
        plant: of the campaign.
    """
    findings = []
    for cause in selection.causes:
        members = selection.classes.get(cause, ())
        parameters = fit_parameters(selection.fit, cause, spread)
        findings.append(
            Finding(
                name=cause,
                sentence=finding_sentence(cause, parameters) + _assumption_clause(cause, plant),
                form=form_of(BY_NAME[cause], parameters),
                parameters=parameters,
                confidence=confidence_of(
                    selection,
                    cause,
                    verdict if verdict == "causes-found" or account.leads(cause) else "unknown-cause",
                ),
                indistinguishable_from=tuple(_member(trial, selection.gains[cause], plant) for trial in members),
                share_of_excess_explained=account.cause_shares[cause],
                loglik_gain=account.gains[cause],
                next_experiment=proposals.get(cause),
            )
        )
    if lost is not None:
        # Counted, not inferred, so no verdict on the model touches it.
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


def _member(trial: Trial, gain: float, plant: Plant) -> Member:
    """Return the member of the class of a cause with this gain."""
    stated = BY_NAME[trial.cause].detector == "stated"
    spread = {name: trial.fit.std(name, plant) for name in coordinates_of(trial.cause) if stated}
    parameters = fit_parameters(trial.fit, trial.cause, spread)
    return Member(
        name=trial.cause,
        parameters=parameters,
        sentence=cause_sentence(trial.cause, parameters),
        lead=trial.gain - gain,
    )


def _assumption_clause(cause: str, plant: Plant) -> str:
    """Name the assumed plant for which the size of a cause holds; empty if the size does not rest on one."""
    return f", {assumption(plant)}" if plant.assumed and rests_on_plant(BY_NAME[cause]) else ""


def with_rival(finding: Finding, selection: Selection, rivals: Mapping[str, Rival]) -> Finding:
    """The finding with the curve that would replace it, and the confidence of a candidate."""
    rival = rivals.get(finding.name)
    if rival is None:
        return finding
    return replace(finding, rival=rival, confidence=confidence_of(selection, finding.name, "unknown-cause"))


def with_change(finding: Finding, change: Change) -> Finding:
    """The finding with the recording in which it begins or after which it ends."""
    if finding.name not in change.selection.causes:
        return finding
    if change.begins:
        return replace(finding, sentence=f"{finding.sentence}, from {change.after} on", begins_in=change.after)
    return replace(finding, sentence=f"{finding.sentence}, up to {change.before}", ends_after=change.before)


def proposals_of(
    criterion: Criterion, selection: Selection, controller: Controller | None, budget: Budget, options: Options
) -> dict[str, Proposal]:
    """Propose for each equivalence class the experiment that splits it best, or a measurement if none does."""
    result = {}
    for cause in selection.causes if options.proposes else ():
        members = selection.classes.get(cause, ())
        if not members:
            continue
        question = f"which experiment separates {cause} from {', '.join(trial.cause for trial in members)}"
        options.say(f"{question}?")
        ranked = []
        with suppress(Spent), budget.question(question):
            ranked = propose(criterion, selection.fit, cause, members, controller, budget)
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


def measurements_of(selection: Selection, stated: StatedValues) -> dict[str, Proposal]:
    """Return what to measure beside the board, for causes that share their class with stated values alone."""
    return {
        cause: Proposal(what="; ".join(BY_NAME[trial.cause].confirm for trial in trials), separation_z=0.0)
        for cause, trials in stated.classes.items()
        if trials and not selection.classes.get(cause)
    }
