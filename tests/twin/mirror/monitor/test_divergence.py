"""A right model raises alarms as rarely as stated, a wrong one at once; the same log gives the same bits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import binom, chi2

from protocol.bus import board51_pb2 as pb
from tests.harness.twin.rig import T_S, G, M, Rig
from twin.control import law_numbers
from twin.mirror.mirror import Mirror
from twin.mirror.monitor.alarms import PLACES, TURNED_OFF, TURNED_ON, UNCHANGED, decide, message, white_threshold
from twin.mirror.monitor.divergence import NIS, Comparison, figures, rolling_mean
from twin.mirror.monitor.expected import (
    ExpectedError,
    autocovariance,
    discrete_lyapunov,
    error_dynamics,
    toeplitz_eigenvalues,
    weighted_chi_square_quantile,
)
from twin.mirror.output import IN_STEP, Output
from twin.model.parameters import Model
from twin.settings.mirror import Settings

HELD = 2.85e-3
MEASURED_SLOPE = 120.364  # A/m: the line through the measured equilibria of a CE 152
MEASURED_OFFSET_M = 2.4377e-3  # its zero, above the top stop


def outputs_of(rig: Rig, ticks: int, *, settings: Settings | None = None) -> tuple[Mirror, list[Output]]:
    rig.hold(HELD)
    mirror = Mirror(Model.load("ce152"), settings)
    mirror.parameters(rig.parameters())
    return mirror, [o for o in map(mirror.handle, rig.run(ticks, HELD)) if o is not None]


def test_a_right_model_is_surprised_once_per_channel() -> None:
    _, outputs = outputs_of(Rig(seed=11), 8000)
    nis = np.array([o.divergence.nis for o in outputs if o.divergence.innovation_valid])

    standard_error = 2.0 / math.sqrt(len(nis))  # chi-square with 2 degrees: variance 4, and white
    assert len(nis) > 7900
    assert abs(nis.mean() - 2.0) < 4.0 * standard_error


def test_innovations_of_a_right_model_are_white() -> None:
    _, outputs = outputs_of(Rig(seed=12), 6000)
    valid = [o.divergence for o in outputs if o.divergence.innovation_valid]

    for series in ([d.innovation_x_m for d in valid], [d.innovation_i_c_a for d in valid]):
        y = np.array(series) - np.mean(series)
        rho = [float(np.dot(y[lag:], y[:-lag]) / np.dot(y, y)) for lag in range(1, 6)]

        assert max(map(abs, rho)) < 4.5 / math.sqrt(len(y))


def test_the_error_of_a_right_twin_has_the_standard_deviation_that_was_derived() -> None:
    _, outputs = outputs_of(Rig(seed=13), 6000)
    in_step = [o.divergence for o in outputs if o.divergence.sync == IN_STEP]

    for signal in ("x_m", "i_c_a", "u_c_v"):
        normalised = np.array([getattr(d, signal).normalised for d in in_step])
        # correlated over some 20 ticks: about n / 20 independent squares, relative std sqrt(2 / (n / 20)) of their mean
        assert abs(np.mean(normalised**2) - 1.0) < 4.0 * math.sqrt(2.0 * 20.0 / len(normalised))


def test_the_loop_colours_the_error_as_derived() -> None:
    """Without it (sensor noise alone) the expected x error would be 5.0 um instead of about 6.3."""
    parameters = Rig().parameters()
    law = law_numbers(parameters)
    assert law is not None
    expected = ExpectedError(
        Model.load("ce152"), law, i_lsb_a=4e-4, x_lsb_m=1.6e-6, u_lsb_v=1.25e-3, window=100, probability=1e-3
    ).at(HELD)

    assert expected is not None
    assert 5.5e-6 < expected.std[0] < 7.5e-6
    assert expected.std[1] > 5 * 2e-3  # noise of x comes back amplified as current
    assert expected.on[0] > white_threshold(100, 1, 1e-3)  # correlated squares average out slower than white ones


def test_autocovariance_agrees_with_a_simulated_difference() -> None:
    parameters = Rig().parameters()
    law = law_numbers(parameters)
    assert law is not None
    F, G_, H, through = error_dynamics(Model.load("ce152"), law, HELD)  # noqa: N806 - the textbook's letters
    variances = np.array([4e-6, 2.5e-11, 1e-7, 1e-8, 1.6e-9])
    derived = autocovariance(F, G_, H, through, variances, lags=30)
    rng = np.random.default_rng(5)
    n = 50_000
    w = rng.normal(size=(n, 5)) * np.sqrt(variances)
    d = np.zeros(5)
    y = np.empty((n, 3))

    for k in range(n):
        y[k] = H @ d + through @ w[k]
        d = F @ d + G_ @ w[k]

    for lag in (0, 1, 5, 20):
        simulated = np.mean(y[lag:] * y[: n - lag], axis=0)
        # correlated over some 20 ticks: relative error of a covariance sqrt(2 * 20 / n) = 2.8 %, here 4 of them
        assert np.all(np.abs(simulated - derived[lag]) < 0.12 * derived[0])


def test_doubling_solves_the_lyapunov_equation() -> None:
    F = np.array([[0.9, 0.2], [-0.1, 0.8]])
    Q = np.diag([1.0, 2.0])

    P = discrete_lyapunov(F, Q)

    assert np.allclose(P, F @ P @ F.T + Q, rtol=1e-12)


@pytest.mark.parametrize("probability", [0.05, 1e-3, 1e-6])
def test_the_saddlepoint_is_the_chi_square_where_that_is_exact(probability: float) -> None:
    for degrees in (5, 50, 500):
        q = weighted_chi_square_quantile(np.full(degrees, 1.0 / degrees), probability)

        assert chi2.sf(q * degrees, degrees) == pytest.approx(probability, rel=0.02)


def test_the_saddlepoint_holds_for_unequal_weights() -> None:
    rng = np.random.default_rng(8)
    weights = np.asarray(0.8 ** np.arange(40), dtype=np.float64)
    q = weighted_chi_square_quantile(weights, 0.01)

    exceeded = np.mean((rng.chisquare(1, size=(200_000, 40)) @ weights) > q)

    assert abs(exceeded - 0.01) < 4.0 * math.sqrt(0.01 / 200_000) + 0.02 * 0.01


@pytest.mark.sample
def test_false_alarms_of_the_whole_mirror_come_at_the_stated_rate() -> None:
    """0.25 s windows, 5 % a window: a flight of 1200 windows, from the rig's own noise through the mirror."""
    stated, window_s, windows = 0.05, 0.25, 1200
    rate = stated * 86400.0 / window_s
    rig = Rig(seed=101)
    rig.hold(HELD)
    mirror = Mirror(Model.load("ce152"), Settings(window_s=window_s, false_alarms_per_day=rate))
    mirror.parameters(rig.parameters())
    counts = dict.fromkeys(("divergence-x", "divergence-i_c", "innovation"), 0)

    for state in rig.run(round(windows * window_s / T_S) + 400, HELD):
        output = mirror.handle(state)
        assert output is not None
        for alarm in output.alarms:
            counts[alarm.name] += alarm.active

    # Raised again only after a window below the lower threshold: at 5 % a window, alarms are a few per cent fewer.
    for name, count in counts.items():
        low, high = (float(binom.ppf(p, windows, stated)) for p in (5e-5, 1 - 5e-5))
        assert 0.85 * low <= count <= high, (name, count, low, high)


def test_the_window_decision_of_correlated_noise_has_the_stated_probability() -> None:
    """The same decision on the derived error process itself: 4000 windows at 2 %."""
    law = law_numbers(Rig().parameters())
    assert law is not None
    window, stated, n = 100, 0.02, 4000
    expected = ExpectedError(
        Model.load("ce152"), law, i_lsb_a=4e-4, x_lsb_m=1.6e-6, u_lsb_v=1.25e-3, window=window, probability=stated
    )
    at = expected.at(HELD)
    assert at is not None
    F, G_, H, through = error_dynamics(Model.load("ce152"), law, HELD)  # noqa: N806 - the textbook's letters
    variances = np.array([4e-6 + 4e-4**2 / 12, 2.5e-11 + 1.6e-6**2 / 12, 1.25e-3**2 / 12, 1e-8, (0.02 * T_S) ** 2])
    rng = np.random.default_rng(21)
    d = np.zeros((5, n))  # n independent flights, 300 ticks to become stationary
    total = np.zeros(n)

    for k in range(300 + window):
        w = rng.normal(size=(5, n)) * np.sqrt(variances)[:, None]
        if k >= 300:
            total += ((H @ d + through @ w)[0] / at.std[0]) ** 2
        d = F @ d + G_ @ w

    exceeded = int(np.sum(total / window > at.on[0]))
    # the threshold is the larger of two neighbouring positions': at most the stated share, and not much less
    low, high = (float(binom.ppf(p, n, stated)) for p in (1e-4, 1 - 1e-4))
    assert 0.5 * low <= exceeded <= high


def test_a_right_model_raises_nothing_at_the_shipped_rate() -> None:
    mirror, outputs = outputs_of(Rig(seed=14), 8000)

    assert [alarm.name for o in outputs for alarm in o.alarms] == []
    assert mirror.counters["innovations"] > 7900


def test_a_coil_plane_above_the_stop_raises_every_alarm() -> None:
    """The rig of the measured equilibria against the model of eq. (8), the reference moving."""
    rig = Rig(K_c=M * G / MEASURED_SLOPE**2, gap_offset_m=MEASURED_OFFSET_M)
    rig.hold(HELD)
    mirror = Mirror(Model.load("ce152"))
    mirror.parameters(rig.parameters())

    outputs = [mirror.handle(s) for s in rig.run(3000, lambda k: HELD if (k // 400) % 2 else 3.6e-3)]

    raised = {alarm.name for o in outputs if o for alarm in o.alarms if alarm.active}
    assert raised == {"divergence-x", "divergence-i_c", "innovation"}
    last = outputs[-1]
    assert last is not None
    assert last.divergence.nis_mean > 100.0
    assert last.divergence.i_c_a.error > 0.1  # the rig takes 0.64 A where the model asks for 0.49 A


def test_an_alarm_is_raised_as_soon_as_it_is_certain_and_cleared_by_a_whole_window() -> None:
    alarm = np.zeros(PLACES)

    raised = [decide(alarm, 10, 6.0, 2.0, 1.5) for _ in range(10)]
    notice = message("a", alarm, TURNED_ON)
    retained = [decide(alarm, 10, 1.8, 2.0, 1.5) for _ in range(10)]
    cleared = [decide(alarm, 10, 1.0, 2.0, 1.5) for _ in range(10)]

    assert raised == [UNCHANGED] * 3 + [TURNED_ON] + [UNCHANGED] * 6  # 4 * 6 > 10 * 2
    assert (notice.active, notice.value, notice.threshold_on, notice.threshold_off) == (True, 2.4, 2.0, 1.5)
    assert retained == [UNCHANGED] * 10  # below on, above off
    assert cleared == [UNCHANGED] * 9 + [TURNED_OFF]
    assert not message("a", alarm, TURNED_OFF).active


def test_rolling_figures_are_those_of_the_window_and_do_not_drift() -> None:
    """After 100 windows with a wild start, the figures agree with the definition to rounding of one window."""
    rng = np.random.default_rng(3)
    n, window = 10_000, 100
    y = 3e-3 + 1e-4 * np.sin(np.arange(n) / 7.0)
    e = 1e-6 * rng.normal(size=n) + 3e-7
    e[:50] = 1e3  # leaves nothing behind
    windows = Comparison()
    windows.start(window, window)
    held = windows.windows

    for k in range(n):
        _, _, rmse, mean, fit, full = figures(held, 0, y[k], y[k] - e[k], 1.0, True)

    held_e, held_y = e[-window:], y[-window:]
    assert full
    assert rmse == pytest.approx(math.sqrt(np.mean(held_e**2)), rel=1e-6)  # y - (y - e) itself costs digits of e
    assert mean == pytest.approx(np.mean(held_e), rel=1e-6)
    assert fit == pytest.approx(100 * (1 - np.linalg.norm(held_e) / np.linalg.norm(held_y - held_y.mean())), rel=1e-6)


def test_a_mean_window_forgets_completely() -> None:
    windows = Comparison()
    windows.start(4, 4)
    means = [
        rolling_mean(windows.ring, windows.sums, windows.counts, NIS, value) for value in (1.0, 2.0, 3.0, 4.0, 5.0)
    ]

    assert means == pytest.approx([1.0, 1.5, 2.0, 2.5, 3.5])
    windows.start(4, 4)
    assert rolling_mean(windows.ring, windows.sums, windows.counts, NIS, 7.0) == 7.0


def test_the_same_messages_give_the_same_bits() -> None:
    rig = Rig(seed=31)
    states = list(rig.run(100, HELD))
    rig.set_mode(pb.MODE_CLOSED_LOOP)
    states += list(rig.run(900, lambda k: HELD if (k // 200) % 2 else 3.4e-3))
    del states[600:605]
    del states[700:760]

    def run() -> list[bytes]:
        mirror = Mirror(Model.load("ce152"))
        mirror.parameters(Rig().parameters())
        produced = []
        for state in states:
            output = mirror.handle(pb.State.FromString(state.SerializeToString()))
            assert output is not None
            for part in (output.divergence, output.state, *output.alarms):
                if part is not None:
                    produced.append(part.SerializeToString(deterministic=True))
        return produced

    assert run() == run()


@pytest.mark.parametrize("n", [2, 7, 30])
def test_eigenvalues_of_a_toeplitz_matrix_by_halves_are_those_of_the_whole(n: int) -> None:
    column = np.asarray(0.7 ** np.arange(n) + np.r_[0.5, np.zeros(n - 1)], dtype=np.float64)
    whole = column[np.abs(np.subtract.outer(np.arange(n), np.arange(n)))]

    assert np.allclose(np.sort(toeplitz_eigenvalues(column)), np.linalg.eigvalsh(whole), rtol=1e-12)
