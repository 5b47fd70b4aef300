"""A line full of commands: every frame is answered or counted, no state is lost, STOP acts."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

from gateway.selftest.bench import CUT, Bench
from gateway.selftest.verdict import Verdict, fault, judge, passed
from gateway.selftest.wire import Wire
from protocol.wire.codec import encode_body
from protocol.wire.decoder import State, StreamDecoder
from protocol.wire.framing import encode_frame
from protocol.wire.messages import RESETS, EventCode, Message

_DRAIN_S = 0.3
_BEFORE_STOP_S = 0.2
_AFTER_STOP_S = 0.3
OVERRUN_REMEDY = "the loop is too slow for its T_s: shorten it, or take a faster part"
_BITS_PER_BYTE = 10  # 8N1
_AHEAD_S = 0.01  # so much may wait in this computer: a STOP stands behind it
_STOP_ID = 255
_RESTART = 1000


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
        remedy = "the board fails under the load: look at its supply and its watchdog"
        yield fault("unexpected-reset", "restarts in a full line", str(flood.restarts), bound="0", remedy=remedy)
        return
    counted = after.int("bad_frames") - before.int("bad_frames")
    yield judge(
        "unaccounted", f"PINGs neither answered nor counted, of {flood.pings}:",
        flood.pings - flood.answers - counted, "", good=(0, 0), possible=(-2, flood.pings // 500),
        remedy="the board drops frames without counting them, or the line loses them",
    )  # fmt: skip
    if counted and not flood.overload:
        yield fault("overload", "event OVERLOAD", f"missing, {counted} dropped", remedy="the firmware must send it")
    else:
        yield passed("overload", "answered and dropped", f"{flood.answers} and {counted}", "dropped with its event")
    yield judge(
        "load-states", f"states lost meanwhile, of {len(flood.states) + flood.lost_states}:", flood.lost_states, "",
        good=(0, 0), possible=(0, len(flood.states) // 1000),
        remedy="if link loses none, answers delay states (rule 5)",
    )  # fmt: skip
    yield judge(
        "overruns", "ticks longer than T_s", after.int("overruns") - before.int("overruns"), "", good=(0, 0),
        remedy=OVERRUN_REMEDY,
    )  # fmt: skip
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
        return fault("stop", "i_c after STOP in a full line", f"{last_a:.3g} A", bound="off", remedy=CUT)
    if off_s is None:
        return fault("stop-in-load", "u_c after STOP in a full line", "not 0", remedy="STOP overtakes all (rule 13)")
    if not on or any(state.u_c == 0 for at_s, state in flood.states if at_s <= stop_s):
        return fault("stop-in-load", "u_c in a full line", "0 before STOP", remedy="see staircase and safety")
    return judge(
        "stop-in-load", "STOP in a full line: u_c is 0 after", 1e3 * (off_s - stop_s), "ms",
        good=(0.0, 60.0), possible=(0.0, 1e3 * _AFTER_STOP_S), remedy="STOP must overtake what waits (rule 13)",
    )  # fmt: skip


class Flood:
    """Counts the commands sent on a line of `baud` bit/s, and the answers.

    It bypasses the session, whose command ids its own would repeat.  Begin a new session afterwards: the board then
    forgets the ids.
    """

    def __init__(self, wire: Wire, baud: int) -> None:
        self.states: list[tuple[float, State]] = []  # arrival, s
        self.pings = self.answers = self.restarts = 0
        self.overload = False
        self.stop_s: float | None = None  # when the last byte of STOP was written
        self._wire = wire
        self._bytes_per_s = baud / _BITS_PER_BYTE
        self._decoder = StreamDecoder()
        self._rest = b""
        self._stop = False

    def run(self, duration_s: float, *, stop_at_s: float | None = None) -> None:
        """Send PINGs as fast as the line takes them; a STOP among them at `stop_at_s`."""
        started_s, written = self._wire.now_s(), 0
        while (elapsed_s := self._wire.now_s() - started_s) < duration_s or self._rest:
            room = int((elapsed_s + _AHEAD_S) * self._bytes_per_s) - written
            while room > 0 and (self._rest or elapsed_s < duration_s):
                if not self._rest:
                    self._rest = self._next(stop=stop_at_s is not None and elapsed_s >= stop_at_s)
                accepted = self._wire.write(self._rest)
                if not accepted:
                    break
                self._rest, written, room = self._rest[accepted:], written + accepted, room - accepted
                if self._stop and not self._rest and self.stop_s is None:
                    self.stop_s = self._wire.now_s()
            self._read(1e-3)

    def drain(self, duration_s: float) -> None:
        """Read what still comes."""
        end_s = self._wire.now_s() + duration_s
        while (left_s := end_s - self._wire.now_s()) > 0.0:
            self._read(left_s)

    @property
    def lost_states(self) -> int:
        """The number of ticks without a state."""
        steps = ((b.sequence - a.sequence) & 0xFFFF for (_, a), (_, b) in pairwise(self.states))
        return sum(step - 1 for step in steps if step < _RESTART)  # a restart is found by the next handshake

    def _next(self, *, stop: bool) -> bytes:
        if stop and not self._stop:
            self._stop = True
            return encode_frame(encode_body("STOP", id=_STOP_ID))
        self.pings += 1
        return encode_frame(encode_body("PING", id=self.pings % (_STOP_ID - 1) + 1))

    def _read(self, timeout_s: float) -> None:
        if not self._wire.wait(timeout_s):
            return
        now_s = self._wire.now_s()
        for item in self._decoder.feed(self._wire.read() or b""):
            if isinstance(item, State):
                self.states.append((now_s, item))
            elif isinstance(item, Message) and item.name == "EVENT":
                self.overload |= item.int("code") == EventCode.OVERLOAD
                self.restarts += item.int("code") in RESETS
            elif isinstance(item, Message):
                self.answers += item.name == "PONG" or (item.name == "NACK" and item.int("id") != _STOP_ID)
