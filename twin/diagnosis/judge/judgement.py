"""The judgement from the judge recordings: the verdict, and the model that is written."""

from __future__ import annotations

from dataclasses import dataclass, replace

from twin.diagnosis.judge.account import Account, Verdict, verdict_of
from twin.diagnosis.judge.choice import Choice, at_20_ms, candidates_of, choice_without_judges, choose, worse
from twin.diagnosis.judge.prediction_gain import Bench, Gain
from twin.diagnosis.judge.reference_model import off_sentence, theta_of
from twin.diagnosis.search.state import Selection
from twin.inference.fisher_scoring import Fit
from twin.inference.theta import Theta
from twin.model.parameters import Model
from twin.settings import diagnosis as settings


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """The verdict, and the model that is written."""

    before: Theta  # of the reference model, or of the fitted paper's model
    whole: Gain | None  # of the model with all causes, at 20 ms
    verdict: Verdict
    choice: Choice
    off: str  # a sentence on wrong parameters of the reference model; "" if there are none


def judge(
    selection: Selection,
    model: Model | None,
    bench: Bench | None,
    account: Account,
    *,
    is_adequate: bool,
    finished: bool,
    counted: bool,
) -> Judgement:
    """Judge the result of a search.

    Args:
        selection: the result.
        model: the user's reference model; None: the paper's model, fitted.
        bench: the judge recordings; None: there are none.
        account: of the shares.
        is_adequate: whether what is left of the recordings for fitting is noise.
        finished: whether the search examined every question.
        counted: whether lost samples are a cause.
    """
    before = selection.base.theta if model is None else theta_of(model, selection.base.theta)
    first = bench.gains(before, selection.fit.theta) if bench is not None else []
    whole = at_20_ms(first)
    # A right name that does nothing to x may be surely worse by less than anybody notices: it loses the file alone.
    harm = worse(first)
    verdict = verdict_of(
        named=not account.overlaps and (bool(set(selection.causes) - account.doubted) or counted),
        is_adequate=is_adequate,
        finished=finished,
        gain=whole,
        leading=(is_adequate and counted) or any(account.leads(name) for name in selection.causes),
        worse=harm is not None and harm.ratio > settings.WORSE_ERROR,
    )
    # Without its names nothing is named, but they did explain something: the model is not adequate.
    if (account.doubted or account.overlaps) and verdict == "model-adequate":
        verdict = "unknown-cause"
    if bench is None or not first:
        choice = choice_without_judges(selection, has_model=model is not None)
        return Judgement(before=before, whole=whole, verdict=verdict, choice=choice, off="")

    def measure(theta: Theta) -> list[Gain]:
        return first if theta is selection.fit.theta else bench.gains(before, theta)

    reference: Fit | None = selection.base if model is None else None
    candidates = candidates_of(selection, has_model=model is not None)
    choice = choose(candidates, reference, measure, sure=verdict in ("causes-found", "partly-explained"))
    if choice.kind == "reference":
        choice = replace(choice, gains=tuple(measure(before)))
    off = ""
    if model is not None and whole is not None:
        off = off_sentence(
            model, selection.base.theta, whole, bench.gain(selection.base.theta, selection.fit.theta, whole.samples)
        )
    return Judgement(before=before, whole=whole, verdict=verdict, choice=choice, off=off)
