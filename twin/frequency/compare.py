"""Test whether a model explains a measured response: all frequencies together, and each alone.

Rule 1: z = E R* / |R|^2 of E = A - H B has mean 0 if the model's H is right.  Its variance is that of the noise, from
        the blocks, and that of H by the parameters' uncertainty.
Rule 2: all frequencies of a response together: the parameters' error is the same at all of them, so the frequencies are
        taken one after the other, each with the knowledge of that error from those before (a Kalman filter of the
        parameters over frequency).  Their probabilities are then independent, and -2 sum ln p is chi-square with two
        degrees of freedom each (Fisher, Statistical Methods for Research Workers, 1932).  With many blocks it is the
        usual sum of |z|^2 / variance.
Rule 3: each frequency alone: F(2, 2 nu); nu is that of the noise's estimate, larger where the parameters' part, which
        is no estimate, dominates (Satterthwaite, Biometrics Bull. 2, 1946).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.distributions import chi2_above, fisher_above
from twin.estimation.record import FloatArray
from twin.frequency.spectra import ComplexArray, Spectra


@dataclass(frozen=True, slots=True, kw_only=True)
class Deviations:
    """The part of a response that a model leaves; arrays of shape (F,), by frequency."""

    f_hz: FloatArray
    z: ComplexArray
    variance: FloatArray  # of z by noise, E|z|^2
    dof: FloatArray  # complex degrees of freedom of that estimate
    slopes: ComplexArray  # of z by one standard deviation of each parameter, shape (F, p)
    predicted: ComplexArray  # H B* / |R|^2, what z is a share of


def deviations(
    s: Spectra,
    rest: ComplexArray,
    bottom: ComplexArray,
    h: ComplexArray,
    slopes: ComplexArray,
    expected: ComplexArray | float = 0.0,
) -> Deviations:
    """Compare one response with the model's.

    Args:
        s: the measured coefficients.
        rest: E = A - H B, shape (K, F), H at each bin.
        bottom: B, the denominator, shape (K, F).
        h: H in the middle of each band, shape (F,).
        slopes: its change by one standard deviation of each parameter, shape (F, p).
        expected: z of the model's own simulation in this experiment, shape (F,).
    """
    driven = s.on_r(bottom)
    return Deviations(
        f_hz=s.f_hz,
        z=s.on_r(rest) - expected,
        variance=s.variance(rest),
        dof=np.full(len(s.f_hz), s.dof),
        slopes=-slopes * driven[:, None],
        predicted=h * driven,
    )


def chances(d: Deviations) -> tuple[FloatArray, float]:
    """Return (p of each frequency, shape (F,); p of all together) under a right model."""
    slopes = np.stack((d.slopes.real, d.slopes.imag), axis=1)  # (F, 2, p)
    z = np.column_stack((d.z.real, d.z.imag))
    noise = 0.5 * d.variance[:, None, None] * np.eye(2)
    parameter_part, error = np.empty_like(noise), np.empty_like(z)
    mean, covariance = np.zeros(slopes.shape[2]), np.eye(slopes.shape[2])
    # In turn: a joint quadratic form of estimated variances has no known distribution, a product of independent p has
    # one (rule 2).
    for k in range(len(z)):
        error[k], parameter_part[k] = z[k] - slopes[k] @ mean, slopes[k] @ covariance @ slopes[k].T
        gain = covariance @ slopes[k].T @ np.linalg.inv(noise[k] + parameter_part[k])
        mean, covariance = mean + gain @ error[k], covariance - gain @ slopes[k] @ covariance
    in_turn = _chance(error, noise, parameter_part, d.dof)
    single = _chance(z, noise, slopes @ slopes.transpose(0, 2, 1), d.dof)
    # A p that rounds to 0 would make the sum infinite.
    return single, chi2_above(-2.0 * np.sum(np.log(np.maximum(in_turn, 1e-300))), 2 * len(z))


def _chance(z: FloatArray, noise: FloatArray, parameter_part: FloatArray, dof: FloatArray) -> FloatArray:
    """Return p of real and imaginary parts z, shape (F, 2), under covariances of shape (F, 2, 2)."""
    whole = noise + parameter_part
    share = np.trace(noise, axis1=1, axis2=2) / np.trace(whole, axis1=1, axis2=2)
    size = 0.5 * np.einsum("fa,fab,fb->f", z, np.linalg.inv(whole), z)
    # Only the noise is estimated: where it is a small share, the variance is known nearly as if it were given.
    return np.asarray(fisher_above(size, 2.0, 2.0 * dof / share**2))
