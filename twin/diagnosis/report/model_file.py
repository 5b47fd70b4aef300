"""A fit as a model file: `model.json` of the paper's model, `extended_model.json` with its causes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from protocol.campaign import Campaign, Plant
from twin.diagnosis.result import fit_parameters
from twin.distributions import Z_95
from twin.estimation.record import Record, day_of
from twin.inference.fisher_scoring import Fit
from twin.inference.theta import NOISES, PARAMETERS
from twin.model import parameters as file
from twin.model.assumed import mark, rests_on_plant
from twin.model.causes.catalogue import BY_NAME

_EQUATIONS = {"K_A": "(1)", "T_A": "(1)", "K_c": "(3)", "b": "(5)"}
_METHOD = "maximum likelihood of the innovations, all recordings together"


def model_of(
    campaign: Campaign, fit: Fit, spread: Mapping[str, float], records: Sequence[Record], lacks: float, description: str
) -> file.Model:
    """The model file of a fit that `lacks` log-likelihood; standard errors where `spread` has them."""
    theta, plant = fit.theta, campaign.plant
    parameters = {}
    for name in PARAMETERS:
        value, std = float(theta.value(name)), spread.get(name, math.nan)
        known = math.isfinite(std) and std > 0.0
        unit, low, _ = file.PARAMETERS[name]
        parameters[name] = file.Parameter(
            value=value,
            unit=unit,
            std=float(std) if known else None,
            ci95=(max(value - Z_95 * std, low), value + Z_95 * std) if known else None,
            verdict=file.verdict_by(Z_95 * std, value) if known else "assumed",
            method=_METHOD,
            equation=_EQUATIONS[name],
        )
    names = list(dict.fromkeys(name.partition(".")[0] for name, _ in theta.causes))
    return file.Model(
        plant=plant,
        parameters=mark(parameters, plant),
        noise=file.Noise(**{name: theta.value(name) for name in NOISES}),
        causes=tuple(file.ModelCause(name=name, parameters=_of_cause(fit, name, spread, plant)) for name in names),
        provenance={
            "tool": "board51 diagnose",
            "about": description,
            **day_of(records),
            "recordings": [{"file": record.name, "kind": record.kind, "samples": len(record.t)} for record in records],
            "log_likelihood_missing": float(lacks),
        },
    )


def _of_cause(fit: Fit, cause: str, spread: Mapping[str, float], plant: Plant) -> dict[str, file.Parameter]:
    parameters = fit_parameters(fit, cause, spread)
    return mark(parameters, plant, tuple(parameters)) if rests_on_plant(BY_NAME[cause]) else parameters
