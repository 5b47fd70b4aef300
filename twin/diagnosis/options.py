"""The options of a diagnosis, from the function that a user calls down to the last step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from twin.model.parameters import Model
from twin.settings import diagnosis as settings

Progress = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class Options:
    """The options of `twin.diagnose`, which has their meaning."""

    model: Model | None = None
    quick: bool = False
    share: float = settings.MIN_SHARE
    experiments: bool | None = None
    free_form: bool | None = None
    without: tuple[str, ...] = ()  # causes that the catalogue is to lack
    seed: int = 0
    workers: int = 2
    budget: float | None = None  # filter steps; None: that of the settings
    say: Progress = lambda line: None  # receives progress, each line with the used share of the budget

    @property
    def proposes(self) -> bool:
        """Return whether to find the experiments that split equivalence classes."""
        return not self.quick if self.experiments is None else self.experiments

    @property
    def limit(self) -> float:
        """The largest number of filter steps."""
        return self.budget or (settings.BUDGET_QUICK if self.quick else settings.BUDGET_FULL)
