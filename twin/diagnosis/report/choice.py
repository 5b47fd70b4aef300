"""The sentence on the model that was written, and its provenance in the file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from twin.diagnosis.judge.choice import Choice, Kind, Refusal
from twin.diagnosis.report.quantities import micrometres
from twin.diagnosis.report.sentences import ON_JUDGES
from twin.diagnosis.result import Diagnosis
from twin.model.parameters import Model

_DESCRIPTIONS: dict[Kind, str] = {
    "all-causes": "extended by board51 diagnose",
    "fewer-causes": "extended by board51 diagnose, without the causes that made the prediction worse",
    "paper": "the paper's model, fitted anew by board51 diagnose",
    "reference": "the reference of board51 diagnose: no model of the search predicts better",
}


def written_model(choice: Choice, model: Model) -> Model:
    """The content of extended_model.json: `model` with a word on what it is.

    Args:
        choice: how it was chosen.
        model: the model of the choice.
    """
    provenance = {"about": _DESCRIPTIONS[choice.kind], "extends": choice.kind, "judged": choice.compared}
    return replace(model, provenance={**model.provenance, **provenance})


def choice_sentence(diagnosis: Diagnosis) -> str:
    """Say what extended_model.json is if a model was refused, with the error that decided; else empty."""
    choice = diagnosis.choice
    if choice is None or not choice.refused:
        return ""
    names = " and ".join(cause.name for cause in diagnosis.extended.causes)
    content = f"has {names}" if names else "is the reference itself"
    if choice.kind == "paper" and not names:
        content = "is the paper's model, fitted anew"
    return f" extended_model.json {content}: {_reason(choice.refused[0])}."


def harm_sentence(refusal: Refusal) -> str:
    """Say how much worse these causes predict the judge recordings."""
    assert refusal.gain is not None
    return f"{ON_JUDGES}: {_errors(refusal)}"


def _reason(refusal: Refusal) -> str:
    if refusal.gain is None:
        return f"{_causes_clause(refusal.causes)} no error was computed {ON_JUDGES}"
    return f"{_errors(refusal)} {ON_JUDGES}" + ("" if refusal.worse else ", which is not significantly better")


def _errors(refusal: Refusal) -> str:
    gain = refusal.gain
    assert gain is not None
    low, high = gain.ci95_ratio
    return (
        f"{_causes_clause(refusal.causes)} the error of x {gain.horizon_s * 1e3:.0f} ms ahead is "
        f"{micrometres(gain.extended_rmse_m)} instead of {micrometres(gain.baseline_rmse_m)} "
        f"({low:.3g} to {high:.3g} times)"
    )


def _causes_clause(causes: Sequence[str]) -> str:
    return f"with {' and '.join(causes)}" if causes else "with the paper's model fitted anew"
