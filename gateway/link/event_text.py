"""EVENT frames in words: stable name, severity, sentence (protocol/README.md, rules 15 and 16)."""

from __future__ import annotations

from protocol.wire.events import BoardEvent
from protocol.wire.messages import FAULT_EVENTS, RESETS, EventCode, Mode

_WARNINGS = frozenset({EventCode.HOST_LOST, EventCode.OVERRUN, EventCode.LIMIT_HIT}) | (RESETS - FAULT_EVENTS)
_RESET = "The board restarted; resets since power-on: {detail}."
_TEXT = {
    EventCode.HOST_LOST: "No frame from the host in time; policy {detail} (0 keep, 1 coil off, 2 hold) has acted.",
    EventCode.HOST_BACK: "The host is back.",
    EventCode.OVER_CURRENT: "The current converter stayed at its top, {detail} counts: coil off.",
    EventCode.SENSOR_FAULT: "The position converter stayed at an end, {detail} counts: coil off.",
    EventCode.OVERRUN: "A tick took longer than T_s; late ticks since the reset: {detail}.",
    EventCode.EXCITATION_DONE: "The excitation has ended.",
    EventCode.CAPTURE_DONE: "The capture is complete.",
    EventCode.LIMIT_HIT: "A limit was hit: {detail} (0 input, 1 reference).",
    EventCode.MODE_CHANGED: "Mode {mode}.",
}


def mode_name(mode: int) -> str:
    """`closed loop` for 2; the number itself where it is no mode."""
    return Mode(mode).name.lower().replace("_", " ") if 0 <= mode <= max(Mode) else str(mode)


def describe(event: BoardEvent) -> tuple[str, str, str]:
    """(name, severity, text) of a board's event."""
    code = event.code
    severity = "fault" if code in FAULT_EVENTS else "warning" if code in _WARNINGS else "info"
    text = _TEXT.get(code, _RESET).format(detail=event.detail, mode=mode_name(event.detail))
    return code.name.lower().replace("_", "-"), severity, text
