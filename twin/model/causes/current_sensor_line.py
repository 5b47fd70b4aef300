"""current-sensor-line: i_c reads a sinusoid that does not flow."""

from __future__ import annotations

from twin.model.causes.cause import Cause
from twin.model.causes.instruments import CLAMP_METER
from twin.model.causes.sensor_line import FORMS, USUAL, line_parameters

CAUSE = Cause(
    name="current-sensor-line",
    family="sensing",
    title="i_c reads a sinusoid that does not flow",
    sentence="i_c reads a sinusoid of {amplitude_a} at {frequency_hz} that is in its sensor and does not pull",
    acts_on="current sensor",
    equation="i_measured = i_c + A sin(2 pi f t + phase), and harmonics",
    source="mains in the wires of the shunt, or a loop of its ground",
    parameters=line_parameters(0, unit="A", high=0.3, probe=0.002),
    signature="one line in the spectrum of i_c, also with the coil off, and none in x",
    shows_in=("rest", "steps", "holds"),
    confirm=CLAMP_METER,
    cure="twist and screen the wires of the shunt, or sample over whole periods of the line",
    detector="sensor-line",
    not_simulated="its phase is not known",
    usual=USUAL,
    forms=FORMS,
)
