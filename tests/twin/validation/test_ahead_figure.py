"""The figure of the error over the horizon."""

from __future__ import annotations

from twin.validation.ball import Ahead
from twin.validation.figures import ahead_figure


def test_a_horizon_alone_has_ticks_on_both_axes() -> None:
    row = Ahead(
        horizon_s=2e-3, rmse_m=7.0e-6, floor_m=6.9e-6, ratio=1.01, ratio_ci95=(0.9, 1.1), still_m=7.4e-6, count=100,
        at_floor=True, beats_still=True,
    )  # fmt: skip

    (ax,) = ahead_figure([row]).axes

    low, high = ax.get_ylim()
    labels = [label.get_text() for label in ax.get_yticklabels() if low <= label.get_position()[1] <= high]
    assert labels == ["5", "10"]
    assert [label.get_text() for label in ax.get_xticklabels()] == ["2"]
