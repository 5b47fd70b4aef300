"""The board's own health, after all that the test has asked of it: HEALTH."""

from __future__ import annotations

import math
from collections.abc import Iterator

from gateway.selftest.bench import Bench, NotReadyError
from gateway.selftest.verdict import Verdict, fault, judge, passed, skipped
from protocol.wire.messages import NOT_KNOWN

_SPARE_BYTES = 16.0  # an interrupt and the functions that it calls
_CANARY_BYTES = 4.0


def health(bench: Bench) -> Iterator[Verdict]:
    """Judge the stack's least room since the reset, and the input at power-on."""
    if (bench.identity.int("firmware_major"), bench.identity.int("firmware_minor")) < (1, 3):
        raise NotReadyError("its firmware is older than 1.3")
    answer = bench.line.order("GET_HEALTH")
    free, u_power_on = answer.int("stack_free"), answer.int("u_power_on")
    if free == NOT_KNOWN:
        yield skipped("stack", "free stack", "the board watches none")
    else:
        yield judge(
            "stack", "stack that was never used", free, "bytes",
            good=(_SPARE_BYTES, math.inf), possible=(_CANARY_BYTES, math.inf),
            remedy="the firmware needs more stack than there is: report what the board was doing",
        )  # fmt: skip
    if u_power_on == NOT_KNOWN:
        yield skipped("input-at-power-on", "u_c at power-on", "the converter has no memory, or it does not answer")
    elif u_power_on:
        yield fault(
            "input-at-power-on", "u_c at power-on", f"code {u_power_on}", bound="0",
            remedy="current flows until the firmware starts, and the converter stores no 0: replace it",
        )  # fmt: skip
    else:
        yield passed("input-at-power-on", "u_c at power-on", "0", "stored in the converter")
