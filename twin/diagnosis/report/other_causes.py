"""The causes that were not named, and why: not testable, ruled out above a size, or only a minor effect."""

from __future__ import annotations

from collections.abc import Sequence

from twin.diagnosis.report.sentences import bound_sentence
from twin.diagnosis.report.trade_offs import symbol_of
from twin.diagnosis.result import Excluded, MinorEffect, fit_parameters
from twin.diagnosis.search.candidate_fits import within_range
from twin.diagnosis.search.state import Selection
from twin.diagnosis.search.stated_values import Absorbed
from twin.estimation.record import Record
from twin.inference.fisher_scoring import spreads, with_covariance
from twin.inference.likelihood import Criterion
from twin.model.causes.catalogue import BY_NAME, CATALOGUE
from twin.model.causes.cause import Cause
from twin.settings import diagnosis as settings

_MAX_MINOR_EFFECTS = 3


def missing_channels(cause: Cause, records: Sequence[Record]) -> list[str]:
    """Return the channels that a cause needs and no recording has."""
    return [channel for channel in cause.needs if not any(record.has(channel) for record in records)]


def not_testable(selection: Selection, records: Sequence[Record]) -> list[Excluded]:
    """The causes that these recordings could not show."""
    entries = []
    # The last round: beside the named causes, the data may show less of another than they did at first.
    last = {score.cause: score for score in selection.rounds[-1].scores} if selection.rounds else {}
    for cause in CATALOGUE:
        missing = missing_channels(cause, records)
        score = last.get(cause.name)
        if cause.not_testable:
            entries.append(Excluded(name=cause.name, why=cause.not_testable))
        elif missing:
            entries.append(Excluded(name=cause.name, why=f"no recording has {' and '.join(missing)}"))
        elif score is not None and not score.testable:
            shows = ", ".join(cause.shows_in) or "no experiment"
            why = f"these recordings would not show it ({shows} would): what it does, the other parameters can do"
            entries.append(Excluded(name=cause.name, why=why))
    return entries


def absorbed_suspect(suspect: Absorbed) -> Excluded:
    """A stated value whose error these recordings do not show, with what settles it."""
    takers = " and ".join(map(symbol_of, suspect.by)) or "the other parameters together"
    why = f"absorbed by {takers}" if suspect.shows else "these recordings do not depend on it"
    return Excluded(name=suspect.cause, why=f"{why}; {BY_NAME[suspect.cause].confirm}")


def ruled_out(selection: Selection, excluded: set[str]) -> list[Excluded]:
    """Return every cause outside `excluded`, with the largest size that it can have."""
    return [
        Excluded(name=score.cause, why=bound_sentence(BY_NAME[score.cause], score))
        for score in (selection.rounds[-1].scores if selection.rounds else ())
        if score.cause not in excluded and score.testable
    ]


def minor_effects_of(criterion: Criterion, selection: Selection) -> tuple[MinorEffect, ...]:
    """Return the causes that the last round refused although chance does not explain their gain, best first.

    Only for a search that leaves noise alone: beside a large rest a small gain may be a part of that rest.
    """
    last = selection.rounds[-1] if selection.rounds else None
    if last is None or last.selected:
        return ()
    classes = {trial.cause for members in selection.classes.values() for trial in members}
    entries = []
    for trial in last.trials:
        other_causes = {name.partition(".")[0] for name in trial.fit.free if "." in name} - {trial.cause}
        is_significant = trial.gain >= settings.MIN_GAIN and within_range(trial) and trial.fit.converged
        # Where one cause took the place of another since, the round was about another model.
        if is_significant and trial.cause not in classes and other_causes == set(selection.causes):
            parameters = fit_parameters(
                trial.fit, trial.cause, spreads(with_covariance(criterion, trial.fit), criterion.plant)
            )
            entries.append(MinorEffect(name=trial.cause, parameters=parameters, loglik_gain=trial.gain))
    return tuple(entries[:_MAX_MINOR_EFFECTS])
