"""Execution of commands on the control loop, and their refusals: rules 6 to 8, 12, 15 and 17 of protocol/README.md.

A handler takes the loop, the message and the next tick, and returns a `Nack` or the answer; None is an ACK.  A refused
command changes nothing.  `board.py` executes the commands of session, stream and host loss.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, fields

from gateway.emulator.firmware_model import flash
from gateway.emulator.firmware_model.calibration import Calibration
from gateway.emulator.firmware_model.capture import FirmwareCapture
from gateway.emulator.firmware_model.control_loop import TARGET_U, ControlLoop
from gateway.emulator.firmware_model.excitation import Excitation, Signal
from gateway.emulator.firmware_model.law import Gains
from protocol.wire.messages import ROW_OF_TYPE, VERSION, EventCode, HostLoss, Message, Mode, Reason, Shape


@dataclass(frozen=True, slots=True)
class Nack:
    """A NACK: its reason, and the violated bound or the current mode."""

    reason: Reason
    detail: int = 0


Handler = Callable[[ControlLoop, Message, int], Nack | Message | None]  # the answer has no id yet


def acknowledge(message_type: int, tick: int) -> Message:
    """Return an ACK: in force from `tick` on."""
    return Message("ACK", {"command": message_type, "tick": tick})


def refuse_range(body: bytes) -> Nack:
    """Return the refusal of a command with a field out of range, with the nearest bound as detail.

    Fields are checked one by one at their offsets, as in a real firmware: the decoder of the row does not report the
    bound.
    """
    at = 1
    for field in ROW_OF_TYPE[body[0]].fields:
        size, signed = {"u8": (1, False), "u16": (2, False), "i16": (2, True), "u32": (4, False)}[field.type]
        value = int.from_bytes(body[at : at + size], "little", signed=signed)
        at += size
        for bound, outside in ((field.low, value < (field.low or 0)), (field.high, value > (field.high or 0))):
            if bound is not None and outside:
                return Nack(Reason.OUT_OF_RANGE, int(abs(bound)))
    return Nack(Reason.OUT_OF_RANGE)


def identity(board_id: int, tick: int, reset_cause: EventCode, profile: flash.BoardProfile) -> Message:
    """Return the answer to HELLO: identity and scalings (rule 14)."""
    major, minor = flash.FIRMWARE
    return Message(
        "IDENTITY",
        {
            "version": VERSION,
            "firmware_major": major,
            "firmware_minor": minor,
            "board_id": board_id,
            "tick": tick,
            "sample_time": flash.T_S_US,
            "adc_bits": profile.adc_bits,
            "dac_bits": flash.DAC_BITS,
            "i_offset": profile.current.offset,
            "i_lsb": profile.current.lsb,
            "x_offset": profile.position.offset,
            "x_lsb": profile.position.lsb,
            "u_offset": profile.input.offset,
            "u_lsb": profile.input.lsb,
            "capture_time": flash.CAPTURE_US,
            "capture_size": flash.CAPTURE_SIZE,
            "reset_cause": int(reset_cause),
            "build": profile.build.ljust(8)[:8],
        },
    )


def parameters(loop: ControlLoop, divider: int, policy: HostLoss, timeout_ms: int) -> Message:
    """Return the answer to GET_PARAMETERS: the values in force."""
    values = flash.Settings(gains=loop.law.gains, limits=loop.limits).in_parameters()
    values |= {"divider": divider, "policy": int(policy), "timeout": timeout_ms, "tick": loop.gains_tick}
    return Message("PARAMETERS", values)


def _hindrance(loop: ControlLoop, *modes: Mode) -> Nack | None:
    """Return why a command has to wait that needs one of these modes, a board without a fault and no capture."""
    if loop.fault:
        return Nack(Reason.FAULT_ACTIVE)
    if loop.capturing:
        return Nack(Reason.BUSY)
    return None if loop.mode in modes else Nack(Reason.WRONG_MODE, loop.mode)


def _get_calibration(loop: ControlLoop, _message: Message, _tick: int) -> Message:
    return Message("CALIBRATION", {**asdict(loop.calibration), "kept": int(loop.stored_calibration is not None)})


def _set_calibration(loop: ControlLoop, message: Message, _tick: int) -> Nack | None:
    if hindrance := _hindrance(loop, Mode.IDLE):
        return hindrance
    points = Calibration(**{name: message.int(name) for name in asdict(loop.calibration)})
    if bound := points.bound_in_the_way():
        return Nack(Reason.OUT_OF_RANGE, bound)
    loop.calibration = loop.stored_calibration = points
    return None


def _set_mode(loop: ControlLoop, message: Message, _tick: int) -> Nack | None:
    mode = Mode(message.int("mode"))
    if loop.capturing and mode != Mode.IDLE:
        return Nack(Reason.BUSY)
    loop.fault = False
    loop.output.rearm()
    loop.set_mode(mode)
    return None


def _set_reference(loop: ControlLoop, message: Message, _tick: int) -> Nack | None:
    x_ref, limits, reference = message.int("x_ref"), loop.limits, loop.reference
    if x_ref < limits.x_ref_min:
        return Nack(Reason.OUT_OF_RANGE, limits.x_ref_min)
    if x_ref > limits.x_ref_max:
        return Nack(Reason.OUT_OF_RANGE, limits.x_ref_max)
    if abs(x_ref - reference.x_ref) > reference.allowance:
        return Nack(Reason.SLEW, reference.allowance)
    loop.set_reference(x_ref)
    return None


def _set_gains(loop: ControlLoop, message: Message, tick: int) -> None:
    loop.law.gains = Gains(
        law=message.int("law"), mantissas=tuple(message.int(f"k{n}_mantissa") for n in range(1, 5)),
        shifts=tuple(message.int(f"k{n}_shift") for n in range(1, 5)), i_0=message.int("i_0"), x_0=message.int("x_0"),
        u_0=message.int("u_0"),
    )  # fmt: skip
    loop.gains_tick = tick


def _excite(loop: ControlLoop, message: Message, _tick: int) -> Nack | None:
    target, amplitude, offset = message.int("target"), abs(message.int("amplitude")), message.int("offset")
    required = Mode.OPEN_LOOP if target == TARGET_U else Mode.CLOSED_LOOP
    low, high = (0, loop.limits.u_max) if target == TARGET_U else (loop.limits.x_ref_min, loop.limits.x_ref_max)
    if hindrance := _hindrance(loop, required):
        return hindrance
    if offset - amplitude < low:
        return Nack(Reason.OUT_OF_RANGE, low)
    if offset + amplitude > high:
        return Nack(Reason.OUT_OF_RANGE, high)
    if message.int("shape") == Shape.CHIRP and message.int("duration") == 0:
        return Nack(Reason.OUT_OF_RANGE, 1)
    loop.excite(Excitation(Signal(**{field.name: message.int(field.name) for field in fields(Signal)})))
    return None


def _capture(loop: ControlLoop, message: Message, tick: int) -> Nack | None:
    u_from, u_to = message.int("u_from"), message.int("u_to")
    if hindrance := _hindrance(loop, Mode.IDLE, Mode.OPEN_LOOP):
        return hindrance
    if max(u_from, u_to) > loop.limits.u_max:
        return Nack(Reason.OUT_OF_RANGE, loop.limits.u_max)
    pre, count = message.int("pre"), message.int("count")
    loop.capture = FirmwareCapture(u_from=u_from, u_to=u_to, pre=pre, count=count, tick=tick)
    return None


def _read_capture(loop: ControlLoop, message: Message, tick: int) -> Nack | Message:
    if loop.capturing:
        return Nack(Reason.BUSY)
    index = message.int("index")
    if loop.capture is None or index >= loop.capture.total:
        return Nack(Reason.NOT_AVAILABLE)
    capture = loop.capture
    return Message(
        "CAPTURE_BLOCK",
        {"index": index, "total": capture.total, "tick": capture.began_tick, "samples": capture.block(index)},
    )


HANDLERS: dict[str, Handler] = {
    "SET_MODE": _set_mode,
    "SET_REFERENCE": _set_reference,
    "SET_GAINS": _set_gains,
    "EXCITE": _excite,
    "CAPTURE": _capture,
    "READ_CAPTURE": _read_capture,
    "SET_CALIBRATION": _set_calibration,
    "GET_CALIBRATION": _get_calibration,
}
