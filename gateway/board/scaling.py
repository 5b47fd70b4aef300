"""Converts between counts of one board and SI units, with the scalings that the board reported.  Pure.

Rule 1: SI value = offset + lsb * count (protocol/README.md, rule 14); x_ref uses the scaling of x.
Rule 2: a value that does not fit its UART field gives a `Refusal`; it is never clipped to another setpoint.
Rule 3: `WireCommand.note` states relevant rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from protocol.bus import board51_pb2 as pb
from protocol.wire.events import Sample
from protocol.wire.mantissa import MANTISSA_MAX, SHIFT_MAX, to_mantissa
from protocol.wire.messages import COUNTS_MAX, Law, Message, Shape, Value

_U16 = 0xFFFF
_U32 = 0xFFFFFFFF
_EXACT_MAX = 2.0**53
# What a rig on a bench can have, with a decade to spare; the page states it.  A scaling beyond this is not a rig but
# flash that was erased or a wrong byte order: everything after it, limits and gains included, would be noise.
_CHANNELS = (("i", "A", 1e3, 1e-3), ("x", "m", 1.0, 1e-5), ("u", "V", 1e3, 1e-3))  # unit, largest value, smallest span
_SAMPLE_TIME_MAX_US = 20_000


@dataclass(frozen=True, slots=True)
class Refusal:
    """The refusal of a command by the gateway.

    `reason` is kebab-case and stable; `text` is a sentence for the user.
    """

    reason: str
    text: str


def measured(value: float, unit: str) -> str:
    """Return a value as text in the units of the web page: lengths in mm."""
    scale, display_unit = (1e3, "mm") if unit == "m" else (1.0, unit)
    return f"{value * scale:.6g} {display_unit}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Scaling:
    """Scalings and times of a board, from IDENTITY."""

    i_offset_a: float
    i_lsb_a: float
    x_offset_m: float
    x_lsb_m: float
    u_offset_v: float
    u_lsb_v: float
    sample_time_s: float  # T_s
    capture_time_s: float
    capture_size: int  # samples

    def i_a(self, count: int) -> float:
        """Coil current, A."""
        return self.i_offset_a + self.i_lsb_a * count

    def x_m(self, count: int) -> float:
        """Return the position or reference, m, up from the sensor."""
        return self.x_offset_m + self.x_lsb_m * count

    def u_v(self, count: int) -> float:
        """Return the input of the amplifier, V."""
        return self.u_offset_v + self.u_lsb_v * count

    def gain_units(self, law: int) -> tuple[float, float, float, float]:
        """Counts per SI unit of each gain, in the order of the law (rule 14)."""
        i, x = self.i_lsb_a / self.u_lsb_v, self.x_lsb_m / self.u_lsb_v
        t_s = self.sample_time_s
        return (i, x, x / t_s, x * t_s) if law == Law.LQI else (x, x * t_s, x / t_s, 1.0)


def scaling_of(identity: Message) -> Scaling | str:
    """Return the scalings in an IDENTITY, or a sentence that says which one is implausible."""
    f = identity.float
    for name, unit, largest, span in _CHANNELS:
        offset, lsb = f(f"{name}_offset"), f(f"{name}_lsb")
        end = offset + lsb * COUNTS_MAX
        if max(abs(offset), abs(end)) > largest or abs(end - offset) < span:
            return (
                f"The board reports {name}_offset = {offset:g} {unit} and {name}_lsb = {lsb:g} {unit}: no rig measures"
                f" {offset:g} .. {end:g} {unit}.  Correct the scalings in its firmware: within {largest:g} {unit},"
                f" {span:g} {unit} apart at least."
            )
    if identity.int("sample_time") > _SAMPLE_TIME_MAX_US:
        return (
            f"The board reports sample_time = {identity.int('sample_time')} us, and nothing levitates above"
            f" {_SAMPLE_TIME_MAX_US} us.  Correct it in its firmware."
        )
    return Scaling(
        i_offset_a=f("i_offset"),
        i_lsb_a=f("i_lsb"),
        x_offset_m=f("x_offset"),
        x_lsb_m=f("x_lsb"),
        u_offset_v=f("u_offset"),
        u_lsb_v=f("u_lsb"),
        sample_time_s=identity.int("sample_time") * 1e-6,
        capture_time_s=identity.int("capture_time") * 1e-6,
        capture_size=identity.int("capture_size"),
    )


class StateEncoder:
    """Encodes the samples of one session as pb.State, serialised once for bus and log."""

    def __init__(self, scaling: Scaling, session: int) -> None:
        s = scaling
        self._scale = (s.i_offset_a, s.i_lsb_a, s.x_offset_m, s.x_lsb_m, s.u_offset_v, s.u_lsb_v)
        # Whole microseconds: tick * 0.002 and tick * 2000 / 1e6 differ in the last bit, and the second is right.
        self._sample_time_us = round(s.sample_time_s * 1e6)
        self._message = pb.State(session=session)

    def encode(self, sample: Sample, host_time_ns: int) -> bytes:
        """Return the serialised pb.State of `sample`, which arrived at `host_time_ns` (Unix time)."""
        i_offset, i_lsb, x_offset, x_lsb, u_offset, u_lsb = self._scale
        tick, _, lost_before, (sequence, i_c, x, u_c, x_ref, flags), _ = sample
        # One message object is reused: this takes half the time of a new one for each sample.
        m = self._message
        m.sequence = sequence
        m.tick = tick
        m.host_time_ns = host_time_ns
        m.i_c_a = i_offset + i_lsb * i_c
        m.x_m = x_offset + x_lsb * x
        m.u_c_v = u_offset + u_lsb * u_c
        m.x_ref_m = x_offset + x_lsb * x_ref
        m.mode = flags & 3  # type: ignore[assignment]  # the decoder lets no mode 3 pass
        m.flags = flags & 0xFC
        m.t_s = tick * self._sample_time_us / 1e6
        m.lost_before = lost_before
        return m.SerializeToString()


def parameters_message(
    parameters: Message, identity: Message, scaling: Scaling, *, session: int, host_time_ns: int
) -> pb.Parameters:
    """Return the board's answer to GET_PARAMETERS in SI units."""
    p, s = parameters.int, scaling
    units = s.gain_units(p("law"))
    gains = [p(f"k{n}_mantissa") * 2.0 ** -p(f"k{n}_shift") / units[n - 1] for n in range(1, 5)]
    return pb.Parameters(
        session=session,
        host_time_ns=host_time_ns,
        firmware=f"{identity.int('firmware_major')}.{identity.int('firmware_minor')}"
        f" {identity.bytes('build').decode('ascii', 'replace').strip()}",
        board_id=identity.int("board_id"),
        protocol_version=identity.int("version"),
        sample_time_s=s.sample_time_s,
        law=pb.LAW_LQI if p("law") == Law.LQI else pb.LAW_PID,
        gains=gains,
        i_0_a=s.i_a(p("i_0")),
        x_0_m=s.x_m(p("x_0")),
        u_0_v=s.u_v(p("u_0")),
        x_ref_min_m=s.x_m(p("x_ref_min")),
        x_ref_max_m=s.x_m(p("x_ref_max")),
        x_ref_step_max_m=p("x_ref_step") * abs(s.x_lsb_m),
        x_ref_slew_m_s=p("x_ref_slew") * abs(s.x_lsb_m),
        u_max_v=s.u_v(p("u_max")),
        stream_divider=p("divider"),
        host_loss_policy=p("policy"),
        host_loss_timeout_s=p("timeout") / 1e3,
        i_lsb_a=s.i_lsb_a,
        x_lsb_m=s.x_lsb_m,
        u_lsb_v=s.u_lsb_v,
        u_min_v=s.u_offset_v,
        from_tick=p("tick"),
        capture_s=_max_capture_samples(s) * s.capture_time_s,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class WireCommand:
    """A bus command, converted to fields of a UART message."""

    name: str
    values: dict[str, Value]
    note: str = ""  # text about rounding, for the reply


class _OutOfFieldError(Exception):
    """A value does not fit its field; never leaves this file."""


def to_wire(command: pb.Command, scaling: Scaling) -> WireCommand | Refusal:
    """Convert a command to its UART form; limits.py has checked that its numbers are finite and its oneof is set."""
    try:
        return _CONVERT[str(command.WhichOneof("what"))](command, scaling)
    except _OutOfFieldError as problem:
        return Refusal("out-of-range", f"{problem}.")


def _nearest(number: float) -> int:
    """Round to an integer; a value beyond all fields, even an infinite one, stays beyond them."""
    return round(min(max(number, -_EXACT_MAX), _EXACT_MAX))


def _count(value: float, offset: float, lsb: float, what: str, unit: str) -> int:
    count = _nearest((value - offset) / lsb)
    if not 0 <= count <= COUNTS_MAX:
        ends = sorted((offset, offset + lsb * COUNTS_MAX))
        raise _OutOfFieldError(
            f"{what} = {measured(value, unit)} is outside the converter's range,"
            f" {measured(ends[0], unit)} .. {measured(ends[1], unit)}"
        )
    return count


def _whole(value: float, unit_s: float, what: str, low: int, high: int) -> int:
    number = _nearest(value / unit_s)
    if not low <= number <= high:
        raise _OutOfFieldError(f"{what} {value:g} s is outside {low * unit_s:g} .. {high * unit_s:g} s")
    return number


def _set_mode(command: pb.Command, scaling: Scaling) -> WireCommand:
    if command.set_mode.mode not in (0, 1, 2):
        raise _OutOfFieldError(f"mode {command.set_mode.mode} is none of 0 idle, 1 open loop, 2 closed loop")
    return WireCommand(name="SET_MODE", values={"mode": int(command.set_mode.mode)})


def _set_reference(command: pb.Command, s: Scaling) -> WireCommand:
    x_ref = _count(command.set_reference.x_ref_m, s.x_offset_m, s.x_lsb_m, "x_ref", "m")
    return WireCommand(name="SET_REFERENCE", values={"x_ref": x_ref})


def _set_gains(command: pb.Command, s: Scaling) -> WireCommand:
    g = command.set_gains
    if g.law not in (0, 1) or len(g.gains) != 4:
        raise _OutOfFieldError(
            f"law {g.law} with {len(g.gains)} gains; law is 0 LQI or 1 PID, and there are four gains"
        )
    values: dict[str, Value] = {"law": int(g.law)}
    worst = 0.0
    for n, (gain, unit) in enumerate(zip(g.gains, s.gain_units(g.law), strict=True), 1):
        try:
            mantissa, shift = to_mantissa(gain * unit)
        except OverflowError:
            raise _OutOfFieldError(
                f"gain {n} = {gain:g} is above {MANTISSA_MAX / abs(unit):g}, the board's largest"
            ) from None
        if gain and not mantissa:
            raise _OutOfFieldError(
                f"gain {n} = {gain:g} becomes 0 on the board, whose smallest is {2.0**-SHIFT_MAX / abs(unit):.3g}:"
                " give 0, or a larger one"
            )
        values[f"k{n}_mantissa"], values[f"k{n}_shift"] = mantissa, shift
        if gain:
            worst = max(worst, abs(mantissa * 2.0**-shift / (gain * unit) - 1))
    values["i_0"] = _count(g.i_0_a, s.i_offset_a, s.i_lsb_a, "i_0", "A")
    values["x_0"] = _count(g.x_0_m, s.x_offset_m, s.x_lsb_m, "x_0", "m")
    values["u_0"] = _count(g.u_0_v, s.u_offset_v, s.u_lsb_v, "u_0", "V")
    return WireCommand(
        name="SET_GAINS", values=values, note=f"Rounding changed no gain by more than {worst:.1e} of it."
    )


def _excite(command: pb.Command, s: Scaling) -> WireCommand:
    e = command.excite
    shape = int(e.shape)
    if not 0 <= shape <= max(Shape):
        raise _OutOfFieldError(f"shape {shape} is none of 0 .. {max(Shape):d}")
    offset, lsb, unit = (s.x_offset_m, s.x_lsb_m, "m") if e.on_reference else (s.u_offset_v, s.u_lsb_v, "V")
    values: dict[str, Value] = {
        "shape": shape,
        "target": int(e.on_reference),
        "amplitude": 0,
        "offset": _count(e.offset, offset, lsb, "offset", unit),
        "period": 1,
        "period_end": 1,
        "seed": 1,
        "duration": 0,
    }
    if shape == Shape.NONE:
        what = "The reference" if e.on_reference else "u_c"
        return WireCommand(name="EXCITE", values=values, note=f"{what} stays at {e.offset:.6g} {unit}.")
    amplitude = _nearest(e.amplitude / lsb)
    if abs(amplitude) > COUNTS_MAX:
        raise _OutOfFieldError(
            f"amplitude = {measured(e.amplitude, unit)} is above {measured(COUNTS_MAX * abs(lsb), unit)}"
        )
    needs_period = shape in (Shape.RECTANGLE, Shape.SAWTOOTH, Shape.PRBS, Shape.MULTISINE, Shape.CHIRP)
    period = _whole(e.period_s, s.sample_time_s, "period", 1, _U16) if needs_period else 1
    period_end = _whole(e.period_end_s, s.sample_time_s, "period_end", 1, _U16) if shape == Shape.CHIRP else period
    seed = e.seed or 1
    if seed > _U16:
        raise _OutOfFieldError(f"seed {seed} is above {_U16}")
    if shape == Shape.CHIRP and e.duration_s == 0:
        raise _OutOfFieldError("a chirp needs a duration")
    # 0 ticks mean endless, so a shorter duration must not round to 0.
    duration = _whole(e.duration_s, s.sample_time_s, "duration", 1 if e.duration_s else 0, _U32)
    values |= {"amplitude": amplitude, "period": period, "period_end": period_end, "seed": seed, "duration": duration}
    return WireCommand(name="EXCITE", values=values)


def _max_capture_samples(s: Scaling) -> int:
    """Return the number of samples of the longest capture: the board's memory and the field of CAPTURE limit it."""
    return min(s.capture_size, 2000)


def _capture(command: pb.Command, s: Scaling) -> WireCommand:
    c = command.capture
    count = _whole(c.duration_s, s.capture_time_s, "duration", 1, _max_capture_samples(s))
    pre = _whole(c.pre_s, s.capture_time_s, "pre", 0, count)
    u_from = _count(c.u_from_v, s.u_offset_v, s.u_lsb_v, "u_from", "V")
    u_to = _count(c.u_to_v, s.u_offset_v, s.u_lsb_v, "u_to", "V")
    return WireCommand(name="CAPTURE", values={"u_from": u_from, "u_to": u_to, "pre": pre, "count": count})


def _set_stream(command: pb.Command, scaling: Scaling) -> WireCommand:
    divider = command.set_stream.divider
    if divider > 1000:
        raise _OutOfFieldError(f"divider {divider} is above 1000")
    return WireCommand(name="SET_STREAM", values={"divider": divider})


def _set_host_loss(command: pb.Command, scaling: Scaling) -> WireCommand:
    h = command.set_host_loss
    if h.policy > 2:
        raise _OutOfFieldError(f"policy {h.policy} is none of 0 keep, 1 coil off, 2 hold")
    timeout = _whole(h.timeout_s, 1e-3, "timeout", 50, 60000)
    return WireCommand(name="SET_HOST_LOSS", values={"policy": h.policy, "timeout": timeout})


_CONVERT: Mapping[str, Callable[[pb.Command, Scaling], WireCommand]] = {
    "set_mode": _set_mode,
    "set_reference": _set_reference,
    "set_gains": _set_gains,
    "excite": _excite,
    "capture": _capture,
    "set_stream": _set_stream,
    "set_host_loss": _set_host_loss,
    "stop": lambda _, _scaling: WireCommand(name="STOP", values={}),
    "ping": lambda _, _scaling: WireCommand(name="PING", values={}),
}
