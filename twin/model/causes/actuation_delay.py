"""actuation-delay: the input acts later than the board says.

u_c(t - delay)
"""

from __future__ import annotations

from twin.model.causes.cause import Cause, CauseParameter, MeasuredProbes
from twin.model.causes.instruments import OSCILLOSCOPE

DELAY = 8

CAUSE = Cause(
    name="actuation-delay",
    family="amplifier",
    title="the input acts later than the board says",
    sentence="the input acts {delay_s} later than the board says",
    acts_on="input of (1)",
    equation="u_c(t - delay)",
    source="computing time between sampling and output, or an output that is latched at the next tick",
    parameters=(
        CauseParameter(
            name="delay_s", symbol="delay", unit="s", place=DELAY, neutral=0.0, low=0.0, high=0.02, probes=(0.0002,)
        ),
    ),
    signature="i_c begins to move a fixed time after u_c, at 25 kHz as at 500 Hz, whatever the size of the step",
    shows_in=("amplifier-steps", "prbs-reference"),
    confirm="trigger an oscilloscope on the board's output pin and look when i_c begins",
    cure="output right after the computation, or predict the state by that time in the law",
    needs=("u_c", "i_c"),
    told_from={
        "sampling-delay": OSCILLOSCOPE,
        "position-sensor-lag": OSCILLOSCOPE,
    },
    traits=frozenset({"delays", "hidden-state"}),
    # The likelihood of a delay has a kink at every whole interval.
    measured_probes=MeasuredProbes(of="sampling-interval", times=(0.5, 1.5)),
)
