"""A bus of a test's own: a router session that also plays the gateway, and a client session for the view."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import zenoh
from google.protobuf.message import Message

from gateway.views.feed import Feed
from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.bus.encoding import BATCH_OF, batch
from protocol.bus.endpoint import zenoh_config
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.ports import free_port
from tests.harness.repeated import repeated

JUNK = b"\xff\xff"  # no message of any kind
TOPICS = (
    "states",
    "status",
    "event",
    "alarms",
    "parameters",
    "command/record",
    "twin/states",
)  # one of each subscriber
CommandHandler = Callable[[str, pb.Command], pb.CommandReply | None]  # None: no answer yet


class PlayedGateway:
    """Publishes what a test wants of a gateway, and answers commands as the test says."""

    def __init__(self, session: zenoh.Session, endpoint: str) -> None:
        self.session, self.endpoint = session, endpoint
        self.commands: list[tuple[str, pb.Command]] = []
        self.answer: CommandHandler = lambda _, command: pb.CommandReply(id=command.id, accepted=True, tick=7)
        self.unanswered: list[zenoh.Query] = []
        self.tick = 0
        self.last = pb.State()
        self._queryable = session.declare_queryable("board51/*/command/**", self._on_query)

    def stop_answering(self) -> None:
        """Stop answering, as if the gateway had ended, but not its router."""
        self._queryable.undeclare()

    def send(self, topic: str, message: Message, board: str = "rig") -> None:
        """Send as a gateway and a twin do, ticks in a batch, too. Sending blocks, so that nothing is lost here."""
        data = message.SerializeToString()
        self.put(topic, data, board)
        if topic in BATCH_OF:
            self.put(BATCH_OF[topic], batch(topic, [data]), board)

    def put(self, topic: str, payload: bytes, board: str = "rig") -> None:
        """Whatever a test wants to send."""
        key = topics.key("board51", board, topic)
        self.session.put(key, payload, congestion_control=zenoh.CongestionControl.BLOCK)

    def state(self, board: str = "rig", **fields: object) -> None:
        """Send the state of one more tick."""
        self.tick += 1
        values: dict[str, object] = {
            "tick": self.tick, "sequence": self.tick & 0xFFFF, "session": 1, "t_s": self.tick * 2e-3,
            "host_time_ns": time.time_ns(), "i_c_a": 0.6, "x_m": 3e-3, "u_c_v": 2.1, "x_ref_m": 3e-3,
            "mode": pb.MODE_CLOSED_LOOP,
        }  # fmt: skip
        values.update(fields)
        self.last = pb.State(**values)  # type: ignore[arg-type]  # a test may send what it likes
        self.send("state", self.last, board)

    def status(self, board: str = "rig", link: str = "streaming") -> None:
        self.send("status", pb.Status(link=link, host_time_ns=time.time_ns(), log_state="writing"), board)

    def parameters(self, board: str = "rig") -> None:
        parameters = pb.Parameters(
            firmware="1.0 test", board_id=7, sample_time_s=2e-3, gains=[0.49, 1700.0, 17.7, -17600.0],
            x_ref_min_m=0.3e-3, x_ref_max_m=5.2e-3, u_min_v=0.0, u_max_v=5.0, stream_divider=1, i_lsb_a=5e-4,
            x_lsb_m=1.5e-6, u_lsb_v=1.25e-3, host_time_ns=time.time_ns(),
        )  # fmt: skip
        self.send("parameters", parameters, board)

    def _on_query(self, query: zenoh.Query) -> None:
        key = str(query.key_expr)
        command = pb.Command.FromString(query.payload.to_bytes() if query.payload is not None else b"")
        self.commands.append((key, command))
        answer = self.answer(key, command)
        if answer is None:
            self.unanswered.append(query)
            return
        with query:
            query.reply(key, answer.SerializeToString())

    def give_up(self) -> None:
        """End what is not answered without an answer."""
        while self.unanswered:
            self.unanswered.pop().drop()


@contextmanager
def played_gateway() -> Iterator[PlayedGateway]:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with zenoh.open(zenoh.Config.from_json5(zenoh_config("router", listen=[endpoint]))) as session:
        yield PlayedGateway(session, endpoint)


@contextmanager
def feed_of(gateway: PlayedGateway) -> Iterator[Feed]:
    """A feed that hears already: what a test sends once arrives."""
    config = zenoh_config("client", connect=[gateway.endpoint])
    with zenoh.open(zenoh.Config.from_json5(config)) as session:
        feed = Feed(session)
        for topic in TOPICS:
            _reach(feed, gateway, topic)
        feed.refused = 0
        yield feed
        feed.close()


def _reach(feed: Feed, gateway: PlayedGateway, topic: str) -> None:
    """Send junk, which leaves nothing behind in a feed, until it arrives: a subscription takes a moment to reach the
    router, and what is put before that is lost."""
    before = feed.refused
    for _ in range(30):
        gateway.put(topic, JUNK)
        try:
            wait_for(lambda: feed.refused > before, topic, timeout_s=1.0)
        except AssertionError:
            continue
        return
    raise AssertionError(f"the feed does not hear {topic}")


@contextmanager
def ticking(
    gateway: PlayedGateway,
    *boards: str,
    values: Callable[[int], dict[str, Any]] | None = None,
    period_s: float = 0.004,
) -> Iterator[None]:
    """The gateway publishes samples, as far as this machine keeps up, status and parameters now and then."""
    numbers = itertools.count()

    def tick() -> None:
        n = next(numbers)
        for board in boards or ("rig",):
            gateway.state(board, **(values(n) if values is not None else {}))
            if n % 50 == 0:
                gateway.status(board)
                gateway.parameters(board)

    with repeated(tick, period_s):
        yield
