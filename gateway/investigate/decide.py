"""Decide the next step of an investigation, with its reason.  Pure.

    start, diagnose -> equivalence class: the experiment that splits it best
                    -> no cause, or low confidence: an experiment that was not made yet
                    -> one cause: recordings to judge it -> thorough diagnosis -> the answer, or again

Rule 1: an experiment is chosen by its expected information for its time on the rig.  Two causes that are z standard
        errors apart have a log-likelihood ratio of z^2/2; a z beyond SURE_Z has no further value.
Rule 2: "model adequate" and "unknown cause" need all experiments of the default campaign, because an effect shows only
        if it is excited.
Rule 3: judge recordings are made last and used for judging only.
Rule 4: an experiment is made once; one that failed on this rig is not tried again.
Rule 5: an experiment that exceeds the remaining time on the rig is not begun.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass

from protocol.diagnosis import Diagnosis

START = ("lift-off", "rest", "amplifier-steps", "wide-steps")
COVERAGE = (*START, "prbs-reference", "multisine", "prbs-open-loop", "steps")  # the default campaign, for fitting
FLIGHTS = ("wide-steps", "prbs-reference", "multisine", "steps")
JUDGES = ("wide-steps-judge", "multisine-judge")
ENOUGH_Z = 3.0  # from this z on, the diagnosis does not put two causes into one equivalence class (9 = 2 * 4.5)
SURE_Z = 5.0
SURE = 0.9  # confidence
_TO_STAND = "to confirm the answer with all recordings and every candidate"


@dataclass(frozen=True, slots=True, kw_only=True)
class Offer:
    """An experiment of the menu on this rig."""

    purpose: str
    seconds: float  # on the rig, with lifting and landing
    needs: str = ""  # an experiment that must be recorded before
    preparation: str = ""  # manual preparation, as an instruction


@dataclass(frozen=True, slots=True, kw_only=True)
class Known:
    """The state of an investigation."""

    recordings: Set[str]  # recordings in the folder
    refused: Set[str]  # experiments that failed, were impossible or were skipped
    answer: Diagnosis | None  # the newest diagnosis
    diagnosed: Set[str]  # the recordings of that diagnosis
    thorough: bool  # whether it was made without --quick
    left_s: float  # remaining time on the rig
    quick: bool  # whether all diagnoses are made with --quick


@dataclass(frozen=True, slots=True, kw_only=True)
class Perform:
    """Action: make experiments."""

    experiments: tuple[str, ...]
    seconds: float
    why: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Diagnose:
    """Action: diagnose all recordings so far."""

    thorough: bool
    why: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Finish:
    """Action: end the investigation."""

    stands: bool  # whether the answer is final
    why: str


Action = Perform | Diagnose | Finish


def next_action(known: Known, menu: Mapping[str, Offer]) -> Action:
    """The next action, of those possible on this rig."""
    if not known.recordings & set(FLIGHTS):  # a diagnosis needs a flight
        missing = [name for name in START if name not in known.recordings | known.refused]
        if missing:
            why = "every model first needs input and current of lift-off, noise, amplifier, one flight"
            return _perform(known, menu, missing, why)
        for name in (name for name in FLIGHTS if name not in known.refused):
            return _perform(known, menu, [name], "no flight is recorded yet, and without one there is no force law")
        return Finish(stands=False, why="no flight could be recorded on this rig")
    if known.answer is None or known.diagnosed != known.recordings:
        if known.quick or not known.recordings & set(JUDGES):
            why = "quick, as requested" if known.quick else "a quick diagnosis suffices to choose the next experiment"
            return Diagnose(thorough=False, why=f"recordings so far: {', '.join(sorted(known.recordings))}; {why}")
        return Diagnose(thorough=True, why=_TO_STAND)
    action = _after(known, known.answer, menu)
    if isinstance(action, Finish) and not known.thorough and not known.quick:
        return Diagnose(thorough=True, why=_TO_STAND)
    return action


def _after(known: Known, answer: Diagnosis, menu: Mapping[str, Offer]) -> Action:
    """The next action if the newest diagnosis has all recordings."""
    if answer.verdict == "unfinished":
        return Finish(stands=False, why="the diagnosis ended by its budget of computation")
    if answer.is_open and (split := _splitting(known, answer, menu)) is not None:
        return split
    lacking = _lacking(answer, thorough=known.thorough)
    if lacking:
        for name in COVERAGE:
            if name not in known.recordings | known.refused:
                return _perform(known, menu, [name], f"{lacking}; not excited yet: {menu[name].purpose}")
    judges = [name for name in JUDGES if name not in known.recordings | known.refused]
    if judges:
        return _perform(known, menu, judges, "the answer must be judged by recordings that were not used to choose it")
    return _finish(known, answer, menu)


def _lacking(answer: Diagnosis, *, thorough: bool) -> str:
    """Return why the answer is not final; "" if it is.  Confidence counts only if it is calibrated (`thorough`)."""
    if answer.verdict == "model-adequate":
        return "only noise is left, as far as the rig was excited"
    if answer.verdict != "causes-found":
        return "more than noise is left"
    weak = [
        suspect for suspect in answer.suspects if thorough and not suspect.confounders and suspect.confidence < SURE
    ]
    return f"{weak[0].name} has a confidence of {weak[0].confidence:.2f}" if weak else ""


def _splitting(known: Known, answer: Diagnosis, menu: Mapping[str, Offer]) -> Action | None:
    """The experiment with most information on the equivalence classes for its time; None if none has any."""
    tells: dict[str, float] = {}
    best_z: dict[str, float] = {}
    for suspect in answer.suspects:
        for name, separations in suspect.experiments.items():
            for confounder, now_z in suspect.confounders.items():
                z = separations.get(confounder, 0.0)
                if z >= ENOUGH_Z:
                    tells[name] = tells.get(name, 0.0) + (min(z, SURE_Z) ** 2 - min(now_z, ENOUGH_Z) ** 2) / 2.0
                    best_z[name] = max(best_z.get(name, 0.0), z)
    possible = [
        name
        for name in tells
        if name in menu and name not in known.recordings | known.refused and not menu[name].preparation
    ]
    if not possible:
        return None
    cost = {name: _seconds(known, menu, [name]) for name in possible}
    ranked = sorted(possible, key=lambda name: -tells[name] / cost[name])
    affordable = [name for name in ranked if cost[name] <= known.left_s]
    if not affordable:
        return _perform(known, menu, ranked[:1], "")
    name = affordable[0]
    alternatives = ", ".join(f"{other} {best_z[other]:.1f} in {cost[other]:.0f} s" for other in ranked if other != name)
    why = (
        f"{_classes(answer)}; {name} is expected to bring them {best_z[name]:.1f} standard errors apart in"
        f" {cost[name]:.0f} s" + (f" ({alternatives})" if alternatives else "")
    )
    return _perform(known, menu, [name], why)


def _classes(answer: Diagnosis) -> str:
    return "; ".join(
        f"{suspect.name} may be "
        + " or ".join(f"{confounder} ({z:.1f} apart)" for confounder, z in suspect.confounders.items())
        for suspect in answer.suspects
        if suspect.confounders
    )


def _seconds(known: Known, menu: Mapping[str, Offer], names: Sequence[str]) -> float:
    """Time on the rig, with the experiments that must be recorded before, s."""
    before = {menu[name].needs for name in names} - known.recordings - {*names, ""}
    return sum(menu[name].seconds for name in (*names, *before))


def _perform(known: Known, menu: Mapping[str, Offer], names: Sequence[str], why: str) -> Action:
    seconds = _seconds(known, menu, names)
    if seconds > known.left_s:
        what = " and ".join(names)
        return Finish(
            stands=False,
            why=f"the budget is spent: {what} would take {seconds:.0f} s, {max(known.left_s, 0.0):.0f} s are left",
        )
    return Perform(experiments=tuple(names), seconds=seconds, why=why)


def _finish(known: Known, answer: Diagnosis, menu: Mapping[str, Offer]) -> Finish:
    if answer.verdict == "unknown-cause":
        return Finish(stands=False, why="no cause of the catalogue explains it, and all experiments were made")
    outside = [text for suspect in answer.suspects for text in suspect.outside]
    if answer.is_open:
        for name in sorted(
            {name for suspect in answer.suspects for name in suspect.experiments} & menu.keys() - known.recordings
        ):
            if menu[name].preparation:
                outside.append(f"`board51 campaign run --experiment {name}` may: {menu[name].preparation}")
        return Finish(stands=True, why=f"{_classes(answer)}: no experiment distinguishes them; " + " ".join(outside))
    if answer.verdict == "model-adequate":
        return Finish(stands=True, why="all experiments were made, and only noise is left")
    if answer.verdict == "partly-explained":
        return Finish(
            stands=True, why="the named causes hold and all experiments were made, but more than noise is left"
        )
    names = " and ".join(suspect.name for suspect in answer.suspects)
    measure = f". Only these measurements would show more: {'; '.join(outside)}" if outside else ""
    return Finish(stands=True, why=f"one cause is left for each effect: {names}{measure}")
