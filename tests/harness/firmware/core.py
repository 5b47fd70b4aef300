"""The functions of the firmware's core one by one, in a library of their own, so that no board is in it."""

from __future__ import annotations

import ctypes
from ctypes import POINTER, byref, c_bool, c_char_p, c_int16, c_int32, c_uint8, c_uint16, c_uint32
from pathlib import Path

from gateway.emulator.firmware_model.excitation import Signal
from gateway.emulator.firmware_model.law import Gains


class CGains(ctypes.Structure):
    """struct b51_gains."""

    _fields_ = (
        ("law", c_uint8),
        ("shift", c_uint8 * 4),
        ("mantissa", c_int16 * 4),
        ("i_0", c_uint16),
        ("x_0", c_uint16),
        ("u_0", c_uint16),
    )


class CSignal(ctypes.Structure):
    """struct b51_signal."""

    _fields_ = (
        ("shape", c_uint8),
        ("target", c_uint8),
        ("amplitude", c_int16),
        ("offset", c_uint16),
        ("period", c_uint16),
        ("period_end", c_uint16),
        ("seed", c_uint16),
        ("duration", c_uint32),
    )


class CLaw(ctypes.Structure):
    """struct b51_law_state, with which struct b51_board begins."""

    _fields_ = (("gains", CGains), ("sum", c_int32), ("x_previous", c_uint16), ("x_known", c_bool))


_FUNCTIONS = {
    "b51_shift_down": (c_int32, (c_int32, c_uint8)),
    "b51_saturated_sum": (c_int32, (c_int32, c_int32)),
    "b51_saturated_difference": (c_int32, (c_int32, c_int32)),
    "b51_scaled_product": (c_int32, (c_int16, c_uint8, c_int32)),
    "b51_divide_rounded": (c_int32, (c_int32, c_int32)),
    "b51_sine_q15": (c_int16, (c_uint32,)),
    "b51_law_reset": (None, ()),
    "b51_law_accumulate": (c_int32, (c_uint16, c_uint16, c_uint16)),
    "b51_law_run": (c_uint16, (c_uint16, c_uint16, c_uint16, POINTER(c_bool))),
    "b51_excitation_start": (None, (POINTER(CSignal),)),
    "b51_excitation_done": (c_bool, ()),
    "b51_excitation_next": (c_uint16, ()),
    "b51_loop_play_ahead": (None, ()),
    "b51_crc_of": (c_uint16, (c_char_p, c_uint8)),
    "b51_frame_encode": (c_uint8, (c_char_p, c_uint8, c_char_p)),
    "b51_frame_decode": (c_uint8, (c_char_p, c_uint8)),
    "b51_fields_check": (c_uint8, (c_char_p, c_uint8, POINTER(c_uint16))),
}


class Core:
    """The core's functions, and the state of its law."""

    def __init__(self, path: Path) -> None:
        self.c = ctypes.CDLL(str(path))
        for name, (result, arguments) in _FUNCTIONS.items():
            function = getattr(self.c, name)
            function.restype, function.argtypes = result, arguments
        self.law = CLaw.in_dll(self.c, "b51_board")
        self.sines = (c_int16 * 257).in_dll(self.c, "B51_SINE_Q15")
        self.peaks = (c_uint32 * 128).in_dll(self.c, "B51_MULTISINE_PEAK")

    def load(self, gains: Gains) -> None:
        """Load gains, and reset the law."""
        self.law.gains = CGains(
            gains.law,
            (c_uint8 * 4)(*gains.shifts),
            (c_int16 * 4)(*gains.mantissas),
            gains.i_0,
            gains.x_0,
            gains.u_0,
        )
        self.c.b51_law_reset()

    def run(self, i: int, x: int, x_ref: int) -> tuple[int, bool]:
        """Run one tick of the law."""
        limited = c_bool()
        u: int = self.c.b51_law_run(i, x, x_ref, byref(limited))
        return u, limited.value

    def play(self, signal: Signal, ticks: int) -> list[int]:
        """Return the first ticks of a signal."""
        names = [name for name, _ in CSignal._fields_]
        self.c.b51_excitation_start(byref(CSignal(*(getattr(signal, name) for name in names))))
        return [self.c.b51_excitation_next() for _ in range(ticks)]

    def encode(self, body: bytes) -> bytes:
        """Return the frame of a body."""
        frame = ctypes.create_string_buffer(len(body) + 5)
        size = self.c.b51_frame_encode(body, len(body), frame)
        return frame.raw[:size]

    def decode(self, encoded: bytes) -> bytes | None:
        """Return the body of what stands between two delimiters, None for a bad frame."""
        data = ctypes.create_string_buffer(encoded, len(encoded))
        size = self.c.b51_frame_decode(data, len(encoded))
        return data.raw[1 : 1 + size] if size else None

    def check(self, body: bytes) -> tuple[int, int]:
        """Return reason (0: none) and detail of a command's refusal by its fields."""
        detail = c_uint16()
        reason: int = self.c.b51_fields_check(body, len(body), byref(detail))
        return reason, detail.value
