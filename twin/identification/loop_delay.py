"""Test of (1) for a delay: a current that answers late by a part of a sample, to which the drag b gives way first.

Rule: the delay is sought in i_c alone, without a force model, because a wrong law of the force would decide on it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin.estimation.innovations import FLIES, USE_X
from twin.identification.fit import Blocks, bare, fit
from twin.inference.optimiser import Fit
from twin.inference.theta import coordinates_of
from twin.model.causes.catalogue import CATALOGUE
from twin.settings import identification as settings

_FREE = ("K_A", "T_A", "sigma_i_c_a", "process_i_c_a")
_PASSES = 15


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopDelay:
    """A delay that (1) lacks, and what becomes of b with it."""

    delay_s: float
    b: float  # N s/m, of the fit with the delay


def find_loop_delay(likelihood: Blocks, fitted: Fit) -> LoopDelay | None:
    """Return the delay of i_c, and b with it, if the recordings show one; None otherwise."""
    (cause,) = (cause for cause in CATALOGUE if cause.family == "amplifier" and "delays" in cause.traits)
    delay, *_ = names = coordinates_of(cause.name)
    flags = likelihood.series.flags & np.uint16(~(FLIES | USE_X) & 0xFFFF)
    current = Blocks(likelihood.whole.over(bare(replace(likelihood.series, flags=flags))))
    prompt = fit(current, fitted.theta, _FREE, passes=_PASSES)
    # From several delays, because T_A that imitates one is a maximum of its own, and the likelihood has a kink at each
    # sample of a capture.
    starts = [
        replace(fitted.theta, T_A=T_A, closed_form=False).having(delay, share * likelihood.whole.tick_s)
        for share in settings.LOOP_DELAY_SHARES
        for T_A in (fitted.theta.T_A, 0.3 * fitted.theta.T_A)
    ]
    best = max(starts, key=lambda start: current.visit(start)[0])
    best_fit = fit(current, best, (*_FREE, *names), passes=_PASSES)
    if best_fit.loglik < prompt.loglik + settings.LOOP_DELAY_GAIN:
        return None
    held = best_fit.theta.value(delay)
    start = replace(fitted.theta, closed_form=False).all_of(
        [(name, best_fit.theta.value(name)) for name in (*names, "T_A")]
    )
    return LoopDelay(delay_s=held, b=fit(likelihood, start, fitted.free, passes=_PASSES).theta.b)
