"""The values that a campaign states and the board cannot measure, each as a suspect: how wrong may it be?

A suspect has one parameter, the relative error e of a stated value: true = (1 + e) stated; of x_max it is a length.
What the data show of it follows from (1), (3) and (6), divided by the mass m:

    T_A i_c' = K_A u_c - i_c        x'' = (K_c / m) i_c^2 / (x_max - x)^2 - (b / m) x' - g

    stated value    what the error does to the equations              takes it up
    mass            K_c / m, b / m                                    K_c, b: exactly
    u_c             K_A u_c                                           K_A: exactly
    g               g                                                 a constant force: exactly
    time base       x'' (1 + e)^2, x' (1 + e), i_c' (1 + e)           K_c, b, T_A, and g (1 + e)^2
    travel and x    x_max / (1 + e), g / (1 + e), K_c / (1 + e)^3     K_c, and a constant force with another x_max
    x_max           gap x_max - x                                     a coil that sits elsewhere: exactly
    travel alone    reading at the upper stop                         the position of that stop

The sensor of x is often calibrated by the travel, so one error may be in both.  The scale of i_c and that of x alone
are causes of the catalogue already.  This table is for readers.  The diagnosis
computes what takes up a suspect from the data of each campaign (`twin/diagnosis/search/stated_values.py`).

Rule 1: a suspect changes the plant, the samples or a parameter before a kernel sees them, so no kernel knows it.
Rule 2: a suspect is never selected and never in a model file.  It can only be as good as a named cause.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from protocol.campaign import Plant
from twin.model.causes.cause import NO_PLACE, Cause, CauseParameter, Family
from twin.model.causes.position_sensor_gain import GAIN

MASS, GRAVITY, CLOCK, SCALE = "stated-mass", "stated-gravity", "stated-clock", "stated-x-scale"
X_MAX, TRAVEL, INPUT = "stated-x-max", "stated-travel", "stated-input"


def _suspect(name: str, family: Family, sentences: tuple[str, str], title: str, confirm: str, cure: str) -> Cause:
    length = name == X_MAX
    strength = CauseParameter(
        name="error_m" if length else "error",
        symbol="error",
        unit="m" if length else "",
        index=NO_PLACE,
        low=-0.01 if length else -0.3,
        high=0.01 if length else 0.3,
        probes=(0.0002,) if length else (0.01,),
    )
    return Cause(
        name=name,
        family=family,
        title=title,
        sentence=sentences[0],
        opposite=sentences[1],
        acts_on="the values that campaign.toml states",
        equation="true value = stated value + error" if length else "true value = (1 + error) stated value",
        source="campaign.toml, or the calibration of the board",
        parameters=(strength,),
        signature="other parameters take it up, in part or exactly",
        shows_in=(),
        confirm=confirm,
        cure=cure,
        needs=(),
        detector="stated",
    )


def _percent(subject: str, more: str, less: str) -> tuple[str, str]:
    return f"{subject} {{error:%}} {more}", f"{subject} {{error:%}} {less}"


STATED: tuple[Cause, ...] = (
    _suspect(
        MASS,
        "motion",
        _percent("the ball weighs", "more than the campaign says", "less than the campaign says"),
        "the mass in campaign.toml is wrong",
        "weigh the ball on a kitchen balance",
        "the right mass_kg in [plant]",
    ),
    _suspect(
        GRAVITY,
        "motion",
        _percent("the campaign's g is", "too small", "too large"),
        "g in campaign.toml is wrong, the axis is tilted, or a part moves with the ball and is not lifted",
        "look up g, put a level on the rig, and see whether anything moves with the ball",
        "the right gravity_m_s2 in [plant]; a level rig",
    ),
    _suspect(
        CLOCK,
        "timing",
        _percent("the board's clock is", "slow", "fast"),
        "the board's clock is wrong",
        "compare ten minutes of the board's ticks with the computer's clock",
        "the right sampling interval on the board, or a scale for t in campaign.toml",
    ),
    _suspect(
        SCALE,
        "sensing",
        _percent("the campaign's travel, and with it the scale of x, is", "too small", "too large"),
        "the travel in campaign.toml is wrong, and x was calibrated by it",
        "measure the travel with a caliper",
        "the right travel_m in [plant], and x calibrated by it",
    ),
    _suspect(
        X_MAX,
        "force",
        ("the campaign's x_max is {error_m} too small", "the campaign's x_max is {error_m} too large"),
        "x_max in campaign.toml is wrong",
        "measure from the rest of the ball to the core with a caliper",
        "the right x_max_m in [plant]",
    ),
    _suspect(
        TRAVEL,
        "sensing",
        _percent("the campaign's travel is", "too small", "too large"),
        "the travel in campaign.toml is wrong",
        "measure the travel with a caliper",
        "the right travel_m in [plant]",
    ),
    _suspect(
        INPUT,
        "amplifier",
        _percent("u_c is", "larger than the board says", "smaller than the board says"),
        "the scale of u_c is wrong",
        "measure u_c with a multimeter",
        "the right scale of u_c",
    ),
)
_STRENGTHS = {cause.name: f"{cause.name}.{cause.strength.name}" for cause in STATED}


def corrected(plant: Plant, values: Mapping[str, float]) -> Plant:
    """Return the plant as it is if the stated one has these errors; `values` by coordinate, other ones are ignored."""
    if not any(name in values for name in _STRENGTHS.values()):
        return plant
    scale = factor(values, SCALE)
    return replace(
        plant,
        mass_kg=plant.mass_kg * factor(values, MASS),
        gravity_m_s2=plant.gravity_m_s2 * factor(values, GRAVITY),
        x_max_m=plant.x_max_m + values.get(_STRENGTHS[X_MAX], 0.0),
        travel_m=plant.travel_m * scale * factor(values, TRAVEL),
    )


def rescale_sensor(c: NDArray[np.float64], values: Mapping[str, float]) -> None:
    """Let the sensor read in the stated unit of length, in place; c has shape (PLACES,)."""
    c[GAIN] /= factor(values, SCALE)


def factor(values: Mapping[str, float], suspect: str) -> float:
    """Return true over stated value under these errors, by coordinate."""
    return 1.0 + values.get(_STRENGTHS[suspect], 0.0)
