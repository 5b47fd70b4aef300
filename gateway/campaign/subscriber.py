"""Subscription to one board: its newest messages, and the messages of a recording.

zenoh calls back in its own thread; other threads wait on `changed`.  A recording stays in memory (4 MB for a minute of
states) until it is checked, so that only usable recordings are written.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import NamedTuple

import zenoh

from gateway.client.rig import Rig
from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.bus.encoding import parse, stamp_ns

Logged = tuple[str, bytes, int]  # key, serialised message and log time, ns
ID_PREFIX = "campaign-"  # of the ids of a campaign's own commands
RECENT = 100  # states for the reading at rest
_RECORDED = ("state", "parameters", "plant", "capture", "event", "command/record", "status")
_STANDING = ("parameters", "plant")  # sent every 5 s: a recording begins with the newest of each


class Recorded(NamedTuple):
    """A recording in memory."""

    messages: list[Logged]
    states: list[pb.State]
    captures: list[pb.CaptureRecord]
    events: list[pb.Event]
    commands: list[pb.CommandRecord]


def is_foreign(record: pb.CommandRecord) -> bool:
    """Return whether the command was accepted and is not one of the campaign."""
    return record.reply.accepted and not record.command.id.startswith(ID_PREFIX)


class BoardSubscriber:
    """Receives the messages of one board until the rig is closed; a STOP after `ordered_ns` (Unix time) ends it."""

    def __init__(self, rig: Rig, ordered_ns: int) -> None:
        self._ordered_ns = ordered_ns
        self.changed = threading.Condition()  # guards everything below
        self.status: pb.Status | None = None
        self.state: pb.State | None = None
        self.parameters: pb.Parameters | None = None
        self.card: pb.PlantCard | None = None
        self.captures = 0  # number since the start
        self.stop_sender: str | None = None  # another client that sent STOP
        self.recent: deque[pb.State] = deque(maxlen=RECENT)
        self._standing: dict[str, Logged] = {}
        self._recorded: Recorded | None = None
        self._last_message_s = time.monotonic()
        self._subscription = rig.subscribe(self._arrived)

    @property
    def newest(self) -> pb.State:
        """The newest state; only after the first one."""
        assert self.state is not None
        return self.state

    @property
    def newest_parameters(self) -> pb.Parameters:
        """The newest parameters; only after the first ones."""
        assert self.parameters is not None
        return self.parameters

    def silence_s(self) -> float:
        """Time since the last state, s; before the first state, since the start."""
        return time.monotonic() - self._last_message_s

    def begin(self) -> None:
        """Begin a recording; its first messages are the newest parameters and the newest plant card."""
        with self.changed:
            self._recorded = Recorded(list(self._standing.values()), [], [], [], [])

    def end(self) -> Recorded:
        """End the recording; returns the messages since `begin`."""
        with self.changed:
            recorded, self._recorded = self._recorded, None
        return recorded or Recorded([], [], [], [], [])

    def _arrived(self, sample: zenoh.Sample) -> None:
        key, data = str(sample.key_expr), sample.payload.to_bytes()
        address = topics.split(key)
        if address is None or address[2] not in _RECORDED:
            return
        message = parse(topics.TOPIC_OF_NAME[address[2]].message, data)
        if message is None:
            return
        with self.changed:
            # By the time in the message: that of arrival here depends on this machine.
            logged = (key, data, stamp_ns(message) or time.time_ns())
            if address[2] in _STANDING:
                self._standing[address[2]] = logged
            recorded = self._recorded
            if recorded is not None:
                recorded.messages.append(logged)
            match message:
                case pb.State():
                    self.state = message
                    self.recent.append(message)
                    self._last_message_s = time.monotonic()
                    if recorded is not None:
                        recorded.states.append(message)
                case pb.Parameters():
                    self.parameters = message
                case pb.PlantCard():
                    self.card = message
                case pb.Status():
                    first, self.status = self.status is None, message
                    # Only the first one: a later STOP may be the run's own.
                    if first and message.last_stop_ns > self._ordered_ns and self.stop_sender is None:
                        self.stop_sender = "somebody"
                case pb.CaptureRecord():
                    self.captures += 1
                    if recorded is not None:
                        recorded.captures.append(message)
                case pb.Event() if recorded is not None:
                    recorded.events.append(message)
                case pb.CommandRecord():
                    if is_foreign(message) and message.command.WhichOneof("what") == "stop":
                        self.stop_sender = message.command.who or "somebody"
                    if recorded is not None:
                        recorded.commands.append(message)
            self.changed.notify_all()
