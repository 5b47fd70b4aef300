"""The functions of `chip.h`, and its structures as C lays them out."""

from __future__ import annotations

import ctypes
from ctypes import POINTER, c_bool, c_uint8, c_uint16, c_uint32, c_uint64
from functools import cache
from pathlib import Path

LINE_BYTES = 4096


class Cpu(ctypes.Structure):
    """struct cpu."""

    _fields_ = (
        ("cycles", c_uint64),
        ("pc", c_uint16),
        ("slow", c_uint8),
        ("in_service", c_uint8),
        ("deepest", c_uint8),
        ("ram", c_uint8 * 256),
        ("sfr", c_uint8 * 128),
        ("xram", c_uint8 * 65536),
        ("code", c_uint8 * 65536),
    )


class Line(ctypes.Structure):
    """struct line."""

    _fields_ = (
        ("first", c_uint32),
        ("count", c_uint32),
        ("at", c_uint64 * LINE_BYTES),
        ("data", c_uint8 * LINE_BYTES),
    )


class Chip(ctypes.Structure):
    """struct chip."""

    _fields_ = (
        ("cpu", Cpu),
        ("held_until", c_uint64),
        ("clock_hz", c_uint32),
        ("converted", c_uint16),
        ("watched_pc", c_uint16),
        ("dead_converter", c_bool),
        ("low_supply", c_bool),
        ("eeprom", c_uint8 * 4096),
        ("turns", c_uint32),
        ("longest_turn", c_uint32),
        ("lost_bytes", c_uint32),
        ("u", c_uint16),
        ("channel", c_uint8),
        ("to_chip", Line),
        ("from_chip", Line),
        ("_inside", c_uint64 * 6),
    )


@cache
def load(path: Path) -> ctypes.PyDLL:
    """Load the simulator."""
    library = ctypes.PyDLL(str(path))
    library.chip_size.restype = c_uint32
    library.chip_size.argtypes = ()
    for name, result, arguments in (
        ("chip_power_on", None, ()),
        ("chip_watchdog", None, ()),
        ("chip_pin", None, ()),
        ("chip_run", c_uint8, (c_uint64,)),
        ("chip_feed", c_bool, (c_uint8, c_uint64)),
        ("chip_take", c_uint32, (POINTER(c_uint8), c_uint32)),
        ("cpu_step", c_uint8, ()),
    ):
        function = getattr(library, name)
        function.restype = result
        function.argtypes = (POINTER(Chip), *arguments)
    assert library.chip_size() == ctypes.sizeof(Chip)
    return library
