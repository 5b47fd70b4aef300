"""A board at the end of a line: firmware, baud rate, link faults, port; some ticks at a time.

Rule 1: the bytes of a tick pass together at its start, up to what the baud rate lets through in T_s.  So nothing is
        ever sent faster than the line, and a byte comes at most T_s too early.
Rule 2: what the board sends in ticks that run together reaches the port at once, at their end, as an adapter with a
        latency timer sends it.
Rule 3: towards the board each byte has its own time within the tick, so that STOP acts when its last byte is in.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

from gateway.emulator.faults import CLOCK, CODES, EVENTS, OUTPUTS, WIRING, Fault, FaultyLine
from gateway.emulator.firmware_model.flash import T_S_US
from gateway.emulator.firmware_model.output import OutputFault
from gateway.emulator.firmware_model.uart import Pacer
from gateway.emulator.ports import EmulatedPort
from gateway.emulator.wiring import FaultyWiring
from protocol.wire.messages import EventCode, Mode

_T_S = T_S_US * 1e-6


class Board(Protocol):
    """A board's firmware, in Python (`firmware_model/board.py`) or in C (`native/board.py`)."""

    @property
    def dropped(self) -> int:
        """The number of frames for which the line had no time, since power-on."""

    @property
    def bad_frames(self) -> int:
        """The number of frames rejected since the reset."""

    @property
    def mode(self) -> Mode:
        """The mode in force."""

    def feed(self, data: bytes, *, into_tick_us: int = 0) -> None:
        """Process bytes from the host, `into_tick_us` after the last tick; never raises."""

    def tick(self) -> None:
        """Advance the plant by T_s with the input held, then run the loop once."""

    def take_frame(self) -> bytes:
        """Return the next frame for the line, or b""."""

    def reset(self, cause: EventCode) -> None:
        """Restart the board."""

    def hang(self) -> None:
        """Hang the program until the watchdog resets the board."""

    def overrun(self) -> None:
        """Let the board report the next tick as late."""

    def break_stack(self) -> None:
        """Overwrite the end of the stack, until the next reset."""

    def fail_output(self, fault: OutputFault) -> None:
        """Let the converter of u_c fail from now on, or work again."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LineCounts:
    """The counters of one board's line since power-on."""

    time_s: float
    bytes_sent: int  # by the board, before faults
    bytes_received: int  # by the board, after faults
    bytes_not_taken: int  # no host is connected, or it does not read
    bytes_damaged: int  # by faults, both directions
    frames_dropped: int  # the board's queues were full: the line is too slow


class BoardLine:
    """An emulated board with its line of `baud` bits per second and its port, which is opened here."""

    def __init__(
        self,
        firmware: Board,
        port: EmulatedPort,
        *,
        baud: int = 115200,
        faults: Iterable[Fault] = (),
        seed: int = 0,
        wiring: FaultyWiring | None = None,
    ) -> None:
        self.firmware = firmware
        self.port = port
        self._faults = list(faults)
        self._wiring = wiring
        self._ahead = 0.0  # of a tick, by a clock that is wrong
        self._wires = {direction: FaultyLine(direction, seed) for direction in ("tx", "rx")}
        self._pacers = {direction: Pacer(baud) for direction in ("tx", "rx")}
        self._ticks = 0
        self._rest = b""  # of the frame on the line
        self._collected = bytearray()  # sent, and not yet at the port
        self._asks = True  # the port for bytes: until it has none, in ticks that run together
        self._output_fault = OutputFault.NONE
        self._plugged = True
        self._disconnected = False
        self._renames = False  # the port opens under its other name
        self._sent = self._received = self._undelivered = 0
        port.open()

    @property
    def time_s(self) -> float:
        """The time of the board since power-on."""
        return self._ticks * _T_S

    @property
    def counts(self) -> LineCounts:
        """Return the counters."""
        return LineCounts(
            time_s=self.time_s,
            bytes_sent=self._sent,
            bytes_received=self._received,
            bytes_not_taken=self._undelivered,
            bytes_damaged=sum(wire.damaged for wire in self._wires.values()),
            frames_dropped=self.firmware.dropped,
        )

    def inject(self, fault: Fault) -> None:
        """Add a fault whose START counts from now."""
        self._faults.append(fault.shifted(self.time_s))

    def disconnect(self) -> None:
        """Close the port until `reconnect`."""
        self._disconnected = True
        self._follow_plug()

    def reconnect(self, *, renamed: bool = False) -> None:
        """Open the port again."""
        self._disconnected = False
        self._follow_plug(renamed=renamed)

    def power_cycle(self) -> None:
        """Interrupt the board's power for a moment; a frame on the line is cut off."""
        self.firmware.reset(EventCode.RESET_POWER_ON)
        self._rest = b""

    def step(self, ticks: int = 1, *, wait_s: float = 0.0) -> None:
        """Run ticks; the board waits at most `wait_s` for a slow host (0: real time, no waiting).

        With a wrong clock each is none, one or two.
        """
        self._asks = True
        for _ in range(ticks):
            if self._faults:
                self._step_with_faults()
            else:
                self._tick()
        self._deliver(wait_s)

    def _step_with_faults(self) -> None:
        rates = [fault.value for fault in self._faults if fault.name in CLOCK and fault.active(self.time_s)]
        self._ahead += (rates[-1] if rates else 1.0) - 1.0
        due = 1 + math.floor(self._ahead)
        self._ahead -= due - 1
        for _ in range(due):
            self._suffer()
            self._tick()

    def _tick(self) -> None:
        time_s = self.time_s
        self._receive(time_s)
        self.firmware.tick()
        self._ticks += 1
        self._send(time_s)

    def close(self) -> None:
        """Close the port."""
        self.port.close()

    def _suffer(self) -> None:
        now, until = self.time_s - _T_S / 2, self.time_s + _T_S / 2  # so that rounding never misses or doubles a time
        events = {
            "reset": self.power_cycle,
            "watchdog": self.firmware.hang,
            "stack": self.firmware.break_stack,
            "overrun": self.firmware.overrun,
        }
        for fault in self._faults:
            if fault.name in EVENTS and fault.happens(now, until):
                events[fault.name]()
        active = [fault for fault in self._faults if fault.active(self.time_s)]
        self._follow_output({fault.name for fault in active})
        if self._wiring is not None:
            self._wiring.follow([fault for fault in active if fault.name in WIRING | CODES])
        self._follow_plug()

    def _follow_output(self, names: set[str]) -> None:
        now = next((OutputFault[name.upper()] for name in OUTPUTS if name in names), OutputFault.NONE)
        if now != self._output_fault:
            self._output_fault = now
            self.firmware.fail_output(now)

    def _follow_plug(self, *, renamed: bool = False) -> None:
        active = [fault for fault in self._faults if fault.name == "disconnect" and fault.active(self.time_s)]
        plugged = not active and not self._disconnected
        if plugged == self._plugged:
            return
        self._plugged = plugged
        self._deliver(0.0)
        if plugged:
            self.port.open(renamed=renamed or self._renames)
        else:
            self._renames = any(fault.option == "renamed" for fault in active)
            self.port.close()

    def _receive(self, time_s: float) -> None:
        pacer = self._pacers["rx"]
        room = pacer.allow(T_S_US)
        data = b""
        if room and self._asks:
            data = self.port.read(room)
            self._asks = bool(data)
        pacer.spend(len(data), more=len(data) == room)
        data = self._wires["rx"].convey(data, time_s, self._faults)
        self._received += len(data)
        for n in range(len(data)):
            self.firmware.feed(data[n : n + 1], into_tick_us=(n + 1) * pacer.byte_us)

    def _send(self, time_s: float) -> None:
        pacer = self._pacers["tx"]
        room = pacer.allow(T_S_US)
        while len(self._rest) < room and (frame := self.firmware.take_frame()):
            self._rest += frame
        data, self._rest = self._rest[:room], self._rest[room:]
        pacer.spend(len(data), more=len(data) == room)
        self._sent += len(data)
        self._collected += self._wires["tx"].convey(data, time_s, self._faults)

    def _deliver(self, wait_s: float) -> None:
        if self._collected:
            data = bytes(self._collected)
            self._collected.clear()
            self._undelivered += len(data) - self.port.write(data, wait_s)
