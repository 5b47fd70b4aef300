"""Commands that are for people: a remark, and who has seen which alarm.  The board never hears of them.  No I/O.

Rule 1: the gateway does not know all alarms (the twin and the views judge too), so an acknowledgement is taken by name:
        it means what was active under that name when it came in, and nothing that comes later.
Rule 2: the latest of each name is kept and repeated in `alarms`, for views that start later; MAX_KEPT names, the oldest
        make room.
"""

from __future__ import annotations

from gateway.link.sink import Sink
from protocol.bus import board51_pb2 as pb

MAX_RETAINED = 64
KINDS = ("mark", "acknowledge")


class Annotations:
    """Of one board.  Written by the serial thread, read by any."""

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        self.acknowledged: tuple[pb.Acknowledgement, ...] = ()  # replaced, never changed

    def take(self, command: pb.Command, host_ns: int, *, tick: int, session: int) -> pb.CommandReply:
        """One command of KINDS, at this moment of the board."""
        who = command.who or "unknown"
        if command.WhichOneof("what") == "mark":
            name, said = "mark", command.mark.text
        else:
            name = "acknowledged"
            said = " ".join(part for part in (command.acknowledge.alarm, command.acknowledge.comment) if part)
            self._keep(command.acknowledge, who, host_ns)
        text = "".join(c if c.isprintable() else " " for c in f"{who}: {said}")
        event = pb.Event(host_time_ns=host_ns, tick=tick, session=session, source="gateway", severity="info")
        event.name, event.text = name, text
        self._sink.send("event", event, host_ns)
        return pb.CommandReply(id=command.id, accepted=True, tick=tick)

    def _keep(self, seen: pb.Acknowledge, who: str, host_ns: int) -> None:
        others = [one for one in self.acknowledged if one.alarm != seen.alarm][-(MAX_RETAINED - 1) :]
        new = pb.Acknowledgement(alarm=seen.alarm, who=who, host_time_ns=host_ns, comment=seen.comment)
        self.acknowledged = (*others, new)
