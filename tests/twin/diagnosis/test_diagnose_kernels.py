"""The numbers under the diagnosis: the extended model, its filter, the score test, intervals of the gain."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.harness.twin.independent_plant import Ball, wandering
from tests.harness.twin.true_theta import TRUE
from twin.diagnosis.checks.change_point import Switched
from twin.diagnosis.judge.prediction_gain import bootstrap
from twin.diagnosis.search.candidate_starts import start_of
from twin.diagnosis.search.score_test import screen
from twin.estimation.record import FloatArray
from twin.evidence.gather import gather
from twin.inference.fisher_scoring import climb
from twin.inference.likelihood import Criterion
from twin.inference.theta import BASE, coordinates_of
from twin.model.causes.catalogue import BY_NAME, CATALOGUE, neutral
from twin.model.causes.cause import PLACES, Cause
from twin.model.extended import FIELD, I_C, SENSOR, STATES, WARMTH, Base, V, X
from twin.model.integration import advance

BALL = Ball()
TICK_S = BALL.tick
BASE_NUMBERS = Base(
    K_A=BALL.K_A,
    T_A=BALL.T_A,
    K_c=BALL.K_c,
    b=BALL.b,
    mass_kg=BALL.m,
    gravity_m_s2=BALL.g,
    x_max_m=BALL.x_max,
    travel_m=BALL.travel,
)


def start(rng: np.random.Generator) -> FloatArray:
    """A ball in flight, all states those of a rig without causes."""
    i, x = rng.uniform(0.2, 1.2), rng.uniform(0.5e-3, 4.5e-3)
    y = np.zeros(STATES)
    y[[I_C, X, V, FIELD, SENSOR, WARMTH]] = i, x, rng.uniform(-0.05, 0.05), i, x, i * i
    return y


def after_a_tick(c: FloatArray, y: FloatArray, u: float) -> FloatArray:
    y = y.copy()
    advance(tuple(BASE_NUMBERS), c, y, u, 0.3, TICK_S, True)
    return y


def criterion(*, ticks: int = 4000, flights: int = 2) -> Criterion:
    plant = BALL.campaign.plant
    records = [
        BALL.closed_loop(wandering(n, ticks, span=1.2e-3), ticks, seed=n + 5, name=f"f{n}") for n in range(flights)
    ]
    return Criterion(gather(records, plant), plant, TICK_S, workers=1)


@pytest.fixture(scope="module")
def flown() -> Criterion:
    return criterion()


def test_every_parameter_has_a_place_of_its_own() -> None:
    """Only the errors of stated values have none: they change what the kernels are called with."""
    kernels = [cause for cause in BY_NAME.values() if cause.detector != "stated"]
    places = [parameter.index for cause in kernels for parameter in cause.parameters]

    assert sorted(places) == list(range(PLACES))


@pytest.mark.parametrize("cause", CATALOGUE, ids=lambda cause: cause.name)
def test_a_cause_without_strength_is_absent_bit_by_bit(cause: Cause) -> None:
    """Its other parameters, a time constant, a frequency, may be anything then."""
    rng = np.random.default_rng(3)
    shaped = neutral()
    for parameter in cause.parameters[1:]:
        shaped[parameter.index] = 0.5 * (parameter.low + parameter.high)

    for _ in range(20):
        y, u = start(rng), rng.uniform(0.0, 4.5)
        plain, other = after_a_tick(neutral(), y, u), after_a_tick(shaped, y, u)
        assert plain[:5].tolist() == other[:5].tolist()  # warmth has a time constant even where it does nothing


@pytest.mark.parametrize(
    "cause",
    [
        c
        for c in CATALOGUE
        if c.name not in ("lost-samples", "actuation-delay", "sampling-delay") and c.detector != "sensor-line"
    ],
    ids=lambda cause: cause.name,
)
def test_a_cause_with_strength_changes_the_tick_or_the_reading(cause: Cause) -> None:
    """Delays act on the input, lost samples on nothing, lines of a sensor are states of the filter alone."""
    from twin.model.extended import position_reading, reading_of_current

    rng = np.random.default_rng(4)
    c = neutral()
    ends = [cause.strength.low, cause.strength.high]
    # a limit shows at its lower end
    far = (
        ends[0] if math.isinf(cause.strength.neutral) else max(ends, key=lambda end: abs(end - cause.strength.neutral))
    )
    for parameter in cause.parameters[1:]:
        c[parameter.index] = parameter.neutral if math.isfinite(parameter.neutral) else parameter.low
    c[cause.strength.index] = far

    changed = False
    for _ in range(40):
        y, u = start(rng), rng.uniform(0.0, 4.5)
        plain, other = after_a_tick(neutral(), y, u), after_a_tick(c, y, u)
        changed |= not np.array_equal(plain[:5], other[:5])
        changed |= reading_of_current(c, other) != reading_of_current(neutral(), plain)
        changed |= position_reading(BASE_NUMBERS, c, y[1], y[0]) != position_reading(
            BASE_NUMBERS, neutral(), y[1], y[0]
        )

    assert changed


def test_the_closed_form_of_the_identification_agrees_with_the_integration(flown: Criterion) -> None:
    """Two integrations of (1) and (6).

    They differ by 0.2 um a tick at most (test_simulate.py), 3 % of the 6 um of sensor noise, mostly far less; i_c is
    exact.
    """
    _, white = flown.white(TRUE)
    _, expected = flown.white(replace(TRUE, closed_form=True))

    both = np.isfinite(white) & np.isfinite(expected)
    assert both.sum() > 0.99 * max(np.isfinite(white).sum(), np.isfinite(expected).sum())
    difference = (white - expected)[200:][both[200:]]
    assert np.sqrt(np.mean(difference**2)) < 0.02


def test_a_right_model_leaves_white_innovations(flown: Criterion) -> None:
    _, white = flown.white(TRUE)

    for column in range(2):
        values = white[np.isfinite(white[:, column]), column]
        assert values.var() == pytest.approx(1.0, abs=4.0 * math.sqrt(2.0 / len(values)))


@pytest.mark.parametrize("name", ["constant-force", "position-sensor-offset"])
def test_for_a_small_effect_the_score_test_says_what_a_fit_gains(name: str) -> None:
    """Both are 0.5 z^2 up to terms of third order: a tenth of it, for effects of 5 to 15 standard errors."""
    plant = BALL.campaign.plant
    heavy = replace(BALL, g=1.02 * BALL.g) if name == "constant-force" else BALL
    record = heavy.closed_loop(wandering(3, 4000, span=1.2e-3), 4000, seed=8)
    if name == "position-sensor-offset":
        record = replace(record, x=record.x + 15e-6)
    record_criterion = Criterion(gather([record], plant), plant, TICK_S, workers=1)
    coordinate = coordinates_of(name)[0]
    try:
        at = climb(record_criterion, TRUE, BASE)
        (score,) = screen(record_criterion, at.theta, at.free, (BY_NAME[name],))
        fit = climb(record_criterion, start_of(record_criterion, at.theta, score), (*at.free, coordinate))
    finally:
        record_criterion.close()

    gain = fit.loglik - at.loglik
    assert 8.0 < gain < 200.0
    assert score.gain == pytest.approx(gain, rel=0.1)


def test_the_bootstrap_interval_holds_the_true_ratio_as_often_as_it_says() -> None:
    """95 %; 40 blocks make it 93 % (an interval of quantiles is narrow by 1 / 2 blocks); less three errors."""
    rng = np.random.default_rng(11)
    trials, n, truth = 200, 10_000, 0.5
    kernel = np.ones(10) / math.sqrt(10.0)  # as predictions of 20 ms overlap
    hits = 0
    for seed in range(trials):
        first, second = (np.convolve(rng.normal(size=n + 9), kernel, "valid") for _ in range(2))
        low, high = bootstrap(first**2, (truth * second) ** 2, 250, seed)
        hits += low <= truth <= high

    assert hits / trials > 0.93 - 3.0 * math.sqrt(0.93 * 0.07 / trials)
    assert hits < trials  # an interval that always holds the truth is too wide


def test_the_bootstrap_is_the_same_for_a_seed() -> None:
    rng = np.random.default_rng(2)
    first, second = rng.normal(size=3000) ** 2, rng.normal(size=3000) ** 2

    assert bootstrap(first, second, 250, 4) == bootstrap(first, second, 250, 4)
    assert bootstrap(first, second, 250, 4) != bootstrap(first, second, 250, 5)


def test_a_cause_that_holds_in_one_recording_is_absent_from_the_other(flown: Criterion) -> None:
    bent = TRUE.having("force-exponent.n", 1.8)
    switched = Switched(flown, [False, True], workers=1)
    later = flown.evidence.series.recording == 1

    outputs = switched.outputs(bent)
    (change,) = switched.changes([bent], [2.0], flown.run_without_steps(TRUE))

    absent, present = flown.outputs(TRUE), flown.outputs(bent)
    assert np.array_equal(outputs, np.where(later[:, None], present, absent), equal_nan=True)
    assert np.array_equal(change, (outputs - absent) / 2.0, equal_nan=True)
    switched.close()
