"""A gateway's driver and a board's firmware, with a line between them that loses frames.  Time is made by ticks alone.

`BoardEnd` stands between line and board and keeps the board's word: which numbered command it says it has executed, at
which ticks.  A repeated answer has the tick of the first, a second execution would have another one.
"""

from __future__ import annotations

import random
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

from google.protobuf.message import Message as ProtoMessage

from gateway.access.authorize import Sender
from gateway.config import BoardConfig, LimitsConfig
from gateway.emulator.firmware_model.board import Firmware
from gateway.emulator.native.board import NativeFirmware
from gateway.link.clock import HostClock
from gateway.link.driver import BoardDriver
from protocol.bus import board51_pb2 as pb
from protocol.wire.decoder import StreamDecoder
from protocol.wire.messages import COUNTS_MAX, ROW_OF_NAME, Message
from tests.harness.gateway.board_host import Bench

TICK_NS = 2_000_000
_START_NS = 1_700_000_000_000_000_000
_GAINS = ROW_OF_NAME["SET_GAINS"].type


@dataclass(slots=True)
class Wire:
    """A direction of the line: a frame is lost with `loss`; in a stall frames wait and then come all at once.

    `loss` is a probability per frame, `stall` one per tick; the longest stall lasts `stall_ticks`.
    """

    random: random.Random
    loss: float
    stall: float
    stall_ticks: int
    carried: int = 0
    lost: int = 0
    spoil: Callable[[bytes], bytes] = bytes  # of what arrives
    _waiting: deque[bytes] = field(default_factory=deque)
    _stalled: int = 0

    def put(self, data: bytes) -> None:
        """Take one frame, or a part of one."""
        self.carried += 1
        if self.random.random() < self.loss:
            self.lost += 1
        else:
            self._waiting.append(data)

    def tick(self) -> Iterator[bytes]:
        """Yield what arrives in this tick."""
        self._stalled -= self._stalled > 0
        if not self._stalled and self.random.random() < self.stall:
            self._stalled = self.random.randrange(1, self.stall_ticks)
        while self._waiting and not self._stalled:
            yield self.spoil(self._waiting.popleft())


class BoardEnd:
    """The board, and what it says it has executed."""

    def __init__(self, board: Firmware | NativeFirmware) -> None:
        self.board = board
        self.executed: dict[int, set[int]] = defaultdict(set)  # number of the command -> ticks of its ACKs
        self.stops: set[int] = set()  # ticks
        self._to_board, self._from_board = StreamDecoder(), StreamDecoder()
        self._number_of_id: dict[int, int] = {}

    def feed(self, data: bytes) -> None:
        for message in self._to_board.feed(data):
            if isinstance(message, Message) and message.name == "SET_GAINS":
                number = message.int("i_0") + (COUNTS_MAX + 1) * message.int("x_0")
                self._number_of_id[message.int("id")] = number
        self.board.feed(data)

    def tick(self) -> Iterator[bytes]:
        self.board.tick()
        while data := self.board.take_frame():
            for message in self._from_board.feed(data):
                if isinstance(message, Message) and message.name == "ACK":
                    if message.int("command") == _GAINS:
                        self.executed[self._number_of_id[message.int("id")]].add(message.int("tick"))
                    elif message.int("command") == ROW_OF_NAME["STOP"].type:
                        self.stops.add(message.int("tick"))
            yield data


class Nobody:
    """A sink that keeps nothing: a hundred thousand commands and their bytes would be."""

    def states(self, payloads: Sequence[bytes], host_time_ns: int, read_mono_ns: int) -> None: ...
    def send(self, topic: str, message: ProtoMessage, host_time_ns: int) -> None: ...
    def raw(self, data: bytes, host_time_ns: int, *, to_board: bool) -> None: ...
    def alive(self, *, alive: bool) -> None: ...


class LossyRig:
    """Driver, line and board.

    Args:
        board: The firmware.
        seed: Of the line.
        loss: Probability per frame, each way.
        stall: Probability per tick, each way, that the line stands.
        stall_ticks: Longest stall.
        divider: Of the states; few by default, they are not what is tried with commands.
    """

    limits: ClassVar = LimitsConfig(commands_per_s=1000.0)

    def __init__(
        self, board: type[Firmware] | type[NativeFirmware], *, seed: int, loss: float, stall: float = 0.0,
        stall_ticks: int = 750, divider: int = 50,
    ) -> None:  # fmt: skip
        self.tick_count = 0
        self.end = BoardEnd(board(Bench()))
        self.to_board, self.from_board = (
            Wire(random.Random(seed + n), loss, stall, stall_ticks) for n in range(2)
        )  # fmt: skip
        # The shortest time-out that the configuration takes: the least ticks for a command.
        config = BoardConfig(
            name="rig", port="none", stream_divider=divider, command_timeout_s=0.02, limits=self.limits
        )  # fmt: skip
        clock = HostClock(lambda: _START_NS + self.now_ns, lambda: self.now_ns)
        self.driver = BoardDriver(config, Nobody(), clock)
        self.driver.port_opened("none", self.now_s)

    @property
    def now_ns(self) -> int:
        return self.tick_count * TICK_NS

    @property
    def now_s(self) -> float:
        return self.now_ns * 1e-9

    def run(self, ticks: int = 1) -> None:
        """Let time pass."""
        for _ in range(ticks):
            self.tick_count += 1
            for data in self.to_board.tick():
                self.end.feed(data)
            for data in self.end.tick():
                self.from_board.put(data)
            for data in self.from_board.tick():
                self.driver.received(data, self.now_ns)
            if self.driver.deadline_s <= self.now_s:
                self.driver.poll(self.now_s)
            while data := self.driver.output():
                self.driver.wrote(len(data))
                self.to_board.put(data)

    def send(self, command: pb.Command, replies: list[pb.CommandReply]) -> None:
        """Send a command, as from the bus; its reply is added to `replies`."""
        self.send_bytes(command.SerializeToString(), replies)

    def send_bytes(self, payload: bytes, replies: list[pb.CommandReply]) -> None:
        """Send what may be no command."""
        sender = Sender(
            name="", role=None, arrived_ns=_START_NS + self.now_ns, arrived_s=self.now_ns * 1e-9, started_ns=0
        )
        self.driver.command(payload, replies.append, self.now_s, sender)

    def gains(self, number: int) -> pb.Command:
        """A command that the board's end knows by its number: the operating point has it."""
        scaling = self.driver.known.scaling
        assert scaling is not None
        high, low = divmod(number, COUNTS_MAX + 1)
        gains = pb.SetGains(gains=[0.0] * 4, i_0_a=scaling.i_a(low), x_0_m=scaling.x_m(high), u_0_v=scaling.u_v(0))
        return pb.Command(id=f"n{number}", issued_ns=_START_NS + self.now_ns, set_gains=gains)


@dataclass(slots=True)
class Account:
    """The fate of numbered commands."""

    executed: Counter[str] = field(default_factory=Counter)  # by the outcome that the caller was told
    outcomes: Counter[str] = field(default_factory=Counter)  # outcomes
    twice: list[int] = field(default_factory=list)
    false_acks: list[int] = field(default_factory=list)  # acknowledged, not executed
    false_refusals: list[int] = field(default_factory=list)  # "it has not acted", and it had
    wrong_ticks: list[int] = field(default_factory=list)  # acknowledged with a tick that is not the board's
    contradictions: list[int] = field(default_factory=list)  # two kept answers to one id


def send_all(rig: LossyRig, count: int, *, seed: int, at_once: int = 4, stops: float = 5e-4) -> Account:
    """Send `count` commands, `at_once` under way at a time, and some of them again; in between STOPs, with a
    probability of `stops` per tick.

    A STOP gives up what was issued before it, and its reply says so.
    """
    draw, replies = random.Random(seed), [list[pb.CommandReply]() for _ in range(count)]
    open_ones: list[tuple[int, pb.Command]] = []
    stop_replies: list[pb.CommandReply] = []
    sent = 0
    while sent < count or any(not replies[n] for n, _ in open_ones):
        if rig.driver.link == "streaming":
            if sent < count and sum(not replies[n] for n, _ in open_ones) < at_once:
                command = rig.gains(sent)
                rig.send(command, replies[sent])
                open_ones = [*open_ones[-16:], (sent, command)]
                sent += 1
            if draw.random() < 0.05:  # the caller has lost patience, or the reply: the same again
                number, command = draw.choice(open_ones)
                rig.send(command, replies[number])
            if draw.random() < stops:
                rig.send(pb.Command(id=f"s{rig.tick_count}", stop=pb.Stop()), stop_replies)
        rig.run()
    rig.run(1500)  # what a stalled line still holds
    assert all(reply.tick in rig.end.stops for reply in stop_replies if reply.accepted)
    return account_of(rig.end, replies)


def account_of(end: BoardEnd, replies: list[list[pb.CommandReply]]) -> Account:
    """Compare what callers were told with what the board did."""
    account = Account()
    for number, answers in enumerate(replies):
        # A reply that is not kept says that nothing has happened and the same id may come again: the last one counts.
        repeatable = [answer for answer in answers if answer.repeat_until_ns]
        ticks, reply = end.executed.get(number, set()), repeatable[0] if repeatable else answers[-1]
        outcome = "acknowledged" if reply.accepted else f"{reply.refused_by}: {reply.reason}"
        if reply.reason == "timed-out":
            outcome += ", not sent" if not reply.attempts else ", unknown"
        account.outcomes[outcome] += 1
        account.executed[outcome] += bool(ticks)
        may_act = reply.accepted or (reply.refused_by == "link" and (reply.reason != "timed-out" or reply.attempts))
        if len(ticks) > 1:
            account.twice.append(number)
        if reply.accepted and not ticks:
            account.false_acks.append(number)
        elif reply.accepted and reply.tick not in ticks:
            account.wrong_ticks.append(number)
        if ticks and not may_act:
            account.false_refusals.append(number)
        if any(again.accepted != reply.accepted for again in repeatable):
            account.contradictions.append(number)
    return account
