"""The control law of a simulated experiment, and the lift-off input.

Rule: an unknown law is designed as by `board51 design` with default weights, (14)-(18), without delays and sensor lag.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import LinAlgError, solve_discrete_are

from protocol.campaign import Controller, OperatingPoint, Plant
from twin.control import LawNumbers
from twin.control_design.gains import LARGEST_U_SHARE, LARGEST_X_SHARE, TIME_CONSTANTS, augmented
from twin.evidence.checks.control_law import WIDE_V, numbers_of
from twin.inference.theta import Theta
from twin.model.equilibrium import at_rest, holding_current, holding_input
from twin.model.extended import I_C, current_reading
from twin.model.linear import measured


def lift_off_input(theta: Theta, plant: Plant) -> float:
    """The u_c at which the ball leaves the lower stop, V, the unit of inputs of the menu; NaN if there is none."""
    p, c = theta.base(plant), theta.vector()
    return holding_input(p, c, holding_current(p, c, max(theta.stop_low_m, 0.0)))


def law_of(controller: Controller | None, theta: Theta, plant: Plant, tick_s: float, u_max_v: float) -> LawNumbers:
    """The law in the form of the kernels.

    Args:
        controller: of the campaign; None: a law is designed for `theta`.
        theta: the model.
        plant: mass, travel, x_max, gravity.
        tick_s: T_s, s.
        u_max_v: upper limit of u_c, V.
    """
    numbers, top = None, min(u_max_v, WIDE_V)
    if controller is not None:
        numbers = numbers_of(controller, tick_s, u_low=0.0, u_high=top)
    if numbers is None:
        numbers = numbers_of(designed(theta, plant, tick_s), tick_s, u_low=0.0, u_high=top)
    assert numbers is not None, "a designed law has its numbers"
    return numbers


def designed(theta: Theta, plant: Plant, tick_s: float) -> Controller:
    """Design an LQI for mid-travel, (13)-(18), with the weights of Bryson's rule as in `twin/control_design/gains.py`.

    If the ball has no equilibrium there or the Riccati equation no solution, all gains are 0; the caller then sees that
    the ball does not fly.
    """
    p, c, x_0 = theta.base(plant), theta.vector(), 0.5 * plant.travel_m
    y, u_0 = at_rest(p, c, x_0, as_reading=True)
    K, i_0 = np.zeros(4), 0.0
    if math.isfinite(u_0):
        i_0 = float(current_reading(c, y[I_C]))
        phi, gamma = measured(p, c, x_0, tick_s)
        unstable = max(math.log(max(float(np.max(np.abs(np.linalg.eigvals(phi)))), 1.0)) / tick_s, 1.0)
        # Weights by the largest deviations that are acceptable (A. E. Bryson, Y. Ho, Applied Optimal Control, 1975).
        # Poles would have to be chosen anew for each rig.
        time_s, x, u = TIME_CONSTANTS / unstable, LARGEST_X_SHARE * plant.travel_m, LARGEST_U_SHARE * u_0
        Q = np.diag([(theta.K_A * u) ** -2, x**-2, (x / time_s) ** -2, (x * time_s) ** -2])
        R = np.array([[u**-2]])
        F, G = augmented(phi, gamma, tick_s)
        try:
            P = solve_discrete_are(F, G, Q, R)
            K = np.linalg.solve(R + G.T @ P @ G, G.T @ P @ F)[0]
        except (LinAlgError, ValueError):
            pass
    return Controller(
        kind="lqi",
        gains=(float(K[0]), float(K[1]), float(K[2]), float(K[3])),
        operating_point=OperatingPoint(i_c_a=i_0, x_m=x_0, u_c_v=u_0 if math.isfinite(u_0) else 0.0),
    )
