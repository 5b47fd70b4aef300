"""Bits of the converters that never toggle, over all that was seen and a slow sawtooth of the input."""

from __future__ import annotations

from collections.abc import Iterator, Set

from gateway.selftest.bench import Bench
from gateway.selftest.verdict import Verdict, fault, passed, skipped
from protocol.wire.messages import Shape

_BITS = 12
_SWEEP_S = 1.0
_UNMOVED = frozenset({"position-end", "position-frozen", "no-lift", "no-current", "input-not-followed"})


def codes(bench: Bench) -> Iterator[Verdict]:
    """Judge the codes of i_c and x."""
    bench.rest()
    first = len(bench.line.samples)
    bench.open_loop()
    bench.play(Shape.SAWTOOTH, bench.rig.rest_input_v, period_s=_SWEEP_S, duration_s=_SWEEP_S)
    bench.pulse(bench.rig.lift_input_v, 15)
    bench.idle()
    finer = max(_BITS - bench.identity.int("adc_bits"), 0)  # bits that a coarser converter does not have
    samples = [sample.state for sample in bench.line.samples]
    yield _judge(bench, "i_c", {s.i_c for s in samples}, {s.i_c for s in samples[first:]}, finer)
    yield _judge(bench, "x", {s.x for s in samples}, {s.x for s in samples[first:]}, finer)


def stuck_bits(values: Set[int], lowest: int) -> tuple[list[int], list[int]]:
    """Return the bits that are stuck, and those that the range of the codes has exercised.

    A bit is exercised where the codes span four times its worth: whatever the noise, both of its values are due.
    """
    span = max(values) - min(values)
    exercised = [bit for bit in range(lowest, _BITS) if span >= 4 << bit]
    return [bit for bit in exercised if len({code >> bit & 1 for code in values}) == 1], exercised


def _judge(bench: Bench, channel: str, values: set[int], now: set[int], lowest: int) -> Verdict:
    """Judge the codes since the start, and those of now alone: a bit may have stuck meanwhile."""
    stuck, exercised = stuck_bits(values, lowest)
    stuck = stuck or stuck_bits(now, lowest)[0]
    name, what = f"stuck-bit-{channel.replace('_', '-')}", f"bits of {channel}"
    if stuck:
        value = f"bit {', '.join(map(str, stuck))} never changes in {len(values)} codes"
        return fault(name, what, value, remedy="look at that line of the converter's bus, or replace the converter")
    if not exercised:
        if bench.faults & _UNMOVED:
            return skipped(name, what, "the reading does not move: see above")
        remedy = "the reading does not move: run polarity and staircase"
        return fault(name, what, f"only {len(values)} codes were seen", remedy=remedy)
    reach = f"bits {exercised[0]} to {exercised[-1]} change"
    return passed(name, what, f"{reach}, {len(values)} codes from {min(values)} to {max(values)}", "no bit stuck")
