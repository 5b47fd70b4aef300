"""The computing budget of a diagnosis, in filter steps, so that the answer does not depend on the speed of the machine.

`Criterion` takes the steps of each run of the filter from the budget before the run begins.

Rule 1: a run that exceeds the budget is not begun: `Spent` is raised, and every later run raises it, too.
Rule 2: parallel work gets equal shares in advance, so that the answer does not depend on the order of execution.
Rule 3: a question is answered completely or not at all.  Open questions are listed in `unanswered`, in words.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

MILLION = 1e6  # filter steps, in which a budget is given


def millions(steps: float) -> str:
    """Return a number of filter steps in words."""
    return f"{steps / MILLION:.4g} million filter steps"


class Spent(Exception):  # noqa: N818  an outcome, not a fault
    """The next run exceeds the budget."""


class Budget:
    """The remaining budget.

    Args:
        limit: filter steps.
        reserved: share of them that waits for `reopen`.
    """

    def __init__(self, limit: float = math.inf, reserved: float = 0.0) -> None:
        self.limit, self.spent, self.closed = limit, 0.0, False
        self._open = limit * (1.0 - reserved)
        self.unanswered: list[str] = []

    def reopen(self) -> None:
        """Release the reserved share."""
        self._open, self.closed = self.limit, False

    def take(self, steps: float) -> None:
        """Take the steps of a run.

        Raises:
            Spent: this run, or one before it, exceeds the budget.
        """
        # Closed for good after the first refusal: a smaller run that still fits would make the end depend on the order.
        self.closed = self.closed or self.spent + steps > self._open
        if self.closed:
            raise Spent
        self.spent += steps

    def shares(self, count: int) -> list[Budget]:
        """Divide the rest into equal parts; `settle` returns them."""
        # Equal shares beforehand, not first come first served: the answer must not depend on which thread is faster.
        return [Budget(0.0 if self.closed else (self._open - self.spent) / count) for _ in range(count)]

    def settle(self, shares: Sequence[Budget]) -> None:
        """Return shares, with their unspent steps."""
        self.spent += sum(share.spent for share in shares)
        self.closed = self.closed or any(share.closed for share in shares)

    @contextmanager
    def question(self, words: str) -> Iterator[None]:
        """Mark a question as unanswered if `Spent` is raised within the block."""
        before = len(self.unanswered)
        try:
            yield
        except Spent:
            # The outer question replaces the open ones inside it: it is answered completely or not at all (rule 3).
            self.unanswered[before:] = [words]
            raise

    @property
    def used(self) -> float:
        """Return the spent share of the limit."""
        return self.spent / self.limit if self.limit > 0.0 else 1.0
