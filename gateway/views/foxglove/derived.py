"""The topics that Foxglove's own panels need: `<site>/<board>/log` and `<site>/<board>/scene`.  Pure.

Rule: they are derived where they are shown, never recorded and never on the bus.  A recorder that wrote them would say
      each event twice, in two schemas; logs of before would have none; and a replay, beside which a live view derives
      them again, would have to leave them out.  So they are not topics of the table: readers, `recover` and `replay`
      pass over them as over any foreign topic.
"""

from __future__ import annotations

from collections.abc import Iterator

from foxglove.messages import Log, SceneUpdate
from google.protobuf.message import Message

from gateway.views.foxglove.lines import line_of
from gateway.views.foxglove.scene import Scene

LOG, SCENE = "log", "scene"
TOPICS = ("state", "event", "plant", "command/record", "twin/state", "twin/alarm")  # what they are derived from


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
