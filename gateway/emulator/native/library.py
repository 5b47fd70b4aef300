"""The functions of `firmware/posix/posix.h`, and its structures as C lays them out."""

from __future__ import annotations

import ctypes
from ctypes import POINTER, c_bool, c_char_p, c_int16, c_int32, c_uint8, c_uint16, c_uint32, c_void_p
from functools import cache
from pathlib import Path


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


class CLimits(ctypes.Structure):
    """struct b51_limits."""

    _fields_ = tuple((name, c_uint16) for name in ("x_ref_min", "x_ref_max", "x_ref_step", "x_ref_slew", "u_max"))


class CSettings(ctypes.Structure):
    """struct b51_settings."""

    _fields_ = (("gains", CGains), ("limits", CLimits))


class CIdentity(ctypes.Structure):
    """struct b51_identity."""

    _fields_ = (
        ("board_id", c_uint32),
        ("firmware_major", c_uint8),
        ("firmware_minor", c_uint8),
        ("adc_bits", c_uint8),
        ("dac_bits", c_uint8),
        ("scalings", c_uint8 * 24),
        ("build", c_uint8 * 8),
    )


class CView(ctypes.Structure):
    """struct b51_posix_view: what a board shows between two calls."""

    _fields_ = (
        ("next_tick", c_uint32),
        ("dropped", c_uint32),
        ("allowance", c_uint32),
        ("sum", c_int32),
        ("capture_wait_us", c_int32),
        ("u", c_uint16),
        ("bad_frames", c_uint16),
        ("mode", c_uint8),
        ("running", c_bool),
        ("written", c_bool),
    )


_FUNCTIONS = {  # name: result, arguments behind the board
    "b51_posix_open": (None, (POINTER(CIdentity), POINTER(CSettings))),
    "b51_posix_close": (None, ()),
    "b51_posix_reset": (None, (c_uint8,)),
    "b51_posix_hang": (None, ()),
    "b51_posix_late": (None, ()),
    "b51_posix_break_stack": (None, ()),
    "b51_posix_fail_output": (None, (c_uint8,)),
    "b51_posix_store": (None, (POINTER(CSettings),)),
    "b51_posix_feed": (None, (c_char_p, c_uint32)),
    "b51_posix_pass": (None, (c_uint16,)),
    "b51_posix_capture": (None, (c_uint16,)),
    "b51_posix_tick": (None, (c_uint16, c_uint16, c_bool)),
    "b51_posix_take": (c_uint8, (c_char_p, c_uint8)),
    "b51_posix_set_tick": (None, (c_uint32,)),
}


@cache
def load(path: Path) -> ctypes.PyDLL:
    """Load the library; only one board at a time may run in it, so its calls keep Python's lock."""
    library = ctypes.PyDLL(str(path))
    library.b51_posix_size.restype = c_uint32
    library.b51_posix_size.argtypes = ()
    for name, (result, arguments) in _FUNCTIONS.items():
        function = getattr(library, name)
        function.restype = result
        function.argtypes = (c_void_p, *arguments)
    return library
