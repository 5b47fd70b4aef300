"""The answer of a diagnosis in at most two short sentences: the largest difference, and what to do about it.

Shares, intervals and errors follow in `Diagnosis.sentence` and in the tables of the page.
"""

from __future__ import annotations

from collections.abc import Sequence

from twin.diagnosis.report.sentences import (
    BLIND,
    NUMBERS,
    adequate_sentence,
    candidates_sentence,
    capital,
    cause_sentence,
    larger_walk,
)
from twin.diagnosis.result import Diagnosis, Finding
from twin.model.causes.catalogue import BY_NAME


def headline_of(diagnosis: Diagnosis, *, blind: bool, off: str) -> str:
    """Return the headline; `blind` and `off` as in `answer_sentence`."""
    sentences = [adequate_sentence(off)] if diagnosis.verdict == "model-adequate" else list(_answer(diagnosis))
    return f"{BLIND} {' '.join(sentences)}" if blind else " ".join(sentences)


def _answer(diagnosis: Diagnosis) -> tuple[str, ...]:
    sure = [finding for finding in diagnosis.causes if diagnosis.holds(finding)]
    # By the share, not by the order of the search: what was found first may explain less once the others are there.
    first = max(sure or diagnosis.causes, key=lambda finding: finding.share_of_excess_explained, default=None)
    if diagnosis.verdict == "unfinished":
        so_far = (f"So far it points to {_listed(diagnosis.causes)}.",) if diagnosis.causes else ()
        return "No answer yet: the search used up its budget.", *so_far
    if sure and first is not None:
        partly = ", but not everything is explained" if diagnosis.verdict == "partly-explained" else ""
        return f"{_difference(sure)}{partly}.", _action(first, alone=len(sure) == 1)
    if first is not None:
        return (
            candidates_sentence(diagnosis),
            f"The nearest candidate, {first.name}, may only imitate an unknown cause.",
        )
    where = diagnosis.unexplained_where
    rest = (f"The remaining error is largest {where.removeprefix('most ')}.",) if where.startswith("most ") else ()
    return "The model is wrong, and none of the known causes explains it.", *rest


def _difference(causes: Sequence[Finding]) -> str:
    if len(causes) == 1:
        cause, parameters = causes[0].name, causes[0].parameters
        return capital(f"{cause_sentence(cause, parameters)} {larger_walk(cause, parameters)}".rstrip())
    return f"{NUMBERS.get(len(causes), str(len(causes)))} causes act: {_listed(causes)}"


def _listed(causes: Sequence[Finding]) -> str:
    names = [finding.name for finding in causes]
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _action(first: Finding, *, alone: bool) -> str:
    """Say what to do next: split the class of the first cause, or cure it."""
    members, proposal = first.indistinguishable_from, first.next_experiment
    if not members:
        cure = BY_NAME[first.name].cure
        return f"{'Remedy' if alone else f'Begin with {first.name}'}: {cure}." if cure else "No cure is known."
    confirm = BY_NAME[members[0].name].confirm
    if all(member.stated for member in members):
        return f"Or {members[0].sentence}: {confirm}."
    names = " or ".join(member.name for member in members if not member.stated)
    doubt = f"{'It' if alone else capital(first.name)} may be {names} instead"
    if proposal is not None and proposal.command and proposal.experiments:
        return f"{doubt}: the experiment {proposal.experiments[0][0]} decides."
    return f"{doubt}: {confirm}."
