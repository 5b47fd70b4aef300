"""The part of the report that names: the search by rounds, each cause with what to do, what was not the cause."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from twin.diagnosis.judge.account import Account
from twin.diagnosis.report import figures
from twin.diagnosis.report.quantities import percent
from twin.diagnosis.report.sentences import LACKED, capital, rival_sentence, round_sentence, sizes
from twin.diagnosis.result import Diagnosis, Finding, Proposal
from twin.model.causes.catalogue import BY_NAME
from twin.model.parameters import Parameter
from twin.page.figures import inline
from twin.settings import diagnosis as settings


def causes(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the fields of page_causes.html."""
    account = diagnosis.account
    return {
        "lacked": LACKED,
        "least_gain": f"{settings.MIN_GAIN:g}",
        "rounds": [
            inline(figures.round_figure(step, number, settings.MIN_GAIN), f"Round {number}: {round_sentence(step)}")
            for number, step in enumerate((step for step in diagnosis.selection.rounds if step.scores), start=1)
        ],
        "cards": [
            _card(finding, f"{number}. " if len(diagnosis.causes) > 1 else "")
            for number, finding in enumerate(diagnosis.causes, start=1)
        ],
        "several": None if len(account.cause_shares) < 2 else _shares(account),
        "minor_effects": [
            [
                *_sized(finding.name, finding.parameters),
                f"{finding.loglik_gain:.0f}",
                ", ".join(BY_NAME[finding.name].shows_in),
            ]
            for finding in diagnosis.minor_effects
        ],
        "ruled_out": [[entry.name, BY_NAME[entry.name].title, entry.why] for entry in diagnosis.ruled_out],
        "not_testable": [[entry.name, BY_NAME[entry.name].title, entry.why] for entry in diagnosis.not_testable],
    }


def _card(finding: Finding, number: str) -> dict[str, Any]:
    """Return the fields of one cause's card: its facts, and what to do about it."""
    cause = BY_NAME[finding.name]
    facts = [
        ("Equation", f"{cause.equation} (in the {cause.acts_on})"),
        ("Where it comes from", _sentence(cause.source)),
        ("What it leaves in recordings", _sentence(cause.signature)),
        ("Experiments that show it", ", ".join(cause.shows_in)),
        ("How to confirm it by hand", _sentence(cause.confirm)),
        ("What to do about it", _sentence(cause.cure)),
    ]
    members = finding.indistinguishable_from
    causes = [_sized(member.name, member.parameters) for member in members if not member.stated]
    return {
        "title": number + finding.name,
        "sentence": _sentence(finding.sentence),
        "share": percent(finding.share_of_excess_explained),
        "confidence": f"{100 * finding.confidence:.0f} %",
        "sizes": sizes(finding.name, finding.parameters),
        "facts": [(term, text) for term, text in facts if text],
        "others": [_sized(finding.name, finding.parameters), *causes] if causes else [],
        "stated": [
            [_sentence(member.sentence), _sentence(BY_NAME[member.name].confirm)] for member in members if member.stated
        ],
        "rival": _sentence(rival_sentence(finding.rival)) if finding.rival is not None else "",
        **_experiment(finding.next_experiment),
    }


def _experiment(proposal: Proposal | None) -> dict[str, Any]:
    """The one that would tell a class apart."""
    if proposal is None:
        return {"experiment": "No experiment was computed that would separate them.", "command": ""}
    instruction = _sentence(proposal.what)
    separation = f"With it they would be {proposal.separation_z:.0f} standard errors apart; 3 are enough."
    return {
        "experiment": f"Next experiment: {instruction} {separation}" if proposal.command else instruction,
        "command": proposal.command,
        "next_best": ", ".join(f"{name} ({z:.0f})" for name, z in proposal.next_best),
        "outside": [_sentence(pair) for pair in proposal.outside],
    }


def _shares(account: Account) -> dict[str, str]:
    return {
        "alone": percent(sum(account.cause_shares.values())),
        "jointly": percent(account.jointly),
        "left": percent(account.unexplained),
    }


def _sized(name: str, parameters: Mapping[str, Parameter]) -> list[str]:
    return [name, BY_NAME[name].title, sizes(name, parameters)]


def _sentence(text: str) -> str:
    text = capital(text)
    return text if text.endswith((".", "!", "?")) else text + "."
