"""Events, alarms and refused commands as lines of Foxglove's Log panel.  Pure."""

from __future__ import annotations

from foxglove.messages import Log, LogLevel, Timestamp
from google.protobuf.message import Message

from protocol.bus import board51_pb2 as pb

_LEVELS = {"info": LogLevel.Info, "warning": LogLevel.Warning, "fault": LogLevel.Error}
_LATEST_S = (1 << 32) - 1  # of Foxglove's messages: February 2106


def timestamp_of(time_ns: int) -> Timestamp:
    """Return a Unix time as Foxglove's; one that it cannot express, which no clock of a rig gives, as its latest."""
    return Timestamp(min(time_ns // 10**9, _LATEST_S), time_ns % 10**9)


def line_of(message: Message, time_ns: int) -> Log | None:
    """Return the line of a message, None if it has none.

    What repeats itself has none (`alarms`, `twin/alarms`): an event or `twin/alarm` says it once.

    Args:
        message: Of any topic.
        time_ns: When it was logged, Unix time.
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
