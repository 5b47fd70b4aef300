"""The state of the search: the causes selected so far and everything that was tried."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from twin.diagnosis.search import periodic
from twin.diagnosis.search.candidate_fits import Trial
from twin.diagnosis.search.forward_step import Round
from twin.diagnosis.search.task import Search
from twin.inference.fisher_scoring import Fit, climb
from twin.inference.likelihood import Criterion
from twin.inference.theta import reinitialised
from twin.settings import diagnosis as settings


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """The causes in the order of selection, and everything that was tried; each step makes a new `Selection`."""

    # Immutable: a step that runs out of budget leaves the selection before it as it was.  A state changed in place
    # would be left half done.
    base: Fit
    fit: Fit
    causes: tuple[str, ...] = ()
    gains: Mapping[str, float] = field(default_factory=dict)
    classes: Mapping[str, tuple[Trial, ...]] = field(default_factory=dict)  # confounders within EQUIVALENT_GAIN
    runner_up: Mapping[str, float] = field(default_factory=dict)  # lead over the best confounder outside the class
    rounds: tuple[Round, ...] = ()
    smaller: Mapping[frozenset[str], Fit] = field(default_factory=dict)  # fits of fewer causes, by what is free in them

    def with_fits(self, fits: Iterable[Fit]) -> Selection:
        """Return a copy with fits for `recall`."""
        return replace(self, smaller={**self.smaller, **{frozenset(fit.free): fit for fit in fits}})

    def recall(self, free: Sequence[str]) -> Fit | None:
        """Return the fit with these free parameters if one is known and has the present phases; None otherwise."""
        fit = self.smaller.get(frozenset(free))
        # The key is the set of free parameters; the phases are not among them, so they are compared.
        stale = fit and periodic.AMPLITUDE in free and fit.theta.phases_s != self.fit.theta.phases_s
        return None if stale else fit

    @property
    def overlaps(self) -> bool:
        """Tell whether the causes explain more jointly than the sum of what is lost without each."""
        return 2.0 * sum(self.gains.values()) < self.fit.loglik - self.base.loglik

    def dropping(self, cause: str, fit: Fit) -> Selection:
        """Return a copy without a cause; `fit` is that of the others."""
        causes = tuple(name for name in self.causes if name != cause)
        gains = {name: gain for name, gain in self.gains.items() if name != cause}
        return replace(self, causes=causes, gains=gains, fit=fit)


def material(search: Search, fit: Fit) -> bool:
    """Tell whether the model leaves more than noise."""
    return search.floor.under(search.criterion, fit.theta).material(fit.loglik)


def superfluous(search: Search, selection: Selection, smaller: Fit) -> bool:
    """Tell whether `smaller`, the model without one cause, does as well by the criteria of a forward step."""
    # The bars for entering, not lower ones for staying: a lower bar would keep causes that could no longer enter.
    loss = selection.fit.loglik - smaller.loglik
    minor_effect = loss < settings.MINOR_SHARE_AT_NOISE * (selection.fit.loglik - selection.base.loglik)
    return loss < settings.MIN_GAIN or (minor_effect and not material(search, smaller))


def fit_without(criterion: Criterion, selection: Selection, cause: str, passes: int = settings.PASSES) -> Fit:
    """Fit the model without one of its causes, or return the fit if `selection` knows it already."""
    free = tuple(name for name in selection.fit.free if not name.startswith(cause + "."))
    start = reinitialised(selection.fit.theta.without(cause, criterion.plant))
    known = selection.recall(free)
    # The known fit may be a lower maximum than the one to which later causes have led.
    if known is not None and criterion.value(start) < known.loglik + settings.MIN_GAIN:
        # Not fitted on to the end: what it could still gain is less than what separates two causes.
        if known.converged or known.ahead < settings.EQUIVALENT_GAIN:
            return known
        start = known.theta
    return climb(criterion, start, free, passes=passes)
