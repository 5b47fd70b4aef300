"""An ATmega328P on an Arduino Uno that runs the firmware in C (`firmware/avr`), in libsimavr.

    board = AvrBoard(EmulatedPlant(), board_id=1)

Rule 1: time is that of the chip's cycles.  The plant follows in its own steps of 20 us, whenever the chip begins
        a conversion or changes u_c.  A reading is that of its instant, and converters and bus take the chip's time.
Rule 2: nothing of the firmware is here.  What a fault does, it does to the chip: power, program counter, EEPROM, pins.
"""

from __future__ import annotations

import ctypes
import struct
from binascii import crc_hqx
from collections import deque
from ctypes import POINTER, c_char_p, c_uint8, c_uint16, c_uint32, c_uint64
from functools import cache
from pathlib import Path

from firmware.sim.avr.build import Image, image, simulator
from gateway.emulator.firmware_model.board import AnalogSide
from gateway.emulator.firmware_model.flash import CE152_BOARD, T_S_US, BoardProfile
from gateway.emulator.firmware_model.output import OutputFault
from protocol.errors import ServiceError
from protocol.wire.framing import cobs_decode
from protocol.wire.messages import ROW_OF_NAME, EventCode, Mode

ADC_BITS = 10
CYCLES_PER_US = 16
CYCLES_PER_TICK = T_S_US * CYCLES_PER_US
_PLANT_STEP_US = 20
_CURRENT_PIN = 2  # A2, firmware/avr/target.h
_POSITION_PIN = 3
_OUTPUT_SIZE = 4096
_RAM_PATTERN = 0xC5  # after power-on, no mode
_TIME_IS_OVER, _CONVERSION, _INPUT_CHANGED, _CRASHED = range(4)
_STATE = ROW_OF_NAME["STATE"].type
_LOST_FOR = 16  # ticks that a STATE may wait in its queue


class _Chip(ctypes.Structure):
    """struct chip of simavr.c, as far as it is used."""

    _fields_ = (
        ("cycle", c_uint64),
        ("slept", c_uint64),
        ("memory", POINTER(c_uint8)),
        ("sent_count", c_uint32),
        ("u", c_uint16),
        ("channel", c_uint8),
        ("output_fault", c_uint8),
        ("acknowledge_at", c_uint64),
        ("held", c_uint16),
        ("held_by_reset", c_uint16),
        ("bit_cycles", c_uint16),
        ("broken", c_uint16),
        ("watched_byte", c_uint8),
        ("dead_converter", c_uint8),
        ("stored", c_uint16),
        ("sent", c_uint8 * _OUTPUT_SIZE),
    )


@cache
def _load(path: Path) -> ctypes.CDLL:
    library = ctypes.CDLL(str(path))
    chip = POINTER(_Chip)
    for name, result, arguments in (
        ("chip_open", chip, (c_char_p, c_uint32)),
        ("chip_close", None, (chip,)),
        ("chip_reset", None, (chip, c_uint8, c_uint8)),
        ("chip_run", c_uint8, (chip, c_uint64)),
        ("chip_convert", None, (chip, c_uint8, c_uint16)),
        ("chip_receive", None, (chip, c_uint8)),
        ("chip_jump", c_uint32, (chip, c_uint32)),
        ("chip_go_on", None, (chip, c_uint32, c_uint32)),
        ("chip_store", None, (chip, c_char_p, c_uint16)),
        ("chip_untouched", c_uint16, (chip, c_uint16)),
    ):
        function = getattr(library, name)
        function.restype = result
        function.argtypes = arguments
    return library


def stored(board_id: int, profile: BoardProfile = CE152_BOARD) -> bytes:
    """Return the content of the EEPROM (firmware/avr/store.c): identity and settings, each with its CRC."""
    parts = (profile.identity(board_id, ADC_BITS), profile.settings.packed())
    return b"".join(part + crc_hqx(part, 0xFFFF).to_bytes(2, "little") for part in parts)


class AvrBoard:
    """A board with an ATmega328P, powered on.

    Args:
        plant: Analog side; the chip advances its time.
        board_id: Serial number in the EEPROM.
        baud: Of the UART, bits per second.
        profile: Scalings, gains and limits, and what lies between the plant and the chip's pins.
        program: The image; None: the firmware of `firmware/avr` for this profile, compiled if it is not yet.

    Raises:
        InstallError: avr-gcc or libsimavr is missing.
        UsageError: the chip does not give the baud rate.
        ServiceError: a compiler fails.
    """

    def __init__(
        self,
        plant: AnalogSide,
        *,
        board_id: int = 1,
        baud: int = 115200,
        profile: BoardProfile = CE152_BOARD,
        program: Image | None = None,
    ) -> None:
        self._plant = plant
        self._profile = profile
        self._library = _load(simulator())
        self.image = image(baud, profile.program) if program is None else program
        self._chip = self._library.chip_open(self.image.code, len(self.image.code))
        self._view: _Chip = self._chip.contents
        self._fields = struct.unpack_from("<5H", self.image.code, self.image.symbols["B51_VIEW"])
        self._ticks = 0  # of the emulator
        self._plant_steps = 0
        self._u = 0  # that the plant has had so far
        self._lost: deque[int] = deque()  # ticks whose STATE the board loses
        self._held = b""  # of a frame that may be lost
        self._loop = self.image.symbols["__stop_program"]  # of avr-libc: an endless loop
        self._held_ticks = 0  # left of `overrun`
        self._go_on_at = 0
        self.store(stored(board_id, profile))
        self.reset(EventCode.RESET_POWER_ON)

    def __del__(self) -> None:
        if hasattr(self, "_chip"):
            self._library.chip_close(self._chip)

    def reset(self, cause: EventCode) -> None:
        """Reset the chip: power on with RAM lost and u_c at 0, or as its watchdog does it."""
        self._restart(power=cause == EventCode.RESET_POWER_ON, brown_out=False)

    def brown_out(self) -> None:
        """Reset the chip by a dip of its supply: RAM is lost, and the converter keeps its output."""
        self._restart(power=False, brown_out=True)

    def hang(self) -> None:
        """Hang the program: an endless loop, until the watchdog resets the chip."""
        self._library.chip_jump(self._chip, self._loop)
        self._held_ticks = 0

    def overrun(self, ticks: int = 2) -> None:
        """Hold the program for some ticks, as work that takes too long would; interrupts are served."""
        if not self._held_ticks:
            self._held_ticks = ticks
            self._go_on_at = self._library.chip_jump(self._chip, self._loop)

    def store(self, content: bytes) -> None:
        """Write the EEPROM; the firmware reads it after the next reset."""
        self._library.chip_store(self._chip, content, len(content))

    def connect(self, plant: AnalogSide) -> None:
        """Put another plant behind the converters."""
        self._plant = plant

    def fail_output(self, fault: OutputFault) -> None:
        """Let the converter of u_c fail from now on, or work again; its output stays as it is."""
        self._view.output_fault = int(fault)

    def fail_conversion(self) -> None:
        """Let no conversion end from now on."""
        self._view.dead_converter = 1

    def reset_in_acknowledge(self, byte: int, *, held: int = 1) -> None:
        """Reset the chip as its watchdog does, while the converter acknowledges this byte of a write of u_c.

        Args:
            byte: Of the message, 1 to 3; 1 is its address.
            held: Falls of SCL until the converter lets SDA go.
        """
        view = self._view
        view.watched_byte, view.held_by_reset = byte, held
        while view.watched_byte:
            self.run_for(1)
        self._run_to(view.acknowledge_at + CYCLES_PER_US)
        self._restart(power=False, brown_out=False)

    def hold_bus(self, falls: int) -> None:
        """Let the converter hold SDA low from now on, for this number of falls of SCL; 0: release it."""
        self._view.held = falls

    def slow_bus(self, bit_us: int) -> None:
        """Let a bit on the converter's bus take this long from now on."""
        self._view.bit_cycles = bit_us * CYCLES_PER_US

    def store_input(self, count: int) -> None:
        """Write the EEPROM of the converter of u_c: what it gives after power-on."""
        self._view.stored = count

    @property
    def stored_input(self) -> int:
        """What the converter of u_c gives after power-on."""
        return int(self._view.stored)

    def break_stack(self) -> None:
        """Overwrite the end of the stack's room, as a stack that is too deep would."""
        self._view.memory[self.image.ram("_end")] ^= 0xFF

    @property
    def broken_writes(self) -> int:
        """The number of messages on the converter's bus within which another one began."""
        return int(self._view.broken)

    def feed(self, data: bytes, *, into_tick_us: int = 0) -> None:
        """Put bytes on the chip's RX pin, `into_tick_us` after the last tick; never raises."""
        self._run_to(self._ticks * CYCLES_PER_TICK + min(into_tick_us, T_S_US) * CYCLES_PER_US)
        for byte in data:
            self._library.chip_receive(self._chip, byte)

    def tick(self) -> None:
        """Let T_s pass."""
        self._ticks += 1
        self._run_to(self._ticks * CYCLES_PER_TICK)
        if self._held_ticks:
            self._held_ticks -= 1
            if not self._held_ticks:
                self._library.chip_go_on(self._chip, self._loop, self._go_on_at)

    def run_for(self, time_us: int) -> None:
        """Let some of a tick pass; the next `tick` ends where it would have ended."""
        self._run_to(self.cycle + time_us * CYCLES_PER_US)

    def take_frame(self) -> bytes:
        """Return what the chip has sent since the last call, or b""."""
        view = self._view
        sent = self._held + bytes(view.sent[: view.sent_count])
        view.sent_count = 0
        self._held = b""
        return self._without_lost(sent) if self._lost else sent

    @property
    def u(self) -> int:
        """Count of the input converter."""
        return int(self._view.u)

    @property
    def mode(self) -> Mode:
        """The mode in force."""
        return Mode(self._number(3, 1))

    @property
    def dropped(self) -> int:
        """The number of frames for which the line had no time, since the reset."""
        return self._number(1, 4)

    @property
    def bad_frames(self) -> int:
        """The number of frames rejected since the reset."""
        return self._number(2, 2)

    @property
    def next_tick(self) -> int:
        """The number of the tick that comes next."""
        return self._number(0, 4)

    @property
    def cycle(self) -> int:
        """The cycles since the start, as of the last event."""
        return int(self._view.cycle)

    @property
    def cycles_awake(self) -> int:
        """The cycles in which the chip has not slept, since the start."""
        return int(self._view.cycle - self._view.slept)

    @property
    def stack_free(self) -> int:
        """The bytes of RAM that neither variables nor the stack have used since the reset."""
        return int(self._library.chip_untouched(self._chip, self.image.ram("_end")))

    def _restart(self, *, power: bool, brown_out: bool) -> None:
        self._library.chip_reset(self._chip, power, brown_out)
        self._held = b""
        self._held_ticks = 0

    def _number(self, field: int, size: int) -> int:
        """A field of `struct board`; 0 until start-up has cleared the RAM."""
        board = self.image.ram("b51_board")
        if self._view.memory[board + self._fields[3]] == _RAM_PATTERN:
            return 0
        at = board + self._fields[field]
        return int.from_bytes(bytes(self._view.memory[at : at + size]), "little")

    def _run_to(self, cycle: int) -> None:
        while (event := self._library.chip_run(self._chip, cycle)) != _TIME_IS_OVER:
            if event == _CRASHED:
                raise ServiceError("The simulated chip has crashed", remedy="Report it with the command line")
            self._advance_plant()
            if event == _CONVERSION:
                self._convert(self._view.channel)
            self._u = self._view.u
        self._advance_plant()

    def _advance_plant(self) -> None:
        steps = self._view.cycle // (_PLANT_STEP_US * CYCLES_PER_US) - self._plant_steps
        if steps > 0:
            self._plant.advance(self._profile.dac_pin(self._u), steps * _PLANT_STEP_US * 1e-6)
            self._plant_steps += steps

    def _convert(self, pin: int) -> None:
        i_pin, x_pin = self._plant.sense()
        of_current = pin == _CURRENT_PIN
        code = self._profile.adc_code(i_pin if of_current else x_pin, current=of_current)
        self._library.chip_convert(self._chip, pin, code)
        if pin == _POSITION_PIN:
            tick = self.next_tick
            while self._lost and not 0 <= tick - self._lost[0] < _LOST_FOR:
                self._lost.popleft()
            if self._plant.drop_sample():
                self._lost.append(tick)

    def _without_lost(self, sent: bytes) -> bytes:
        """Remove the STATEs that the board loses; hold back a frame that has not ended."""
        sequences = {tick & 0xFFFF for tick in self._lost}
        passed = b""
        while sent.startswith(b"\0") and (end := sent.find(b"\0", 1)) > 0:
            body = cobs_decode(sent[1:end])
            if not (body and body[0] == _STATE and int.from_bytes(body[1:3], "little") in sequences):
                passed += sent[: end + 1]
            sent = sent[end + 1 :]
        if not sent.startswith(b"\0"):  # the rest of a frame that began before
            return passed + sent
        self._held = sent
        return passed
