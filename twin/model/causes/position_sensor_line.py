"""position-sensor-line: x reads a sinusoid that the ball does not follow."""

from __future__ import annotations

from twin.model.causes.cause import Cause
from twin.model.causes.sensor_line import FORMS, USUAL, line_parameters

CAUSE = Cause(
    name="position-sensor-line",
    family="sensing",
    title="x reads a sinusoid that the ball does not follow",
    sentence="x reads a sinusoid of {amplitude_m} at {frequency_hz} that is in its sensor, not in the force",
    acts_on="position sensor",
    equation="x_measured = x + A sin(2 pi f t + phase), and harmonics",
    source="mains in the cable of the sensor, or a lamp that shines into an optical one",
    parameters=line_parameters(1, unit="m", high=0.0005, probe=0.00001),
    signature="one line in the spectrum of x, also with the ball on its rest",
    shows_in=("rest", "steps", "holds"),
    confirm="read x with the ball on its rest and the coil off: the line is still there",
    cure="screen the sensor and its cable, ground them at one point, or sample over whole periods of the line",
    deciding_measurements={
        "periodic-disturbance": "read x with the ball on its rest: a line that is still there belongs to the sensor"
    },
    detector="sensor-line",
    not_simulated="its phase is not known",
    usual=USUAL,
    forms=FORMS,
)
