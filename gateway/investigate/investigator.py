"""The loop of an investigation: decide, act, write the journal, until the answer is final or no step is left."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gateway.campaign.plan import needs_lift_off
from gateway.campaign.runner import OVERHEAD_S
from gateway.campaign.selection import chosen
from gateway.investigate.decide import Diagnose, Finish, Offer, Perform, next_action
from gateway.investigate.journal import Diagnosed, Journal, Performed
from gateway.investigate.work import Interrupted, Work, WriteLine
from protocol.errors import ServiceError
from protocol.experiments import LIFT_OFF, MENU

_RETAINED = ("verdict", "sentence", "causes", "candidates")  # of diagnosis.json


def menu_of(*, quick: bool) -> dict[str, Offer]:
    """The experiments of the menu, by name; `quick`: the shorter form."""
    offers = {}
    for experiment in MENU:
        (made,) = chosen((experiment.name,), quick=quick)
        seconds = made.duration_s + OVERHEAD_S[made.closed_loop]
        needs = LIFT_OFF if needs_lift_off(made) else ""
        offers[made.name] = Offer(purpose=made.purpose, seconds=seconds, preparation=made.person, needs=needs)
    return offers


def investigate(
    work: Work, journal: Journal, menu: Mapping[str, Offer], *, budget_s: float, quick: bool, write_line: WriteLine
) -> None:
    """Run an investigation within `budget_s` on the rig; `quick`: all its diagnoses are made with --quick.

    The journal is written after each step.  Its `ended` is the result, or None after an interruption.

    Raises:
        UsageError, ServiceError: a step failed; the earlier steps are kept.
    """
    journal.ended = None
    try:
        while not work.stopped:
            action = next_action(journal.known(budget_s=budget_s, quick=quick), menu)
            write_line(sentence(action))
            match action:
                case Perform():
                    _perform(work, journal, action)
                case Diagnose():
                    _diagnose(work, journal, action, write_line)
                case Finish():
                    journal.ended = action
                    journal.save()
                    return
    except Interrupted:
        return


def sentence(action: Perform | Diagnose | Finish) -> str:
    """The action and its reason, as a line of progress."""
    match action:
        case Perform():
            return f"record {', '.join(action.experiments)} ({action.seconds:.0f} s): {action.why}"
        case Diagnose():
            return f"diagnose{'' if action.thorough else ' --quick'}: {action.why}"
        case Finish():
            return f"end: {action.why}"


def _perform(work: Work, journal: Journal, action: Perform) -> None:
    summary = work.perform(action.experiments)
    standings = {str(row["name"]): str(row["standing"]) for row in summary["experiments"]}
    journal.steps.append(Performed(why=action.why, standings=standings, rig_s=float(summary["rig_s"])))
    journal.save()
    if not summary["parked"]:
        raise ServiceError("THE COIL MAY BE ON: STOP was not delivered", remedy="Switch the rig off by hand")
    if summary["interrupted"]:
        raise Interrupted
    if summary["failure"]:
        raise ServiceError(
            str(summary["failure"]).rstrip("."),
            remedy="The ball is parked; the same command continues where it stopped",
        )


def _diagnose(work: Work, journal: Journal, action: Diagnose, write_line: WriteLine) -> None:
    recordings = sorted(journal.known(budget_s=0.0, quick=False).recordings)
    result: dict[str, Any] = work.diagnose(thorough=action.thorough)
    retained = {name: result[name] for name in _RETAINED if name in result}
    step = Diagnosed(
        why=action.why, thorough=action.thorough, recordings=recordings, found={"candidates": []} | retained
    )
    journal.steps.append(step)
    journal.answer()  # raises for an invalid answer before it is saved
    journal.save()
    write_line(f"{result['verdict']}: {result['sentence']}")
