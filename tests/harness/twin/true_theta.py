"""The parameters of the independent plant, as the twin writes them."""

from __future__ import annotations

from tests.harness.twin.independent_plant import Ball
from twin.inference.theta import Theta

BALL = Ball()
TRUE = Theta(
    K_A=BALL.K_A,
    T_A=BALL.T_A,
    K_c=BALL.K_c,
    b=BALL.b,
    sigma_i_c_a=BALL.sigma_i,
    sigma_x_m=BALL.sigma_x,
    process_i_c_a=1e-5,
    process_a_m_s2=0.02,
)
