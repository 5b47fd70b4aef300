"""Short pulses, each longer than the one before, until the ball has moved: up is right."""

from __future__ import annotations

from collections.abc import Iterator

from gateway.selftest.bench import Bench
from gateway.selftest.rigs import RigNumbers
from gateway.selftest.verdict import Verdict, fault, passed

_MOVED_M = 0.2e-3
_TICKS = (6, 10, 15, 20, 30, 50)
_TOP_TICKS = (10, 20)
_FLOWS = 0.2  # of the current that is due


def polarity(bench: Bench) -> Iterator[Verdict]:
    """Judge which way x goes when the coil pulls."""
    rest, rig = bench.rest(), bench.rig
    change_m = current_a = 0.0
    codes: set[int] = set()
    bench.open_loop()
    for u_v, ticks in _pulses(rig):
        samples = bench.pulse(u_v, ticks)
        codes |= {sample.state.x for sample in samples}
        change_m = max((x - rest.x_m for x in bench.positions(samples)), key=abs, default=0.0)
        current_a = max(bench.currents(samples), default=0.0) - rest.i_a
        if abs(change_m) > _MOVED_M:
            break
    bench.idle()
    due_a, bench.lift_input_v = rig.K_A * u_v, u_v
    moved = f"{1e3 * change_m:+.2f} mm by a pulse of {1e3 * ticks * bench.scaling.sample_time_s:.0f} ms"
    flows = current_a > _FLOWS * due_a
    if abs(change_m) <= _MOVED_M:
        yield _unmoved(bench, frozen=len(codes) == 1, flows=flows, current_a=current_a)
        return
    if change_m > 0.0:
        yield passed("position-polarity", "the ball rises, and x", moved, "up")
    else:
        yield fault(
            "position-polarity", "the ball rises, and x", moved, bound="up", remedy="the position sensor is inverted"
        )
    if flows:
        yield passed("current-polarity", "i_c meanwhile", f"{current_a:.3g} A", f"above {_FLOWS * due_a:.2g} A")
    else:
        yield fault(
            "current-sensor", "i_c while the coil lifts the ball", f"{current_a:.3g} A",
            bound=f"above {_FLOWS * due_a:.2g} A",
            remedy="the current sensor is unplugged or inverted, or its amplifier is dead",
        )  # fmt: skip


def _pulses(rig: RigNumbers) -> list[tuple[float, int]]:
    """Return inputs, V, and ticks: those that lift a usual ball, then the top of the input, where that is more."""
    top = _TOP_TICKS if rig.top_input_v > rig.lift_input_v else ()
    return [*((rig.lift_input_v, ticks) for ticks in _TICKS), *((rig.top_input_v, ticks) for ticks in top)]


def _unmoved(bench: Bench, *, frozen: bool, flows: bool, current_a: float) -> Verdict:
    what, value = "x in a pulse of the coil", f"does not move, i_c reaches {current_a:.3g} A"
    if frozen:
        return fault("position-frozen", what, value, remedy="x is the same to the bit: its converter is stuck or open")
    if not flows:
        raise bench.no_current()
    wires = "the coil's wires are swapped (it pushes the magnet down), " if bench.rig.magnet else ""
    return fault("no-lift", what, value, remedy=f"{wires}the ball is missing, or it sticks")
