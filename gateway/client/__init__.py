"""Control and read a live rig from Python, through its gateway.

    from gateway.client import Rig

    with Rig("rig1") as rig:
        rig.set_mode("closed-loop")
        rig.set_reference(0.003)                    # m; returns when the board has accepted it
        flight = rig.read(2.0)                      # 2 s of samples as numpy arrays
        print(flight.x_m.mean())
        rig.stop()

All quantities are in SI units, and each name ends with its unit.  Names are imported at their first use.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gateway.client.commands import HostLoss, Law, Mode, OperatingPoint, Shape
    from gateway.client.errors import CommandNotDeliveredError, CommandRefusedError, NoSamplesError
    from gateway.client.message_queue import SampleStream
    from gateway.client.recording import Recording
    from gateway.client.rig import Rig
    from gateway.client.values import Capture, Reply, Sample, Samples, read_log

__all__ = [
    "Capture", "CommandNotDeliveredError", "CommandRefusedError", "HostLoss", "Law", "Mode", "NoSamplesError",
    "OperatingPoint", "Recording", "Reply", "Rig", "Sample", "SampleStream", "Samples", "Shape", "read_log",
]  # fmt: skip

_HOMES = {
    "commands": ("HostLoss", "Law", "Mode", "OperatingPoint", "Shape"),
    "errors": ("CommandNotDeliveredError", "CommandRefusedError", "NoSamplesError"),
    "recording": ("Recording",),
    "rig": ("Rig",),
    "message_queue": ("SampleStream",),
    "values": ("Capture", "Reply", "Sample", "Samples", "read_log"),
}


def __getattr__(name: str) -> object:
    for home, names in _HOMES.items():
        if name in names:
            return getattr(importlib.import_module(f"{__name__}.{home}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
