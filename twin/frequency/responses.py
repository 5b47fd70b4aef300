"""The responses of a loop, as ratios of its signals: measured, and linearised from a model.

    amplifier  i_c / u_c       ball  x / i_c       plant  x / u_c
    loop       L = w / u_c,  S = u_c / (u_c + w) = 1 / (1 + L),  T = w / (u_c + w) = L / (1 + L)

w is what the law makes of the readings, with the sign of a negative feedback, so that L is the loop broken at u_c:

    w = k_i i_c + K_x(z) x,   K_x(z) = k_x + k_p + k_v (1 - 1/z) / T_s + k_s T_s / (z - 1)

Of the model they come from (15), the delays of its causes included; u_c of a sample acts until the next one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from twin.control import LawNumbers, discrete
from twin.distributions import Z_95
from twin.estimation.record import FloatArray
from twin.frequency.spectra import ComplexArray, Spectra
from twin.model.parameters import PARAMETERS, Model, Parameter

Name = Literal["amplifier", "ball", "plant", "loop", "S", "T"]
TITLES: Mapping[Name, str] = {
    "amplifier": "amplifier, i_c / u_c",
    "ball": "ball and coil, x / i_c",
    "plant": "plant, x / u_c",
    "loop": "loop gain L",
    "S": "sensitivity S",
    "T": "complementary sensitivity T",
}
UNITS: Mapping[Name, str] = {"amplifier": "A/V", "ball": "m/A", "plant": "m/V", "loop": "-", "S": "-", "T": "-"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Curve:
    """A response of the linearised model; arrays of shape (F,)."""

    f_hz: FloatArray
    value: ComplexArray
    slopes: ComplexArray  # its change by one standard deviation of each uncertain parameter, shape (F, p)

    @property
    def log_gain_std(self) -> FloatArray:
        """The standard deviation of ln |H|, by the delta method."""
        return np.asarray(np.linalg.norm((self.slopes / self.value[:, None]).real, axis=1))

    @property
    def phase_std(self) -> FloatArray:
        """The standard deviation of arg H, rad."""
        return np.asarray(np.linalg.norm((self.slopes / self.value[:, None]).imag, axis=1))


def pairs(s: Spectra, law: LawNumbers | None) -> dict[Name, tuple[ComplexArray, ComplexArray]]:
    """Return the numerator and denominator of each response, coefficients of shape (K, F); no loop without a law."""
    return _pairs(s.u, s.i, s.x, law, s.bins_hz)


def _pairs(
    u: ComplexArray, i: ComplexArray, x: ComplexArray, law: LawNumbers | None, f_hz: FloatArray
) -> dict[Name, tuple[ComplexArray, ComplexArray]]:
    of: dict[Name, tuple[ComplexArray, ComplexArray]] = {"amplifier": (i, u), "ball": (x, i), "plant": (x, u)}
    if law is not None:
        w = law.k_i * i + position_law(law, f_hz) * x
        of |= {"loop": (w, u), "S": (u, u + w), "T": (w, u + w)}
    return of


def position_law(law: LawNumbers, f_hz: FloatArray) -> ComplexArray:
    """Return K_x at f, V/m, shape (F,)."""
    T_s = law.sample_time_s
    z = np.exp(2j * np.pi * f_hz * T_s)
    return np.asarray(law.k_x + law.k_p + law.k_v * (1.0 - 1.0 / z) / T_s + law.k_s * T_s / (z - 1.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """The circumstances of a linearisation."""

    law: LawNumbers | None
    x_m: float  # the height
    sample_time_s: float
    delay: int = 0  # of u_c, samples, that the identification of the model corrected


def linear_responses(model: Model, setting: Setting, f_hz: FloatArray) -> dict[Name, ComplexArray]:
    """Return the responses of the linearised model, (14) and (15), shape (F,); none where nothing holds the ball."""
    T_s = setting.sample_time_s
    phi, gamma = discrete(model, setting.x_m, T_s)
    if not np.isfinite(phi).all():
        return {}
    z = np.exp(2j * np.pi * f_hz * T_s)[:, None, None]
    # Solved at each frequency: the polynomials of a transfer function of many states would lose digits.
    states = np.linalg.solve(z * np.eye(len(phi)) - phi, gamma[None] * z**-setting.delay)[:, :, 0]
    item = np.ones(len(f_hz), dtype=complex)
    # The same ratios as of the measured signals, for u_c = 1: so the two have one definition.
    return {a: top / bottom for a, (top, bottom) in _pairs(item, states[:, 0], states[:, 1], setting.law, f_hz).items()}


def curves(model: Model, setting: Setting, f_hz: FloatArray) -> dict[Name, Curve]:
    """Return the responses of the model with their uncertainty.

    The model file has a standard deviation for each parameter and no correlations: they are taken as independent.
    """
    nominal = linear_responses(model, setting, f_hz)
    slopes: dict[Name, list[ComplexArray]] = {name: [] for name in nominal}
    # Differences, no derivatives of (14): those would need an equation for each cause.
    for higher, lower in _varied(model):
        up, down = (linear_responses(changed, setting, f_hz) for changed in (higher, lower))
        for name in nominal:
            if name in up and name in down:
                slopes[name].append(0.5 * (up[name] - down[name]))
    empty = np.empty((len(f_hz), 0), dtype=complex)
    return {
        name: Curve(f_hz=f_hz, value=value, slopes=np.column_stack(slopes[name]) if slopes[name] else empty)
        for name, value in nominal.items()
    }


def _varied(model: Model) -> Iterator[tuple[Model, Model]]:
    """The model with each uncertain parameter one standard deviation higher and lower."""
    for name, parameter in model.parameters.items():
        if ends := _ends(parameter, PARAMETERS[name][1]):
            high, low = (replace(model, parameters={**model.parameters, name: end}) for end in ends)
            yield high, low
    for n, cause in enumerate(model.causes):
        for name, parameter in cause.parameters.items():
            if ends := _ends(parameter, -math.inf):
                changed = [replace(cause, parameters={**cause.parameters, name: end}) for end in ends]
                high, low = (replace(model, causes=(*model.causes[:n], c, *model.causes[n + 1 :])) for c in changed)
                yield high, low


def _ends(parameter: Parameter, lowest: float) -> tuple[Parameter, Parameter] | None:
    std = parameter.std
    if std is None and parameter.ci95 is not None:
        std = (parameter.ci95[1] - parameter.ci95[0]) / (2.0 * Z_95)
    if std is None or not std > 0.0:
        return None
    if abs(parameter.value) > 0.0 and lowest > 0.0:  # a positive number: in proportion, and within a factor of two
        factor = math.exp(min(std / parameter.value, math.log(2.0)))
        return replace(parameter, value=parameter.value * factor), replace(parameter, value=parameter.value / factor)
    return replace(parameter, value=parameter.value + std), replace(parameter, value=parameter.value - std)
