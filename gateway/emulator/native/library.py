"""The functions of `firmware/posix/posix.h`, and the view of a board as C lays it out."""

from __future__ import annotations

import ctypes
from ctypes import c_bool, c_char_p, c_int32, c_uint8, c_uint16, c_uint32, c_void_p
from functools import cache
from pathlib import Path


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


_FUNCTIONS = {  # name: result, arguments behind the board; identity and settings are bytes as `flash.py` packs them
    "b51_posix_open": (None, (c_char_p, c_char_p)),
    "b51_posix_close": (None, ()),
    "b51_posix_reset": (None, (c_uint8,)),
    "b51_posix_hang": (None, ()),
    "b51_posix_late": (None, ()),
    "b51_posix_break_stack": (None, ()),
    "b51_posix_fail_output": (None, (c_uint8,)),
    "b51_posix_store": (None, (c_char_p,)),
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
