"""The comparison: what was compared, the changes, the parameters, and the answer in words."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from protocol.errors import DataError
from twin.comparison.errors import WHOLE, Change, paired, predictions, unpaired
from twin.comparison.parameters import Course, courses
from twin.estimation.family import holm
from twin.estimation.record import Record
from twin.model.parameters import Model
from twin.page.plain import micrometres

SAME_TIME = 0.05  # of the sampling time: flights nearer than that have the same horizons


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Two models on the same flights, two flights under one model, or models over time."""

    kind: Literal["models", "flights", "time"]
    names: tuple[str, ...]  # of the sides, in their order
    days: tuple[str, ...]  # on which they were measured, ISO 8601; empty: unknown
    flights: tuple[str, ...]
    changes: tuple[Change, ...]  # of the second side against the first
    parameters: tuple[Course, ...]
    notes: tuple[str, ...]

    @property
    def differs(self) -> bool:
        """Return whether any difference is significant."""
        marks = [change.significant for change in self.changes]
        return any(marks) or any(course.significant for course in self.parameters)

    def answer(self) -> str:
        """Return at most two sentences: the largest significant difference, and what follows."""
        if self.kind == "time":
            return _changed(self.parameters, len(self.names))
        # The whole travel alone: the regions are parts of it, and the answer has room for one number.
        whole = [change for change in self.changes if change.region == WHOLE and math.isfinite(change.chance)]
        if not whole:
            return "The flights are too short, or the predictions too equal, for a comparison."
        marked = [change for change in whole if change.significant]
        if not marked:
            # The widest interval: the answer claims no more than the poorest horizon shows.
            widest = max(whole, key=lambda change: change.ci95[1] / change.ci95[0])
            return (
                f"No difference is significant. {_ms(widest)} ahead the second error is between "
                f"{widest.ci95[0]:.3g} and {widest.ci95[1]:.3g} times the first."
            )
        # By the logarithm: half the error is as large a change as twice the error.
        largest = max(marked, key=lambda change: abs(math.log(change.ratio)))
        better = {change.ratio < 1.0 for change in marked}
        name = self.names[1] if largest.ratio < 1.0 else self.names[0]
        figures = (
            f"{_ms(largest)} ahead the error of {self.names[1]} is {micrometres(largest.second_m)} um, "
            f"that of {self.names[0]} {micrometres(largest.first_m)} um"
        )
        if self.kind == "flights":
            if len(better) > 1:
                return f"The error of the model differs between the flights, not in one direction. {figures}."
            return f"The model predicts {name} better. {figures}."
        if len(better) > 1:
            return f"Which model predicts better depends on the horizon. {figures}."
        return f"{name} predicts better. {figures}."


def compare_models(
    models: Sequence[Model], flights: Sequence[Record], *, progress: Callable[[str], None] = lambda _: None
) -> Comparison:
    """Compare two models on the same flights.

    Raises:
        DataError: the models are of different rigs, the sampling times differ, or a flight cannot be predicted.
    """
    first, second = models
    _same_rig(models)
    _same_sampling(flights)
    pairs = []
    for record in flights:
        progress(f"predicting {record.name}")
        pairs.append((predictions(first, record), predictions(second, record)))
    changes = []
    for n in range(len(pairs[0][0])):
        changes += paired([a[n] for a, _ in pairs], [b[n] for _, b in pairs], first.plant.travel_m)
    notes = [note for a, b in pairs for side in (a[-1], b[-1]) for note in side.notes]
    return Comparison(
        kind="models",
        names=_names(models),
        days=_days(models),
        flights=tuple(record.name for record in flights),
        changes=_decided(changes),
        parameters=courses(models),
        notes=tuple(dict.fromkeys(notes)),
    )


def compare_flights(model: Model, flights: Sequence[Record]) -> Comparison:
    """Compare two flights under one model.

    Raises:
        DataError: the sampling times differ, or a flight cannot be predicted.
    """
    _same_sampling(flights)
    sides = [predictions(model, record) for record in flights]
    changes = [change for a, b in zip(*sides, strict=True) for change in unpaired(a, b, model.plant.travel_m)]
    names = tuple(record.name for record in flights)
    return Comparison(
        kind="flights",
        names=names if names[0] != names[1] else (f"{names[0]} (first)", f"{names[1]} (second)"),
        days=("", ""),
        flights=names,
        changes=_decided(changes),
        parameters=(),
        notes=tuple(dict.fromkeys(note for side in sides for note in side[-1].notes)),
    )


def compare_over_time(models: Sequence[Model]) -> Comparison:
    """Compare the parameters of models of one rig, in the order of their days of measurement.

    Raises:
        DataError: the models are of different rigs.
    """
    _same_rig(models)
    # All or none: a model without a day has no place among dated ones.
    dated = all(model.measured is not None for model in models)
    ordered = sorted(models, key=lambda model: str(model.measured)) if dated else list(models)
    notes = () if dated else ("Not every model states its day of measurement: they are in the order given.",)
    return Comparison(
        kind="time",
        names=_names(ordered),
        days=_days(ordered),
        flights=(),
        changes=(),
        parameters=courses(ordered),
        notes=notes,
    )


def _decided(changes: Sequence[Change]) -> tuple[Change, ...]:
    """The changes with `significant` decided over all of them as one family of tests."""
    # One family: of 16 independent tests at 5 % each, one or more would mark equal models in half of all comparisons.
    marks = holm([change.chance for change in changes])
    return tuple(replace(change, significant=mark) for change, mark in zip(changes, marks, strict=True))


def _same_rig(models: Sequence[Model]) -> None:
    first = models[0].plant
    for model in models[1:]:
        for key in ("travel_m", "x_max_m", "mass_kg"):
            a, b = getattr(first, key), getattr(model.plant, key)
            if abs(a - b) > 1e-6 * abs(a):
                raise DataError(
                    f"{key} is {a:g} in {models[0].name} and {b:g} in {model.name}: they describe different rigs",
                    remedy="Compare models of one rig",
                )


def _same_sampling(flights: Sequence[Record]) -> None:
    first = flights[0]
    for record in flights[1:]:
        if abs(first.interval_s - record.interval_s) > SAME_TIME * first.interval_s:
            raise DataError(
                f"{first.name} is sampled every {first.interval_s * 1e3:.4g} ms, {record.name} every "
                f"{record.interval_s * 1e3:.4g} ms",
                remedy="Compare flights of one sampling time, as their horizons are not the same otherwise",
            )


def _names(models: Sequence[Model]) -> tuple[str, ...]:
    """The names of the models; those that are equal are numbered."""
    names = [model.name for model in models]
    return tuple(name if names.count(name) == 1 else f"{name} (no. {n + 1})" for n, name in enumerate(names))


def _days(models: Sequence[Model]) -> tuple[str, ...]:
    return tuple("" if model.measured is None else model.measured.isoformat() for model in models)


def _ms(change: Change) -> str:
    return f"{change.horizon_s * 1e3:.3g} ms"


def _changed(parameters: Sequence[Course], count: int) -> str:
    marked = [course for course in parameters if course.significant]
    if not any(math.isfinite(course.chance) for course in parameters):
        return "No parameter has a standard error in two of the models, so no change can be tested."
    if not marked:
        return f"No parameter changed significantly over the {count} models."
    largest = min(marked, key=lambda course: course.chance)
    more = [course.name for course in marked if course is not largest]
    low, high = (f"{100.0 * end:+.3g}" for end in largest.change_ci95)
    also = f" Also changed: {', '.join(more)}." if more else " No other parameter changed significantly."
    return f"{largest.name} changed by {100.0 * largest.change:+.3g} % from first to last ({low} .. {high} %).{also}"
