"""The time base under lies and losses: a simulated board and line, a clock in the test's hand.

Every true STATE carries its full tick in its counts, so that a sample can be compared with what the board meant.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.wire.codec import encode_body
from protocol.wire.decoder import StreamDecoder
from protocol.wire.events import Event, Restarted, Sample
from protocol.wire.framing import encode_frame
from protocol.wire.messages import ROW_OF_NAME, EventCode, Message
from protocol.wire.session import Session
from tests.harness.protocol.port import take_output

T_S = 0.002
PING_TICKS = 60
LIE = 4095  # u_c of a state that the board never sent


def frame(name: str, /, **values: Any) -> bytes:
    return encode_frame(encode_body(name, **values))


def state(tick: int, *, u_c: int = 0) -> bytes:
    counts = {"i_c": tick & 0xFFF, "x": tick >> 12 & 0xFFF, "x_ref": tick >> 24 & 0xFFF}
    return frame("STATE", sequence=tick & 0xFFFF, u_c=u_c, flags=0, **counts)


def encoded_tick(sample: Sample) -> int:
    return sample.state.i_c | sample.state.x << 12 | sample.state.x_ref << 24


class Rig:
    """A board of the page's rules 1 to 5, as far as time goes; the line to it; the host's session, which pings."""

    def __init__(self, *, tick: int = 1000, divider: int = 1, loss: float = 0.0, chunk: int = 1, seed: int = 0) -> None:
        self.rng = random.Random(seed)
        self.tick, self.divider, self.loss, self.chunk = tick, divider, loss, chunk
        self.now_s = 100.0
        self.events: list[Event] = []
        self.states_through = 0  # STATE frames that arrived undamaged
        self.session = Session(choose_session=lambda: self.rng.randrange(1 << 16))
        self._decoder = StreamDecoder()
        self._line = b""
        self._steps = 0
        self.session.connect(self.now_s)

    def run(self, ticks: int) -> None:
        for _ in range(ticks):
            self._step()

    def send(self, data: bytes) -> None:
        """Bytes on the line to the host, spared by the losses."""
        self._line += data

    def settle(self) -> None:
        """Let everything that is still on the line arrive."""
        self.chunk = 1
        self._step()

    def samples(self) -> list[Sample]:
        return [e for e in self.events if isinstance(e, Sample) and e.state.u_c != LIE]

    def wrong(self) -> list[Sample]:
        return [sample for sample in self.samples() if sample.tick != encoded_tick(sample)]

    def restarts(self) -> list[Restarted]:
        return [e for e in self.events if isinstance(e, Restarted)]

    def accounted(self) -> int:
        session = self.session
        return session.counters.samples + sum(session.states_ignored.values())

    def _step(self) -> None:
        self._steps += 1
        if self.session.is_open and self._steps % PING_TICKS == 0:
            self.session.submit("PING", self.now_s)
        self.events += self.session.poll(self.now_s)
        commands = [m for m in self._decoder.feed(take_output(self.session)) if isinstance(m, Message)]
        if self.divider and self.tick % self.divider == 0:
            self._send(state(self.tick), is_state=True)
        for command in commands:
            self._send(self._answer(command))
        self.tick = self.tick + 1 & 0xFFFFFFFF
        self.now_s += T_S
        if self._steps % self.chunk == 0:
            self.events += self.session.feed(self._line, self.now_s)
            self._line = b""

    def _send(self, data: bytes, *, is_state: bool = False) -> None:
        if self.rng.random() >= self.loss:
            self._line += data
            self.states_through += is_state

    def _answer(self, command: Message) -> bytes:
        number = command.int("id")
        if command.name == "PING":
            return frame("PONG", id=number, tick=self.tick, bad_frames=0, overruns=0)
        assert command.name == "HELLO", command
        return frame(
            "IDENTITY", id=number, version=1, firmware_major=1, firmware_minor=0, board_id=7, tick=self.tick,
            sample_time=2000, adc_bits=12, dac_bits=12, i_offset=0.0, i_lsb=1e-3, x_offset=0.0, x_lsb=1e-6,
            u_offset=0.0, u_lsb=1e-3, capture_time=40, capture_size=2000, reset_cause=1, build=b"simulate",
        )  # fmt: skip


def lying_frame(kind: str, value: int, rig: Rig) -> bytes:
    if kind == "STATE":
        return state(value, u_c=LIE)
    if kind == "EVENT":
        codes = [*EventCode]
        return frame("EVENT", number=value & 0xFF, tick=value, code=int(codes[value % len(codes)]), detail=0)
    # An answer is heard only where it has the id of what is under way.
    rig.session.submit("PING", rig.now_s)
    pings = [m for m in StreamDecoder().feed(rig.session.output()) if isinstance(m, Message)]
    number = pings[-1].int("id") if pings else 1
    if kind == "PONG":
        return frame("PONG", id=number, tick=value, bad_frames=0, overruns=0)
    return frame("ACK", id=number, command=ROW_OF_NAME["PING"].type, tick=value)


@settings(max_examples=100, deadline=None)
@given(
    kind=st.sampled_from(["STATE", "PONG", "EVENT", "ACK"]),
    value=st.one_of(
        st.integers(0, 2**32 - 1),
        st.integers(-400, 400).map(lambda off: 2_000 + off),  # near the truth
        st.integers(1, 40_000).map(lambda n: 2_000 + 65_536 * n),  # right in the low 16 bits
    ).map(lambda v: v & 0xFFFFFFFF),
    start=st.sampled_from([0, 1000, 65_000, 2**31 - 500, 2**32 - 70_000]),
    when=st.integers(80, 300),
    loss=st.sampled_from([0.0, 0.05, 0.3]),
    chunk=st.integers(1, 12),
    divider=st.sampled_from([1, 1, 2, 7, 50]),
    known=st.booleans(),
    seed=st.integers(0, 1000),
)
def test_no_single_lying_frame_moves_the_time_base(
    kind: str, value: int, start: int, when: int, loss: float, chunk: int, divider: int, known: bool, seed: int
) -> None:
    rig = Rig(tick=start, divider=divider, chunk=chunk, seed=seed)
    rig.run(chunk * 20)  # the handshake is not what is tested
    if known:
        rig.session.unwrapper.stream(divider)
    rig.loss = loss
    rig.run(when)

    value = (value - 2_000 + rig.tick) & 0xFFFFFFFF if value < 4_000 or value % 65_536 == 2_000 else value
    rig.send(lying_frame(kind, value, rig))
    rig.run(600)
    rig.loss = 0.0
    rig.run(4 * divider)
    rig.settle()

    assert rig.wrong() == []
    assert rig.restarts() == []
    assert rig.session.unwrapper.lost <= 600 + when + 4 * divider
    # What was not published was counted, and is no more than a second's worth where the line lost the answers, too.
    assert sum(rig.session.states_ignored.values()) <= (500 / divider if loss else 0) + 20


@settings(max_examples=60, deadline=None)
@given(
    faults=st.lists(
        st.tuples(
            st.sampled_from(["reset", "jump", "noise", "double", "silence", "lie", "reconnect", "asleep", "stream"]),
            st.integers(0, 2**32 - 1),
        ),
        max_size=8,
    ),
    loss=st.sampled_from([0.0, 0.02, 0.3]),
    chunk=st.integers(1, 12),
    seed=st.integers(0, 1000),
)
def test_every_valid_state_is_a_sample_or_counted_by_its_cause(
    faults: list[tuple[str, int]], loss: float, chunk: int, seed: int
) -> None:
    rig = Rig(loss=loss, chunk=chunk, seed=seed)
    lies = 0

    for name, value in faults:
        rig.run(value % 150)
        if name == "reset":
            rig.tick = 0
            rig.send(frame("EVENT", number=0, tick=0, code=int(EventCode.RESET_WATCHDOG), detail=1))
        elif name == "jump":
            rig.tick = value
        elif name == "noise":
            rig.send(rig.rng.randbytes(value % 200) + b"\x00")
        elif name == "double":
            rig.send(state(rig.tick, u_c=LIE) + state(rig.tick, u_c=LIE))
            lies += 2
        elif name == "silence":
            rig.tick = rig.tick + value % 100_000 & 0xFFFFFFFF
            rig.now_s += value % 100_000 * T_S
        elif name == "lie":
            rig.send(b"\x00" + state(value, u_c=LIE))
            lies += 1
        elif name == "reconnect":
            rig.session.disconnect()
            rig.session.connect(rig.now_s)
        elif name == "asleep":
            rig.tick = rig.tick + value % 200_000 & 0xFFFFFFFF
        else:
            rig.divider = value % 3
    rig.run(100)
    rig.settle()
    rig.session.disconnect()

    # Noise may join or cut frames that follow it, so what the decoder took for valid is what has to be accounted for.
    assert rig.session.counters.states == rig.accounted()
    assert rig.session.counters.states <= rig.states_through + lies
    assert rig.session.counters.samples == sum(isinstance(e, Sample) for e in rig.events)


def test_restarts_cost_no_state_without_a_count() -> None:
    rig = Rig()
    for _ in range(15):
        rig.run(200)
        rig.tick = 0
    rig.run(100)
    rig.settle()
    rig.session.disconnect()

    assert len(rig.restarts()) == 15
    assert rig.wrong() == []
    assert rig.session.counters.states == rig.states_through == rig.accounted()
    assert rig.session.states_ignored["unplaced"] == 30  # the two that betray each restart


def jump_two_wraps(rig: Rig) -> None:
    rig.tick += 2 * 65_536


def sleep(rig: Rig) -> None:
    """The computer of the gateway: its monotonic clock stands while the board goes on for 270 s."""
    rig.tick += 135_000


def pause_board(rig: Rig) -> None:
    """A board that was held for exactly as long as the sequence takes to wrap, by a debugger."""
    rig.now_s += 65_536 * T_S


@pytest.mark.parametrize("upset", [jump_two_wraps, sleep, pause_board])
def test_what_sequences_cannot_show_ends_the_session_and_names_the_samples_in_doubt(
    upset: Callable[[Rig], None],
) -> None:
    rig = Rig()
    rig.run(500)

    upset(rig)
    rig.run(500)
    rig.settle()

    (restart,) = rig.restarts()
    wrong = rig.wrong()
    assert not restart.board_reset
    assert len(wrong) <= PING_TICKS + 3  # the next PONG contradicts, the one asked for at once confirms
    if wrong:
        assert restart.doubtful is not None
        first, last = restart.doubtful
        assert all(first <= sample.tick <= last for sample in wrong)
    assert rig.samples()[-1].tick == encoded_tick(rig.samples()[-1]) == rig.tick - 1


def test_an_identity_with_a_wrong_tick_publishes_no_sample() -> None:
    rig = Rig()
    rig.session.poll(rig.now_s)
    true_tick, rig.tick = rig.tick, 40_000
    rig.run(1)
    rig.tick = true_tick + 1

    rig.run(200)
    rig.settle()

    assert rig.wrong() == []
    assert len(rig.samples()) > 150
