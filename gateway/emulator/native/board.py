"""A board that runs the firmware in C: as `firmware_model/board.py`, around the compiled core.

    firmware = NativeFirmware(EmulatedPlant(), board_id=1)

What is Python here is hardware: converters, clock, and the content of the flash.  Every rule of protocol/README.md is
in C; so the two firmwares share no code, and each is the other's test (tests/firmware).
"""

from __future__ import annotations

import ctypes
from pathlib import Path

from gateway.emulator.firmware_model.board import AnalogSide
from gateway.emulator.firmware_model.flash import CE152_BOARD, T_S_US, BoardProfile, Settings
from gateway.emulator.firmware_model.output import OutputFault
from gateway.emulator.native.build import library
from gateway.emulator.native.library import CView, load
from protocol.wire.messages import EventCode, Mode

_PLANT_STEP_US = 20
_LONGEST_FRAME = 64  # bytes


class NativeFirmware:
    """A board with the firmware in C, powered on: compiled for this machine, or the library at `path`.

    Raises:
        InstallError: there is no C compiler.
        ServiceError: the compiler fails.
    """

    def __init__(
        self, plant: AnalogSide, *, board_id: int = 1, profile: BoardProfile = CE152_BOARD, path: Path | None = None
    ) -> None:
        self._plant = plant
        self._profile = profile
        self._library = load(library() if path is None else path)
        words = -(-self._library.b51_posix_size() // 8)
        self._memory = (ctypes.c_uint64 * words)()
        self._board = ctypes.addressof(self._memory)
        self._view = CView.from_buffer(self._memory)
        self._frame = ctypes.create_string_buffer(_LONGEST_FRAME)
        self._elapsed_us = 0  # plant time since the last tick
        identity = profile.identity(board_id, profile.adc_bits)
        self._library.b51_posix_open(self._board, identity, settings_of(profile.settings))

    def __del__(self) -> None:
        if hasattr(self, "_board"):
            self._library.b51_posix_close(self._board)

    def reset(self, cause: EventCode) -> None:
        """Restart: coil off, no output during the boot, then tick 0; a power cycle also clears the count of resets."""
        self._library.b51_posix_reset(self._board, int(cause))

    def hang(self) -> None:
        """Hang the program: no loop, no answers, u_c unchanged, until the watchdog resets the board."""
        self._library.b51_posix_hang(self._board)

    def overrun(self) -> None:
        """Let the board report the next tick as late."""
        self._library.b51_posix_late(self._board)

    def break_stack(self) -> None:
        """Overwrite the end of the board's stack, until its next reset."""
        self._library.b51_posix_break_stack(self._board)

    def fail_output(self, fault: OutputFault) -> None:
        """Let the converter of u_c fail from now on, or work again."""
        self._library.b51_posix_fail_output(self._board, int(fault))

    def store(self, settings: Settings) -> None:
        """Write the memory of gains, operating point and limits, which the board reads at its next boot."""
        self._library.b51_posix_store(self._board, settings_of(settings))

    def feed(self, data: bytes, *, into_tick_us: int = 0) -> None:
        """Process bytes from the host, `into_tick_us` after the last tick; never raises."""
        if not self._view.running:
            return
        now_us = min(into_tick_us, T_S_US) // _PLANT_STEP_US * _PLANT_STEP_US
        if self._view.capture_wait_us >= 0:
            self._advance_to(now_us)
        u = self._view.u
        self._library.b51_posix_feed(self._board, data, len(data))
        if self._view.written:  # by a STOP: until its last byte the input was what it had been
            self._advance_to(now_us, u=u)

    def tick(self) -> None:
        """Advance the plant by T_s with the input held, then run the loop once."""
        self._advance_to(T_S_US)
        self._elapsed_us = 0
        i = x = 0
        lost = False
        if self._view.running:
            i_pin, x_pin = self._plant.sense()
            i, x = self._profile.current_count(i_pin), self._profile.position_count(x_pin)
            lost = self._plant.drop_sample()
        self._library.b51_posix_tick(self._board, i, x, lost)

    def take_frame(self, room: int = _LONGEST_FRAME) -> bytes:
        """Return the next frame for the line, or its next `room` bytes, or b""."""
        size: int = self._library.b51_posix_take(self._board, self._frame, room)
        return self._frame.raw[:size]

    @property
    def u(self) -> int:
        """Count of the input converter."""
        return int(self._view.u)

    @property
    def mode(self) -> Mode:
        """The mode in force."""
        return Mode(self._view.mode)

    @property
    def dropped(self) -> int:
        """The number of frames for which the line had no time, since power-on."""
        return int(self._view.dropped)

    @property
    def bad_frames(self) -> int:
        """The number of frames rejected since the reset."""
        return int(self._view.bad_frames)

    @property
    def next_tick(self) -> int:
        """The number of the tick that comes next."""
        return int(self._view.next_tick)

    @next_tick.setter
    def next_tick(self, tick: int) -> None:
        self._library.b51_posix_set_tick(self._board, tick)

    def _advance_to(self, time_us: int, *, u: int | None = None) -> None:
        """Advance the plant to this time after the last tick, taking capture samples on the way."""
        view = self._view
        while self._elapsed_us < time_us:
            step_us = time_us - self._elapsed_us
            if view.capture_wait_us >= 0 and view.running:
                if view.capture_wait_us == 0:
                    self._library.b51_posix_capture(self._board, self._profile.current_count(self._plant.sense()[0]))
                step_us = min(step_us, view.capture_wait_us)
            self._plant.advance(self._profile.input_pin(view.u if u is None else u), step_us * 1e-6)
            self._elapsed_us += step_us
            self._library.b51_posix_pass(self._board, step_us)


def settings_of(settings: Settings) -> bytes:
    """Return gains, operating point and limits as C lays them out: a byte aligns the mantissas."""
    packed = settings.packed()
    return packed[:5] + b"\0" + packed[5:]
