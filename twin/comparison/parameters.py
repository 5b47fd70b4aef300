"""Parameters of several models beside each other, and whether they changed.

Rule 1: the models come from different recordings, so their errors are independent.  For models of the same recordings
        the test finds too few changes.
Rule 2: a parameter without a standard error is shown and not tested.

Source: W. G. Cochran, The Combination of Estimates from Different Experiments, Biometrics 10 (1954), 101-129.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.distributions import Z_95, chi2_above
from twin.estimation.family import holm
from twin.model.parameters import Model, Parameter


@dataclass(frozen=True, slots=True, kw_only=True)
class Course:
    """A parameter in all models that have it."""

    name: str  # K_A, or cause: symbol
    unit: str
    values: tuple[float, ...]  # by model; NaN: the model lacks it
    stds: tuple[float, ...]  # NaN: unknown
    chance: float  # p value of one true value for all (chi-square); NaN: not testable
    change: float  # of the last value against the first, as a share of the first
    change_ci95: tuple[float, float]
    significant: bool = False  # by Holm's method over all parameters


def courses(models: Sequence[Model]) -> tuple[Course, ...]:
    """Return the course of each parameter of the paper and of each cause."""
    tables = [_named(model) for model in models]
    names = dict.fromkeys(name for parameters in tables for name in parameters)
    rows = [_course(name, [parameters.get(name) for parameters in tables]) for name in names]
    decided = holm([row.chance for row in rows])
    return tuple(replace(row, significant=mark) for row, mark in zip(rows, decided, strict=True))


def _named(model: Model) -> dict[str, Parameter]:
    own = dict(model.parameters)
    return own | {
        f"{cause.name}: {name}": parameter for cause in model.causes for name, parameter in cause.parameters.items()
    }


def _std(parameter: Parameter | None) -> float:
    """The standard error; for a profile interval, a quarter of its width is that of a normal distribution."""
    if parameter is None or parameter.verdict == "not-identifiable":
        return math.nan
    if parameter.std is not None:
        return parameter.std
    return (parameter.ci95[1] - parameter.ci95[0]) / (2.0 * Z_95) if parameter.ci95 is not None else math.nan


def _course(name: str, estimates: Sequence[Parameter | None]) -> Course:
    values = np.array([math.nan if parameter is None else parameter.value for parameter in estimates])
    stds = np.array([_std(parameter) for parameter in estimates])
    known = np.flatnonzero(np.isfinite(values) & (stds > 0.0))
    chance, change, half = math.nan, math.nan, math.nan
    if len(known) > 1:
        # Cochran (1954): under one true value, the weighted squares about the weighted mean are chi-square.
        weights = stds[known] ** -2.0
        mean = float(weights @ values[known] / weights.sum())
        chance = chi2_above(float(weights @ (values[known] - mean) ** 2), len(known) - 1)
        first, last = known[0], known[-1]
        if values[first]:
            change = float(values[last] / values[first] - 1.0)
            # The error of a ratio near 1; with a large change the part of the first value would grow with the ratio.
            half = Z_95 * math.hypot(stds[last], stds[first]) / abs(float(values[first]))
    return Course(
        name=name,
        unit=next(parameter.unit for parameter in estimates if parameter is not None),
        values=tuple(values.tolist()),
        stds=tuple(stds.tolist()),
        chance=chance,
        change=change,
        change_ci95=(change - half, change + half),
    )
