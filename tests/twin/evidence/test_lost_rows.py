"""Lost samples: nothing is made out of them, nothing is forgotten behind them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gateway.emulator.plant.constants import CE152
from tests.harness.diagnose.simulated_rig import (
    MIDDLE_M,
    PLANT,
    THETA,
    TICK_S,
    controller,
    criterion_of,
    fitted,
    rig_of,
    strong,
)
from tests.harness.twin.emulated_campaign import Lab
from tests.harness.twin.true_model import true_model
from twin.diagnosis.experiments.virtual_recordings import Schedule, simulate
from twin.diagnosis.search.score_test import screen
from twin.estimation.innovations import FLIES, FOLLOWS, LOST, USE_I, USE_X
from twin.estimation.record import BoolArray, Record
from twin.estimation.rollout import SETTLE_S, predict_ahead
from twin.evidence.gather import gather
from twin.evidence.lost_rows import bridged
from twin.evidence.sensor_noise import noise_errors, sensor_noise
from twin.inference.theta import Theta
from twin.model.causes.catalogue import BY_NAME
from twin.prediction import predict
from twin.settings import diagnosis as settings

NOISY = replace(THETA, T_A=9e-4, sigma_x_m=8e-6, sigma_i_c_a=1.6e-3)


def flight(theta: Theta, *, seed: int, seconds: float = 20.0) -> Record:
    t = np.arange(round(seconds / TICK_S)) * TICK_S
    command = MIDDLE_M + 1.2e-3 * np.sin(2.0 * np.pi * 0.31 * t) + np.where(t % 2.0 < 1.0, 0.3e-3, -0.3e-3)
    schedule = Schedule(name=f"flight {seed}", kind="closed-loop", command=command, closed_loop=True)
    (record,) = simulate(replace(rig_of(theta), controller=controller(theta)), schedule, seed=seed)
    return record


def less(record: Record, removed: BoolArray) -> Record:
    """The recording without those samples."""
    retained = {name: getattr(record, name)[~removed] for name in ("t", "u_c", "i_c", "x", "x_ref")}
    return replace(record, **retained)


def drawn(record: Record, share: float, seed: int) -> BoolArray:
    removed = np.random.default_rng(seed).random(len(record.t)) < share
    removed[[0, -1]] = False
    return np.asarray(removed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_lost_samples_are_no_reason_to_name_a_cause(seed: int) -> None:
    """Forgetting at each gap made six standard errors of constant force and of negative lags."""
    records = [flight(NOISY, seed=10 * seed + k) for k in range(2)]
    criterion = criterion_of([less(record, drawn(record, 0.1, seed)) for record in records])
    base = fitted(criterion, NOISY)

    causes = [BY_NAME[name] for name in ("constant-force", "eddy-current-lag", "position-sensor-lag")]
    scores = screen(criterion, base.theta, base.free, causes)

    assert len(scores) == len(causes)
    for score in scores:
        assert 0.5 * score.z**2 < settings.MIN_GAIN, score.cause
    criterion.close()


@pytest.mark.parametrize(
    ("cause", "value", "share"),
    [("constant-force", 1e-3, 0.1), ("actuation-delay", 0.7e-3, 0.1), ("actuation-delay", 2.6e-3, 0.03)],
)
def test_behind_a_lost_sample_x_surprises_the_right_model_no_more_than_elsewhere(
    cause: str, value: float, share: float
) -> None:
    theta = strong(cause, value, NOISY)
    record = flight(theta, seed=5)
    criterion = criterion_of([less(record, drawn(record, share, 5))])

    _, white = criterion.white(theta)

    flags = criterion.evidence.series.flags
    lost = np.flatnonzero(flags & LOST != 0)
    assert len(lost) > 200
    behind = np.concatenate([white[lost + k, 1] for k in (1, 2, 3) if (lost + k < len(flags)).all()])
    behind = behind[np.isfinite(behind)]
    assert np.mean(behind**2) == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / len(behind)))
    # The two currents behind a lost input tell it: they are no predictions.
    assert np.isnan(white[lost + 1, 0]).all()
    criterion.close()


def test_up_to_three_lost_samples_in_a_row_get_rows_and_more_stay_a_gap() -> None:
    record = flight(NOISY, seed=7, seconds=2.0)
    removed = np.zeros(len(record.t), np.bool_)
    removed[[300, 500, 501, 502, 600, 601, 602, 603, 700, 701]] = True
    rows = [300, 500, 501, 502, 696, 697]  # without the four

    whole, lost = bridged(less(record, removed))

    assert np.flatnonzero(lost).tolist() == rows
    assert np.delete(whole.t, rows).tolist() == less(record, removed).t.tolist()
    assert whole.t[500:503] == pytest.approx(record.t[500:503])
    assert whole.u_c[500:503] == pytest.approx(record.u_c[499])
    assert whole.x[lost] == pytest.approx(record.x[[300, 500, 501, 502, 700, 701]], abs=5.0 * NOISY.sigma_x_m)
    series = gather([less(record, removed)], PLANT).series
    assert np.flatnonzero(series.flags & LOST != 0).tolist() == rows
    assert (series.flags[[300, 301, 500, 501, 502, 503]] & FOLLOWS != 0).all()
    assert (series.flags[rows] & (USE_I | USE_X) == 0).all()
    assert series.flags[600] & FOLLOWS == 0  # behind the four


def test_where_u_c_jumps_only_a_single_lost_sample_gets_a_row() -> None:
    record = flight(NOISY, seed=7, seconds=2.0)
    jumps = replace(
        record, u_c=record.u_c + 3.0 * (np.arange(len(record.t)) >= 502) - 3.0 * (record.t >= record.t[701])
    )
    removed = np.zeros(len(record.t), np.bool_)
    removed[[500, 501, 502, 701, 800, 801]] = True

    _, lost = bridged(less(jumps, removed))

    assert np.flatnonzero(lost).tolist() == [698, 797, 798]  # without the three


def test_what_is_sampled_at_varying_times_has_lost_nothing() -> None:
    record = flight(NOISY, seed=7, seconds=1.0)
    uneven = replace(record, t=np.cumsum(np.tile([1.6e-3, 2e-3, 2e-3, 4e-3, 2.4e-3], len(record.t) // 5)))

    whole, lost = bridged(uneven)

    assert whole is uneven
    assert not lost.any()


def at_rest(seconds: float) -> Record:
    """A ball on its lower stop, under constant u_c."""
    n = round(seconds / TICK_S)
    noise = np.random.default_rng(1).standard_normal((2, n))
    x, i_c = NOISY.sigma_x_m * noise[0], 0.2 + NOISY.sigma_i_c_a * noise[1]
    record = flight(NOISY, seed=7, seconds=seconds)
    return replace(record, kind="free", x=x, i_c=i_c, u_c=np.full(n, 0.7), x_ref=np.full(n, np.nan))


def test_a_sample_lost_at_rest_is_a_gap_only_where_u_c_changes() -> None:
    rests = at_rest(2.0)
    removed = np.zeros(len(rests.t), np.bool_)
    removed[[400, 600, 601]] = True
    changed = replace(rests, u_c=rests.u_c + 0.1 * (np.arange(len(removed)) >= 500))

    flags = gather([less(changed, removed)], PLANT).series.flags
    split = gather([less(replace(changed, u_c=np.roll(changed.u_c, -100)), removed)], PLANT).series.flags

    assert np.flatnonzero(flags & LOST != 0).tolist() == np.flatnonzero(split & LOST != 0).tolist() == [400, 600, 601]
    assert (flags[[400, 401, 600, 601, 602]] & FOLLOWS != 0).all()
    assert (flags[[400, 600, 601]] & (USE_I | USE_X) == 0).all()
    assert split[401] & FOLLOWS == 0
    assert (split[[600, 601, 602]] & FOLLOWS != 0).all()


@pytest.mark.slow
def test_lost_samples_hide_no_ball_at_rest_from_the_measurement_of_noise() -> None:
    rests = at_rest(60.0)

    shares = (0.0, 0.1)
    evidences = [gather([less(rests, drawn(rests, share, 3))], PLANT) for share in shares]

    for evidence, (error_i, error_x) in zip(evidences, map(noise_errors, evidences), strict=True):
        sigma_i, sigma_x = sensor_noise(evidence)
        assert sigma_i == pytest.approx(NOISY.sigma_i_c_a, rel=4.0 * error_i)
        assert sigma_x == pytest.approx(NOISY.sigma_x_m, rel=4.0 * error_x)
    assert noise_errors(evidences[1])[1] < 1.2 * noise_errors(evidences[0])[1]
    assert noise_errors(evidences[1])[0] < 1.2 * noise_errors(evidences[0])[0]


def test_an_interpolated_reading_is_not_beyond_the_converter_s_range() -> None:
    record = flight(NOISY, seed=7, seconds=2.0)
    removed = np.arange(len(record.t)) == 500
    i_c = record.i_c.copy()
    i_c[[499, 501]] = 0.0  # the end of the range, with higher readings around it

    whole, _ = bridged(less(replace(record, i_c=i_c), removed))

    assert whole.i_c[500] == 0.0


def test_nothing_is_predicted_across_a_lost_input() -> None:
    record = flight(NOISY, seed=7, seconds=2.0)
    removed = np.zeros(len(record.t), np.bool_)
    removed[500] = True
    evidence = gather([less(record, removed)], PLANT)
    s, ahead = evidence.series, 10

    x_hat = predict_ahead(NOISY.system(PLANT, TICK_S), evidence.samples, ahead)

    is_predicted = np.isfinite(x_hat)
    begins = np.flatnonzero(s.flags & FLIES != 0)[0] + ahead + round(SETTLE_S / TICK_S)
    assert is_predicted[begins + 1 : 500].all()
    assert not is_predicted[500 : 500 + ahead + 3].any()
    assert is_predicted[500 + ahead + 4 :].all()  # without the tenth of a second that a new flight would take
    assert np.std((x_hat - s.x)[is_predicted]) < 5.0 * NOISY.sigma_x_m


def test_predict_speaks_of_the_samples_that_there_are() -> None:
    lab = Lab(CE152, effects={}, seed=4)
    lab.fly()
    lab.run(300)
    record = lab.record("flight", "closed-loop", 2000)
    shorter = less(record, drawn(record, 0.02, 1))

    whole, shortened = (predict(true_model(), recording, 5) for recording in (record, shorter))

    assert np.isin(shortened.t, shorter.t).all()
    assert len(shortened.x_hat) + sum(count for _, count in shortened.left_out) == len(shorter.t)
    assert len(shortened.x_hat) > 0.6 * len(shorter.t)
    assert whole.rmse_m is not None
    assert shortened.rmse_m is not None
    assert shortened.rmse_m < 1.2 * whole.rmse_m
