"""The topics that Foxglove's own panels need: `<site>/<board>/log` and `<site>/<board>/scene`.  Pure.

Rule: they are derived where they are shown, never recorded and never on the bus.  A recorder that wrote them would say
      each event twice, in two schemas; logs of before would have none; and a replay, beside which a live view derives
      them again, would have to leave them out.  So they are not topics of the table: readers, `recover` and `replay`
      pass over them as over any foreign topic.
"""

from __future__ import annotations

from collections.abc import Iterator

from foxglove.messages import Log, LogLevel, SceneUpdate
from google.protobuf.message import Message

from gateway.views.foxglove.scene import Scene, timestamp_of
from protocol.bus import board51_pb2 as pb

LOG, SCENE = "log", "scene"
TOPICS = ("state", "event", "plant", "command/record", "twin/state", "twin/alarm")  # what they are derived from
_LEVELS = {"info": LogLevel.Info, "warning": LogLevel.Warning, "fault": LogLevel.Error}


class Derived:
    """The derived topics of all rigs."""

    def __init__(self) -> None:
        self._scenes: dict[str, Scene] = {}

    def take(self, site: str, board: str, message: Message, time_ns: int) -> Iterator[tuple[str, Log | SceneUpdate]]:
        """Process a message and yield what follows from it: key, and message of Foxglove."""
        rig = f"{site}/{board}"
        line = line_of(message, time_ns)
        if line is not None:
            yield f"{rig}/{LOG}", line
        update = self._scenes.setdefault(rig, Scene(board)).take(message, time_ns)
        if update is not None:
            yield f"{rig}/{SCENE}", update


def line_of(message: Message, time_ns: int) -> Log | None:
    """Return the line of a message, None if it has none.

    What repeats itself has none (`alarms`, `twin/alarms`): an event or `twin/alarm` says it once.
    """
    match message:
        case pb.Event():
            level, name = _LEVELS.get(message.severity, LogLevel.Unknown), message.source
            text = f"{message.name}: {message.text}" if message.text else message.name
        case pb.Alarm():
            level, name = (LogLevel.Warning if message.active else LogLevel.Info), "twin"
            text = f"alarm {message.name} {'raised' if message.active else 'over'}: {message.text}"
        case pb.CommandRecord() if not message.reply.accepted:
            level, name, reply = LogLevel.Warning, "command", message.reply
            what = (message.command.WhichOneof("what") or "command").replace("_", "-")
            text = f"{what} by {message.command.who or '?'} refused ({reply.refused_by}, {reply.reason}): {reply.text}"
        case _:
            return None
    return Log(timestamp=timestamp_of(time_ns), level=level, name=name, message=text)
