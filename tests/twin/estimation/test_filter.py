"""The filter compiled against the same in plain Python, and what it says of samples that are not all there."""

from __future__ import annotations

import numpy as np

from twin.compiled import Packed
from twin.estimation.ekf import filter as ekf
from twin.estimation.ekf.memory import memory_for
from twin.estimation.innovations import FLIES, FOLLOWS, USE_I, USE_X
from twin.estimation.structures import AT_THE_ENDS, NO_STEPS, NoiseLevels, Results, Samples, System, room_for
from twin.model.causes.catalogue import neutral
from twin.model.extended import I_C, V, X

BASE: Packed = (0.3, 3e-4, 8e-6, 0.03, 0.0118, 9.81, 8.1e-3, 5.7e-3)
NOISE = NoiseLevels(2e-3, 5e-6, 1e-4, 0.02, 2e-3)
PAPER = System(BASE, neutral(), NOISE, AT_THE_ENDS, closed_form=True)


def readings(n: int) -> Samples:
    """A ball that hovers, seen through noise: without x at 10, without i_c at 20, at a stop from 30 to 33."""
    rng = np.random.default_rng(1)
    flags = np.full(n, FOLLOWS | FLIES | USE_I | USE_X, np.uint16)
    flags[0] &= ~FOLLOWS & 0xFF
    flags[10] &= ~USE_X & 0xFF
    flags[20] &= ~USE_I & 0xFF
    flags[30:34] &= ~FLIES & 0xFF
    return Samples(
        np.linspace(0.0, 2e-3 * (n - 1), n),
        np.full(n, 2e-3),
        2.1 + 0.01 * rng.normal(size=n),
        0.63 + 2e-3 * rng.normal(size=n),
        2.9e-3 + 5e-6 * rng.normal(size=n),
        flags,
    )


def plain(system: System, samples: Samples) -> Results:
    """`filtered` with its own loop in plain Python."""
    results = room_for(len(samples.u), 3, state=True)
    getattr(ekf._run, "py_func", ekf._run)(memory_for(system), samples, NO_STEPS, results)
    return results


def test_compiled_and_plain_filter_agree() -> None:
    samples = readings(60)

    compiled, interpreted = ekf.filtered(PAPER, samples, state=True), plain(PAPER, samples)

    np.testing.assert_allclose(compiled.innovations, interpreted.innovations, rtol=1e-9, atol=1e-15)
    assert np.isnan(compiled.innovations[10, 1])
    assert np.isnan(compiled.innovations[20, 0])
    assert np.isfinite(compiled.innovations[1, 0])  # in closed form u_c is known from the first sample on


def test_the_closed_form_is_the_step_of_the_model_without_causes() -> None:
    """Beside the first two readings of i_c, which say nothing where the input may be late, up to its 60 nm."""
    samples = readings(60)

    closed, stepped = (ekf.filtered(PAPER._replace(closed_form=form), samples, state=True) for form in (True, False))

    assert np.isnan(stepped.innovations[1:3, 0]).all()
    np.testing.assert_allclose(closed.state[3:, I_C], stepped.state[3:, I_C], atol=1e-3)
    np.testing.assert_allclose(closed.state[8:, X], stepped.state[8:, X], atol=1e-7)
    np.testing.assert_allclose(closed.state[8:, V], stepped.state[8:, V], atol=1e-4)
