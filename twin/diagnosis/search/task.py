"""The task of a search: the data, the noise, the candidates and the required share; equal in all its steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from twin.inference.fisher_scoring import Fit
from twin.inference.likelihood import Criterion
from twin.inference.noise_floor import Floor
from twin.model.causes.catalogue import CATALOGUE
from twin.model.causes.cause import Cause
from twin.settings import diagnosis as settings


@dataclass(frozen=True, slots=True, kw_only=True)
class Search:
    """The task of a search for causes.

    A share below `settings.MIN_SHARE` selects more causes, too.  `quick` skips most of the class search where several
    causes were found.
    """

    criterion: Criterion  # of the recordings for fitting
    floor: Floor  # what sensor noise alone leaves, under any model
    candidates: Sequence[Cause] = CATALOGUE
    max_candidates: int = settings.CANDIDATES  # that are fitted in a round
    min_share: float = settings.MIN_SHARE  # of the unexplained rest that a cause must explain
    quick: bool = False
    # The best curve of unknown origin beside the paper's model; None if there is none.  Asked where names leave a rest.
    curve: Callable[[], Fit | None] = lambda: None
    report: Callable[[str], None] = lambda line: None  # receives lines of progress

    @property
    def thorough(self) -> bool:
        """Tell whether selected causes are doubted while more than noise is left; it costs many fits."""
        # With a lower share many small causes are selected, and to doubt each of them would cost many fits.
        return self.min_share == settings.MIN_SHARE and not self.quick

    @property
    def passes(self) -> int:
        """Return the passes of a fit in forward and backward steps."""
        return settings.PASSES_QUICK if self.quick else settings.PASSES
