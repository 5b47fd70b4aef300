"""The table of all UART messages: one row defines encoding, decoding (`codec.py`) and the interface page.

`framing.py` describes the frame around a body.  A body is the type byte followed by the fields of its row,
little-endian, without padding.  All process values are converter counts; IDENTITY contains their scalings.

`protocol/README.md` is the reference for firmware authors; a test compares its field tables with this file.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, IntFlag

VERSION = 1  # protocol version; the board's answer to HELLO contains the version it chose
COUNTS_MAX = 4095  # 12-bit converters


class Mode(IntEnum):
    """The source of the coil's input."""

    IDLE = 0
    OPEN_LOOP = 1
    CLOSED_LOOP = 2


class Flag(IntFlag):
    """Bits 2 to 7 of the state's flag byte (bits 0 and 1 are the mode)."""

    INPUT_SATURATED = 0x04  # u_c is at an end of its converter
    POSITION_RANGE = 0x08  # position converter at an end: x is clipped
    CURRENT_RANGE = 0x10  # current converter at an end: i_c is clipped
    OVERRUN = 0x20  # the previous tick took longer than T_s
    HOST_LOST = 0x40  # the host-loss policy has acted
    FAULT = 0x80  # coil off until SET_MODE; an EVENT says why


class Law(IntEnum):
    """The control laws that SET_GAINS can load."""

    LQI = 0
    PID = 1


class Shape(IntEnum):
    """The excitation shapes."""

    NONE = 0
    STEP = 1
    RECTANGLE = 2
    SAWTOOTH = 3
    PRBS = 4
    MULTISINE = 5
    CHIRP = 6


class HostLoss(IntEnum):
    """The reaction of the board when no valid frame has arrived within the time-out."""

    KEEP = 0  # continue as commanded
    COIL_OFF = 1  # mode IDLE
    HOLD = 2  # closed loop: keep regulating, excitation off; otherwise as COIL_OFF


class Reason(IntEnum):
    """The reasons for refusing a command (NACK)."""

    UNKNOWN_TYPE = 1
    BAD_LENGTH = 2
    OUT_OF_RANGE = 3
    WRONG_MODE = 4
    BUSY = 5
    VERSION = 6
    NO_SESSION = 7
    NOT_AVAILABLE = 8
    FAULT_ACTIVE = 9
    SLEW = 10


class EventCode(IntEnum):
    """The kinds of EVENT; the meaning of its detail is on the interface page."""

    RESET_POWER_ON = 1
    RESET_WATCHDOG = 2
    RESET_COMMANDED = 3
    HOST_LOST = 4
    HOST_BACK = 5
    OVER_CURRENT = 6
    SENSOR_FAULT = 7
    OVERRUN = 8
    EXCITATION_DONE = 9
    CAPTURE_DONE = 10
    LIMIT_HIT = 11
    MODE_CHANGED = 12
    OUTPUT_FAULT = 13
    UNCOMMANDED_CURRENT = 14
    SETTINGS_REJECTED = 15
    OVERLOAD = 16
    STACK_FAULT = 17


# Faults that the board cannot end: the coil may be on whatever it orders.
COIL_FAULTS = frozenset({EventCode.OUTPUT_FAULT, EventCode.UNCOMMANDED_CURRENT})
FAULT_EVENTS = COIL_FAULTS | {
    EventCode.RESET_WATCHDOG,
    EventCode.OVER_CURRENT,
    EventCode.SENSOR_FAULT,
    EventCode.STACK_FAULT,
}
RESETS = frozenset({EventCode.RESET_POWER_ON, EventCode.RESET_WATCHDOG, EventCode.RESET_COMMANDED})


@dataclass(frozen=True, slots=True)
class Field:
    """A field of a body: name, type, allowed range, meaning, unit ("" = a plain number).

    Types: u8, i8, u16, i16, u32, f32 (finite), counts, flags, bytesN.  `counts` fields come in pairs and share three
    bytes, 12 bits each.  `flags` is a u8 whose two low bits hold a Mode, so they are never 3.
    """

    name: str
    type: str
    low: float | None = None
    high: float | None = None
    description: str = ""
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Row:
    """A message: type byte, name, direction, fields.  Commands have `id` as their first field."""

    type: int
    name: str
    to_board: bool
    fields: tuple[Field, ...]
    description: str


def _u8(name: str, unit: str, description: str, low: int = 0, high: int = 0xFF) -> Field:
    return Field(name, "u8", low, high, description, unit)


def _u16(name: str, unit: str, description: str, low: int = 0, high: int = 0xFFFF) -> Field:
    return Field(name, "u16", low, high, description, unit)


def _u32(name: str, unit: str, description: str) -> Field:
    return Field(name, "u32", 0, 0xFFFFFFFF, description, unit)


def _f32(name: str, unit: str, description: str) -> Field:
    return Field(name, "f32", None, None, description, unit)


def _counts(name: str, description: str) -> Field:
    return Field(name, "counts", 0, COUNTS_MAX, description, "count")


def _u16_counts(name: str, description: str) -> Field:
    return _u16(name, "count", description, 0, COUNTS_MAX)


def _gains() -> tuple[Field, ...]:
    pairs = []
    for n in range(1, 5):
        pairs.append(Field(f"k{n}_mantissa", "i16", -32767, 32767, f"gain k{n} = mantissa * 2^-shift", "count/count"))
        pairs.append(_u8(f"k{n}_shift", "bit", f"binary places of k{n}", 0, 30))
    return tuple(pairs)


_ID = _u8("id", "", "command id; the same id again is answered again but not executed again", 1)
_OPERATING_POINT = (
    _u16_counts("i_0", "operating point (13): coil current"),
    _u16_counts("x_0", "operating point (13): position"),
    _u16_counts("u_0", "operating point (13): input"),
)

_CALIBRATION = (
    _u16_counts("low_read", "a reading without calibration"),
    _u16_counts("low_true", "what it should have been"),
    _u16_counts("high_read", "another reading without calibration"),
    _u16_counts("high_true", "what it should have been"),
)

ROWS: tuple[Row, ...] = (
    Row(0x01, "HELLO", True, (
        _ID,
        _u16("session", "", "chosen by the host for each connection; a new one makes the board forget old ids"),
        _u8("version_min", "", "lowest protocol version the host speaks"),
        _u8("version_max", "", "highest protocol version the host speaks"),
    ), "open a session; answered by IDENTITY"),
    Row(0x02, "PING", True, (_ID,), "sign of life; answered by PONG"),
    Row(0x03, "SET_MODE", True, (_ID, _u8("mode", "", "0 idle, 1 open loop, 2 closed loop", 0, 2)),
        "change the mode; clears a fault"),
    Row(0x04, "SET_REFERENCE", True, (_ID, _u16_counts("x_ref", "absolute reference, in counts of x")),
        "in force from the next tick; ends an excitation of the reference"),
    Row(0x05, "SET_GAINS", True, (_ID, _u8("law", "", "0 LQI, 1 PID", 0, 1), *_gains(), *_OPERATING_POINT),
        "control law, gains and operating point, all at one tick"),
    Row(0x06, "EXCITE", True, (
        _ID,
        _u8("shape", "", "0 none, 1 step, 2 rectangle, 3 sawtooth, 4 prbs, 5 multisine, 6 chirp", 0, 6),
        _u8("target", "", "0 u_c (open loop), 1 x_ref (closed loop)", 0, 1),
        Field("amplitude", "i16", -COUNTS_MAX, COUNTS_MAX, "counts of the target", "count"),
        _u16_counts("offset", "counts of the target, absolute"),
        _u16("period", "tick", "prbs: one chip; chirp: period at the start", 1),
        _u16("period_end", "tick", "chirp: period at the end", 1),
        _u16("seed", "", "prbs, multisine", 1),
        _u32("duration", "tick", "0 = until the next command"),
    ), "play a signal on u_c or x_ref"),
    Row(0x07, "STOP", True, (_ID,), "coil off at once, mode idle; accepted always, without a session too"),
    Row(0x08, "CAPTURE", True, (
        _ID,
        _u16_counts("u_from", "input before the step"),
        _u16_counts("u_to", "input after it"),
        _u16("pre", "sample", "samples before the step", 0, 2000),
        _u16("count", "sample", "samples in all", 1, 2000),
    ), "record i_c at 25 kHz around a step of u_c; idle or open loop"),
    Row(0x09, "READ_CAPTURE", True, (_ID, _u16("index", "sample", "first sample wanted", 0, 1999)),
        "answered by CAPTURE_BLOCK"),
    Row(0x0A, "SET_STREAM", True, (_ID, _u16("divider", "tick", "send every n-th tick; 0 = none", 0, 1000)),
        "rate of STATE"),
    Row(0x0B, "SET_HOST_LOSS", True, (
        _ID,
        _u8("policy", "", "0 keep, 1 coil off, 2 hold", 0, 2),
        _u16("timeout", "ms", "without a valid frame", 50, 60000),
    ), "what to do when the host is lost"),
    Row(0x0C, "GET_PARAMETERS", True, (_ID,), "answered by PARAMETERS"),
    Row(0x0D, "RESET", True, (_ID,), "restart the firmware; the ACK goes out before"),
    Row(0x0E, "GET_HEALTH", True, (_ID,), "answered by HEALTH; firmware 1.3"),
    Row(0x0F, "SET_CALIBRATION", True, (_ID, *_CALIBRATION), "correct the position sensor; idle; firmware 1.4"),
    Row(0x10, "GET_CALIBRATION", True, (_ID,), "answered by CALIBRATION; firmware 1.4"),
    Row(0x40, "STATE", False, (
        _u16("sequence", "tick", "number of the control tick, modulo 65536"),
        _counts("i_c", "coil current"),
        _counts("x", "position"),
        _counts("u_c", "input, as the converter confirmed it last: in force from this tick to the next"),
        _counts("x_ref", "reference used at this tick, in counts of x"),
        Field("flags", "flags", 0, 0xFF, "bits 0-1 mode, others see Flags"),
    ), "one control tick"),
    Row(0x41, "IDENTITY", False, (
        _ID,
        _u8("version", "", "protocol version chosen", 1),
        _u8("firmware_major", "", "firmware version, before the point"),
        _u8("firmware_minor", "", "firmware version, after the point"),
        _u32("board_id", "", "serial number"),
        _u32("tick", "tick", "control ticks since reset"),
        _u16("sample_time", "us", "T_s", 100),
        _u8("adc_bits", "bit", "resolution of the i_c and x converters", 8, 16),
        _u8("dac_bits", "bit", "resolution of the u_c converter", 8, 16),
        _f32("i_offset", "A", "i_c at count 0"),
        _f32("i_lsb", "A/count", "i_c per count"),
        _f32("x_offset", "m", "x at count 0, up from the sensor"),
        _f32("x_lsb", "m/count", "x per count"),
        _f32("u_offset", "V", "u_c at count 0"),
        _f32("u_lsb", "V/count", "u_c per count"),
        _u16("capture_time", "us", "between capture samples", 1),
        _u16("capture_size", "sample", "what the board can hold"),
        _u8("reset_cause", "", "code of the reset event", 1, 3),
        Field("build", "bytes8", None, None, "ASCII, filled with spaces"),
    ), "answer to HELLO"),
    Row(0x42, "PONG", False, (
        _ID,
        _u32("tick", "tick", "control ticks since reset"),
        _u16("bad_frames", "", "frames the board dropped without an answer since reset, saturating"),
        _u16("overruns", "", "late ticks since reset, saturating"),
    ), "answer to PING"),
    Row(0x43, "ACK", False, (
        _ID,
        _u8("command", "", "type of the command"),
        _u32("tick", "tick", "from which it is in force"),
    ), "command executed"),
    Row(0x44, "NACK", False, (
        _ID,
        _u8("command", "", "type of the command"),
        _u8("reason", "", "see Reasons", 1, 10),
        _u16("detail", "", "the bound or the mode in the way; see Reasons"),
    ), "command refused, nothing changed"),
    Row(0x45, "PARAMETERS", False, (
        _ID,
        _u8("law", "", "0 LQI, 1 PID", 0, 1),
        *_gains(),
        *_OPERATING_POINT,
        _u16_counts("x_ref_min", "lower bound of the reference"),
        _u16_counts("x_ref_max", "upper bound of the reference"),
        _u16_counts("x_ref_step", "largest jump of the reference at once"),
        _u16("x_ref_slew", "count/s", "rate at which the allowance for jumps refills", 1),
        _u16_counts("u_max", "largest u_c of an excitation"),
        _u16("divider", "tick", "of the stream", 0, 1000),
        _u8("policy", "", "host loss", 0, 2),
        _u16("timeout", "ms", "host loss", 50, 60000),
        _u32("tick", "tick", "from which gains and operating point are in force"),
    ), "answer to GET_PARAMETERS"),
    Row(0x46, "EVENT", False, (
        _u8("number", "", "counts events, modulo 256: a gap is a lost event"),
        _u32("tick", "tick", "when"),
        _u8("code", "", "see Events", 1, 17),
        _u16("detail", "", "see Events"),
    ), "something happened; not acknowledged"),
    Row(0x47, "CAPTURE_BLOCK", False, (
        _ID,
        _u16("index", "sample", "of the first sample here"),
        _u16("total", "sample", "samples in the capture", 1, 2000),
        _u32("tick", "tick", "at which the capture began"),
        Field("samples", "bytes48", None, None, "up to 32 samples of i_c, 12 bits, packed in pairs; rest 0", "count"),
    ), "answer to READ_CAPTURE"),
    Row(0x48, "HEALTH", False, (
        _ID,
        _u16("stack_free", "byte", "of the stack, never used since the reset; 0 overwritten, 65535 not watched"),
        _u16("u_power_on", "count", "u_c that the input converter wakes up with; 65535 not known"),
    ), "answer to GET_HEALTH"),
    Row(0x49, "CALIBRATION", False, (
        _ID,
        *_CALIBRATION,
        _u8("kept", "", "1: a reset leaves it in force; 0: it does not, or nothing was written yet", 0, 1),
    ), "answer to GET_CALIBRATION"),
)  # fmt: skip

ROW_OF_TYPE = {row.type: row for row in ROWS}
ROW_OF_NAME = {row.name: row for row in ROWS}
CAPTURE_BLOCK_SAMPLES = 32
NOT_KNOWN = 0xFFFF  # in HEALTH

Value = int | float | bytes


@dataclass(frozen=True, slots=True)
class Message:
    """A decoded body: name of its row, and values by field name."""

    name: str
    values: dict[str, Value]

    def int(self, field: str) -> int:
        """An integer field."""
        value = self.values[field]
        assert isinstance(value, int)
        return value

    def float(self, field: str) -> float:
        """An f32 field."""
        value = self.values[field]
        assert isinstance(value, float)
        return value

    def bytes(self, field: str) -> bytes:
        """A bytes field."""
        value = self.values[field]
        assert isinstance(value, bytes)
        return value
