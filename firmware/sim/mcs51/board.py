"""A board whose ADuC841 runs the image of `firmware/mcs51`: as `firmware_model/board.py`, around a simulated chip.

    board = Mcs51Board(EmulatedPlant(), board_id=1)

Rule 1: every rule of protocol/README.md is run by the chip, instruction by instruction.  What is Python here is outside
        of it: the rig, the crystal, the content of its data memory.
Rule 2: the rig's time is the chip's.  It is advanced to each conversion and each change of the output, in its steps
        of 20 us; a change of the input leads by less than one.
Rule 3: one `tick` is T_s by the chip's own timer.  It begins just before the chip's loop does, so each tick has one run
        of the loop and one STATE.  The first after a boot is longer, as the chip finds its phase in it.
"""

from __future__ import annotations

import ctypes
import json
import struct
from pathlib import Path
from typing import Final

from firmware.sim.mcs51.build import CLOCK_HZ, image, simulator
from firmware.sim.mcs51.library import Chip, load
from gateway.emulator.firmware_model.board import AnalogSide
from gateway.emulator.firmware_model.flash import CE152_BOARD, CURRENT, INPUT, POSITION, T_S_US, BoardProfile
from gateway.emulator.firmware_model.output import OutputFault
from protocol.errors import UsageError
from protocol.wire.framing import crc16
from protocol.wire.messages import EventCode, Mode

TICK_CYCLES: Final = CLOCK_HZ // 1000 * T_S_US // 1000  # as in the reload of timer 2
_CONVERTS, _WRITES, _BOOTS = 1, 2, 3
_CHANNEL_CURRENT = 0
_WATCHED = (("mode", "B"), ("dropped", "<I"), ("bad_frames", "<H"), ("sum", "<i"), ("allowance", "<I"), ("tick", "<I"))
_PLANT_STEP_US = 20
_LEAD_CYCLES = 200  # of a `tick` to the chip's


class Mcs51Board:
    """A board with an ADuC841, powered on.

    Args:
        plant: Analog side; the chip advances its time.
        board_id: Serial number in IDENTITY.
        baud: Of the line, bits per second.
        path: The image; None: that of this version, built if it is not yet.
        eeprom: Content of the chip's data memory; None: what a board is programmed with.
        profile: That of the CE 152: there is no program for another one.

    Raises:
        InstallError: there is no C compiler, or no sdcc.
        UsageError: the part does not give the baud rate, or there is no firmware for this profile.
        ServiceError: a compiler fails.
    """

    def __init__(
        self,
        plant: AnalogSide,
        *,
        board_id: int = 1,
        baud: int = 115200,
        path: Path | None = None,
        eeprom: bytes | None = None,
        profile: BoardProfile = CE152_BOARD,
    ) -> None:
        if profile is not CE152_BOARD:
            raise UsageError(
                "The 8051 has no firmware for this rig",
                remedy="Give --chip avr, --firmware python or c, or --rig ce152",
            )
        self._plant = plant
        self._library = load(simulator())
        program = json.loads((image(baud) if path is None else path).read_text(encoding="utf-8"))
        self.symbols: dict[str, int] = program["symbols"]
        code = bytes.fromhex(program["code"])
        self.chip = chip = Chip()
        chip.clock_hz = CLOCK_HZ
        chip.cpu.code[:] = code.ljust(len(chip.cpu.code), b"\xff")
        chip.eeprom[:] = (memory_of(board_id) if eeprom is None else eeprom).ljust(len(chip.eeprom), b"\xff")
        chip.watched_pc = self.symbols["b51_board_poll"]
        table = struct.unpack_from(f"<{len(_WATCHED)}H", code, self.symbols["B51_WATCHED"])
        self._watched = {name: (at, kind) for (name, kind), at in zip(_WATCHED, table, strict=True)}
        self._buffer = (ctypes.c_uint8 * 1024)()
        self._sent = b""
        self._plant_us = 0
        self._tick_at = 0
        self._u = 0
        self._in_phase = False
        self._cleared = False  # its RAM, by start-up: before that it holds anything
        self._stuck = False
        self._dropped = 0  # before the last reset
        self._library.chip_power_on(chip)

    def reset(self, cause: EventCode) -> None:
        """Restart: by the power, by the watchdog, or by the program as RESET does."""
        self._remember_dropped()
        if cause == EventCode.RESET_POWER_ON:
            self._library.chip_power_on(self.chip)
            self._sent, self._dropped, self._cleared = b"", 0, False
        elif cause == EventCode.RESET_WATCHDOG:
            self._library.chip_watchdog(self.chip)
        else:
            self.chip.cpu.pc = self.symbols["b51_hal_restart"]
        self._follow_input()

    def pull_reset(self) -> None:
        """Reset the chip by its pin: its RAM stays as it is."""
        self._remember_dropped()
        self._library.chip_pin(self.chip)
        self._follow_input()

    def hang(self) -> None:
        """Hang the main loop: no ticks, no answers, u_c unchanged, until the watchdog resets the board."""
        self.chip.held_until = 2**64 - 1

    def break_stack(self) -> None:
        """Overwrite the end of the stack's room, as a stack that is too deep would."""
        self.chip.cpu.ram[0xFF] ^= 0xFF

    def overrun(self, ticks: int = 2) -> None:
        """Hold the main loop until some ticks are due, of which it can then run one, late."""
        self.chip.held_until = self.chip.cpu.cycles + ticks * TICK_CYCLES - TICK_CYCLES // 2

    def fail_output(self, fault: OutputFault) -> None:
        """Let the output of the converter stay as it is from now on, or follow again.

        Raises:
            UsageError: the converter is to be deaf: it is on the chip, where nothing is confirmed.
        """
        if fault == OutputFault.DEAF:
            raise UsageError(
                "The converter of the 8051 is on the chip, so it cannot be deaf", remedy="Use the fault stuck"
            )
        self._stuck = fault == OutputFault.STUCK
        self._follow_input()

    def feed(self, data: bytes, *, into_tick_us: int = 0) -> None:
        """Put bytes from the host on the line, the first of which is in `into_tick_us` after the last tick."""
        at = self._tick_at + into_tick_us * TICK_CYCLES // T_S_US
        for byte in data:
            self._library.chip_feed(self.chip, byte, at)

    def tick(self) -> None:
        """Let T_s pass on the chip and the rig."""
        self._tick_at += TICK_CYCLES
        chip = self.chip
        while reason := self._library.chip_run(chip, self._tick_at):
            self._advance()
            if reason == _CONVERTS:
                self._cleared = True
                if not self._in_phase:
                    self._tick_at, self._in_phase = chip.cpu.cycles + TICK_CYCLES - _LEAD_CYCLES, True
                i_a, x_m = self._plant.sense()
                chip.converted = CURRENT.to_count(i_a) if chip.channel == _CHANNEL_CURRENT else POSITION.to_count(x_m)
            else:
                if reason == _BOOTS:
                    self._remember_dropped()
                    self._in_phase = False
                self._follow_input()
        self._advance()

    def take_frame(self) -> bytes:
        """Return the next frame that the chip has sent to its end, or b""."""
        size = self._library.chip_take(self.chip, self._buffer, len(self._buffer))
        self._sent += bytes(self._buffer[:size])
        end = self._sent.find(b"\0", 1) + 1
        frame, self._sent = self._sent[:end], self._sent[end:]
        return frame

    @property
    def u(self) -> int:
        """Count of the input converter."""
        return self._u

    @property
    def mode(self) -> Mode:
        """The mode in force."""
        return Mode(self._look("mode"))

    @property
    def dropped(self) -> int:
        """The number of frames for which the line had no time, since power-on."""
        return self._dropped + self._look("dropped")

    @property
    def bad_frames(self) -> int:
        """The number of frames rejected since the reset."""
        return self._look("bad_frames")

    @property
    def next_tick(self) -> int:
        """The number of the tick that comes next."""
        return self._look("tick")

    def _look(self, name: str) -> int:
        if not self._cleared:
            return 0
        at, kind = self._watched[name]
        size = struct.calcsize(kind)
        (value,) = struct.unpack(kind, bytes(self.chip.cpu.xram[at : at + size]))
        return int(value)

    def _remember_dropped(self) -> None:
        self._dropped += self._look("dropped")

    def _follow_input(self) -> None:
        if not self._stuck:
            self._u = self.chip.u

    def _advance(self) -> None:
        """Advance the plant to the chip's cycle, with the input as it has been until now."""
        now_us = self.chip.cpu.cycles * T_S_US // (TICK_CYCLES * _PLANT_STEP_US) * _PLANT_STEP_US
        if now_us > self._plant_us:
            self._plant.advance(INPUT.to_si(self._u), (now_us - self._plant_us) * 1e-6)
            self._plant_us = now_us


def memory_of(board_id: int) -> bytes:
    """Return the content of the data memory of a board: identity and settings, and their CRC."""
    data = CE152_BOARD.identity(board_id, CE152_BOARD.adc_bits) + CE152_BOARD.settings.packed()
    return data + crc16(data).to_bytes(2, "big")
