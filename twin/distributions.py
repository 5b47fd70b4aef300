"""Tails and quantiles of the distributions of statistical tests.

They are those of `scipy.stats`, bit by bit, from the functions that it calls itself.  `scipy.stats` takes 45 MB and
half a second of each process that imports it; the running twin needs one number of it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincc, chdtrc, chdtri, fdtrc, fdtri, gammainc, gammaincinv, ndtr, ndtri, stdtr, stdtrit

FloatArray = NDArray[np.float64]
Z_95 = 1.96  # standard errors on either side of an estimate that make a 95 % interval


def normal_above(z: float) -> float:
    """Return the probability that a standard normal number exceeds `z`."""
    return float(ndtr(-z))


def normal_exceeded(probability: float) -> float:
    """Return the number that a standard normal one exceeds with this probability."""
    return float(-ndtri(probability))


def robust_spread(deviations: FloatArray) -> float:
    """Return the standard deviation of normal deviations from 0, by their median size: outliers do not widen it."""
    return 1.4826 * float(np.median(np.abs(deviations)))


def chi2_above(value: float, freedom: float) -> float:
    """Return the probability that chi-square with so many degrees of freedom exceeds `value`."""
    return float(chdtrc(freedom, value))


def chi2_below(value: FloatArray, freedom: float) -> FloatArray:
    """Return the probability that chi-square stays below each value, of its shape."""
    return np.asarray(gammainc(0.5 * freedom, 0.5 * np.maximum(value, 0.0)), np.float64)


def chi2_exceeded(probability: float, freedom: float) -> float:
    """Return the number that chi-square exceeds with this probability."""
    return float(chdtri(freedom, probability))


def chi2_quantile(probability: float, freedom: float) -> float:
    """Return the number below which chi-square stays with this probability."""
    return float(2.0 * gammaincinv(0.5 * freedom, probability))


def student_above(t: float, freedom: float) -> float:
    """Return the probability that Student's t exceeds `t`."""
    return float(stdtr(freedom, -t))


def student_quantile(probability: float, freedom: float) -> float:
    """Return the number below which Student's t stays with this probability."""
    return float(stdtrit(freedom, probability))


def fisher_above(ratio: FloatArray | float, upper: float, lower: FloatArray | float) -> FloatArray:
    """Return the probability that F, with so many degrees of freedom above and below, exceeds each ratio."""
    return np.asarray(fdtrc(upper, lower, ratio), np.float64)


def fisher_quantile(probability: float, upper: float, lower: FloatArray | float) -> FloatArray:
    """Return the number below which F stays with this probability."""
    return np.asarray(fdtri(upper, lower, probability), np.float64)


def log_beta_above(share: float, first: float, second: float) -> float:
    """Return the logarithm of the probability that a beta-distributed share exceeds `share`; -inf where it is 0."""
    with np.errstate(divide="ignore"):
        return float(np.log(betaincc(first, second, share)))
