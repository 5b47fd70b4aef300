"""Starting values of the fit of the paper's model, from the recordings alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from protocol.campaign import Plant
from protocol.errors import DataError
from twin.estimation.record import Record
from twin.evidence.gather import Evidence
from twin.evidence.noise_levels import Noise
from twin.evidence.sensor_noise import sensor_noise
from twin.evidence.starting.regression import AmplifierStart, amplifier_start, ball_start
from twin.inference.theta import COLOURS, Theta, max_drag
from twin.settings import diagnosis as settings


def start_theta(records: Sequence[Record], plant: Plant) -> Theta:
    """Return the starting values of the fit of the paper's model; the user gives none.

    Raises:
        DataError: no recording has u_c and i_c that move.
    """
    amplifier = amplifier_start(list(records))
    if amplifier is None or amplifier.K_A <= 0.0:
        raise DataError(
            "no recording shows i_c following u_c",
            remedy="Record a step or a ramp of u_c with i_c, and map both columns",
        )
    if not any(record.has("x") for record in records):
        # No recording has x: only the amplifier can be estimated, and any K_c will do.
        weight, half = plant.mass_kg * plant.gravity_m_s2, plant.x_max_m - 0.5 * plant.travel_m
        return first_theta(amplifier, weight * half**2 / 0.25, 0.0)
    # A regression, not multiple shooting: (6) is linear in K_c/m and b/m, so a regression has no local minima and needs
    # no guess.
    ball = ball_start(list(records), plant, amplifier)
    if ball is None or ball.k <= 0.0:
        raise DataError(
            "no recording shows the ball in flight for long enough",
            remedy="Record closed-loop flights or an open-loop prbs with x: without them only the amplifier is known",
        )
    return first_theta(amplifier, ball.k * plant.mass_kg, min(max(ball.d * plant.mass_kg, 0.0), 0.9 * max_drag(plant)))


def first_theta(amplifier: AmplifierStart, K_c: float, b: float) -> Theta:
    """Return the starting values with those of the noise; its levels follow from that of i_c."""
    return Theta(
        K_A=amplifier.K_A,
        T_A=amplifier.T_A,
        K_c=K_c,
        b=b,
        sigma_i_c_a=max(amplifier.sigma_i_c_a, 1e-5),
        sigma_x_m=1e-5,
        process_i_c_a=max(0.3 * amplifier.sigma_i_c_a, 1e-5),
        # From a smaller value, an incomplete model ends at a far lower maximum: all its error counts as noise of x.
        process_a_m_s2=3.0,
    )


def coloured(noise: Noise) -> tuple[tuple[str, float], ...]:
    """The colour of the noise at rest, as `NoiseLevels` has it; empty where all is white."""
    i_c, x, captured = noise.colours
    names = zip(COLOURS[::2], COLOURS[1::2], (i_c, x, captured), strict=True)
    return tuple(
        pair
        for tau, white, colour in names
        if colour is not None
        for pair in ((tau, colour.tau_s), (white, colour.white))
    )


def with_noise_bounds(theta: Theta, evidence: Evidence) -> Theta:
    """Bound the sensor noise from below by a share of the noise at rest, and give it the colour that it has there."""
    sigma_i, sigma_x = sensor_noise(evidence)
    # A bound, not a fixed level: the noise in flight may differ from that at rest, as it may follow the height.
    min_sigma_i = settings.MIN_NOISE_SHARE * sigma_i if sigma_i else theta.min_sigma_i_c_a
    min_sigma_x = settings.MIN_NOISE_SHARE * sigma_x if sigma_x else theta.min_sigma_x_m
    if evidence.noise is not None:
        theta = theta.all_of(coloured(evidence.noise))
    return replace(
        theta,
        min_sigma_i_c_a=min_sigma_i,
        min_sigma_x_m=min_sigma_x,
        sigma_i_c_a=max(theta.sigma_i_c_a, min_sigma_i),
        sigma_x_m=max(theta.sigma_x_m, min_sigma_x),
    )
