"""Delays of u_c, whole samples of its record or a part of one in the loop, sought in i_c alone.

A wrong law of the force would decide on a delay, so both tests are without a force model, and with a large margin.

Rule 1: many control programs log u_c one sample before it takes effect.  That would bias T_A by most of a sampling
        interval, so it is corrected and reported.
Rule 2: a current that answers late by a part of a sample is not in (1), and the drag b gives way to it first.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np

from protocol.campaign import Plant
from twin.estimation.innovations import FLIES, USE_X, Series
from twin.estimation.prepare import prepare
from twin.estimation.record import Record
from twin.evidence.dead_time import delayed
from twin.evidence.starting.regression import amplifier_start
from twin.identification.fit import Blocks, bare, fit
from twin.identification.starts import nominal
from twin.inference.likelihood import Criterion
from twin.inference.optimiser import Fit
from twin.inference.theta import coordinates_of
from twin.model.causes.catalogue import CATALOGUE
from twin.settings import identification as settings

AMPLIFIER = ("K_A", "T_A", "sigma_i_c_a", "process_i_c_a")  # what i_c alone shows
_SAMPLES = 5_000  # more than enough for that margin
_PASSES = 15


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
        with closing(Criterion(bare(_current(series)), plant, record.interval_s, workers=1)) as criterion:
            values.append(fit(Blocks(criterion), nominal(start, 1.0, 0.0), AMPLIFIER, passes=_PASSES).loglik)
    best = int(np.argmax(values))
    # Not simply the likeliest: other errors of the model change the likelihood, too.
    return best if values[best] > values[0] + settings.DELAY_GAIN else 0


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopDelay:
    """A delay that (1) lacks, and what becomes of b with it."""

    delay_s: float
    b: float  # N s/m, of the fit with the delay


def find_loop_delay(likelihood: Blocks, fitted: Fit) -> LoopDelay | None:
    """Return the delay of i_c, and b with it, if the recordings show one; None otherwise."""
    (cause,) = (cause for cause in CATALOGUE if cause.family == "amplifier" and "delays" in cause.traits)
    delay, *_ = names = coordinates_of(cause.name)
    current = Blocks(likelihood.whole.over(bare(_current(likelihood.series))))
    # In i_c alone: with x, an error of the force law would ask for a delay as well.
    prompt = fit(current, fitted.theta, AMPLIFIER, passes=_PASSES)
    # From several delays, because T_A that imitates one is a maximum of its own, and the likelihood has a kink at each
    # sample of a capture.
    starts = [
        replace(fitted.theta, T_A=T_A, closed_form=False).having(delay, share * likelihood.whole.tick_s)
        for share in settings.LOOP_DELAY_SHARES
        for T_A in (fitted.theta.T_A, 0.3 * fitted.theta.T_A)
    ]
    best = max(starts, key=lambda start: current.visit(start)[0])
    best_fit = fit(current, best, (*AMPLIFIER, *names), passes=_PASSES)
    if best_fit.loglik < prompt.loglik + settings.LOOP_DELAY_GAIN:
        return None
    held = best_fit.theta.value(delay)
    start = replace(fitted.theta, closed_form=False).all_of(
        [(name, best_fit.theta.value(name)) for name in (*names, "T_A")]
    )
    return LoopDelay(delay_s=held, b=fit(likelihood, start, fitted.free, passes=_PASSES).theta.b)


def _current(series: Series) -> Series:
    """The series without x, so that its likelihood is that of i_c."""
    return replace(series, flags=series.flags & np.uint16(~(FLIES | USE_X) & 0xFFFF))
