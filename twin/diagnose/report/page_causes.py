"""The part of the report that names: the search by rounds, each cause with what to do, what was not the cause."""

from __future__ import annotations

import html

from twin.diagnose import settings
from twin.diagnose.judge.account import Account
from twin.diagnose.report.figures import drawn, round_figure
from twin.diagnose.report.sentences import LACKED, capital, percent, round_sentence, sizes
from twin.diagnose.result import Diagnosis, Finding, Proposal
from twin.model.causes.catalogue import BY_NAME
from twin.page import bullets, figures, folded, paragraph, table


def ranking(found: Diagnosis) -> str:
    """Each round of the search as bars."""
    rounds = found.selection.rounds
    drawings = [
        drawn(round_figure(step, number, settings.LEAST_GAIN), f"Round {number}: {round_sentence(step)}")
        for number, step in enumerate(rounds, start=1)
        if step.scores
    ]
    if not drawings:
        return paragraph("No cause was tried.")
    text = (
        "By how much each cause would improve the log-likelihood of all recordings for fitting together. Dark: fitted, "
        "with everything else fitted again; pale: estimated by its score; green with a tick: taken. The dotted line is "
        f"the least gain of a cause that is taken ({settings.LEAST_GAIN:g}: by chance once in 4000 for thirty causes). "
        "Causes that these recordings cannot show are left out. The search ends when nothing earns its place."
    )
    return figures(drawings) + paragraph(text)


def causes(found: Diagnosis) -> str:
    """A card for each cause."""
    cards = [_card(finding, number, len(found.causes)) for number, finding in enumerate(found.causes, start=1)]
    return "".join(cards) + (paragraph(_together(found.account)) if len(found.account.by_cause) > 1 else "")


def _together(account: Account) -> str:
    """What several causes take of the whole, as a sum."""
    return (
        f"Of {LACKED}, {percent(sum(account.by_cause.values()))} would be missing again if each cause were taken out "
        f"alone, {percent(account.jointly)} is what they take jointly, whichever of them is there, and "
        f"{percent(account.unexplained)} is left."
    )


def _card(finding: Finding, number: int, count: int) -> str:
    known = BY_NAME[finding.name]
    head = f"{number}. {finding.name}" if count > 1 else finding.name
    share = f"{percent(finding.share_of_excess_explained)} of {LACKED} on the recordings for fitting"
    entries = [
        ("Equation", f"{known.equation} (in the {known.acts_on})"),
        ("Where it comes from", _sentence(known.source)),
        ("What it leaves in recordings", _sentence(known.signature)),
        ("Experiments that show it", ", ".join(known.shows_in)),
        ("How to confirm it by hand", _sentence(known.confirm)),
        ("What to do about it", _sentence(known.cure)),
    ]
    listed = "".join(f"<dt>{name}</dt><dd>{html.escape(text)}</dd>" for name, text in entries if text)
    return (
        f'<div class="card"><h3>{html.escape(head)}</h3><p><b>{html.escape(_sentence(finding.sentence))}</b> '
        f"It explains {share}; confidence in the name {100 * finding.confidence:.0f} %.</p>"
        f"<p>{html.escape(sizes(finding.name, finding.parameters))}</p><dl>{listed}</dl>{_class(finding)}</div>"
    )


def _class(finding: Finding) -> str:
    members = finding.indistinguishable_from
    if not members:
        return paragraph("No other cause of the catalogue explains these recordings as well.")
    rows = [
        [
            html.escape(finding.name),
            html.escape(BY_NAME[finding.name].title),
            html.escape(sizes(finding.name, finding.parameters)),
        ]
    ]
    rows += [
        [html.escape(one.name), html.escape(BY_NAME[one.name].title), html.escape(sizes(one.name, one.parameters))]
        for one in members
    ]
    text = "These recordings cannot tell it from the following; each explains them as well, with these sizes:"
    return paragraph(text) + table(["cause", "", "size"], rows, words=True) + _next(finding.next_experiment)


def _next(proposal: Proposal | None) -> str:
    if proposal is None:
        return paragraph("No experiment was computed that would tell them apart.")
    if not proposal.command:
        return paragraph(_sentence(proposal.what))
    text = (
        f"Next experiment: {_sentence(proposal.what)} With it they would be {proposal.separation_z:.0f} standard "
        "errors apart; 3 are enough."
    )
    others = ", ".join(f"{name} ({z:.0f})" for name, z in proposal.others)
    return (
        paragraph(text)
        + f"<pre>{html.escape(proposal.command)}</pre>"
        + (paragraph(f"Next best: {others}.") if others else "")
        + (bullets([_sentence(one) for one in proposal.outside]) if proposal.outside else "")
    )


def not_the_cause(found: Diagnosis) -> str:
    """What was ruled out, and what could not be tested."""
    parts = []
    if found.minor_effects:
        rows = [
            [
                one.name,
                BY_NAME[one.name].title,
                html.escape(sizes(one.name, one.parameters)),
                f"{one.loglik_gain:.0f}",
                html.escape(", ".join(BY_NAME[one.name].shows_in)),
            ]
            for one in found.minor_effects
        ]
        total = found.selection.fit.loglik - found.selection.base.loglik
        parts.append(
            paragraph(
                "Seen, and too small to be named: the log-likelihood gains more than chance makes of it, and next to "
                f"nothing beside the {total:.0f} of what was named. Each was fitted alone. It may be there, or mend "
                "how the model writes what was named; the experiments that show it best would tell."
            )
            + table(["cause", "", "size", "gain", "shows in"], rows, words=True)
        )
    if found.ruled_out:
        rows = [[entry.name, BY_NAME[entry.name].title, entry.why] for entry in found.ruled_out]
        parts.append(
            paragraph("Tried, and ruled out but for a size that these recordings would not show:")
            + table(["cause", "", "at most"], [[html.escape(cell) for cell in row] for row in rows], words=True)
        )
    if found.not_testable:
        rows = [[entry.name, BY_NAME[entry.name].title, entry.why] for entry in found.not_testable]
        parts.append(
            folded(
                f"Not testable with these recordings: {len(rows)}",
                table(["cause", "", "why"], [[html.escape(cell) for cell in row] for row in rows], words=True),
            )
        )
    return "".join(parts) or paragraph("Every cause of the catalogue is named above.")


def _sentence(text: str) -> str:
    text = capital(text)
    return text if text.endswith((".", "!", "?")) else text + "."
