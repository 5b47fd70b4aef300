"""A stop where nobody has it: little among so many readings, and a contradiction all the same."""

from __future__ import annotations

import pytest

from tests.harness.diagnose.simulated_rig import ITEMS, criterion_of, made, narrow, strong
from twin.diagnosis.search.score_test import screen
from twin.inference.adequacy import adequate, where_left
from twin.inference.fisher_scoring import Fit, climb
from twin.inference.likelihood import Criterion
from twin.inference.noise_floor import floor_of
from twin.inference.theta import BASE, STOPS, coordinates_of
from twin.model.causes.catalogue import BY_NAME
from twin.settings import diagnosis as settings

OFFSET_M = 0.3e-3
HIDDEN, CONFOUNDER = "position-sensor-offset", "air-gap-offset"


@pytest.fixture(scope="module")
def criterion() -> Criterion:
    """The sensor reads too high; at rest, too."""
    rig = strong(HIDDEN, OFFSET_M)
    return criterion_of([*narrow(rig, seconds=8.0), *made(ITEMS["lift-off"], rig)])


@pytest.fixture(scope="module")
def wrong(criterion: Criterion) -> Fit:
    """The coil sits lower, and the stop higher."""
    return climb(criterion, strong(CONFOUNDER, -OFFSET_M), (*BASE, *STOPS, *coordinates_of(CONFOUNDER)))


def test_a_coil_and_a_stop_in_the_wrong_place_are_no_adequate_model(criterion: Criterion, wrong: Fit) -> None:
    fit = wrong
    floor = floor_of(criterion, fit.theta)

    is_adequate, why = adequate(criterion, fit, floor)

    assert fit.theta.stop_low_m == pytest.approx(OFFSET_M, abs=2.0 * settings.STOP_STD_M)
    assert not floor.above_noise(fit.loglik)  # nothing but the stop speaks against it
    assert floor.material(fit.loglik)
    assert not is_adequate
    assert "needs a stop 0.3" in why
    assert where_left(criterion, fit, floor).startswith("at rest: the model needs a stop 0.3")


def test_the_right_cause_puts_the_stop_back(criterion: Criterion) -> None:
    fit = climb(criterion, strong(HIDDEN, OFFSET_M), (*BASE, *STOPS, *coordinates_of(HIDDEN)))
    floor = floor_of(criterion, fit.theta)

    assert floor.misplaced_m < settings.MISPLACED_STOP_M
    assert adequate(criterion, fit, floor) == (True, "")


def test_the_screen_knows_where_a_stop_is(criterion: Criterion, wrong: Fit) -> None:
    """Among the readings alone the sensor's offset is what the coil's and the stop's are together."""
    scores = {score.cause: score for score in screen(criterion, wrong.theta, wrong.free, [BY_NAME[HIDDEN]])}

    lacking = 0.5 * (wrong.theta.stop_low_m**2 + wrong.theta.stop_high_m**2) / settings.STOP_STD_M**2
    assert scores[HIDDEN].gain == pytest.approx(lacking, rel=0.1)
    assert scores[HIDDEN].testable
