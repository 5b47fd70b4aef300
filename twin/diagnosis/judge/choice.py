"""The choice of the extended model: the last model of the search that predicts no worse than the reference.

The search maximises the likelihood, which weighs errors one sample ahead.  Where an unknown effect is at work, a cause
that imitates it raises the likelihood, and process noise hides the harm.  The error of a longer prediction may grow
meanwhile.  So the judge recordings decide on the file.

Rule 1: a model is worse if its error exceeds WORSE_ERROR times that of the reference at any horizon.  It is also worse
        if its error 20 ms ahead surely (95 %) exceeds that of the reference.  A worse model is refused.  An error that
        noise alone makes of a right model does not count.
Rule 2: a model whose names do not hold is refused, too, unless it surely predicts better 20 ms ahead.  There is no
        other evidence for it.
Rule 3: after a refusal, the models with fewer causes are tried, the likeliest first.  Then come the paper's model,
        fitted anew, and the reference itself.
Rule 4: without judge recordings no comparison is possible: the model is written, and marked as not judged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from twin.diagnosis.judge.prediction_gain import Gain
from twin.diagnosis.search.state import Selection
from twin.estimation.prediction_floor import TOLERANCE
from twin.inference.fisher_scoring import Fit
from twin.inference.theta import Theta
from twin.settings import diagnosis as settings

Kind = Literal["all-causes", "fewer-causes", "paper", "reference"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """A model of the search."""

    kind: Kind
    fit: Fit

    @property
    def causes(self) -> tuple[str, ...]:
        """The names of its causes."""
        return causes_of(self.fit)


@dataclass(frozen=True, slots=True, kw_only=True)
class Refusal:
    """A model that was not written, and the error that decided."""

    causes: tuple[str, ...]
    gain: Gain | None  # None: the budget did not pay for its errors
    worse: bool  # otherwise: not surely better


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """The model that is written."""

    kind: Kind
    fit: Fit | None  # None: the user's reference model, unchanged
    gains: tuple[Gain, ...]  # over the reference, one per horizon
    compared: bool
    refused: tuple[Refusal, ...] = ()


def causes_of(fit: Fit) -> tuple[str, ...]:
    """The names of the causes of a fit."""
    return tuple(dict.fromkeys(name.partition(".")[0] for name, _ in fit.theta.causes))


def at_20_ms(gains: Sequence[Gain]) -> Gain | None:
    """The gain at the horizon that decides."""
    return next((gain for gain in gains if abs(gain.horizon_s - settings.BENEFIT_HORIZON_S) < 0.5 * gain.tick_s), None)


def worse(gains: Sequence[Gain]) -> Gain | None:
    """The gain that shows the model to be worse than the reference, the nearest to 20 ms; None if it is not worse."""
    # One and a half time constants of the unstable pole, so a wrong force shows.  Farther ahead the error of the start
    # grows as fast.
    decisive = at_20_ms(gains)
    ordered = sorted(gains, key=lambda gain: abs(gain.horizon_s - settings.BENEFIT_HORIZON_S))
    surely = decisive is not None and decisive.ci95_ratio[0] > 1.0
    # The loop brings the ball back to its reference, which a prediction from one sample does not know.  So a wrong
    # model with a slower unstable pole may err less than the right one: 75.6 um, where the right one has 78.2 by noise.
    above = [gain for gain in ordered if not gain.extended_rmse_m <= TOLERANCE * gain.floor_m]
    return next((gain for gain in above if gain.ratio > settings.WORSE_ERROR or (surely and gain is decisive)), None)


def refusal_of(candidate: Candidate, gains: Sequence[Gain], *, sure: bool) -> Refusal | None:
    """Return the reason why a model is not written; None if it is.

    Args:
        candidate: the model.
        gains: over the reference.
        sure: whether its names hold by their own evidence.
    """
    # Two bars: no model may be clearly worse, and one whose names are not sure must be significantly better.  A single
    # bar for both would either write candidates that do nothing, or refuse true causes that the judges hardly excite.
    harm, decisive = worse(gains), at_20_ms(gains)
    if harm is not None:
        return Refusal(causes=candidate.causes, gain=harm, worse=True)
    if decisive is None or not (sure or decisive.ci95_ratio[1] < 1.0):
        return Refusal(causes=candidate.causes, gain=decisive, worse=False)
    return None


def choice_without_judges(selection: Selection, *, has_model: bool) -> Choice:
    """Return the model of a search that no recording judges; `has_model`: whether the user gave a reference model."""
    # Written although nothing judged it: it is the likeliest model, and the file says that no recording compared it.
    kind: Kind = "all-causes" if selection.causes else "paper" if has_model else "reference"
    return Choice(kind=kind, fit=selection.fit, gains=(), compared=False)


def choose(
    candidates: Iterable[Candidate],
    reference: Fit | None,
    measure: Callable[[Theta], Sequence[Gain]],
    *,
    sure: bool,
) -> Choice:
    """Return the first candidate that is not refused, or the reference.

    Args:
        candidates: models of the search, the best first.
        reference: the fit of the reference; None: the user gave a reference model.
        measure: the gains of a model over the reference, on the judge recordings.
        sure: whether the names of the first candidate hold by their own evidence.
    """
    refused: list[Refusal] = []
    for index, candidate in enumerate(candidates):
        gains = measure(candidate.fit.theta)
        # Only the first model has the names of the verdict. One with fewer causes has to predict surely better.
        refusal = refusal_of(candidate, gains, sure=sure and index == 0)
        if refusal is None:
            return Choice(
                kind=candidate.kind, fit=candidate.fit, gains=tuple(gains), compared=True, refused=tuple(refused)
            )
        refused.append(refusal)
    return Choice(kind="reference", fit=reference, gains=(), compared=True, refused=tuple(refused))


def candidates_of(selection: Selection, *, has_model: bool) -> list[Candidate]:
    """The models of a search with causes in the order in which they are tried.

    Args:
        selection: the result of the search.
        has_model: whether the user gave a reference model; then the paper's model, fitted anew, is one of them.
    """
    fewer = [
        fit for fit in selection.smaller.values() if causes_of(fit) and set(causes_of(fit)) < set(selection.causes)
    ]
    # The likeliest first, not the best on the judges: the judges test a choice that the fit made.  Choosing by them
    # would make their error an optimistic one.
    fewer.sort(key=lambda fit: -fit.loglik)
    return [
        *([Candidate(kind="all-causes", fit=selection.fit)] if selection.causes else []),
        *(Candidate(kind="fewer-causes", fit=fit) for fit in fewer[: settings.FEWER_CAUSES_COMPARED]),
        *([Candidate(kind="paper", fit=selection.base)] if has_model else []),
    ]
