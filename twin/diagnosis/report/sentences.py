"""Sentences for people: a cause with its size, the answer of a diagnosis, the bound on what was not found.

Rule 1: the answer has the causes, how sure they are, their share of the error, and the gain.  Causes that these data
        cannot tell apart come next.
Rule 2: a share is one of log-likelihood on the recordings for fitting, and the text says so.  A gain is given in
        prediction errors on the judge recordings.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from twin.diagnosis.report.quantities import measured, micrometres, percent, quantity, times
from twin.diagnosis.search.forward_step import Round
from twin.diagnosis.search.score_test import Score
from twin.distributions import Z_95
from twin.inference.budget import millions
from twin.model.causes.catalogue import BY_NAME
from twin.model.causes.cause import Cause, CauseParameter
from twin.model.parameters import Parameter
from twin.settings import diagnosis as settings

if TYPE_CHECKING:
    from twin.diagnosis.checks.change_point import Change
    from twin.diagnosis.checks.consistency import Beginning, Contradiction
    from twin.diagnosis.checks.outlier_recording import Outlier
    from twin.diagnosis.judge.account import Account
    from twin.diagnosis.judge.prediction_gain import Gain
    from twin.diagnosis.remainder.rivals import Rival
    from twin.diagnosis.result import Diagnosis, Finding

LACKED = "the log-likelihood that the model lacks"  # on the recordings for fitting, against sensor noise alone
ON_JUDGES = "on the judge recordings"
BLIND = "For the amplifier only, because no recording has x:"
NUMBERS = {2: "Two", 3: "Three", 4: "Four"}


class _Size:
    """A parameter in the template of a sentence: `{d_m}` its magnitude, `{gain:%}` its distance from neutral."""

    def __init__(self, known: CauseParameter, parameter: Parameter) -> None:
        self._known, self._parameter = known, parameter

    def __format__(self, how: str) -> str:
        value, ci95 = self._parameter.value, self._parameter.ci95
        if how == "%":
            away = abs(value - self._known.neutral)
            spread = None if ci95 is None else (away - 0.5 * (ci95[1] - ci95[0]), away + 0.5 * (ci95[1] - ci95[0]))
            return measured(100.0 * away, None if spread is None else (100 * spread[0], 100 * spread[1]), "%")[0]
        ends = ci95 if ci95 is None or value >= 0.0 else (-ci95[1], -ci95[0])
        return measured(abs(value), ends, self._known.unit)[0]


def cause_sentence(cause: str, parameters: Mapping[str, Parameter]) -> str:
    """The cause in plain words with its sizes."""
    known = BY_NAME[cause]
    strength = parameters[known.strength.name]
    template = known.opposite if known.opposite and strength.value < known.strength.neutral else known.sentence
    if not template:
        return f"{known.title}: {sizes(cause, parameters)}"
    return template.format(
        **{
            parameter.name: _Size(parameter, parameters[parameter.name])
            for parameter in known.parameters
            if parameter.name in parameters
        }
    )


def finding_sentence(cause: str, parameters: Mapping[str, Parameter]) -> str:
    """The cause in plain words with its sizes, and the 95 % interval of its strength."""
    known, text = BY_NAME[cause], cause_sentence(cause, parameters)
    if not known.sentence:
        return text
    strength = parameters[known.strength.name]
    _, interval = measured(strength.value, strength.ci95, known.strength.unit)
    form = form_of(known, parameters)
    size = f"{known.strength.symbol} = {interval}, 95 %" if interval else ""
    spreads = [
        _spread_sentence(shape, parameters[shape.name])
        for shape in known.shapes
        if shape.random and shape.name in parameters and _differs(shape, parameters[shape.name])
    ]
    shape = "; ".join(spreads) if spreads else f"nearest form: {form}" if form else ""
    details = "; ".join(part for part in (size, shape) if part)
    return f"{text} ({details})" if details else text


def larger_walk(cause: str, parameters: Mapping[str, Parameter]) -> str:
    """Return how far an error wanders in a minute, if that is more than its mean; else ""."""
    known = BY_NAME[cause]
    mean = abs(parameters[known.strength.name].value)
    walks = (shape for shape in known.shapes if shape.walks and shape.name in parameters)
    return " ".join(
        f"and {_spread_sentence(shape, parameters[shape.name])}"
        for shape in walks
        if parameters[shape.name].value > mean and _differs(shape, parameters[shape.name])
    )


def _differs(shape: CauseParameter, parameter: Parameter) -> bool:
    return abs(parameter.value - shape.neutral) > 2.0 * (parameter.std or 0.0)


def _spread_sentence(shape: CauseParameter, parameter: Parameter) -> str:
    size, _ = measured(parameter.value, parameter.ci95, shape.unit)
    return f"wanders by {size} in a minute" if shape.walks else f"varies by {size} from tick to tick"


def form_of(cause: Cause, parameters: Mapping[str, Parameter]) -> str:
    """The form of the literature that is nearest to the shape of a cause; "" for the usual one.

    A shape within two standard errors of its neutral value counts as the usual form.
    """
    shapes = [shape for shape in cause.shapes if shape.name in parameters]

    def distance(values: Mapping[str, float | str]) -> float:
        total = 0.0
        for shape in shapes:
            value = values.get(shape.name, shape.neutral)
            at = parameters[value].value if isinstance(value, str) else value
            # In spreads of the priors, as shapes have no common unit.  Standard errors would call the best known shape
            # the most different.
            total += ((parameters[shape.name].value - at) / shape.spread) ** 2
        return total

    # A shape that the data leave open stays near its prior, so the usual form keeps its name.
    if not any(_differs(shape, parameters[shape.name]) for shape in shapes):
        return ""
    forms: dict[str, Mapping[str, float | str]] = {"": {}, **{form.name: form.values for form in cause.forms}}
    return min(forms, key=lambda name: distance(forms[name]))


def sizes(cause: str, parameters: Mapping[str, Parameter]) -> str:
    """List every parameter by its symbol, with its interval."""
    parts = []
    for entry in BY_NAME[cause].parameters:
        parameter = parameters[entry.name]
        number, interval = measured(parameter.value, parameter.ci95, entry.unit)
        parts.append(f"{entry.symbol} = {number}" + (f" (95 %: {interval})" if interval else ""))
    return ", ".join(parts)


def bound_sentence(cause: Cause, score: Score) -> str:
    """Say how large a cause that was not selected can be at most."""
    strength = cause.strength
    if score.detectable <= 0.0:
        return "no effect on these recordings"
    # The far end of the interval, not the estimate: that of an absent cause is near 0 and bounds nothing.
    reach = abs(score.step) + Z_95 / score.detectable
    if math.isinf(strength.neutral):
        if score.step <= 0.0:
            return f"not reached: {quantity(score.probe, strength.unit)} would already show"
        return f"would gain {score.gain:.1f} of log-likelihood: too little"
    size = abs(strength.coordinate(score.probe)) * reach
    change = "differs by at most" if strength.neutral else "is at most"
    what = quantity(size, strength.unit) if strength.unit else f"{100.0 * size:.2g} %"
    return f"{strength.symbol} {change} {what} (95 %)"


def round_sentence(step: Round) -> str:
    """Say what one round of the search decided."""
    best = step.best
    if best is None:
        return "nothing in the catalogue gains anything"
    if not step.refusal:
        return (f"together with {step.partner}, " if step.partner else "") + f"log-likelihood +{best.gain:.0f}"
    because = {
        "chance": f", but its gain of {best.gain:.1f} may be chance",
        "outside its range": ", but outside its physical range",
        "minor": ", but is a minor effect compared with all that was missing",
        "minor beside noise": ", but hardly more than noise is left, and it is a minor effect",
        "small share": f", but explains {100 * step.share:.0f} % of what is left",
    }
    return f"{best.cause} would be best{because[step.refusal]}"


def answer_sentence(diagnosis: Diagnosis, *, blind: bool, off: str) -> str:
    """Return `summary_sentence` for recordings without x (`blind`) or for a given model whose numbers are `off`."""
    if off and diagnosis.verdict == "model-adequate":
        return adequate_sentence(off)
    sentence = summary_sentence(diagnosis)
    return f"{BLIND} {sentence}" if blind else sentence


def adequate_sentence(off: str) -> str:
    """Say that the model is adequate; `off`: which of its numbers are not, or ""."""
    return (
        f"The form of the model is adequate, but {off}."
        if off
        else "The model is adequate: its errors are sensor noise."
    )


def summary_sentence(diagnosis: Diagnosis) -> str:
    """The answer of a diagnosis, verdict by verdict."""
    if diagnosis.verdict == "model-adequate":
        return adequate_sentence("") + _floor_clause(diagnosis.gain)
    gain = _gain_sentence(diagnosis)
    if diagnosis.verdict == "unfinished":
        return _unfinished(diagnosis) + gain
    sure = [finding for finding in diagnosis.causes if diagnosis.holds(finding)]
    unsure = [finding for finding in diagnosis.causes if not diagnosis.holds(finding)]
    if diagnosis.verdict in ("causes-found", "partly-explained"):
        text = _causes_sentence(sure, whole=not unsure) + _classes_sentence(sure) + gain
        introduction = " In addition, as candidates: "
        if diagnosis.verdict == "partly-explained":
            text += _rest_clause(diagnosis)
            introduction = " These are smaller than the rest, and perhaps only due to another form of an equation: "
        if unsure:
            text += introduction + _causes_sentence(unsure, whole=False)
        return text + _rivals_sentence(unsure)
    where = diagnosis.unexplained_where.removeprefix("most ")
    rest = f" The remaining error is largest {where}." if where else ""
    if not diagnosis.causes:
        if diagnosis.unexplained_where.startswith(ON_JUDGES):
            rest = f" It explains the recordings for fitting, but not all {diagnosis.unexplained_where}."
        return f"The model is wrong, and none of the known causes explains it.{rest}"
    if overlap := overlap_sentence(diagnosis.account):
        rest = f" {capital(overlap)}.{rest}"
    nearest = _causes_sentence(diagnosis.causes, whole=False)
    nearest = nearest[:1].lower() + nearest[1:] if nearest.startswith("The ") else nearest
    return (
        f"{candidates_sentence(diagnosis)} The nearest candidates may only "
        f"imitate an unknown cause: {nearest}{_classes_sentence(diagnosis.causes)}{_rivals_sentence(unsure)}"
        f"{rest}{gain}"
    )


def _unfinished(diagnosis: Diagnosis) -> str:
    budget = diagnosis.budget
    so_far = _causes_sentence(diagnosis.causes, whole=False) if diagnosis.causes else "no cause was named."
    return (
        f"No answer yet: the search used up its budget of {millions(budget.limit)}. Not examined: "
        f"{'; '.join(budget.unanswered)}. So far: {so_far}"
    )


def _rest_clause(diagnosis: Diagnosis) -> str:
    where = diagnosis.unexplained_where
    if where.startswith(ON_JUDGES):
        return f" But not everything is explained {where}."
    largest = f", most {where.removeprefix('most ')}" if where else ""
    return f" But not everything is explained: {percent(diagnosis.account.unexplained)} of {LACKED} is left{largest}."


def _floor_clause(gain: Gain | None) -> str:
    if gain is None:
        return ""
    return (
        f" On the judge recordings it predicts x {gain.horizon_s * 1e3:.0f} ms ahead to "
        f"{micrometres(gain.baseline_rmse_m)} rms; noise alone makes {micrometres(gain.floor_m)}."
    )


def _causes_sentence(causes: Sequence[Finding], *, whole: bool) -> str:
    """The causes with the share of each."""
    shares = [finding.share_of_excess_explained for finding in causes]
    if len(causes) == 1:
        text = capital(causes[0].sentence)
        if shares[0] <= 0.0:
            return f"{text}."
        what = f"{percent(shares[0])} of {LACKED}"
        return f"{text}: this explains {what}." if whole else f"{text}, which explains {what}."
    listed = "; ".join(
        f"({n}) {finding.sentence}" + (f", {percent(share)}" if share > 0.0 else "")
        for n, (finding, share) in enumerate(zip(causes, shares, strict=True), start=1)
    )
    of = f" (shares: of {LACKED})" if any(share > 0.0 for share in shares) else ""
    return f"{NUMBERS.get(len(causes), str(len(causes)))} causes{of}: {listed}."


def _classes_sentence(causes: Sequence[Finding]) -> str:
    """Say which causes these data cannot tell apart, and which stated value may be wrong instead."""
    parts = []
    for finding in causes:
        names = " or ".join(member.name for member in finding.indistinguishable_from if not member.stated)
        stated = [member for member in finding.indistinguishable_from if member.stated]
        if names:
            parts.append(f" These data cannot tell {finding.name} from {names}.")
        if stated:
            more = any(member.lead > settings.EQUIVALENT_GAIN for member in stated)
            wrong = " or ".join(member.sentence for member in stated)
            explains = "explain this, and better than" if more else "explain this instead of"
            parts.append(f" A wrong value in the campaign would {explains} {finding.name}: {wrong}.")
    return "".join(parts)


def _rivals_sentence(causes: Sequence[Finding]) -> str:
    """Say which names something unknown would replace."""
    rivals = dict.fromkeys(rival_sentence(one.rival) for one in causes if one.rival is not None)
    return "".join(f" {capital(sentence)}." for sentence in rivals)


def candidates_sentence(diagnosis: Diagnosis) -> str:
    """Say that the model is wrong where no name holds: because something is left, or because of the names."""
    if diagnosis.account.unexplained > 0.0 or diagnosis.unexplained_where:
        return "The model is wrong, and the known causes do not explain all of it."
    return "The model is wrong, and no known cause is sure to be the reason."


def overlap_sentence(account: Account) -> str:
    """Say how much the names explain jointly, where that is most of it; else ""."""
    if not account.overlaps:
        return ""
    return f"they explain {percent(account.jointly)} of {LACKED} only jointly, as imitations of one effect would"


def rival_sentence(rival: Rival) -> str:
    """Say which curve takes the place of names."""
    place = "its place" if len(rival.names) == 1 else "their place"
    return (
        f"{rival.curve.title} explains more than {' and '.join(rival.names)} in {place} (log-likelihood "
        f"+{rival.lead:.0f})"
    )


def _gain_sentence(diagnosis: Diagnosis) -> str:
    gain = diagnosis.gain
    if gain is None or not diagnosis.causes or diagnosis.before == diagnosis.after:
        return ""
    ratio = gain.baseline_rmse_m / max(gain.extended_rmse_m, 1e-12)
    error = f"{gain.horizon_s * 1e3:.0f} ms prediction error"
    change = f"hardly changes the {error}"
    if ratio >= settings.WORSE_ERROR:
        change = f"cuts the {error} by a factor of {times(ratio)}"
    elif ratio < 1.0 / settings.WORSE_ERROR:
        change = f"makes the {error} {times(1.0 / ratio)} times as large"
    return (
        f" On the judge recordings extending the model {change}: from {micrometres(gain.baseline_rmse_m)} to "
        f"{micrometres(gain.extended_rmse_m)}; noise alone makes {micrometres(gain.floor_m)}."
    )


def beyond_sentence(gain: Gain) -> str:
    """Say how far the error on the judge recordings is above the noise floor."""
    low, high = gain.ci95_floor
    ratio = gain.extended_rmse_m / gain.floor_m
    return (
        f"{ON_JUDGES}: their {gain.horizon_s * 1e3:.0f} ms prediction error is {ratio:.3g} times what noise alone "
        f"makes ({low:.3g} to {high:.3g})"
    )


def contradiction_sentence(contradiction: Contradiction) -> str:
    """Say which recording contradicts the others, and by how much."""
    size = f"{contradiction.parameter} {100 * contradiction.change:+.0f} %"
    return f"{contradiction.recording} contradicts the others: a fit of it alone gives {size}"


def outlier_sentence(outlier: Outlier) -> str:
    """Say which recording was left out, and why."""
    changes = " and ".join(f"{name} {100.0 * change:+.0f} %" for name, change in outlier.moves)
    return (
        f"{outlier.name} contradicts the others and was left out: alone it is explained by {changes}, like another "
        "rig. Check where it comes from"
    )


def beginning_sentence(beginning: Beginning) -> str:
    """Say which cause is absent at first, and where it begins."""
    where = f"{beginning.recording} at about {beginning.t_s:.0f} s"
    return f"{beginning.cause} is absent at first: it begins in {where}"


def change_sentence(change: Change) -> str:
    """Say what changed, and where."""
    names = " and ".join(change.selection.causes)
    if change.begins:
        return f"{names} begins in {change.after}: it is absent up to {change.before}"
    return f"{names} ends after {change.before}: it is absent from {change.after} on"


def capital(text: str) -> str:
    """Capitalise the first letter; a symbol stays as it is."""
    return text if text.startswith(("x ", "i_c ", "i x", "x_max")) else text[:1].upper() + text[1:]
