"""sampling-delay: both sensors show past values.

i_measured(t) = i_c(t - delay), x_measured(t) = x(t - delay); in a capture, which has its own clock, r delay
"""

from __future__ import annotations

from twin.model.causes.actuation_delay import AT_THE_KINKS, in_captures
from twin.model.causes.cause import Cause, CauseParameter, Form

DELAY, IN_CAPTURES = 26, 110

CAUSE = Cause(
    name="sampling-delay",
    family="timing",
    title="both sensors show past values",
    sentence="both sensors show the values of {delay_s} ago",
    acts_on="sampling",
    equation="i_measured(t) = i_c(t - delay), x_measured(t) = x(t - delay)",
    source="sample-and-hold and multiplexing before conversion, or a filter in front of both",
    parameters=(
        CauseParameter(name="delay_s", symbol="delay", unit="s", index=DELAY, low=0.0, high=0.02, probes=(0.0002,)),
        in_captures(IN_CAPTURES),
    ),
    signature="u_c seems to act late, on i_c and on x alike: from the samples alone it is an actuation delay",
    shows_in=("amplifier-steps", "prbs-reference"),
    confirm="trigger an oscilloscope on the start of the converter and compare with the sampled value",
    cure="convert right before the computation, or predict the state by that time in the law",
    needs=("u_c", "i_c"),
    traits=frozenset({"delays", "hidden-state"}),
    usual="delay of both sensors",
    forms=(
        Form(
            name="samples taken before the loop begins",
            values={"in_captures": 0.0},
            source="K. J. Astrom, B. Wittenmark, Computer-Controlled Systems, 1997, ch. 9: computational delay",
            probed=True,
        ),
    ),
    measured_probes=AT_THE_KINKS,
    same_samples_as="actuation-delay",
)
