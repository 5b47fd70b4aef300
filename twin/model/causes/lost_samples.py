"""lost-samples: samples are lost between board and log."""

from __future__ import annotations

from twin.model.causes.cause import Cause, CauseParameter

PROBABILITY = 27

CAUSE = Cause(
    name="lost-samples",
    family="timing",
    title="samples are lost between board and log",
    sentence="{probability:%} of the samples are missing",
    acts_on="transmission",
    equation="each sample is missing with a probability",
    source="an overrun buffer, a loaded or noisy line",
    parameters=(
        CauseParameter(name="probability", symbol="probability", index=PROBABILITY, low=0.0, high=0.9, probes=(0.01,)),
    ),
    signature="gaps in the sequence numbers, or in t",
    shows_in=("rest",),
    confirm="board51 info LOG lists the gaps",
    cure="a faster line, a larger stream divider, or less load on the host",
    needs=("u_c",),
    detector="gaps",
    not_simulated="it belongs to the serial line, not to the rig",
)
