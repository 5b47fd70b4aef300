"""Check of the input's time: many control programs log u_c one sample before it takes effect.

Rule: each recording is tested by the likelihood of i_c alone, without a force model, and with a large margin.  A delay
      would bias T_A by most of a sampling interval, so it is corrected and reported.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

import numpy as np

from protocol.campaign import Plant
from twin.estimation.innovations import FLIES, USE_X
from twin.estimation.prepare import prepare
from twin.estimation.record import Record
from twin.evidence.dead_time import delayed
from twin.evidence.starting.regression import amplifier_start
from twin.identification.fit import Blocks, bare, fit
from twin.identification.starts import nominal
from twin.inference.likelihood import Criterion
from twin.settings import identification as settings

_SAMPLES = 5_000  # more than enough for that margin
_FREE = ("K_A", "T_A", "sigma_i_c_a", "process_i_c_a")


def input_delay(record: Record, plant: Plant) -> int:
    """Return the delay of u_c against its record, samples; 0 if it cannot be determined, as in a ramp."""
    if record.kind in ("equilibria", "sawtooth") or not record.has("u_c", "i_c") or len(record.t) < 100:
        return 0
    part = replace(record, captures=()).part(slice(0, _SAMPLES))
    values = []
    for samples in range(settings.DELAY_SAMPLES + 1):
        shifted = delayed(part, samples)
        start = amplifier_start([shifted])
        if start is None or start.K_A <= 0:
            return 0
        series, _ = prepare([shifted], plant)
        # By i_c alone: with x in the likelihood, a wrong law of the force could decide on the delay.
        current_series = replace(series, flags=series.flags & np.uint16(~(FLIES | USE_X) & 0xFFFF))
        with closing(Criterion(bare(current_series), plant, record.interval_s, workers=1)) as criterion:
            values.append(fit(Blocks(criterion), nominal(start, 1.0, 0.0), _FREE, passes=15).loglik)
    best = int(np.argmax(values))
    # Not simply the likeliest: other errors of the model change the likelihood, too.
    return best if values[best] > values[0] + settings.DELAY_GAIN else 0
