"""The curve through what is left: its sentence, and the page's pictures and table."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from twin.diagnosis.remainder.remainder import Improvement, Remainder, Shape
from twin.diagnosis.report import figures
from twin.diagnosis.report.quantities import micrometres, quantity
from twin.diagnosis.report.sentences import capital, finding_sentence
from twin.diagnosis.result import Diagnosis
from twin.model.parameters import Parameter
from twin.page.figures import inline

NO_CURVE = (
    "No smooth curve of height, speed, current or input predicts better: what is left has a memory, changes with time, "
    "or depends on something that was not recorded."
)
_EXTENDED = {"causes": "the causes", "paper": "the paper's model"}


def remainder_sentence(remainder: Remainder, parameters: Mapping[str, Mapping[str, Parameter]]) -> str:
    """Say what is left, and what its model is worth.

    Args:
        remainder: of the diagnosis.
        parameters: of each cause of the extended model, by its name.
    """
    parts = [
        f"a curve of what is left has the form of {name}, which predicts as well in its place: "
        f"{finding_sentence(name, parameters[name])}; a candidate, not in the causes"
        for name in remainder.proposed
    ]
    parts += [f"what is left is best described by {_curve(shape)}" for shape in remainder.shapes]
    if remainder.refused is not None:
        return f"{capital(remainder.refused.title)} predicts x worse than the names, so it is not in the model."
    if not parts:
        return NO_CURVE + _regression_sentence(remainder.improvement)
    return f"{capital('; '.join(parts))}. {_improvement_sentence(remainder.improvement)}"


def answer_with(diagnosis: Diagnosis, sentence: str) -> str:
    """The answer of a diagnosis with its remainder; what leads is what the extended model says.

    Args:
        diagnosis: with its remainder.
        sentence: its answer without the remainder.
    """
    left = diagnosis.remainder
    if left is None:
        return sentence
    text = remainder_sentence(left, {cause.name: cause.parameters for cause in diagnosis.extended.causes})
    if left.extends == "causes" or diagnosis.verdict != "unknown-cause":
        return f"{sentence} {text}"
    names = ", ".join(cause.name for cause in diagnosis.causes)
    return (
        f"The model is wrong, and none of the known causes explains it. {text} With this curve the candidates "
        f"({names}) are not needed: they may only imitate it."
    )


def remainder(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the fields of page_errors.html about the curve."""
    left = diagnosis.remainder
    if left is None:
        return {"remainder": None}
    return {
        "remainder": {
            "sentence": remainder_sentence(left, {entry.name: entry.parameters for entry in diagnosis.extended.causes}),
            "pictures": [
                inline(figures.shape_figure(shape), f"{capital(shape.curve.title)}{instead}")
                for shapes, instead in (
                    (left.shapes, ""),
                    (left.replaced, f"; in its place: {', '.join(left.proposed)}"),
                )
                for shape in shapes
            ],
            "in_model": bool(left.shapes),
            "tried": [
                [
                    entry.name,
                    _EXTENDED[entry.extends],
                    f"{entry.loglik_gain:.0f}",
                    f"{entry.rmse_m * 1e6:.3g}",
                    "" if math.isnan(entry.absorbed) else f"{100.0 * entry.absorbed:.0f} %",
                ]
                for entry in left.attempts
            ],
        }
    }


def _curve(shape: Shape) -> str:
    known = shape.curve.parameters[0]
    ends = sorted((int(np.argmax(shape.share)), int(np.argmin(shape.share))))
    sizes = [f"{100.0 * shape.share[end]:+.2g} % at {quantity(float(shape.at[end]), known.unit)}" for end in ends]
    return f"{shape.curve.title}: {' to '.join(sizes)}, {shape.curve.acts_on}, about its mean"


def _improvement_sentence(improvement: Improvement) -> str:
    return (
        f"With it the error of x {improvement.horizon_s * 1e3:.0f} ms ahead is "
        f"{micrometres(improvement.extended_rmse_m)} instead of {micrometres(improvement.causes_rmse_m)}, "
        f"on judge samples that were not used to choose. Noise alone makes {micrometres(improvement.floor_m)}."
        f"{_regression_sentence(improvement)}"
    )


def _regression_sentence(improvement: Improvement) -> str:
    if math.isnan(improvement.flexible_rmse_m):
        return ""
    return (
        f" A regression without physics predicts the same recordings to {micrometres(improvement.flexible_rmse_m)}."
        " In closed loop it can infer later positions from u_c, which depends on them."
    )
