"""The converters with u_c = 0 and the ball at rest at the bottom."""

from __future__ import annotations

import math
from collections.abc import Iterator

from gateway.selftest.bench import Bench, Rest
from gateway.selftest.rigs import RigNumbers
from gateway.selftest.verdict import Verdict, fault, judge
from protocol.wire.messages import COUNTS_MAX


def converters(bench: Bench) -> Iterator[Verdict]:
    """Judge noise and offset of both readings, and whether they are alive."""
    rest, rig = bench.rest(), bench.rig
    u_v = max(bench.scaling.u_v(sample.state.u_c) for sample in rest.samples)
    yield judge(
        "input-at-zero", "u_c when 0 V is commanded", u_v, "V", good=(-0.01, 0.01),
        remedy="the input converter does not confirm its value: cut the coil's supply, look at the converter's bus",
    )  # fmt: skip
    yield from _current(rest, rig)
    yield from _position(rest, rig)


def _current(rest: Rest, rig: RigNumbers) -> Iterator[Verdict]:
    good, possible = rig.current_offset_a
    yield judge(
        "current-at-zero", "i_c at u_c = 0", 1e3 * rest.i_a, "mA",
        good=(-1e3 * good, 1e3 * good), possible=(-1e3 * possible, 1e3 * possible),
        remedy="current flows, or the current amplifier has an offset: cut the supply, measure with a meter",
    )  # fmt: skip
    good, possible = rig.current_noise_a
    yield judge(
        "current-noise", "noise of i_c, one sigma", 1e3 * rest.i_deviation_a, "mA",
        good=(0.0, 1e3 * good), possible=(0.0, 1e3 * possible),
        remedy="look at shunt, ground and the capacitor of the reference",
    )  # fmt: skip


def _position(rest: Rest, rig: RigNumbers) -> Iterator[Verdict]:
    counts = {sample.state.x for sample in rest.samples}
    if counts <= {0, COUNTS_MAX}:
        yield fault(
            "position-end", "x", f"at the {'bottom' if counts == {0} else 'top'} end of its converter",
            remedy="the position sensor is unplugged or shorted, or its magnet is upside down or missing",
        )  # fmt: skip
        return
    yield judge(
        "position-at-rest", "x of the ball at rest", 1e3 * rest.x_m, "mm", good=(-0.1, 0.1), possible=(-0.5, 0.5),
        remedy="the ball is not at the bottom, or the sensor is not calibrated (check calibration)",
    )  # fmt: skip
    good, possible = rig.position_noise_m
    yield judge(
        "position-noise", "noise of x, one sigma", 1e6 * rest.x_deviation_m, "um",
        good=(0.0, 1e6 * good), possible=(0.0, 1e6 * possible),
        remedy="look at the sensor's supply, its ground, and loose wires",
    )  # fmt: skip
    yield judge(
        "position-constant", "different codes of x at rest", len(counts), "",
        good=(2, math.inf), possible=(1, math.inf),
        remedy="the noise is less than a code, or the reading is stuck: the check `polarity` decides",
    )  # fmt: skip
