"""The table of all topics of the bus: message type, publisher, rate, and whether it is logged.

A key is `<site>/<board>/<topic>`, without a leading slash.  The same key is the topic of the MCAP channel.
All processes and documents take keys, types and rates from this table.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

from google.protobuf.message import Message

from protocol.bus import board51_pb2 as pb
from protocol.errors import ConfigError

DEFAULT_SITE = "board51"
_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,31}")  # no wildcards, no slashes: it becomes a key chunk and a file name


@dataclass(frozen=True, slots=True, kw_only=True)
class Topic:
    """A row of the table.

    `source` is the publisher, or the client that sends queries.  `rate` is text for the documentation.
    `bus` and `logged` say where messages go.
    """

    name: str
    message: type[Message]
    rate: str
    description: str
    source: Literal["gateway", "twin", "client"] = "gateway"
    bus: bool = True
    logged: bool = True


TOPICS: tuple[Topic, ...] = (
    Topic(name="state", message=pb.State, rate="every tick (500 Hz)", description="one control tick in SI units"),
    Topic(name="states", message=pb.StateBatch, rate="every 20 ms (50 Hz)", logged=False,
          description="the ticks of the last 20 ms in one message"),
    Topic(name="status", message=pb.Status, rate="1 Hz", description="health of link, bus and log"),
    Topic(name="event", message=pb.Event, rate="on event", description="faults, resets, limits hit, link changes"),
    Topic(name="alarms", message=pb.Alarms, rate="on change, and every 5 s",
          description="conditions that the gateway detects, and acknowledgements of alarms"),
    Topic(name="parameters", message=pb.Parameters, rate="on change, and every 5 s",
          description="identity, gains, operating point, limits, scalings"),
    Topic(name="plant", message=pb.PlantCard, rate="on change, and every 5 s",
          description="the rig's ball, travel, x_max and gravity, and who stated them"),
    Topic(name="capture", message=pb.CaptureRecord, rate="on request", description="25 kHz burst of i_c around a step"),
    Topic(name="command", message=pb.Command, source="client", rate="query", logged=False,
          description="queryable: one Command in, one CommandReply out"),
    Topic(name="command/record", message=pb.CommandRecord, rate="on command",
          description="who, when, what, result of each command"),
    Topic(name="raw", message=pb.RawBytes, rate="each read and write", bus=False,
          description="bytes of the UART, both ways"),
    Topic(name="twin/state", message=pb.TwinState, source="twin", rate="every tick",
          description="the free-running closed-loop twin"),
    Topic(name="twin/divergence", message=pb.Divergence, source="twin", rate="every tick",
          description="measured against twin, and one-step innovations"),
    Topic(name="twin/states", message=pb.TwinBatch, source="twin", rate="every 20 ms (50 Hz)", logged=False,
          description="twin/state and twin/divergence of the last 20 ms in one message"),
    Topic(name="twin/alarm", message=pb.Alarm, source="twin", rate="on change",
          description="divergence alarms with hysteresis"),
    Topic(name="twin/alarms", message=pb.TwinAlarms, source="twin", rate="every 5 s",
          description="all active alarms of the twin, for late subscribers"),
    Topic(name="twin/model", message=pb.TwinModel, source="twin", rate="on change, and every 5 s",
          description="the model the twin runs on, since when, from whom"),
    Topic(name="twin/diagnosis", message=pb.TwinDiagnosis, source="twin", rate="on change, and every 5 s",
          description="the cause by which a rig in flight may differ from the twin's model"),
    Topic(name="twin/command", message=pb.TwinCommand, source="client", rate="query", logged=False,
          description="queryable: one TwinCommand in, one CommandReply per board out"),
)  # fmt: skip
TOPIC_OF_NAME = {topic.name: topic for topic in TOPICS}
RECEIVED = tuple(topic.name for topic in TOPICS if topic.bus and topic.source != "client")  # by a client
RECORDED = tuple(topic.name for topic in TOPICS if topic.bus and topic.logged)  # from the bus

AS = "as"
ALIVE = "alive"  # liveliness token <site>/<board>/alive, held while the gateway serves the board
TWIN_ALIVE = "twin/alive"  # liveliness token <site>/<board>/twin/alive/<name of a process>, held by a twin
# Queryable <site>/_logs/<server> over the log of a site: LogRequest in, LogReply out.  No board has this name.
LOGS = "_logs"
EVERY_BOARD = "_every"  # in place of the board, in the token of a twin of all boards; not a board's name


def check_name(name: str, *, what: str) -> str:
    """Return `name` if it may be a chunk of a key, else raise ConfigError naming `what`."""
    if not _NAME.fullmatch(name):
        raise ConfigError(
            f"{what} {name!r} is not a name",
            remedy="Use 1 to 32 lower-case letters, digits, - or _, starting with a letter or digit",
        )
    return name


def key(site: str, board: str, topic: str) -> str:
    """Return the key `<site>/<board>/<topic>`; the topic must be in the table (or be the liveliness token)."""
    if topic != ALIVE and topic not in TOPIC_OF_NAME:
        raise ValueError(f"{topic!r} is not a topic of the table")
    return f"{site}/{board}/{topic}"


def command_key(site: str, board: str, *, role: str = "", who: str = "", topic: str = "command") -> str:
    """Return the key of a command; on a guarded bus it contains the sender's role and name.

    On a guarded bus the key is `<site>/<board>/command/as/<role>/<who>`.  The router enforces that a client uses only
    its own name, which it could not do with a field of the message.  Without a role the key is
    `<site>/<board>/command`, served on an unguarded bus only.
    """
    plain = key(site, board, topic)
    return f"{plain}/{AS}/{role}/{check_name(who, what='who')}" if role else plain


def sender(full: str) -> tuple[str, str] | None:
    """Return (role, who) of a key made by `command_key`, or None if the key contains neither."""
    _, separator, rest = full.partition(f"/{AS}/")
    role, _, who = rest.partition("/")
    return (role, who) if separator and _NAME.fullmatch(role) and _NAME.fullmatch(who) else None


def split(full: str) -> tuple[str, str, str] | None:
    """Return (site, board, topic) of a key, or None if it is not a Board51 key."""
    site, _, rest = full.partition("/")
    board, _, topic = rest.partition("/")
    before, separator, _ = topic.partition(f"/{AS}/")
    if separator and before in TOPIC_OF_NAME and TOPIC_OF_NAME[before].source == "client":
        topic = before
    return (site, board, topic) if site and board and topic in TOPIC_OF_NAME else None
