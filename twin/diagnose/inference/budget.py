"""How much a diagnosis may compute: filter steps, never seconds, so that a busy machine gives the same answer.

`Criterion` takes the steps of a run before it begins; nobody else counts.

Rule 1: a run that is not affordable is not begun: `Spent` is raised, and nothing more is affordable afterwards.
Rule 2: work side by side gets equal shares before it begins: the answer does not depend on who is first.
Rule 3: a question is answered whole or not at all.  Those that were not are `unanswered`, in words.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

MILLION = 1e6
QUICK, FULL = 600 * MILLION, 20_000 * MILLION  # a million takes 0.06 to 0.09 s of processor time
RESERVED = 0.2  # of the limit: for experiments and gain, whatever the search takes


def millions(steps: float) -> str:
    """For people."""
    return f"{steps / MILLION:.4g} million filter steps"


class Spent(Exception):  # noqa: N818  an outcome, not a fault
    """The next run is not affordable."""


class Budget:
    """What is left to compute.

    Args:
        limit: filter steps.
        kept: share of them that waits for `reopen`.
    """

    def __init__(self, limit: float = math.inf, reserved: float = 0.0) -> None:
        self.limit, self.spent, self.closed = limit, 0.0, False
        self._open = limit * (1.0 - reserved)
        self.unanswered: list[str] = []

    def reopen(self) -> None:
        """Allow what was kept back."""
        self._open, self.closed = self.limit, False

    def take(self, steps: float) -> None:
        """Pay for a run.

        Raises:
            Spent: it is not affordable, or one before it was not.
        """
        self.closed = self.closed or self.spent + steps > self._open
        if self.closed:
            raise Spent
        self.spent += steps

    def shares(self, count: int) -> list[Budget]:
        """What is left in equal parts; `settle` takes them back."""
        return [Budget(0.0 if self.closed else (self._open - self.spent) / count) for _ in range(count)]

    def settle(self, shares: Sequence[Budget]) -> None:
        """Take back shares, with what was not spent of them."""
        self.spent += sum(share.spent for share in shares)
        self.closed = self.closed or any(share.closed for share in shares)

    @contextmanager
    def question(self, words: str) -> Iterator[None]:
        """What `Spent` ends in here leaves the whole question unanswered, with whatever was asked on the way."""
        before = len(self.unanswered)
        try:
            yield
        except Spent:
            self.unanswered[before:] = [words]
            raise

    @property
    def used(self) -> float:
        """Share of the limit."""
        return self.spent / self.limit if self.limit > 0.0 else 1.0
