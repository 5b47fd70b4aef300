"""Starting values of a delay and of T_A from fast step responses.

A model without a delay imitates it by a T_A that is ten times too long, and from there the likelihood has a very small
derivative by the delay.  A grid over both, on i_c alone, avoids that starting point.

    T_A di/dt + i = K_A u_c(t - delay)                                                                    (1), delayed
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin.estimation.record import Record
from twin.identify.checks.input_delay import delayed
from twin.identify.starting.regression import amplifier_start

_FAST_S = 2e-4  # longest sampling interval of a step response that shows both
_LONGEST_S = 6e-3
_COARSE_S = 2e-4


def dead_time(records: Sequence[Record]) -> tuple[float, float] | None:
    """(delay, T_A), s; None without a step response that is sampled fast enough, or without a delay."""
    steps = [only for record in records for only in _fast(record)]
    if not steps:
        return None
    interval = min(_interval(one) for one in steps)
    coarse, most = max(round(_COARSE_S / interval), 1), round(_LONGEST_S / interval)
    errors = {late: _error(steps, late) for late in range(0, most + 1, coarse)}
    best = min(errors, key=lambda late: errors[late])
    near = range(max(best - coarse + 1, 0), best + coarse)
    errors |= {late: _error(steps, late) for late in near if late not in errors}
    best = min(errors, key=lambda late: errors[late])
    start = amplifier_start([_late(one, best) for one in steps])
    return (best * interval, start.T_A) if best and start is not None else None


def _fast(record: Record) -> list[Record]:
    nothing = record.t[:0]
    captures = tuple(capture for capture in record.captures if capture.sample_time_s <= _FAST_S)
    found = []
    if captures:
        found.append(replace(record, captures=captures, t=nothing, u_c=nothing, i_c=nothing, x=nothing, x_ref=nothing))
    if record.kind == "amplifier-step" and len(record.t) > 1 and record.interval_s <= _FAST_S:
        found.append(replace(record, captures=()))
    return found


def _interval(record: Record) -> float:
    return record.captures[0].sample_time_s if record.captures else record.interval_s


def _late(record: Record, samples: int) -> Record:
    captures = tuple(replace(one, step_index=one.step_index + samples) for one in record.captures)
    return replace(delayed(record, samples) if len(record.t) else record, captures=captures)


def _error(steps: Sequence[Record], late: int) -> float:
    start = amplifier_start([_late(one, late) for one in steps])
    return start.sigma_i_c_a if start is not None else np.inf
