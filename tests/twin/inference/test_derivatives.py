"""Derivatives of the likelihood for less work: how near they are to those of the filter itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from tests.harness.diagnose.simulated_rig import PLANT, THETA, TICK_S, criterion_of, fitted, narrow, rig_of, strong
from tests.twin.evidence.test_lost_rows import drawn, less
from twin.diagnosis.experiments.virtual_recordings import Schedule, simulate
from twin.diagnosis.search.score_test import screen
from twin.estimation.pace import Reuse
from twin.estimation.record import FloatArray
from twin.estimation.structures import Results
from twin.evidence.gather import gather
from twin.inference.likelihood import Criterion, mean_square
from twin.inference.theta import BASE, NOISES, STOP_UNIT_M, STOPS, Theta, coordinates_of, derivative_step, moved
from twin.settings import diagnosis as settings

SLOPES, GAINS = Reuse.SLOPES, Reuse.GAINS
CASES = [
    THETA,
    strong("eddy-current-lag", 1e-3),
    strong("amplifier-gain-drift", 0.05),
    strong("actuation-delay", 7e-4),
    strong("coulomb-friction", 1e-3),
]


def score_of(criterion: Criterion, theta: Theta, *, rough: bool | None) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """(score over the root of its information, that information, names); `rough` None: of the filter itself."""
    free = [
        *BASE,
        *STOPS,
        *(name for cause in {n.partition(".")[0] for n, _ in theta.causes} for name in coordinates_of(cause)),
    ]
    run = None if rough is None else criterion.run(theta)
    base, change = criterion.derivatives(theta, free, run, rough=bool(rough))
    _, score, fisher = criterion.slopes(theta, free, base, change)
    spread = np.sqrt(np.maximum(np.diag(fisher), 1e-12))
    return score / spread, spread, free


@pytest.mark.parametrize("theta", CASES)
def test_a_run_is_the_filter_bit_by_bit(theta: Theta) -> None:
    criterion = criterion_of(narrow(theta, seconds=2.0))

    assert np.array_equal(criterion.run(theta).innovations, criterion.outputs(theta), equal_nan=True)
    criterion.close()


@pytest.mark.parametrize("theta", CASES)
@pytest.mark.parametrize("share", [0.0, 0.05])
def test_the_noise_along_a_run_has_the_derivatives_of_the_filter(theta: Theta, share: float) -> None:
    records = narrow(theta, seconds=2.0)
    criterion = criterion_of([less(record, drawn(record, share, 1)) if len(record.t) else record for record in records])
    # Not at the maximum, where every score is small, and with process noise of a size that the data tell.
    off = replace(
        theta, K_c=1.001 * theta.K_c, sigma_x_m=0.9 * theta.sigma_x_m, process_i_c_a=1e-3, process_a_m_s2=0.02
    )

    exact, spread, names = score_of(criterion, off, rough=None)
    run_score, run_spread, _ = score_of(criterion, off, rough=False)

    noise = [names.index(name) for name in NOISES]
    assert run_score[noise] == pytest.approx(exact[noise], rel=2e-3)
    assert run_spread[noise] == pytest.approx(spread[noise], rel=2e-3)
    remaining = [index for index in range(len(names)) if index not in noise]
    assert run_score[remaining] == pytest.approx(exact[remaining], rel=1e-9, abs=1e-9)
    criterion.close()


@pytest.mark.parametrize(
    "theta", [THETA, replace(THETA, tau_x_s=8e-3, white_x=0.1), strong("position-dependent-inductance", 0.5)]
)
def test_the_derivative_by_a_stop_is_that_of_the_filter_whatever_the_colour_of_the_noise(theta: Theta) -> None:
    """Coloured noise takes up most of a shift that stays: a reading soon counts less than it does in white noise."""
    k = np.arange(600)
    ramp = Schedule(name="ramp", kind="sawtooth", command=3.0 * (k % 300) / 300, closed_loop=False)
    criterion = criterion_of([*narrow(theta, seconds=1.0), *simulate(rig_of(theta), ramp, seed=3)])
    run = criterion.run(theta)

    _, change = criterion.derivatives(theta, STOPS, run)
    steps = {name: derivative_step(theta, name, PLANT) for name in STOPS}
    exact = [(criterion.outputs(moved(theta, *step, PLANT)) - run.innovations) / step[1] for step in steps.items()]
    criterion.close()

    assert np.nanmin(exact[0][:, 1]) == pytest.approx(-STOP_UNIT_M, rel=1e-3)
    np.testing.assert_allclose(change, exact, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("theta", [*CASES, replace(THETA, tau_x_s=8e-3, white_x=0.1)])
@pytest.mark.parametrize(("share", "tolerance"), [(0.0, 0.02), (0.05, 0.2)])
def test_a_run_with_the_gains_of_another_is_one_with_its_slopes(theta: Theta, share: float, tolerance: float) -> None:
    """The doubt about a lost input depends on the model, that about the first field on its lag, and so do the gains."""
    records = narrow(theta, seconds=1.0)
    criterion = criterion_of([less(record, drawn(record, share, 1)) if len(record.t) else record for record in records])
    names = ["K_A", "T_A", "K_c", "b", *(name for name, _ in theta.causes[-1:])]
    run, steps = criterion.run(theta), [derivative_step(theta, name, PLANT) for name in names]
    models = [moved(theta, name, step, PLANT) for name, step in zip(names, steps, strict=True)]

    by_slopes, by_gains = (criterion.changes(models, steps, run, [mode] * len(names)) for mode in (SLOPES, GAINS))
    criterion.close()

    if share == 0.0:  # the paper's parameters change no covariance at all
        assert np.array_equal(by_gains[:4, :, :2], by_slopes[:4, :, :2], equal_nan=True)
    for slopes, gains in zip(by_slopes, by_gains, strict=True):
        largest = np.nanmax(np.abs(slopes), axis=0)[:2]
        assert np.all(np.nan_to_num(np.abs(gains - slopes))[:, :2] <= tolerance * largest + 1e-9)


@pytest.mark.parametrize("theta", CASES)
def test_rough_derivatives_point_to_where_the_likelihood_rises(theta: Theta) -> None:
    """The slope by b is off by two standard errors there: why the end of a climb takes the exact ones."""
    criterion = criterion_of(narrow(theta, seconds=2.0))
    off = replace(theta, K_c=1.02 * theta.K_c, process_a_m_s2=0.4)  # which makes the misfit no surprise
    assert mean_square(criterion.outputs(off)) < settings.EXACT_SLOPES_SQUARE

    values = []
    for rough in (None, True):
        score, spread, names = score_of(criterion, off, rough=rough)
        places = [names.index(name) for name in ("K_A", "T_A", "K_c")]
        moves = {names[index]: score[index] / spread[index] for index in places}
        target = off
        for name, step in moves.items():
            target = moved(target, name, step, PLANT)
        values.append(criterion.value(target) - criterion.value(off))

    assert values[0] > 20.0  # there is something to climb
    assert values[1] > 0.9 * values[0]
    criterion.close()


class Exact(Criterion):
    """The filter itself wherever the slopes of another run would do."""

    def changes(
        self, thetas: Sequence[Theta], scales: Sequence[float], at: Results, reuse: Sequence[Reuse] = ()
    ) -> FloatArray:
        return super().changes(thetas, scales, at)


@pytest.mark.slow
@pytest.mark.parametrize("hidden", [strong("motional-emf", 0.3), strong("coulomb-friction", 1e-3)])
def test_the_screen_with_the_slopes_at_hand_ranks_as_the_filter_itself(hidden: Theta) -> None:
    """Within a fifth: a likelihood that is no parabola is farther off."""
    evidence = gather(narrow(hidden, seconds=6.0), PLANT)
    quick, exact = Criterion(evidence, PLANT, TICK_S, workers=1), Exact(evidence, PLANT, TICK_S, workers=1)
    base = fitted(exact, THETA)

    swift, whole = ({entry.cause: entry for entry in screen(c, base.theta, base.free)} for c in (quick, exact))

    for cause, score in whole.items():
        assert swift[cause].testable == score.testable
        if score.testable:  # otherwise the gain is one of rounding errors
            assert swift[cause].gain == pytest.approx(score.gain, rel=0.2, abs=2.0), cause
    quick.close()
    exact.close()
