"""The board's firmware: processes bytes from the host, runs the control loop, sends frames.  No I/O, clock or threads.

    firmware = Firmware(EmulatedPlant(), board_id=1)
    firmware.feed(frame)               # between two ticks
    firmware.tick()                    # T_s of plant time, then one run of the loop
    line.write(firmware.take_frame())

Every rule of 'Behaviour of the board' in protocol/README.md holds here; this file has 1, 2, 4, 5 and 13,
`answers.py` has 3, `control_loop.py` and `commands.py` have the others.
"""

from __future__ import annotations

from collections import deque
from typing import Protocol

from gateway.emulator.firmware_model.answers import Answers
from gateway.emulator.firmware_model.calibration import Calibration
from gateway.emulator.firmware_model.commands import HANDLERS, Nack, acknowledge, identity, parameters, refuse_range
from gateway.emulator.firmware_model.control_loop import ControlLoop, CountedEvent, HostWatch, Tick
from gateway.emulator.firmware_model.flash import (
    BOOT_TICKS,
    CE152_BOARD,
    T_S_US,
    WATCHDOG_TICKS,
    BoardProfile,
    Settings,
)
from gateway.emulator.firmware_model.output import InputConverter, OutputFault
from gateway.emulator.firmware_model.uart import Inbox, Outbox, Priority
from protocol.wire.codec import decode_body, encode_body, pack_pair
from protocol.wire.framing import encode_frame
from protocol.wire.messages import (
    NOT_KNOWN,
    ROW_OF_NAME,
    ROW_OF_TYPE,
    VERSION,
    EventCode,
    HostLoss,
    Message,
    Mode,
    Reason,
)

PENDING_COMMANDS = 8
COMMANDS_PER_TICK = 1
_PLANT_STEP_US = 20
_STATE_TYPE = bytes((ROW_OF_NAME["STATE"].type,))
_WITHOUT_SESSION = {"HELLO", "PING", "STOP"}
_REVOKED = {"SET_MODE", "CAPTURE"}  # by a STOP: they could turn the coil on again


class AnalogSide(Protocol):
    """The analog side of the converters; `plant.EmulatedPlant` implements it."""

    def advance(self, u_v: float, duration_s: float) -> None:
        """Advance the time with the input's pin held."""

    def sense(self) -> tuple[float, float]:
        """Return what the pins of i_c and x carry: A and m, or as the board's profile says."""

    def drop_sample(self) -> bool:
        """Return whether this tick's STATE is lost on the board."""


class Firmware:
    """A board, powered on; it advances the time of its plant, and `board_id` is the serial number in IDENTITY."""

    def __init__(self, plant: AnalogSide, *, board_id: int = 1, profile: BoardProfile = CE152_BOARD) -> None:
        self._plant = plant
        self._profile = profile
        self._board_id = board_id
        self._stored = profile.settings
        self._converter = InputConverter()
        self.outbox = Outbox()
        self._resets = 0
        self._elapsed_us = 0  # plant time since the last tick
        self._boot(EventCode.RESET_POWER_ON, None)

    def _boot(self, cause: EventCode, calibration: Calibration | None) -> None:
        self.next_tick = 0
        self.outbox.clear()
        self._inbox = Inbox()
        self._pending: deque[tuple[bytes, Message | Nack, bool]] = deque()  # and whether a STOP has overtaken it
        self._commands_left = COMMANDS_PER_TICK  # to execute before the next tick
        self._answers = Answers(self.outbox)
        self._unanswered = CountedEvent()
        self._session: int | None = None
        self._divider = 1
        self._events = 0
        self._overruns = CountedEvent()
        self._reset_cause = cause
        self._reset_wait = 0  # ticks left to get the ACK of RESET out; 0: no reset pending
        self._hung_ticks = 0
        self._dead_ticks = 0
        field = self._stored.first_bad_field()
        settings = self._profile.settings if field else self._stored
        self.loop = ControlLoop(self._emit, settings, self._converter, calibration)
        self._host = HostWatch(self.loop, self._emit)
        self._emit(cause, self._resets)
        if field:
            self._emit(EventCode.SETTINGS_REJECTED, field)

    def reset(self, cause: EventCode) -> None:
        """Restart: coil off, no output during the boot, then tick 0; a power cycle also clears the count of resets."""
        self._resets = 0 if cause == EventCode.RESET_POWER_ON else min(self._resets + 1, 0xFFFF)
        if cause == EventCode.RESET_POWER_ON:
            self._converter.count = 0  # the converter's own power-on value
        self._boot(cause, self.loop.stored_calibration)
        self._dead_ticks = BOOT_TICKS

    def hang(self) -> None:
        """Hang the program: no loop, no answers, u_c unchanged, until the watchdog resets the board."""
        self._hung_ticks = WATCHDOG_TICKS

    def overrun(self) -> None:
        """Let the board report the next tick as late."""
        self.loop.overrun = True
        if self._overruns.add():
            self._emit(EventCode.OVERRUN, 0)

    def break_stack(self) -> None:
        """Overwrite the end of the board's stack, until its next reset."""
        self.loop.stack_broken = True

    def fail_output(self, fault: OutputFault) -> None:
        """Let the converter of u_c fail from now on, or work again."""
        self._converter.fault = fault

    def store(self, settings: Settings) -> None:
        """Write the memory of gains, operating point and limits, which the board reads at its next boot."""
        self._stored = settings

    def feed(self, data: bytes, *, into_tick_us: int = 0) -> None:
        """Process bytes from the host, `into_tick_us` after the last tick; never raises."""
        if self._hung_ticks or self._dead_ticks:
            return
        if self.loop.sampling:  # a capture's end comes before what these bytes bring
            self._advance_to(min(into_tick_us, T_S_US) // _PLANT_STEP_US * _PLANT_STEP_US)
        self._execute_pending()
        for body in self._inbox.feed(data):
            self._receive(body, min(into_tick_us, T_S_US))
        self._execute_pending()

    def tick(self) -> None:
        """Advance the plant by T_s with the input held, then run the loop once."""
        self._advance_to(T_S_US)
        self._elapsed_us = 0
        if self._dead_ticks:
            self._dead_ticks -= 1
            return
        if self._hung_ticks:
            self._hung_ticks -= 1
            if not self._hung_ticks:
                self.reset(EventCode.RESET_WATCHDOG)
            return
        i_pin, x_pin = self._plant.sense()
        # The plant decides at every tick, not at every frame: the loss belongs to the board, not to the divider.
        lost = self._plant.drop_sample()
        self._execute_pending()
        if self._reset_wait and self._leave():
            return
        self._host.watch()
        state = self.loop.run(self._profile.current_count(i_pin), self._profile.position_count(x_pin))
        if self._divider and self.next_tick % self._divider == 0 and not lost:
            self.outbox.put(_state_frame(self.next_tick, state), Priority.STATE)
        self.next_tick = self.next_tick + 1 & 0xFFFFFFFF
        self._overruns.pass_tick()
        self._unanswered.pass_tick()
        self._commands_left = COMMANDS_PER_TICK
        self._execute_pending()

    def take_frame(self) -> bytes:
        """Return the next frame for the line, or b""."""
        return b"" if self._dead_ticks else self.outbox.take()

    @property
    def u(self) -> int:
        """Count of the input converter."""
        return self._converter.count

    @property
    def mode(self) -> Mode:
        """The mode in force."""
        return self.loop.mode

    @property
    def dropped(self) -> int:
        """The number of frames for which the line had no time, since power-on."""
        return self.outbox.dropped

    @property
    def bad_frames(self) -> int:
        """The number of frames rejected since the reset."""
        return self._inbox.bad_frames

    def _advance_to(self, time_us: int) -> None:
        """Advance the plant to this time after the last tick, taking capture samples on the way."""
        loop = self.loop
        while self._elapsed_us < time_us:
            step_us = time_us - self._elapsed_us
            # A program that hangs leaves u_c as it is, in a capture, too.
            capture = loop.capture if loop.sampling and not self._hung_ticks else None
            if capture is not None:
                if capture.wait_us == 0:
                    i_pin, _ = self._plant.sense()
                    capture.take(self._profile.current_count(i_pin), loop.output.write)
                step_us = min(step_us, capture.wait_us)
            self._plant.advance(self._profile.input_pin(self.u), step_us * 1e-6)
            self._elapsed_us += step_us
            if capture is not None:
                capture.wait_us -= step_us
                if capture.has_ended:
                    loop.end_capture()
                    self._execute_pending()

    def _receive(self, body: bytes, into_tick_us: int) -> None:
        command = _command(body)
        if command is None:
            self._inbox.count_bad()
            return
        self._host.heard()
        if isinstance(command, Message) and command.name == "STOP":
            self._advance_to(into_tick_us // _PLANT_STEP_US * _PLANT_STEP_US)
            self._pending = deque((*waiting[:2], True) for waiting in self._pending)
            self.loop.switch_off()
            if self._reset_wait:
                return
            answer: Message | Nack = acknowledge(body[0], self.next_tick)
        elif len(self._pending) < PENDING_COMMANDS:
            self._pending.append((body, command, False))
            return
        else:
            answer = Nack(Reason.BUSY)
        if self._answers.has_room(body):
            self._answers.put(body, answer, keep=isinstance(answer, Message))
        else:
            self._leave_unanswered()

    def _leave_unanswered(self) -> None:
        self._inbox.count_bad()
        if self._unanswered.add():
            self._emit(EventCode.OVERLOAD, self._unanswered.count)

    def _execute_pending(self) -> None:
        """Execute what waits, as far as the tick's budget and the room for answers go; none after a RESET."""
        while self._pending and self._commands_left and self._answers.has_room(self._pending[0][0]):
            if self._reset_wait:
                return
            body, command, is_overtaken = self._pending.popleft()
            self._commands_left -= 1
            if isinstance(command, Message) and command.name == "HELLO":
                self._answers.put(body, self._hello(command), keep=False)
            elif self._answers.repeat(body):
                continue
            elif isinstance(command, Nack):
                # Not kept: noise at the end of a good frame may leave the CRC right and the length wrong, and the
                # repetition of that command must not meet the noise again.
                self._answers.put(body, command, keep=False)
            elif self._session is None and command.name not in _WITHOUT_SESSION:
                self._answers.put(body, Nack(Reason.NO_SESSION), keep=False)
            elif is_overtaken and command.name in _REVOKED:
                self._answers.put(body, Nack(Reason.BUSY))
            else:
                self._answers.put(body, self._execute(command))

    def _execute(self, message: Message) -> Message | Nack:
        row, tick = ROW_OF_NAME[message.name], self.next_tick
        match message.name:
            case "PING":
                counts = {"bad_frames": self.bad_frames, "overruns": self._overruns.count}
                return Message("PONG", {"tick": tick, **counts})
            case "SET_STREAM":
                self._divider = message.int("divider")
            case "SET_HOST_LOSS":
                self._host.policy, self._host.timeout_ms = HostLoss(message.int("policy")), message.int("timeout")
            case "GET_PARAMETERS":
                return parameters(self.loop, self._divider, self._host.policy, self._host.timeout_ms)
            case "GET_HEALTH":  # a model has no stack of its own, and its converter no memory
                free = 0 if self.loop.stack_broken else NOT_KNOWN
                return Message("HEALTH", {"stack_free": free, "u_power_on": NOT_KNOWN})
            case "RESET":
                self._reset_wait = WATCHDOG_TICKS  # a line that never takes the ACK must not prevent the reset
            case _:
                if (answer := HANDLERS[message.name](self.loop, message, tick)) is not None:
                    return answer
        return acknowledge(row.type, tick)

    def _hello(self, message: Message) -> Message | Nack:
        if not message.int("version_min") <= VERSION <= message.int("version_max"):
            return Nack(Reason.VERSION, VERSION)
        if message.int("session") != self._session:
            self._session = message.int("session")
            self._answers.forget()
        return identity(self._board_id, self.next_tick, self._reset_cause, self._profile)

    def _leave(self) -> bool:
        """Return whether an acknowledged RESET is due."""
        self._reset_wait -= 1
        if self._reset_wait and self.outbox.waiting(Priority.ANSWER):
            return False
        self.reset(EventCode.RESET_COMMANDED)
        return True

    def _emit(self, code: EventCode, detail: int) -> None:
        body = encode_body("EVENT", number=self._events & 0xFF, tick=self.next_tick, code=int(code), detail=int(detail))
        self._events += 1
        self.outbox.put(encode_frame(body), Priority.EVENT)


def _command(body: bytes) -> Message | Nack | None:
    """Return the command, or its refusal; None if it is not from the host or has no id: it gets no answer."""
    row = ROW_OF_TYPE.get(body[0])
    if len(body) < 2 or body[1] == 0 or (row is not None and not row.to_board):
        return None
    decoded = decode_body(body)
    if isinstance(decoded, Message):
        return decoded
    reason = {"type": Reason.UNKNOWN_TYPE, "length": Reason.BAD_LENGTH}.get(decoded)
    return refuse_range(body) if reason is None else Nack(reason)


def _state_frame(tick: int, state: Tick) -> bytes:
    # Packed by hand: this runs 500 times a second for each board.
    sequence = (tick & 0xFFFF).to_bytes(2, "little")
    counts = pack_pair(state.i, state.x) + pack_pair(state.u, state.x_ref)
    return encode_frame(_STATE_TYPE + sequence + counts + bytes((state.flags,)))
