"""The alarms of one board: divergence alarms, faults, a link without samples, a failing log.  Pure.

An alarm is active (the condition holds) and acknowledged (an operator has seen it), independently:

    comes:         active, not acknowledged          listed, calls for attention
    acknowledged:  active, acknowledged              listed, quiet
    goes:          not active, not acknowledged      listed until acknowledged: it happened
    both:          not active, acknowledged          not listed

Rule 1: an alarm that comes again needs a new acknowledgement; `times` counts.  A repetition on the bus, for views that
        joined late, does not count as coming again.  It changes nothing here, or adds what was missed with its first
        time.
Rule 2: one alarm for each name of a board; the latest text and value are shown.
Rule 3: memory is bounded, because names come from the bus.  Beyond MAX_ALARMS the oldest alarm that is gone is dropped;
        if none is gone, the new alarm is refused.
Rule 4: times are from the clock of the source: gateway, twin, or this host for conditions that the views detect.
Rule 5: an acknowledgement from any view applies to earlier alarms only; an alarm that is raised again needs a new one.
Rule 6: `revision` rises with each change that a screen would show.
Rule 7: a shelved alarm (ISA-18.2) is acknowledged until its time is over, even if it goes and comes back.  Then it
        is unacknowledged again if it is active.  A plain acknowledgement ends the shelving before that.
Rule 8: the journal has what became of them; its oldest entry goes first.  `noted` rises with each entry, so that a view
        knows without a look whether there are new ones.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

from gateway.board.conditions import LINK, LOG, TO_BOARD
from gateway.board.faults import BOARD_FAULTS, COIL, FAULT, FAULT_TEXT
from gateway.board.limits import MAX_SHELVE_S
from protocol.bus import board51_pb2 as pb
from protocol.wire.messages import Flag

MAX_ALARMS, MAX_ENTRIES = 64, 200
TWIN = "twin-gone"  # like LINK and LOG, a condition that the views judge themselves
_FAULTY = int(Flag.FAULT)  # a Flag takes 2 us, this 0.1, 500 times a second
_REFUSED_BOARD = frozenset({"version-mismatch", "wrong-board", "bad-identity"})  # end when samples come


@dataclass(frozen=True, slots=True, kw_only=True)
class Alarm:
    """A condition of a board."""

    board: str
    name: str  # kebab-case, stable
    severity: str  # "warning" | "fault"
    text: str
    since_ns: int  # Unix time of the latest coming
    changed_ns: int
    active: bool = True
    acknowledged: bool = False
    acknowledger: str = ""  # also who shelved it
    shelved_ns: int = 0  # Unix time at which it was shelved
    shelved_until_ns: int = 0  # 0: it is not shelved
    comment: str = ""  # of who acknowledged
    times: int = 1  # how often it came
    value: float | None = None
    threshold_on: float | None = None
    of_twin: bool = False

    @property
    def is_shelved(self) -> bool:
        """Return whether it is listed apart until a stated time."""
        return self.shelved_until_ns > 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """A line of the journal."""

    at_ns: int  # Unix time
    name: str  # of the alarm
    what: str  # "came" | "went" | "acknowledged" | "shelved" | "unshelved"
    severity: str
    who: str = ""  # a person; empty where nobody did it
    until_ns: int = 0  # of a shelving
    text: str = ""


class AlarmBook:
    """The alarms of one board."""

    def __init__(self, board: str) -> None:
        self.revision = 0
        self.noted = 0
        self.journal: deque[Entry] = deque(maxlen=MAX_ENTRIES)
        self._board = board
        self._alarms: dict[str, Alarm] = {}
        self._fault_at = (0, 0)  # session, tick

    def listed(self) -> tuple[Alarm, ...]:
        """Return the alarms that are active or not acknowledged, the most urgent first.

        Order: active, then faults, then not acknowledged, then new.
        """
        urgency = sorted(
            (a for a in self._alarms.values() if a.active or not a.acknowledged),
            key=lambda a: (not a.active, a.severity != "fault", a.acknowledged, -a.since_ns),
        )
        return tuple(urgency)

    def shelved(self) -> tuple[Alarm, ...]:
        """Return the shelved alarms, active or not, the first that comes back first."""
        return tuple(sorted((a for a in self._alarms.values() if a.is_shelved), key=lambda a: a.shelved_until_ns))

    def twin_alarm(self, alarm: pb.Alarm, now_ns: int) -> None:
        """Process `twin/alarm`."""
        at_ns = alarm.host_time_ns or now_ns
        if not alarm.active:
            self.go(alarm.name, at_ns)
            return
        threshold_on = alarm.threshold_on or None
        self.come(alarm.name, "warning", alarm.text, at_ns, value=alarm.value, threshold_on=threshold_on, of_twin=True)

    def twin_alarms(self, alarms: pb.TwinAlarms, now_ns: int) -> None:
        """Process `twin/alarms`: an alarm that is missing there has ended, possibly with the twin that raised it."""
        self.go(TWIN, now_ns)
        active = {alarm.name for alarm in alarms.active}
        for name in [a.name for a in self._alarms.values() if a.of_twin and a.active and a.name not in active]:
            self.go(name, now_ns)
        for alarm in alarms.active:
            self.twin_alarm(alarm, now_ns)

    def end_twin_alarms(self, now_ns: int) -> None:
        """Note that the twin has ended: its alarms end, and the alarm `twin-gone` is raised."""
        for name in [a.name for a in self._alarms.values() if a.of_twin and a.active]:
            self.go(name, now_ns)
        self.come(TWIN, "warning", "The twin has ended: the rig is not compared with its model.", now_ns)

    def repeated(self, alarms: pb.Alarms, now_ns: int) -> None:
        """Process the gateway's `alarms`: names and start of active conditions, and acknowledgements.

        They only complete existing alarms: whether a condition holds follows from samples and status, which are newer.
        """
        for alarm in alarms.active:
            since_ns = alarm.host_time_ns or now_ns
            if alarm.name in BOARD_FAULTS and alarm.name != FAULT and self._is_active(FAULT):
                del self._alarms[FAULT]
                self.come(alarm.name, "fault", alarm.text, since_ns)
            known = self._alarms.get(alarm.name)
            if known is not None and known.active and known.times == 1 and since_ns < known.since_ns:
                self.revision += 1
                self._alarms[alarm.name] = replace(known, since_ns=since_ns, changed_ns=since_ns)
        for record in alarms.acknowledged:
            at_ns = record.host_time_ns or now_ns
            self.acknowledge(record.alarm, record.who, at_ns, record.comment, shelve_s=record.shelve_s, now_ns=now_ns)

    def event(self, event: pb.Event, now_ns: int) -> None:
        """Process `event`: the start and end of faults."""
        now_ns = event.host_time_ns or now_ns
        if event.name in BOARD_FAULTS:
            self._fault_at = (event.session, event.tick)  # samples from before it may still be on their way
            self._alarms.pop(FAULT, None)  # its name is known now
            self.come(event.name, "fault", event.text, now_ns)
        elif event.name in (TO_BOARD, *_REFUSED_BOARD):
            self.come(event.name, "fault", event.text, now_ns)
        elif event.name in ("log-disk-full", "log-failed", "log-removed"):
            self.come(LOG, "fault", event.text, now_ns)
        elif event.name == "log-resumed":
            self.go(LOG, now_ns)
        elif event.name == "board-answers":
            self.go(TO_BOARD, now_ns)

    def state(self, state: pb.State, now_ns: int) -> None:
        """Process `state`: faults have no end event, so the end of the FAULT flag ends them."""
        if state.flags & _FAULTY:
            if not self.fault():
                self.come(FAULT, "fault", FAULT_TEXT, now_ns)
        elif self._alarms and (state.session != self._fault_at[0] or state.tick > self._fault_at[1]):
            for name in [a.name for a in self._alarms.values() if a.active and a.name in BOARD_FAULTS]:
                self.go(name, now_ns)

    def link(self, down: str, now_ns: int) -> None:
        """Set the state of the link: `down` is the reason why no samples arrive; empty if they arrive."""
        if down:
            self.come(LINK, "fault", down, now_ns)
            return
        for name in (LINK, *_REFUSED_BOARD):
            self.go(name, now_ns)

    def to_board(self, status: pb.Status, now_ns: int) -> None:
        """Process `to_board` of `status`: a view that joined late has not seen the event."""
        known = self._alarms.get(TO_BOARD)
        if known is not None and status.host_time_ns < known.changed_ns:
            return  # the event was quicker
        if status.to_board != "unanswered":
            self.go(TO_BOARD, now_ns)
        elif not self._is_active(TO_BOARD):
            since_ns = (status.host_time_ns or now_ns) - round(status.unanswered_s * 1e9)
            self.come(TO_BOARD, "fault", "The board does not answer: a STOP may not reach it.", since_ns)

    def log(self, log_state: str, now_ns: int) -> None:
        """Process `log_state` of `status`: a view that joined late has not seen the event."""
        if log_state in ("writing", "off"):
            self.go(LOG, now_ns)
        elif log_state and not self._is_active(LOG):
            self.come(LOG, "fault", f"The log is not being written: {log_state}.", now_ns)

    def waits(self, name: str, *, shelve: bool = False) -> bool:
        """Return whether there is an alarm of that name to acknowledge, or to shelve."""
        alarm = self._alarms.get(name)
        return alarm is not None and (shelve or alarm.is_shelved or not alarm.acknowledged)

    def acknowledge(
        self, name: str, who: str, at_ns: int, comment: str = "", *, shelve_s: float = 0.0, now_ns: int = 0
    ) -> bool:
        """Acknowledge an alarm that was raised before `at_ns`, or shelve it; return False if that changes nothing.

        Args:
            name: of the alarm.
            who: for the journal.
            at_ns: Unix time of the act.
            comment: of who acknowledged.
            shelve_s: for how long to shelve it, as a gateway lets it through; 0: not.
            now_ns: Unix time at which this arrives; 0: that of the act.
        """
        alarm = self._alarms.get(name)
        if alarm is None or at_ns <= alarm.shelved_ns:
            return False
        until_ns = at_ns + round(min(shelve_s, MAX_SHELVE_S) * 1e9) if shelve_s > 0.0 else 0
        if until_ns:
            if until_ns <= max(now_ns, at_ns):
                return False  # it is over
        elif (alarm.acknowledged and not alarm.is_shelved) or alarm.since_ns > at_ns:
            return False
        self.revision += 1
        what = "shelved" if until_ns else "unshelved" if alarm.is_shelved else "acknowledged"
        self._note(alarm, what, at_ns, who=who, until_ns=until_ns, text=comment)
        self._alarms[name] = replace(
            alarm, acknowledged=True, acknowledger=who, comment=comment, changed_ns=at_ns,
            shelved_ns=at_ns if until_ns or alarm.is_shelved else alarm.shelved_ns, shelved_until_ns=until_ns,
        )  # fmt: skip
        if not (alarm.active or until_ns):
            del self._alarms[name]
        return True

    def expire(self, now_ns: int) -> None:
        """End the shelvings whose time is over: what is active calls again."""
        for alarm in [a for a in self._alarms.values() if a.is_shelved and a.shelved_until_ns <= now_ns]:
            self.revision += 1
            until_ns = alarm.shelved_until_ns
            self._note(alarm, "unshelved", until_ns)
            if not alarm.active:
                del self._alarms[alarm.name]
                continue
            self._alarms[alarm.name] = replace(
                alarm, acknowledged=False, acknowledger="", comment="", since_ns=until_ns, changed_ns=until_ns,
                times=alarm.times + 1, shelved_ns=until_ns, shelved_until_ns=0,
            )  # fmt: skip

    def come(
        self,
        name: str,
        severity: str,
        text: str,
        now_ns: int,
        *,
        value: float | None = None,
        threshold_on: float | None = None,
        of_twin: bool = False,
    ) -> None:
        """The condition holds."""
        known = self._alarms.get(name)
        if known is not None and known.active:
            if (known.text, known.value) != (text, value):
                self.revision += 1
                self._alarms[name] = replace(known, text=text, value=value, changed_ns=now_ns)
            return
        if known is None and len(self._alarms) >= MAX_ALARMS and not self._make_room():
            return
        self.revision += 1
        before = Alarm(board=self._board, name=name, severity=severity, text=text, since_ns=now_ns, changed_ns=now_ns)
        if known is not None and known.is_shelved:
            before = known
        alarm = self._alarms[name] = replace(
            before, severity=severity, text=text, since_ns=now_ns, changed_ns=now_ns, active=True,
            times=1 if known is None else known.times + 1, value=value, threshold_on=threshold_on, of_twin=of_twin,
        )  # fmt: skip
        self._note(alarm, "came", now_ns, text=text)

    def go(self, name: str, now_ns: int) -> None:
        """Note that the condition no longer holds."""
        alarm = self._alarms.get(name)
        if alarm is None or not alarm.active:
            return
        self.revision += 1
        self._note(alarm, "went", now_ns)
        if alarm.acknowledged and not alarm.is_shelved:
            del self._alarms[name]
        else:
            self._alarms[name] = replace(alarm, active=False, changed_ns=now_ns)

    def fault(self) -> str:
        """The fault that the board has latched, first one that it cannot end; "fault" where its kind is not known."""
        names = [a.name for a in self._alarms.values() if a.active and a.name in BOARD_FAULTS]
        return min(names, key=lambda name: name not in COIL, default="")

    def _is_active(self, name: str) -> bool:
        return name in self._alarms and self._alarms[name].active

    def _note(self, alarm: Alarm, what: str, at_ns: int, *, who: str = "", until_ns: int = 0, text: str = "") -> None:
        severity = alarm.severity
        entry = Entry(at_ns=at_ns, name=alarm.name, what=what, severity=severity, who=who, until_ns=until_ns, text=text)
        self.noted += 1
        self.journal.append(entry)

    def _make_room(self) -> bool:
        ended = [alarm for alarm in self._alarms.values() if not alarm.active]
        if not ended:
            return False
        del self._alarms[min(ended, key=lambda a: a.changed_ns).name]
        return True
