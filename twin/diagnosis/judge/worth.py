"""The gains of one model over another on the judge recordings, at the horizons within the budget."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

from twin.diagnosis.judge.prediction_gain import Gain, Yardstick
from twin.estimation.pace import pace_of
from twin.identification.horizon import HORIZONS_S
from twin.inference.budget import Budget, Spent
from twin.inference.theta import Theta
from twin.settings import diagnosis as settings


@dataclass(frozen=True, slots=True, kw_only=True)
class Bench(Yardstick):
    """A yardstick that is paid from a budget."""

    workers: int
    budget: Budget

    def gains(self, before: Theta, after: Theta) -> list[Gain]:
        """The gains of `after` over `before`, shortest horizon first; empty if nothing can be predicted or paid for."""
        # The longest first, as it takes most time.
        horizons = sorted({max(round(horizon / self.tick_s), 1) for horizon in HORIZONS_S}, reverse=True)
        horizons = self._affordable(horizons, (before, after))

        with ThreadPoolExecutor(max_workers=self.workers) as pool:
            gains = pool.map(partial(self.gain, before, after), horizons)
            return [result for result in gains if result is not None][::-1]

    def _affordable(self, horizons: Sequence[int], thetas: Sequence[Theta]) -> list[int]:
        """The horizons within the budget; that of the answer has priority."""
        pace, paid = pace_of(self.judge.series), set()
        for samples in sorted(horizons, key=lambda samples: abs(samples * self.tick_s - settings.BENEFIT_HORIZON_S)):
            with suppress(Spent), self.budget.question(f"the error of x {1e3 * samples * self.tick_s:.0f} ms ahead"):
                self.budget.take(
                    sum(pace.steps_ahead(theta.base(self.plant), theta.vector(), samples) for theta in thetas)
                )
                paid.add(samples)
        return [samples for samples in horizons if samples in paid]
