"""Remarks, and acknowledgements and shelvings of alarms: commands that are not sent to the board.  No I/O.

Rule 1: an acknowledgement refers to a name, because the gateway does not know all alarms: the twin and the views raise
        alarms, too.  It applies to the alarm that is active under that name on arrival, not to a later one.
Rule 2: the latest acknowledgement of each name is kept and repeated in `alarms`, for views that start later.  At most
        MAX_RETAINED names are kept; the oldest is discarded first.
"""

from __future__ import annotations

from gateway.link.sink import Sink
from protocol.bus import board51_pb2 as pb

MAX_RETAINED = 64
KINDS = ("mark", "acknowledge")


class Annotations:
    """The remarks and acknowledgements of one board.  Written by the serial thread, read by any thread."""

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        self.acknowledged: tuple[pb.Acknowledgement, ...] = ()  # replaced, never changed

    def take(self, command: pb.Command, host_ns: int, *, tick: int, session: int) -> pb.CommandReply:
        """Execute a command of KINDS at the given tick of the board, and return the reply."""
        who = command.who or "unknown"
        if command.WhichOneof("what") == "mark":
            name, remark = "mark", command.mark.text
        else:
            name = "shelved" if command.acknowledge.shelve_s else "acknowledged"
            remark = " ".join(part for part in (command.acknowledge.alarm, command.acknowledge.comment) if part)
            self._keep(command.acknowledge, who, host_ns)
        # Replaced, not refused: a remark must not be lost for one character.
        text = "".join(c if c.isprintable() else " " for c in f"{who}: {remark}")
        event = pb.Event(host_time_ns=host_ns, tick=tick, session=session, source="gateway", severity="info")
        event.name, event.text = name, text
        self._sink.send("event", event, host_ns)
        return pb.CommandReply(id=command.id, accepted=True, tick=tick)

    def _keep(self, acknowledge: pb.Acknowledge, who: str, host_ns: int) -> None:
        # The oldest goes, not the new one, which is accepted in the same moment.
        remaining = [entry for entry in self.acknowledged if entry.alarm != acknowledge.alarm][-(MAX_RETAINED - 1) :]
        new = pb.Acknowledgement(alarm=acknowledge.alarm, who=who, host_time_ns=host_ns, comment=acknowledge.comment)
        new.shelve_s = acknowledge.shelve_s
        self.acknowledged = (*remaining, new)
