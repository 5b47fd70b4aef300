"""The filter under coloured sensor noise: white innovations of the right size; nothing changes where all is white."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tests.harness.diagnose.simulated_rig import THETA, criterion_of, narrow
from twin.estimation.innovations import FLIES, whitened
from twin.inference.theta import Theta

QUIET = replace(THETA, sigma_i_c_a=1e-6, sigma_x_m=1e-8)
I_A, X_M = 2e-3, 5e-6


def forgetful(rng: np.random.Generator, t: NDArray[np.float64], tau_s: float) -> NDArray[np.float64]:
    """Unit-variance noise whose autocorrelation falls exponentially, at the times t, shape (n,)."""
    noise = rng.standard_normal(len(t))
    for k in range(1, len(t)):
        left = np.exp(-(t[k] - t[k - 1]) / tau_s)
        noise[k] = left * noise[k - 1] + np.sqrt(1.0 - left * left) * noise[k]
    return noise


def innovations_of(theta: Theta, tau_s: float) -> NDArray[np.float64]:
    """Return the innovations of a flight whose readings have this noise, shape (n, 2)."""
    rng = np.random.default_rng(5)
    records = [
        replace(
            record,
            i_c=record.i_c + I_A * forgetful(rng, record.t, tau_s),
            x=record.x + X_M * forgetful(rng, record.t, tau_s),
        )
        for record in narrow(QUIET, seconds=12.0)
        if record.kind == "closed-loop"
    ]
    criterion = criterion_of(records)
    white = whitened(criterion.outputs(theta))
    criterion.close()
    return np.asarray(white[criterion.evidence.series.flags & FLIES != 0][50:])


def correlation(white: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the correlation from reading to reading, shape (2,)."""
    return np.asarray(np.nansum(white[1:] * white[:-1], axis=0) / np.nansum(white**2, axis=0))


def test_coloured_noise_leaves_white_innovations_of_the_right_size() -> None:
    tau_s = 5e-3
    theta = replace(THETA, tau_i_c_s=tau_s, white_i_c=1e-3, tau_x_s=tau_s, white_x=1e-3)

    right, wrong = innovations_of(theta, tau_s), innovations_of(THETA, tau_s)

    assert np.abs(correlation(right)).max() < 0.06
    assert np.abs(np.nanmean(right**2, axis=0) - 1.0).max() < 0.08
    assert np.abs(correlation(wrong)).max() > 0.2


def test_noise_that_is_forgotten_at_once_is_white() -> None:
    records = narrow(THETA)
    criterion = criterion_of(records)
    short = replace(THETA, tau_i_c_s=1e-7, white_i_c=0.5, tau_i_c_captured_s=1e-7, white_i_c_captured=0.5)
    short = replace(short, tau_x_s=1e-7, white_x=0.5)

    coloured, white = criterion.outputs(short), criterion.outputs(THETA)

    np.testing.assert_allclose(coloured, white, rtol=1e-6, atol=1e-12)
    criterion.close()
