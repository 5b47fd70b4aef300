"""The control loop between two converters: modes, reference, excitation, law, faults.  Counts in, counts out.

Rules 6 to 11 and the board's half of 12 and 13 of protocol/README.md.  `board.py` handles frames, ids and sessions,
`commands.py` the effect of commands on the loop.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from gateway.emulator.firmware_model.calibration import Calibration
from gateway.emulator.firmware_model.capture import FirmwareCapture
from gateway.emulator.firmware_model.excitation import Excitation
from gateway.emulator.firmware_model.flash import T_S_US, TICKS_PER_S, FlashLimits, Settings
from gateway.emulator.firmware_model.law import ControlLaw
from gateway.emulator.firmware_model.output import InputConverter, Output
from protocol.wire.messages import COUNTS_MAX, EventCode, Flag, HostLoss, Mode

HOST_LOSS_MS = 500
OVER_CURRENT_TICKS = 50
SENSOR_FAULT_TICKS = 500
TARGET_U, TARGET_X_REF = 0, 1
INPUT_LIMIT = 0  # detail of LIMIT_HIT
_INPUT_SATURATED, _POSITION_RANGE, _CURRENT_RANGE, _OVERRUN, _HOST_LOST, _FAULT = (int(flag) for flag in Flag)


class CountedEvent:
    """Counts what happened since the reset; its event is sent at most once per second: rule 16."""

    def __init__(self) -> None:
        self.count = 0
        self._ticks = TICKS_PER_S  # since the last event

    def pass_tick(self) -> None:
        """Note that a tick has passed."""
        self._ticks += 1

    def add(self) -> bool:
        """Count one more; return whether its event is sent."""
        self.count = min(self.count + 1, 0xFFFF)
        is_due = self._ticks >= TICKS_PER_S
        self._ticks = 0 if is_due else self._ticks
        return is_due


class Reference:
    """x_ref in force and the allowance for jumps: rule 7.

    The allowance is kept in counts times ticks per second, so that refilling it is one addition of an integer.
    """

    def __init__(self, x_ref: int, limits: FlashLimits) -> None:
        self.x_ref = x_ref
        self._limits = limits
        self._full = limits.x_ref_step * TICKS_PER_S
        self._allowance = self._full

    @property
    def allowance(self) -> int:
        """The largest jump that is accepted now, counts."""
        return self._allowance // TICKS_PER_S

    def refill(self) -> None:
        """Refill the allowance for one tick."""
        self._allowance = min(self._allowance + self._limits.x_ref_slew, self._full)

    def jump(self, x_ref: int) -> None:
        """Set the reference to `x_ref` and reduce the allowance by the jump."""
        self._allowance -= abs(x_ref - self.x_ref) * TICKS_PER_S
        self.x_ref = x_ref


@dataclass(frozen=True, slots=True, kw_only=True)
class Tick:
    """The values of one run of the loop, for STATE."""

    i: int
    x: int
    u: int
    x_ref: int
    flags: int


class ControlLoop:
    """The control loop between two resets; `emit` is called with code and detail of each event."""

    def __init__(
        self,
        emit: Callable[[EventCode, int], None],
        settings: Settings,
        converter: InputConverter,
        calibration: Calibration | None,
    ) -> None:
        self.stored_calibration = calibration
        self.calibration = calibration or Calibration()
        self.limits = settings.limits
        self.law = ControlLaw(settings.gains)
        self.reference = Reference(settings.gains.x_0, settings.limits)
        self.output = Output(converter)
        self.mode = Mode.IDLE
        self.fault = False
        self.host_lost = False
        self.overrun = False
        self.stack_broken = False
        self.gains_tick = 0
        self.excitation: Excitation | None = None
        self.capture: FirmwareCapture | None = None  # drives the coil from the next tick on
        self._emit = emit
        self._open_loop_u = 0
        self._u = 0  # what the mode says
        self._announced = False  # EXCITATION_DONE was sent
        self._over_current_ticks = 0
        self._sensor_ticks = 0
        self._limited = False
        self._limit_hits = CountedEvent()

    @property
    def u(self) -> int:
        """Count of the input converter, as far as it has confirmed it."""
        capture = self.capture
        due = capture is not None and not capture.has_ended and capture.step_is_due
        return capture.u_to if capture is not None and due else self.output.u

    @property
    def capturing(self) -> bool:
        """Return whether a capture drives the coil."""
        return self.capture is not None and not self.capture.has_ended

    @property
    def sampling(self) -> bool:
        """Return whether that capture has begun, at its tick."""
        return self.capture is not None and self.capture.begun and not self.capture.has_ended

    def set_mode(self, mode: Mode) -> None:
        """Enter `mode`, as SET_MODE does; the current mode is not entered again."""
        if mode == Mode.IDLE and self.capturing:
            self.capture = None
        if mode == self.mode:
            return
        self.end_excitation()
        self.mode = mode
        self._open_loop_u = 0
        self._limited = False
        self._sensor_ticks = 0
        self.law.reset()
        self._emit(EventCode.MODE_CHANGED, mode)

    def switch_off(self) -> None:
        """Switch the coil off at once, not at the next tick: mode idle, excitation and capture ended."""
        self.set_mode(Mode.IDLE)
        self._u = 0
        self.output.write(0)

    def end_capture(self) -> None:
        """Drive the coil as the mode says: all samples of the capture are taken."""
        self.output.write(self._u)
        self._emit(EventCode.CAPTURE_DONE, 0)

    def excite(self, excitation: Excitation) -> None:
        """Start an excitation at this tick."""
        self.excitation = excitation
        self._announced = excitation.has_ended

    def end_excitation(self) -> None:
        """End the excitation: the signal stays at its offset."""
        if self.excitation is not None and self.excitation.signal.target == TARGET_X_REF:
            self.reference.x_ref = self.excitation.signal.offset
        elif self.excitation is not None:
            self._open_loop_u = self.excitation.signal.offset
        self.excitation = None

    def set_reference(self, x_ref: int) -> None:
        """Set a reference that is already checked; it ends an excitation of the reference."""
        if self.excitation is not None and self.excitation.signal.target == TARGET_X_REF:
            self.excitation = None
        self.reference.jump(x_ref)

    def run(self, i: int, x: int) -> Tick:
        """Run one tick: from the counts of current and position, as read, to the count of the input."""
        x = self.calibration.corrected(x)
        self._watch(i, x)
        self._play()
        limited = False
        if self.mode == Mode.CLOSED_LOOP:
            self._u, limited = self.law.run(i, x, self.reference.x_ref)
        else:
            self._u = self._open_loop_u if self.mode == Mode.OPEN_LOOP else 0
        if self.capture is not None and not self.capture.begun:
            self.capture.begun = True
            self.output.write(self.capture.u_from)
        elif not self.capturing:
            self.output.write(self._u)
        self._report_limit(limited=limited)
        self.reference.refill()
        if self.output.is_unconfirmed():
            self._fail(EventCode.OUTPUT_FAULT, self.u)
        if self.output.is_bypassed(i):
            self._fail(EventCode.UNCOMMANDED_CURRENT, i)
        self.output.end_tick(capturing=self.capturing)
        return Tick(i=i, x=x, u=self.u, x_ref=self.reference.x_ref, flags=self._flags(i, x))

    def _play(self) -> None:
        if self.excitation is None:
            return
        if self.excitation.has_ended and not self._announced:
            self._announced = True
            self._emit(EventCode.EXCITATION_DONE, 0)
        value = self.excitation.next()
        if self.excitation.signal.target == TARGET_X_REF:
            self.reference.x_ref = value
        else:
            self._open_loop_u = value

    def _report_limit(self, *, limited: bool) -> None:
        self._limit_hits.pass_tick()
        if limited and not self._limited and self._limit_hits.add():
            self._emit(EventCode.LIMIT_HIT, INPUT_LIMIT)
        self._limited = limited

    def _watch(self, i: int, x: int) -> None:
        self._over_current_ticks = self._over_current_ticks + 1 if i == COUNTS_MAX else 0
        clipped = self.mode == Mode.CLOSED_LOOP and x in (0, COUNTS_MAX)
        self._sensor_ticks = self._sensor_ticks + 1 if clipped else 0
        if self.fault:
            return
        if self.stack_broken:
            self._fail(EventCode.STACK_FAULT, 0)
        elif self._over_current_ticks >= OVER_CURRENT_TICKS:
            self._fail(EventCode.OVER_CURRENT, i)
        elif self._sensor_ticks >= SENSOR_FAULT_TICKS:
            self._fail(EventCode.SENSOR_FAULT, x)

    def _fail(self, code: EventCode, count: int) -> None:
        self._emit(code, count)
        self.fault = True
        self.switch_off()

    def _flags(self, i: int, x: int) -> int:
        # Plain integers: combining IntFlag members costs more than the control law, 500 times a second.
        flags = int(self.mode)
        flags |= _INPUT_SATURATED if self._limited else 0
        flags |= _POSITION_RANGE if x in (0, COUNTS_MAX) else 0
        flags |= _CURRENT_RANGE if i == COUNTS_MAX else 0
        flags |= _OVERRUN if self.overrun else 0
        flags |= _HOST_LOST if self.host_lost else 0
        flags |= _FAULT if self.fault else 0
        self.overrun = False
        return flags


class HostWatch:
    """Acts on the loop when no frame of the host has come for `timeout_ms`: rule 10."""

    def __init__(self, loop: ControlLoop, emit: Callable[[EventCode, int], None]) -> None:
        self.policy = HostLoss.COIL_OFF
        self.timeout_ms = HOST_LOSS_MS
        self._loop, self._emit = loop, emit
        self._silent_us = 0

    def heard(self) -> None:
        """Note a frame of the host."""
        self._silent_us = 0
        if self._loop.host_lost:
            self._loop.host_lost = False
            self._emit(EventCode.HOST_BACK, 0)

    def watch(self) -> None:
        """Count one tick of silence; act once, when the host is lost."""
        self._silent_us += T_S_US
        if self._loop.host_lost or self._silent_us < self.timeout_ms * 1000:
            return
        self._loop.host_lost = True
        self._emit(EventCode.HOST_LOST, self.policy)
        if self.policy == HostLoss.HOLD and self._loop.mode == Mode.CLOSED_LOOP:
            self._loop.end_excitation()
        elif self.policy != HostLoss.KEEP:
            self._loop.switch_off()
