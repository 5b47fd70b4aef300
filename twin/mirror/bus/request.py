"""The alarm `diagnosis-wanted`: a model has been wrong for so long that a diagnosis is due.  Pure.

An episode begins with the first alarm on divergence or innovation and lasts while any of them is active.

Rule 1: time is the board's, and it counts only while samples judge one of the alarms.  A rig that idles, or a twin out
        of step, proves nothing, however long.
Rule 2: raised once per episode; cleared when the last alarm is, or when another model ends them all.
Rule 3: it asks for work and decides nothing: no alarm waits for it.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from protocol.bus import board51_pb2 as pb
from twin.mirror.monitor.divergence import ALARMS
from twin.settings.mirror import SILENT_S

NAME = "diagnosis-wanted"


class DiagnosisRequest:
    """The request for a diagnosis of one board.

    Args:
        after_s: how long an alarm must last, s; 0: never ask.
        command: that diagnoses, for the text; the control room has a button for it.
    """

    def __init__(self, *, after_s: float, command: str) -> None:
        self._after_s, self._command = after_s, command
        self._alarms: dict[str, None] = {}  # in the order in which they were raised
        self._since_s = self._last_s = math.nan  # on the board's clock
        self.active = False

    def take_alarm(self, alarm: pb.Alarm) -> pb.Alarm | None:
        """Take an alarm of the twin; the end of the request, where this was the last one."""
        if alarm.name not in ALARMS:
            return None
        if alarm.active:
            self._alarms[alarm.name] = None
            return None
        self._alarms.pop(alarm.name, None)
        if self._alarms:
            return None
        self._since_s = math.nan
        if not self.active:
            return None
        self.active = False
        return self._message(alarm, active=False, value=0.0, text=f"no alarm is left: {alarm.text}")

    def sample(self, state: pb.State, judges: Callable[[str], bool]) -> pb.Alarm | None:
        """Take a sample, and whether it judges an alarm of that name; the request, where it is time for it."""
        if not self._alarms or self.active or self._after_s <= 0.0:
            return None
        if not self._since_s <= state.t_s:  # the first of an episode, or of a board that was reset
            self._since_s = self._last_s = state.t_s
        if state.t_s - self._last_s > SILENT_S or not any(map(judges, self._alarms)):
            self._since_s += state.t_s - self._last_s  # without evidence the clock stands
        self._last_s = state.t_s
        lasted_s = state.t_s - self._since_s
        if lasted_s < self._after_s:
            return None
        self.active = True
        # The way to the remedy belongs into the alarm: who reads it in a DCS has no page of ours open.
        text = (
            f"{', '.join(self._alarms)} for {lasted_s:.0f} s: the model is wrong. On the page of the rig's model press"
            f" Diagnose the last 2 minutes of flight, or use {self._command}"
        )
        return self._message(state, active=True, value=lasted_s, text=text)

    def _message(self, at: pb.Alarm | pb.State, *, active: bool, value: float, text: str) -> pb.Alarm:
        return pb.Alarm(
            host_time_ns=at.host_time_ns,
            session=at.session,
            tick=at.tick,
            name=NAME,
            active=active,
            value=value,
            threshold_on=self._after_s,
            text=text,
        )
