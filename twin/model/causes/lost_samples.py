"""lost-samples: samples are lost between board and log.

each sample is missing with a probability
"""

from __future__ import annotations

from twin.model.causes.cause import Cause, CauseParameter

PROBABILITY = 27

CAUSE = Cause(
    name="lost-samples",
    family="timing",
    title="samples are lost between board and log",
    acts_on="transmission",
    equation="each sample is missing with a probability",
    source="an overrun buffer, a loaded line",
    parameters=(
        CauseParameter(
            name="probability",
            symbol="probability",
            unit="",
            place=PROBABILITY,
            neutral=0.0,
            low=0.0,
            high=0.9,
            probes=(0.01,),
        ),
    ),
    signature="gaps in the sequence numbers or in t",
    shows_in=("rest",),
    confirm="board51 info LOG",
    cure="a faster line or a larger stream divider",
    needs=("u_c",),
)
