"""Tests on linear loops of known truth: an estimate has no bias, its bands hold, tests alarm as often as stated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom
from scipy.stats import f as f_distribution

from tests.harness.twin.linear_loops import LAW, TICK_S, Loop, chirp, multisine
from twin.estimation.family import holm
from twin.frequency.compare import Deviations, chances, deviations
from twin.frequency.excitation import Part
from twin.frequency.responses import Name, pairs, position_law
from twin.frequency.spectra import ComplexArray, Spectra, spectra

Array = NDArray[np.float64]
FLIGHTS = 120
REFERENCES: dict[str, Callable[[], tuple[Array, int]]] = {
    "slow multisine": lambda: (multisine(5000, period=500, amplitude=2e-4), 500),
    "fast multisine": lambda: (multisine(5000, period=125, amplitude=1e-4), 125),
    "chirp": lambda: (chirp(5000, from_hz=0.5, to_hz=10.0, amplitude=1.7e-4), 0),
}
TESTED: tuple[Name, ...] = ("amplifier", "ball", "plant", "loop")


@cache
def flown(reference: str, loop: Loop, flights: int = FLIGHTS) -> list[Spectra]:
    r, period = REFERENCES[reference]()
    part = Part(samples=slice(0, len(r)), period=period)
    several = [spectra(flight, part, TICK_S) for flight in loop.fly(r, flights=flights, seed=7)]
    return [flight for flight in several if flight is not None]


@cache
def quiet(reference: str, loop: Loop) -> Spectra:
    r, period = REFERENCES[reference]()
    (flight,) = loop_without_noise(loop).fly(r, flights=1, seed=0)
    made = spectra(flight, Part(samples=slice(0, len(r)), period=period), TICK_S)
    assert made is not None
    return made


def loop_without_noise(loop: Loop) -> Loop:
    return replace(loop, noise=frozen(i=0.0, x=0.0, u=0.0, v=0.0))


class frozen(dict[str, float]):  # noqa: N801  # a key of the cache
    def __hash__(self) -> int:  # type: ignore[override]
        return hash(tuple(self.items()))


NOISE = frozen(i=2e-3, x=5e-6, u=4e-4, v=4e-5)
RIG = Loop(noise=NOISE)


def true_responses(loop: Loop, bins_hz: Array) -> dict[Name, ComplexArray]:
    i, x = (response.reshape(bins_hz.shape) for response in loop.response(bins_hz.ravel()))
    loop_gain = LAW.k_i * i + position_law(LAW, bins_hz) * x
    return {"amplifier": i, "ball": x / i, "plant": x, "loop": loop_gain}


def compared(s: Spectra, q: Spectra, model: Loop, name: Name, slopes: ComplexArray | None = None) -> Deviations:
    h = true_responses(model, s.bins_hz)[name]
    (top, bottom), (q_top, q_bottom) = pairs(s, LAW)[name], pairs(q, LAW)[name]
    middle = h[len(h) // 2]
    none = np.empty((len(middle), 0), dtype=complex)
    expected = s.on_r(q_top - h * q_bottom)
    return deviations(s, top - h * bottom, bottom, middle, none if slopes is None else slopes, expected)


def as_stated(hits: int, of: int, level: float) -> bool:
    """Return whether the count agrees with the level, as 999 of 1000 such counts do."""
    return bool(binom.ppf(5e-4, of, level) <= hits <= binom.ppf(1.0 - 5e-4, of, level))


def test_the_indirect_estimate_has_no_bias_where_the_direct_one_has() -> None:
    several = flown("fast multisine", RIG)
    truth = RIG.response(several[0].f_hz)[1]
    indirect = np.mean([s.on_r(s.x) / s.on_r(s.u) for s in several], axis=0)
    direct = [np.sum(s.x * s.u.conj(), axis=0) / np.sum(np.abs(s.u) ** 2, axis=0) for s in several]

    scatter = np.std([s.on_r(s.x) / s.on_r(s.u) for s in several], axis=0) / np.sqrt(len(several))
    assert (np.abs(indirect - truth) < 4.0 * scatter).all()
    assert np.abs(np.mean(direct, axis=0) / truth - 1.0).max() > 0.1


@pytest.mark.parametrize("reference", REFERENCES)
def test_bands_hold_the_truth_as_often_as_they_say(reference: str) -> None:
    held = total = 0
    for s in flown(reference, RIG):
        h = true_responses(RIG, s.bins_hz)["plant"]
        shape = h / h[len(h) // 2]
        estimate = s.on_r(s.x) / s.on_r(shape * s.u)
        radius2 = s.variance(s.x - estimate * shape * s.u) / np.abs(s.on_r(shape * s.u)) ** 2
        in_band = np.abs(estimate - h[len(h) // 2]) ** 2 < f_distribution.ppf(0.95, 2, 2 * s.dof) * radius2
        held, total = held + int(in_band[1:-1].sum()), total + len(in_band[1:-1])

    assert 0.93 < held / total < 0.97


@pytest.mark.slow  # a rate; the bands above are what it counts
@pytest.mark.parametrize("reference", REFERENCES)
@pytest.mark.parametrize("name", TESTED)
def test_a_right_model_is_refused_as_often_as_stated(reference: str, name: Name) -> None:
    q = quiet(reference, RIG)
    p = np.array([chances(compared(s, q, RIG, name))[1] for s in flown(reference, RIG)])

    assert as_stated(int((p < 0.05).sum()), len(p), 0.05)
    assert as_stated(int((p < 0.3).sum()), len(p), 0.3)


@pytest.mark.slow
def test_uncertain_parameters_are_no_contradiction_and_certain_ones_are() -> None:
    """Rigs drawn from what the model file says of K_A and K_c."""
    rng = np.random.default_rng(3)
    r, period = REFERENCES["fast multisine"]()
    part, spread = Part(samples=slice(0, len(r)), period=period), 0.02
    uncertain, certain, flights = [], [], 40
    for n in range(flights):
        K_A, K_c = (value * (1.0 + spread * rng.normal()) for value in (RIG.K_A, RIG.K_c))
        rig = replace(RIG, K_A=K_A, K_c=K_c)
        s = spectra(rig.fly(r, flights=1, seed=n)[0], part, TICK_S)
        assert s is not None
        h = true_responses(RIG, s.bins_hz)["plant"][len(s.r) // 2]
        ends = [replace(RIG, K_A=RIG.K_A * (1 + spread)), replace(RIG, K_c=RIG.K_c * (1 + spread))]
        slopes = np.column_stack([true_responses(end, s.bins_hz)["plant"][len(s.r) // 2] - h for end in ends])
        q = quiet("fast multisine", RIG)
        uncertain.append(chances(compared(s, q, RIG, "plant", slopes))[1])
        certain.append(chances(compared(s, q, RIG, "plant"))[1])

    assert as_stated(int((np.array(uncertain) < 0.05).sum()), flights, 0.05)
    assert np.mean(np.array(certain) < 0.05) > 0.2


@pytest.mark.parametrize(
    ("hidden", "visible_in", "not_in"),
    [
        ({"delay_s": 1.2e-3}, "plant", "amplifier"),  # i_c has settled before the next sample, x is late
        ({"K_A": 0.297 * 1.05}, "amplifier", "ball"),
        ({"lag_s": 2e-3}, "ball", "amplifier"),
        ({"K_c": 5.607e-6 * 1.08}, "ball", "amplifier"),
    ],
)
def test_what_is_hidden_shows_in_its_own_response(hidden: dict[str, float], visible_in: Name, not_in: Name) -> None:
    reference = "fast multisine" if "delay_s" in hidden else "slow multisine"
    q = quiet(reference, RIG)
    several = flown(reference, Loop(noise=NOISE, **hidden), flights=20)
    visible = [chances(compared(s, q, RIG, visible_in))[1] for s in several]
    unseen = [chances(compared(s, q, RIG, not_in))[1] for s in several]

    assert np.mean(np.array(visible) < 1e-3) > 0.9
    assert np.mean(np.array(unseen) < 1e-3) < 0.1


def test_holm_rejects_one_by_one_from_the_smallest() -> None:
    assert holm([0.012, 0.6, 0.02, 0.001], 0.05) == [True, False, True, True]
    assert holm([0.02, 0.03], 0.05) == [True, True]
    assert not any(holm([0.03, 0.03], 0.05))


def test_too_short_a_part_has_no_spectra() -> None:
    r = multisine(1200, period=500, amplitude=2e-4)
    signals = RIG.fly(r, flights=1, seed=0)[0]
    assert spectra(signals, Part(samples=slice(0, 1200), period=500), TICK_S) is None
    constant = np.zeros((4, 5000))
    assert spectra(constant, Part(samples=slice(0, 5000), period=0), TICK_S) is None
