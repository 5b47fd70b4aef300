"""Rule 3 under a line that repeats, delays and damages: what a host asked for once happens at most once."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from gateway.emulator.firmware_model.flash import LIMITS
from gateway.emulator.native.build import compiler
from protocol.wire.decoder import State, StreamDecoder
from protocol.wire.messages import Message, Reason
from tests.harness.gateway.board_host import FIRMWARES, Bench, Host, frame
from tests.harness.protocol.port import take_output

each_firmware = pytest.mark.usefixtures("each_firmware")

# A capture is a command that shows how often it was executed: each one gives one CAPTURE_DONE.
CAPTURE = {"u_from": 0, "u_to": 1, "pre": 0, "count": 1}


class RetryingHost(RuleBasedStateMachine):
    """A host with one command outstanding, on a line that loses and doubles frames."""

    board = Host

    def __init__(self) -> None:
        super().__init__()
        self.host = self.board()
        self.id = 1
        self.delivered = 0  # distinct commands that reached the board at least once
        self.outstanding: bytes | None = None
        self.reached = False

    @rule()
    def begin(self) -> None:
        """A new command, once the last one is answered or given up."""
        self.id = self.id % 255 + 1
        self.outstanding = frame("CAPTURE", id=self.id, **CAPTURE)
        self.reached = False
        self.host.run(15)  # so that a capture in progress never is the reason for a refusal

    @rule(times=st.integers(1, 4), gap=st.integers(0, 3))
    def deliver(self, times: int, gap: int) -> None:
        """The frame arrives, perhaps several times."""
        if self.outstanding is None:
            return
        for _ in range(times):
            self.host.firmware.feed(self.outstanding)
            self.host.run(gap, alive=False)
        self.delivered += not self.reached
        self.reached = True

    @rule(at=st.integers(0, 14), bit=st.integers(0, 7))
    def deliver_damaged(self, at: int, bit: int) -> None:
        """The frame arrives with one bit flipped: never executed.

        A damaged delimiter at its end may leave the CRC right and the length wrong; that NACK must not be kept, or the
        repetition of the command would get it too.
        """
        if self.outstanding is None:
            return
        damaged = bytearray(self.outstanding)
        damaged[at] ^= 1 << bit
        self.host.firmware.feed(bytes(damaged) + b"\x00")

    @rule()
    def repeat_hello(self) -> None:
        """The same session: ids stay."""
        self.host.firmware.feed(frame("HELLO", id=self.host.next_id(), session=1, version_min=1, version_max=1))

    @invariant()
    def executed_once(self) -> None:
        """Check that captures are as many as distinct commands, and that the same command gets the same answer."""
        self.host.run(15, alive=False)
        executions = sum(event.int("code") == 10 for event in self.host.events)
        assert executions == self.delivered
        answers = [a for a in self.host.answers if a.name != "IDENTITY" and a.int("id") == self.id]
        answers = [a for a in answers if not (a.name == "NACK" and a.int("reason") == Reason.BAD_LENGTH)]
        assert len({(a.name, *a.values.values()) for a in answers}) <= 1


class HostOfC(Host):
    """A host of a board with the firmware in C."""

    make = FIRMWARES["c"]


class RetryingHostOfC(RetryingHost):
    """The same with the firmware in C."""

    board = HostOfC


RetryingHost.TestCase.settings = RetryingHostOfC.TestCase.settings = settings(
    max_examples=40, stateful_step_count=25, deadline=None
)
TestRetryingHost = RetryingHost.TestCase
TestRetryingHostOfC = pytest.mark.skipif(compiler() is None, reason="the firmware in C needs a C compiler")(
    RetryingHostOfC.TestCase
)


@each_firmware
@settings(max_examples=60, deadline=None)
@given(
    jumps=st.lists(st.integers(-300, 300), min_size=1, max_size=12),
    repeats=st.lists(st.integers(1, 3), min_size=12, max_size=12),
)
def test_repeated_references_use_up_the_allowance_once(jumps: list[int], repeats: list[int]) -> None:
    once, often = Host(), Host()

    x_ref = 2034
    for jump, times in zip(jumps, repeats, strict=False):
        x_ref = min(max(x_ref + jump, LIMITS.x_ref_min), LIMITS.x_ref_max)
        once.firmware.feed(frame("SET_REFERENCE", id=once.next_id(), x_ref=x_ref))
        repeated = frame("SET_REFERENCE", id=often.next_id(), x_ref=x_ref)
        for _ in range(times):
            often.firmware.feed(repeated)
        once.run(3, alive=False)  # a tick executes one
        often.run(3, alive=False)

    far = LIMITS.x_ref_min if x_ref >= 2034 else LIMITS.x_ref_max  # refused with the allowance as its detail
    assert once.request("SET_REFERENCE", x_ref=far) == often.request("SET_REFERENCE", x_ref=far)
    assert once.states == often.states


@each_firmware
@settings(max_examples=200, deadline=None)
@given(data=st.lists(st.binary(max_size=80), max_size=8), at=st.integers(0, 2000))
def test_no_bytes_make_the_firmware_fail_or_drive_the_coil(data: list[bytes], at: int) -> None:
    firmware = Host.make(Bench())

    for piece in data:
        firmware.feed(piece, into_tick_us=at)
        firmware.tick()

    received = StreamDecoder().feed(take_output(firmware))
    assert all(event.u_c == 0 for event in received if isinstance(event, State))
    assert all(isinstance(event, State | Message) for event in received)


@each_firmware
@settings(max_examples=50, deadline=None)
@given(cuts=st.lists(st.integers(0, 40), max_size=6))
def test_chunks_of_a_command_do_not_matter(cuts: list[int]) -> None:
    data = frame("SET_MODE", id=9, mode=1) + frame("SET_STREAM", id=10, divider=2)
    edges = [0, *sorted(cut for cut in cuts if cut < len(data)), len(data)]
    host, whole = Host(), Host()

    for a, b in pairwise(edges):
        host.firmware.feed(data[a:b])
    whole.firmware.feed(data)
    host.run(3)
    whole.run(3)

    assert host.answers == whole.answers
    assert host.states == whole.states
