"""actuation-delay: the input acts later than the board says.

u_c(t - delay) in the control loop, u_c(t - r delay) in a capture, which counts its time from its own step.  Either the
amplifier is late (r = 1), or the output of a loop that computes before (r = 0).
"""

from __future__ import annotations

from twin.model.causes.cause import Cause, CauseParameter, Form, MeasuredProbes
from twin.model.causes.instruments import OSCILLOSCOPE

DELAY, IN_CAPTURES = 8, 109
# The likelihood of a delay has a kink at every whole interval.
AT_THE_KINKS = MeasuredProbes(of="sampling-interval", times=(0.5, 1.5))


def in_captures(index: int) -> CauseParameter:
    """The share of a delay that captures show."""
    return CauseParameter(
        name="in_captures", symbol="r", index=index, neutral=1.0, low=0.0, high=1.5, probes=(0.8,), spread=0.7
    )


CAUSE = Cause(
    name="actuation-delay",
    family="amplifier",
    title="the input acts later than the board says",
    sentence="the input acts {delay_s} later than the board says",
    acts_on="input of (1)",
    equation="u_c(t - delay); in a capture u_c(t - r delay)",
    source="computing time between sampling and output, or an output that is latched at the next tick",
    parameters=(
        CauseParameter(name="delay_s", symbol="delay", unit="s", index=DELAY, low=0.0, high=0.02, probes=(0.0002,)),
        in_captures(IN_CAPTURES),
    ),
    signature="i_c begins to move a fixed time after u_c, whatever the size of the step; in a capture as well, unless "
    "it is the loop's output that is late",
    shows_in=("amplifier-steps", "prbs-reference"),
    confirm="trigger an oscilloscope on the board's output pin and see when i_c begins",
    cure="output right after the computation, or predict the state by that time in the law",
    needs=("u_c", "i_c"),
    deciding_measurements={"sampling-delay": OSCILLOSCOPE, "position-sensor-lag": OSCILLOSCOPE},
    traits=frozenset({"delays", "hidden-state"}),
    usual="delay of the amplifier",
    forms=(
        Form(
            name="computing time of the loop",
            values={"in_captures": 0.0},
            source="K. J. Astrom, B. Wittenmark, Computer-Controlled Systems, 1997, ch. 9: computational delay",
            probed=True,
        ),
    ),
    measured_probes=AT_THE_KINKS,
)
