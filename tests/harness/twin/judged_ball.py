"""A ball on a rig that shares no code with the twin, its models and recordings, and the verdicts on them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from protocol.campaign import Controller, OperatingPoint, Plant
from tests.harness.twin.independent_plant import Ball
from twin.estimation.record import Capture, Record
from twin.model.parameters import PARAMETERS, Model, Noise, Parameter
from twin.validation.source import Source, source_of
from twin.validation.verdict import Validation, validate_sources

BALL = Ball()
TICKS = 8000


def model_of(ball: Ball, **wrong: float) -> Model:
    values = {name: getattr(ball, name) * wrong.get(name, 1.0) for name in PARAMETERS}
    return Model(
        plant=Plant(name="bench", mass_kg=ball.m, travel_m=ball.travel, x_max_m=ball.x_max, gravity_m_s2=ball.g),
        parameters={name: Parameter(value=values[name], unit=PARAMETERS[name][0]) for name in PARAMETERS},
        noise=Noise(sigma_x_m=ball.sigma_x, sigma_i_c_a=ball.sigma_i, process_a_m_s2=0.0, process_i_c_a=0.0),
    )


def controller_of(ball: Ball) -> Controller:
    """The law that `Ball.closed_loop` runs."""
    x = 0.5 * ball.travel
    point = OperatingPoint(i_c_a=ball.current(x), x_m=x, u_c_v=ball.current(x) / ball.K_A)
    return Controller(kind="lqi", gains=(0.49, 2000.0, 18.0, -17600.0), operating_point=point)


def steps(seed: int) -> Callable[[int], float]:
    """A reference that jumps every 0.5 s."""
    levels = np.random.default_rng(seed).uniform(2.3e-3, 3.7e-3, TICKS // 250 + 1)
    return lambda k: float(levels[k // 250])


def captured(ball: Ball, seed: int) -> Record:
    """A step of the amplifier at 25 kHz, from (1) alone."""
    t = (np.arange(1000) - 200) * 40e-6
    i = ball.K_A * (0.5 + np.where(t > 0, 1.5 * (1.0 - np.exp(-t / ball.T_A)), 0.0))
    i = i + ball.sigma_i * np.random.default_rng(seed).normal(size=len(t))
    capture = Capture(sample_time_s=40e-6, u_from_v=0.5, u_to_v=2.0, step_index=200, i_c_a=i)
    empty = np.empty(0)
    return Record(
        name="step", kind="amplifier-step", use="judge",
        t=empty, u_c=empty, i_c=empty, x=empty, x_ref=empty, captures=(capture,),
    )  # fmt: skip


def validate_records(records: list[Record], model: Model, controller: Controller | None = None) -> Validation:
    sources: list[Source] = [source_of(r, model, controller=controller or controller_of(BALL)) for r in records]
    return validate_sources(sources, model)
