"""Lines in the spectrum of a sensor, as states of the filter: `twin/model/causes/sensor_line.py`.

A line is a pair of states (p, q) that rotates at its frequency; p is added to the reading.
"""

from __future__ import annotations

import math

from twin.compiled import inlined, kernel
from twin.estimation.ekf.memory import Floats, Memory


@kernel
def turn_state(f: Memory, y: Floats, T_s: float) -> None:
    """Rotate the lines of the state y by an interval T_s, s, in place."""
    for line in range(f.lines_count):
        at = f.places[f.lines + 2 * line]
        cosine, sine = math.cos(f.pulse[line] * T_s), math.sin(f.pulse[line] * T_s)
        p, q = y[at], y[at + 1]
        y[at], y[at + 1] = cosine * p + sine * q, cosine * q - sine * p


@kernel
def slopes_of_lines(f: Memory, T_s: float) -> None:
    """Fill the rows and columns of F that belong to lines."""
    for k in range(f.lines, f.m):
        for j in range(f.m):
            f.F[k, j], f.F[j, k] = 0.0, 0.0
    for line in range(f.lines_count):
        k = f.lines + 2 * line
        cosine, sine = math.cos(f.pulse[line] * T_s), math.sin(f.pulse[line] * T_s)
        f.F[k, k], f.F[k, k + 1] = cosine, sine
        f.F[k + 1, k], f.F[k + 1, k + 1] = -sine, cosine


@kernel
def turn_covariance(f: Memory, T_s: float) -> None:
    """Rotate rows and columns of lines in the covariance by an interval T_s, s, in which no other state moves."""
    P = f.P
    for line in range(f.lines_count):
        k = f.lines + 2 * line
        cosine, sine = math.cos(f.pulse[line] * T_s), math.sin(f.pulse[line] * T_s)
        for j in range(f.m):
            p, q = P[k, j], P[k + 1, j]
            P[k, j], P[k + 1, j] = cosine * p + sine * q, cosine * q - sine * p
        for j in range(f.m):
            p, q = P[j, k], P[j, k + 1]
            P[j, k], P[j, k + 1] = cosine * p + sine * q, cosine * q - sine * p


@inlined
def doubt_lines(f: Memory, T_s: float) -> None:
    """Add the process noise of lines over T_s, s, to their covariance: old readings lose their weight."""
    for line in range(f.lines_count):
        k = f.lines + 2 * line
        f.P[k, k] += f.q_line[line] * T_s
        f.P[k + 1, k + 1] += f.q_line[line] * T_s


@inlined
def lines_of_position(f: Memory, y: Floats, h: Floats) -> float:
    """Return what the lines of state y add to the reading of x, m; h, shape (m,), receives its derivatives."""
    total = 0.0
    for k in range(f.lines, f.m):
        h[k] = f.h_line[k]
        total += f.h_line[k] * y[f.places[k]]
    return total


@inlined
def lines_of_current(f: Memory, y: Floats) -> float:
    """Return what the lines of state y add to the reading of i_c, A."""
    total = 0.0
    for k in range(f.lines, f.m):
        total += f.h_i[k] * y[f.places[k]]
    return total


@kernel
def share_of_lines(f: Memory, k: int) -> float:
    """The covariance, with state k, of what the lines add to the reading of x."""
    total = 0.0
    for a in range(f.lines, f.m):
        total += f.h_line[a] * f.P[a, k]
    return total


@kernel
def variance_of_lines(f: Memory) -> float:
    """The variance of what the lines add to the reading of x, m^2."""
    total = 0.0
    for k in range(f.lines, f.m):
        total += f.h_line[k] * share_of_lines(f, k)
    return total
