"""Commands between bus and board, on times that the test makes."""

from __future__ import annotations

from typing import Any

from gateway.access.authorize import Sender
from gateway.access.roles import Role
from gateway.board.scaling import scaling_of
from gateway.config import LimitsConfig
from gateway.link.command_handler import CommandHandler
from gateway.link.from_board import Known
from protocol.bus import board51_pb2 as pb
from protocol.wire.decoder import StreamDecoder
from protocol.wire.events import Answer, Opened
from protocol.wire.messages import ROW_OF_NAME, Message
from protocol.wire.session import Session
from tests.harness.gateway.gateway_peers import Collector, frame, identity_values
from tests.harness.protocol.port import take_output

S = 1_000_000_000
START_NS = 1_700_000_000 * S


class Rig:
    """A command handler, its session, and a board that the test plays."""

    def __init__(self, **limits: Any) -> None:
        self.now_s = 100.0
        self.sink, self.known = Collector(), Known()
        self.session = Session(choose_session=lambda: 7)
        options = {"commands_per_s": 1000.0, **limits}
        self.handler = CommandHandler(LimitsConfig(**options), self.session, self.known, self.sink, lambda *_: None)
        self.wire: list[Message] = []
        self.ends: list[Answer] = []
        self.tick = 5000
        self.stepped_s = 0.0  # the wall clock
        self.answering = True
        self.session.connect(self.now_s)
        self.session.poll(self.now_s)
        (hello,) = StreamDecoder().feed(take_output(self.session))
        assert isinstance(hello, Message)
        (opened,) = self.session.feed(
            frame("IDENTITY", id=hello.int("id"), tick=self.tick, **identity_values()), self.now_s
        )
        assert isinstance(opened, Opened)
        scaling = scaling_of(opened.identity)
        assert not isinstance(scaling, str), scaling
        self.known.identity, self.known.scaling = opened.identity, scaling

    @property
    def now_ns(self) -> int:
        return START_NS + round((self.now_s + self.stepped_s) * S)

    @property
    def records(self) -> list[pb.CommandRecord]:
        return self.sink.messages["command/record"]

    def request(self, payload: bytes, *, role: Role | None = None, link: str = "streaming") -> list[pb.CommandReply]:
        """The replies so far to a query; the board has had its say."""
        replies: list[pb.CommandReply] = []
        sender = Sender(name="ben", role=role, arrived_ns=self.now_ns, arrived_s=self.now_s, started_ns=START_NS)
        self.handler.take(payload, replies.append, self.now_s, self.now_ns, link=link, reason="", sender=sender)
        self.settle()
        return replies

    def command(self, **fields: Any) -> pb.CommandReply:
        (reply,) = self.request(pb.Command(**fields).SerializeToString())
        return reply

    def settle(self) -> None:
        """Answer what the handler sends until there is nothing more to say."""
        while True:
            for event in self.session.take_outcomes():
                assert isinstance(event, Answer)
                self.handler.answered(event, self.now_ns)
            messages = [m for m in StreamDecoder().feed(take_output(self.session)) if isinstance(m, Message)]
            self.wire += messages
            if not messages or not self.answering:
                return
            for message in messages:
                self.tick += 1
                for event in self.session.feed(self._answer(message), self.now_s):
                    if isinstance(event, Answer):
                        self.handler.answered(event, self.now_ns)

    def _answer(self, message: Message) -> bytes:
        number = message.int("id")
        if message.name == "PING":
            return frame("PONG", id=number, tick=self.tick, bad_frames=0, overruns=0)
        return frame("ACK", id=number, command=ROW_OF_NAME[message.name].type, tick=self.tick)

    def wait(self, seconds: float) -> None:
        """Let time pass in steps that a poll would make."""
        end_s = self.now_s + seconds
        while self.now_s < end_s:
            self.now_s = min(end_s, max(self.now_s + 0.01, min(self.session.deadline_s, end_s)))
            for event in self.session.poll(self.now_s):
                assert isinstance(event, Answer)
                self.handler.answered(event, self.now_ns)
            self.settle()

    def sent(self, name: str) -> int:
        return [message.name for message in self.wire].count(name)


CLOSED = pb.SetMode(mode=pb.MODE_CLOSED_LOOP)
