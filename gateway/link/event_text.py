"""Texts of link events; name and severity of EVENT frames (protocol/README.md, rules 15 and 16)."""

from __future__ import annotations

from gateway.board.faults import COIL_MAY_BE_ON, OUTPUT_UNCONFIRMED, name_of
from protocol.wire.events import BoardEvent
from protocol.wire.messages import FAULT_EVENTS, RESETS, ROW_OF_NAME, VERSION, EventCode, Message, Mode

_WARNINGS = frozenset(
    {EventCode.HOST_LOST, EventCode.OVERRUN, EventCode.LIMIT_HIT, EventCode.SETTINGS_REJECTED, EventCode.OVERLOAD}
) | (RESETS - FAULT_EVENTS)
_RESET = "The board restarted; resets since power-on: {detail}."
_TEXT = {
    EventCode.HOST_LOST: "No frame from the host came in time. The host-loss policy has acted: {policy}.",
    EventCode.HOST_BACK: "The host is back.",
    EventCode.OVER_CURRENT: "The current converter stayed at its maximum, {detail} counts: coil off.",
    EventCode.SENSOR_FAULT: "The position converter stayed at an end of its range, {detail} counts: coil off.",
    EventCode.OVERRUN: "A tick took longer than T_s; board_overruns of the status counts such ticks since the reset.",
    EventCode.EXCITATION_DONE: "The excitation has ended.",
    EventCode.CAPTURE_DONE: "The capture is complete.",
    EventCode.LIMIT_HIT: "The {limited} has reached its limit.",
    EventCode.MODE_CHANGED: "Mode {mode}.",
    EventCode.OUTPUT_FAULT: OUTPUT_UNCONFIRMED,
    EventCode.UNCOMMANDED_CURRENT: "A current flows although u_c is 0, {detail} counts. " + COIL_MAY_BE_ON,
    EventCode.SETTINGS_REJECTED: (
        "The settings in the board's memory are not usable: {field} is out of range."
        " The gains and limits of its program are in force: check them before you fly, and store the settings again."
    ),
    EventCode.STACK_FAULT: (
        "The end of the board's stack was overwritten: coil off. Its memory may be wrong: reset the board,"
        " and report what it was doing."
    ),
    EventCode.OVERLOAD: "Commands come faster than the board can answer; without an answer since its reset: {detail}.",
}

_POLICIES = ("the coil goes on as before", "coil off", "the reference is held")
_LIMITED = ("input u_c", "reference")
_SETTINGS = ("?", *(field.name for field in ROW_OF_NAME["PARAMETERS"].fields[1:18]))


def _word(words: tuple[str, ...], number: int) -> str:
    """Return the word of a number; the number itself if it has none."""
    return words[number] if number < len(words) else str(number)


def mode_name(mode: int) -> str:
    """Return the name of a mode, such as `closed loop` for 2; the number itself if it is not a mode."""
    return Mode(mode).name.lower().replace("_", " ") if 0 <= mode <= max(Mode) else str(mode)


def of_board(event: BoardEvent) -> tuple[str, str, str]:
    """Return (name, severity, text) of a board's event."""
    code = event.code
    severity = "fault" if code in FAULT_EVENTS else "warning" if code in _WARNINGS else "info"
    text = _TEXT.get(code, _RESET).format(
        detail=event.detail,
        mode=mode_name(event.detail),
        policy=_word(_POLICIES, event.detail),
        limited=_word(_LIMITED, event.detail),
        field=_word(_SETTINGS, event.detail),
    )
    return name_of(code), severity, text


def board_identity(identity: Message, port: str, session: int) -> str:
    """Return a sentence that describes a streaming board."""
    f = identity.int
    return (
        f"Board {f('board_id')} at {port}, firmware {f('firmware_major')}.{f('firmware_minor')},"
        f" T_s {f('sample_time')} us, session {session}."
    )


def other_version(board_version: int) -> str:
    """Return a sentence about a board with another protocol version."""
    return (
        f"The board speaks protocol version {board_version}, this gateway {VERSION}:"
        f" flash firmware of version {VERSION}.x or install a gateway for it."
    )


def wrong_board(port: str, board_id: int, configured: int) -> str:
    """Return a sentence about a board whose serial number differs from the configured one."""
    return (
        f"The board at {port} has the serial number {board_id}, the configuration requires {configured}:"
        " exchange the cables or correct board_id."
    )


def in_doubt(first_tick: int, last_tick: int, session: int) -> str:
    """Return a sentence about samples whose ticks PONGs contradict."""
    return (
        f"PONGs of the board contradict the count of its ticks: the samples {first_tick} to {last_tick} of session"
        f" {session} may have wrong ticks."
    )
