"""Starting values of a delay and of T_A from fast step responses.

A model without a delay imitates it by a T_A that is ten times too long.  There the derivative of the likelihood by the
delay is very small.  A grid over both, on i_c alone, avoids that starting point.

    T_A di/dt + i = K_A u_c(t - delay)                                                                    (1), delayed
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin.estimation.record import Record
from twin.evidence.starting.regression import amplifier_start
from twin.settings import diagnosis as settings

_COARSE_S = 2e-4  # of the first grid; a finer one follows around its best


def dead_time(records: Sequence[Record]) -> tuple[float, float] | None:
    """Return (delay, T_A), s; None without a step response that is sampled fast enough, or without a delay."""
    steps = [step for record in records for step in _fast(record)]
    if not steps:
        return None
    interval = min(record.captures[0].sample_time_s if record.captures else record.interval_s for record in steps)
    # A grid of whole samples, coarse and then fine: the error has a kink at each sample, at which a slope misleads.
    coarse, longest = max(round(_COARSE_S / interval), 1), round(settings.DEAD_TIME_LONGEST_S / interval)
    errors = {delay: _error(steps, delay) for delay in range(0, longest + 1, coarse)}
    best = min(errors, key=lambda delay: errors[delay])
    neighbours = range(max(best - coarse + 1, 0), best + coarse)
    errors |= {delay: _error(steps, delay) for delay in neighbours if delay not in errors}
    best = min(errors, key=lambda delay: errors[delay])
    start = amplifier_start([_delayed(record, best) for record in steps])
    return (best * interval, start.T_A) if best and start is not None else None


def delayed(record: Record, samples: int) -> Record:
    """The recording with u_c delayed by `samples`."""
    if samples == 0:
        return record
    u = np.concatenate((np.full(samples, record.u_c[0]), record.u_c[:-samples]))
    return replace(record, u_c=u)


def _fast(record: Record) -> list[Record]:
    captures = tuple(capture for capture in record.captures if capture.sample_time_s <= settings.DEAD_TIME_FAST_S)
    result = []
    if captures:
        result.append(replace(record.part(slice(0, 0)), captures=captures))
    if record.kind == "amplifier-step" and len(record.t) > 1 and record.interval_s <= settings.DEAD_TIME_FAST_S:
        result.append(replace(record, captures=()))
    return result


def _delayed(record: Record, samples: int) -> Record:
    captures = tuple(replace(capture, step_index=capture.step_index + samples) for capture in record.captures)
    return replace(delayed(record, samples) if len(record.t) else record, captures=captures)


def _error(steps: Sequence[Record], delay: int) -> float:
    # K_A and T_A are found anew for each delay: held, they would keep what they had taken from the delay.
    start = amplifier_start([_delayed(record, delay) for record in steps])
    return start.sigma_i_c_a if start is not None else np.inf
