"""A line for each rig, refreshed in place: `board51 watch --table`.

Rule: a value is shown only while it is fresh, not after its gateway or twin has fallen silent.
"""

from __future__ import annotations

import shutil
import sys
import time

from google.protobuf.message import Message

from gateway.client.message_queue import MessageQueue
from protocol.bus import board51_pb2 as pb
from protocol.bus import encoding, topics

TABLE_TOPICS = ("states", "status", "alarms", "twin/states", "twin/alarm", "twin/alarms")
FRESH_S = 2.5  # of what comes once a second or more often
FRESH_ALARMS_S = 12.0  # they come every 5 s, and on change
# 80 columns have room for an alarm.
COLUMNS = "{:<8} {:<10} {:<11} {:>6} {:>6} {:>6} {:>7}  {}"
HEAD = COLUMNS.format("rig", "link", "mode", "x mm", "ref mm", "i_c A", "-twin", "alarms")


class Table:
    """The latest messages of each rig, and their lines."""

    def __init__(self) -> None:
        self._rigs: dict[str, dict[str, tuple[float, Message]]] = {}
        self._twin_alarms: dict[str, dict[str, float]] = {}  # by rig: name, when it was last said

    def take(self, key: str, message: Message, now_s: float) -> None:
        """Keep a message that arrived under `key`."""
        site, board, topic = key.split("/", 2)
        rig = board if site == topics.DEFAULT_SITE else f"{site}/{board}"
        self._rigs.setdefault(rig, {})[topic] = now_s, message
        alarms = self._twin_alarms.setdefault(rig, {})
        if isinstance(message, pb.TwinAlarms):
            alarms.clear()
            alarms |= {alarm.name: now_s for alarm in message.active}
        elif isinstance(message, pb.Alarm):
            alarms.pop(message.name, None)
            alarms |= {message.name: now_s} if message.active else {}

    def lines(self, now_s: float) -> list[str]:
        """Return the head and a line for each rig, by name."""
        return [HEAD, *(self._line(rig, now_s) for rig in sorted(self._rigs))]

    def _line(self, rig: str, now_s: float) -> str:
        latest = {
            topic: message
            for topic, (at_s, message) in self._rigs[rig].items()
            if now_s - at_s < (FRESH_ALARMS_S if topic == "alarms" else FRESH_S)
        }
        status, batch, twin = latest.get("status"), latest.get("states"), latest.get("twin/states")
        cells = ["-"] * 5
        if isinstance(batch, pb.StateBatch) and batch.states:
            state = batch.states[-1]
            cells[0] = encoding.word_of(pb.Mode, state.mode).replace(" ", "-")
            for n, (name, scale) in enumerate((("x_m", 1e3), ("x_ref_m", 1e3), ("i_c_a", 1.0)), 1):
                cells[n] = f"{scale * getattr(state, name):.3f}" if state.HasField(name) else "-"
        if isinstance(twin, pb.TwinBatch) and twin.divergences:
            cells[4] = f"{1e3 * twin.divergences[-1].x_m.error:+.3f}"  # mm, measured minus twin
        active = latest.get("alarms")
        names = [alarm.name for alarm in active.active] if isinstance(active, pb.Alarms) else []
        names += [name for name, at_s in self._twin_alarms[rig].items() if now_s - at_s < FRESH_ALARMS_S]
        link = status.link if isinstance(status, pb.Status) else "-" if batch else "no gateway"
        return COLUMNS.format(rig, link, *cells, ", ".join(names) or "-")


def show(queue: MessageQueue, *, every_s: float, count: int, end_s: float | None) -> int:
    """Print the table every `every_s` until `count` (0: no end) or the time `end_s`; return how often.

    On a terminal the new table takes the place of the old one.
    """
    table, printed, up, overwrites = Table(), 0, "", sys.stdout.isatty()
    while not count or printed < count:
        next_s = time.monotonic() + every_s
        while (left_s := next_s - time.monotonic()) > 0:
            arrival = queue.take(left_s)
            if arrival is not None and arrival.message is not None:
                table.take(arrival.key, arrival.message, time.monotonic())
        lines = table.lines(time.monotonic())
        if overwrites:  # a line that wraps would not be overwritten
            lines = [line[: shutil.get_terminal_size().columns - 1] for line in lines]
        print(up + "\n".join(lines), flush=True)
        up = f"\x1b[{len(lines)}A\x1b[J" if overwrites else ""
        printed += len(lines) > 1
        if end_s is not None and time.monotonic() >= end_s:
            break
    return printed
