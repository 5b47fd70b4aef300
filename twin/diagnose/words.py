"""Sentences for people: a cause with its size, the answer of a diagnosis, the bound on what was not found."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from twin.diagnose.screen import Score
from twin.model.causes.catalogue import BY_NAME
from twin.model.causes.cause import Cause
from twin.model.parameters import Parameter

if TYPE_CHECKING:
    from twin.diagnose.result import Diagnosis

_PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "u"))
_SCALED = ("m", "A", "s", "N", "V")


def quantity(value: float, unit: str) -> str:
    """A number with its unit at a readable power of ten."""
    if unit in _SCALED and 0.0 < abs(value) < 0.1:
        factor, prefix = next(((f, p) for f, p in _PREFIXES if abs(value) >= 0.1 * f), _PREFIXES[-1])
        return f"{value / factor:.3g} {prefix}{unit}"
    return f"{value:.4g} {unit}".rstrip()


def finding_sentence(cause: str, parameters: Mapping[str, Parameter]) -> str:
    """The cause in plain words, with its sizes."""
    known = BY_NAME[cause]
    sizes = []
    for entry in known.parameters:
        parameter = parameters[entry.name]
        text = f"{entry.symbol} = {quantity(parameter.value, entry.unit)}"
        if parameter.ci95 is not None:
            low, high = (quantity(end, entry.unit) for end in parameter.ci95)
            text += f" ({low} to {high})"
        sizes.append(text)
    return f"{known.title}: {', '.join(sizes)}"


def bound_sentence(cause: Cause, score: Score) -> str:
    """How large a cause that was not taken can be at most."""
    strength = cause.strength
    if score.detectable <= 0.0:
        return "no effect on these recordings"
    reach = abs(score.step) + 1.96 / score.detectable
    if math.isinf(strength.neutral):
        if score.step <= 0.0:
            return f"not reached: nothing below {quantity(score.probe, strength.unit)} is seen"
        return f"explains {score.gain:.1f} of log-likelihood, not enough"
    size = abs(strength.coordinate(score.probe)) * reach
    change = "differs by at most" if strength.neutral else "is at most"
    return f"{strength.symbol} {change} {quantity(size, strength.unit)} (95 %)"


def summary_sentence(found: Diagnosis) -> str:
    """The answer, first."""
    gain = ""
    if found.gain is not None and found.causes:
        ratio = found.gain.baseline_rmse_m / max(found.gain.extended_rmse_m, 1e-12)
        gain = (
            f" Extending the model cuts the {found.gain.horizon_s * 1e3:.0f} ms prediction error by {ratio:.2g} times."
        )
    named = "; ".join(cause.sentence for cause in found.causes)
    share = sum(cause.share_of_excess_explained for cause in found.causes)
    if found.verdict == "model-adequate":
        return "The model is adequate: what it gets wrong is sensor noise."
    if found.verdict == "causes-found":
        text = named[:1].upper() + named[1:]
        explained = f" This explains {100 * min(share, 1.0):.0f} % of what the model lacks." if share > 0.0 else ""
        return f"{text}.{explained}{gain}"
    rest = f" What is left shows {found.unexplained_where}." if found.unexplained_where else ""
    if found.causes:
        return f"{named[:1].upper()}{named[1:]}: but that is not all, and nothing in the catalogue explains the rest.{rest}{gain}"
    return f"The model is wrong, and none of the known causes explains it.{rest}"
