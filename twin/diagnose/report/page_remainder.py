"""What is left as a curve: its sentence, and the page's pictures and table."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from twin.diagnose.remainder.remainder import Remainder, Shape, Worth
from twin.diagnose.report import figures
from twin.diagnose.report.sentences import finding_sentence, micrometres, quantity
from twin.diagnose.result import Diagnosis
from twin.model.parameters import Parameter
from twin.page.figures import inline

NOTHING = (
    "No smooth curve of height, speed, current or input predicts better: what is left has a memory, changes with time, "
    "or depends on something that was not recorded."
)
_BESIDE = {"causes": "the causes", "paper": "the paper's model"}


def remainder_sentence(found: Remainder, parameters: Mapping[str, Mapping[str, Parameter]]) -> str:
    """What is left, and what its model is worth.

    Args:
        found: the remainder.
        parameters: of each cause of the extended model, by its name.
    """
    parts = [
        f"a curve of what is left has the form of {name}, which predicts as well in its place: "
        f"{finding_sentence(name, parameters[name])}; a candidate, not in the causes"
        for name in found.proposed
    ]
    parts += [f"what is left is best described by {_curve(shape)}" for shape in found.shapes]
    if not parts:
        return NOTHING + _flexible(found.worth)
    text = "; ".join(parts)
    return f"{text[:1].upper()}{text[1:]}. {_worth(found.worth)}"


def answer_with(found: Diagnosis, sentence: str) -> str:
    """The answer of a diagnosis with its remainder; what leads is what the extended model says.

    Args:
        found: the diagnosis.
        sentence: its answer without the remainder.
    """
    left = found.remainder
    if left is None:
        return sentence
    own = remainder_sentence(left, {one.name: one.parameters for one in found.extended.causes})
    if left.beside == "causes" or found.verdict != "unknown-cause":
        return f"{sentence} {own}"
    names = ", ".join(one.name for one in found.causes)
    return (
        f"The model is wrong, and none of the known causes explains it. {own} Beside this curve the candidates "
        f"({names}) are not needed: they may only imitate it."
    )


def remainder(found: Diagnosis) -> dict[str, Any]:
    """What page_errors.html shows of it."""
    left = found.remainder
    if left is None:
        return {"remainder": None}
    return {
        "remainder": {
            "sentence": remainder_sentence(left, {one.name: one.parameters for one in found.extended.causes}),
            "pictures": [
                inline(figures.shape_figure(shape), f"{shape.curve.title[:1].upper()}{shape.curve.title[1:]}{instead}")
                for shapes, instead in (
                    (left.shapes, ""),
                    (left.replaced, f"; in its place: {', '.join(left.proposed)}"),
                )
                for shape in shapes
            ],
            "in_model": bool(left.shapes),
            "tried": [
                [
                    one.name,
                    _BESIDE[one.beside],
                    f"{one.loglik_gain:.0f}",
                    f"{one.rmse_m * 1e6:.3g}",
                    "" if math.isnan(one.absorbed) else f"{100.0 * one.absorbed:.0f} %",
                ]
                for one in left.tried
            ],
        }
    }


def _curve(shape: Shape) -> str:
    known = shape.curve.parameters[0]
    ends = sorted((int(np.argmax(shape.share)), int(np.argmin(shape.share))))
    sizes = [f"{100.0 * shape.share[end]:+.2g} % at {quantity(float(shape.at[end]), known.unit)}" for end in ends]
    return f"{shape.curve.title}: {' to '.join(sizes)}, {shape.curve.acts_on}, about its mean"


def _worth(worth: Worth) -> str:
    return (
        f"With it the error of x {worth.horizon_s * 1e3:.0f} ms ahead is {micrometres(worth.extended_rmse_m)} instead "
        f"of {micrometres(worth.causes_rmse_m)}, on judge samples that chose nothing; noise alone makes "
        f"{micrometres(worth.floor_m)}.{_flexible(worth)}"
    )


def _flexible(worth: Worth) -> str:
    if math.isnan(worth.flexible_rmse_m):
        return ""
    return (
        f" A regression without physics, on the same recordings, predicts to {micrometres(worth.flexible_rmse_m)}; "
        "it can also read later positions from the u_c that a closed loop makes of them."
    )
