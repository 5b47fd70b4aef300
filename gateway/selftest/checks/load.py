"""A line full of commands: every frame is answered or counted, no state is lost, STOP acts."""

from __future__ import annotations

from collections.abc import Iterator

from gateway.selftest.bench import Bench
from gateway.selftest.flood import Flood
from gateway.selftest.verdict import Verdict, fault, judge, passed

_DRAIN_S = 0.3
_BEFORE_STOP_S = 0.2
_AFTER_STOP_S = 0.3
OVERRUN_REMEDY = "the loop is too slow for its T_s: shorten it, or take a faster part"
_CUT = "CUT THE SUPPLY OF THE COIL, then look at driver and input converter"


def load(bench: Bench) -> Iterator[Verdict]:
    """Fill the line to the board, with the coil on the second time, and send STOP into it."""
    line = bench.line
    before = line.order("PING")
    flood = Flood(line.wire, bench.baud)
    bench.progress("a line full of PINGs", 0.0)
    flood.run(0.5 if bench.quick else 3.0)
    flood.drain(_DRAIN_S)
    line.open()
    after = line.order("PING")
    if flood.restarts:
        remedy = "the board does not bear the load: look at its supply and its watchdog"
        yield fault("unexpected-reset", "restarts in a full line", str(flood.restarts), bound="0", remedy=remedy)
        return
    counted = after.int("bad_frames") - before.int("bad_frames")
    yield judge(
        "unaccounted",
        f"PINGs neither answered nor counted, of {flood.pings}:",
        flood.pings - flood.answers - counted,
        "",
        good=(0, 0),
        possible=(-2, flood.pings // 500),
        remedy="the board drops frames without counting them, or the line loses them",
    )
    if counted and not flood.overload:
        yield fault("overload", "event OVERLOAD", f"missing, {counted} dropped", remedy="the firmware must send it")
    else:
        yield passed("overload", "answered and dropped", f"{flood.answers} and {counted}", "dropped with its event")
    yield judge(
        "load-states",
        f"states lost meanwhile, of {len(flood.states) + flood.lost_states}:",
        flood.lost_states,
        "",
        good=(0, 0),
        possible=(0, len(flood.states) // 1000),
        remedy="if link loses none, answers delay states (rule 5)",
    )
    yield judge(
        "overruns",
        "ticks longer than T_s",
        after.int("overruns") - before.int("overruns"),
        "",
        good=(0, 0),
        remedy=OVERRUN_REMEDY,
    )
    yield _stop_in_flood(bench)


def _stop_in_flood(bench: Bench) -> Verdict:
    u_v = 0.3 * bench.rig.rest_input_v
    bench.open_loop()
    on = bool(bench.level(u_v, 0.05))
    flood = Flood(bench.line.wire, bench.baud)
    flood.run(_BEFORE_STOP_S + _AFTER_STOP_S, stop_at_s=_BEFORE_STOP_S)
    flood.drain(_DRAIN_S)
    bench.line.open()
    stop_s = flood.stop_s or 0.0
    off_s = next((at_s for at_s, state in flood.states if at_s > stop_s and state.u_c == 0), None)
    last_a = bench.scaling.i_a(flood.states[-1][1].i_c) if flood.states else 0.0
    if off_s is not None and last_a > bench.rig.no_current_a:
        return fault("stop", "i_c after STOP in a full line", f"{last_a:.3g} A", bound="off", remedy=_CUT)
    if off_s is None:
        return fault("stop-in-load", "u_c after STOP in a full line", "not 0", remedy="STOP overtakes all (rule 13)")
    if not on or any(state.u_c == 0 for at_s, state in flood.states if at_s <= stop_s):
        return fault("stop-in-load", "u_c in a full line", "0 before STOP", remedy="see staircase and safety")
    return judge(
        "stop-in-load",
        "STOP in a full line: u_c is 0 after",
        1e3 * (off_s - stop_s),
        "ms",
        good=(0.0, 60.0),
        possible=(0.0, 1e3 * _AFTER_STOP_S),
        remedy="STOP must overtake what waits (rule 13)",
    )
