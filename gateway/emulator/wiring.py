"""Faults between the plant and the board's pins: what a wrong wire, an open plug or a bad converter does.

Rule 1: without an active fault every value passes unchanged.
Rule 2: a fault acts on pins, so each firmware and each chip has the same one.
"""

from __future__ import annotations

import random
from collections.abc import Sequence

from gateway.emulator.faults import Fault
from gateway.emulator.firmware_model.flash import BoardProfile, ConverterScale
from gateway.emulator.plant.levitation import EmulatedPlant


class FaultyWiring:
    """The analog side of a board, behind wires that may be wrong."""

    def __init__(self, plant: EmulatedPlant, profile: BoardProfile, *, seed: int = 0) -> None:
        self._plant = plant
        self._pins = {"i": profile.pin(current=True), "x": profile.pin(current=False)}
        self._top = (1 << profile.adc_bits) - 1
        self._random = random.Random(seed)
        self._faults: Sequence[Fault] = ()
        self._held: dict[str, float] = {}  # what a frozen pin carries

    def follow(self, faults: Sequence[Fault]) -> None:
        """Let exactly these faults act from now on."""
        if faults != self._faults:
            self._faults = faults
            self._held.clear()
            self._plant.reverse_coil(any(fault.name == "coil-reversed" for fault in faults))

    def advance(self, u_v: float, duration_s: float) -> None:
        """Advance the time with the input's pin held; a coil that is not connected sees nothing of it."""
        connected = not any(fault.name == "coil-open" for fault in self._faults)
        self._plant.advance(u_v if connected else 0.0, duration_s)

    def sense(self) -> tuple[float, float]:
        """Return what the pins of i_c and x carry."""
        i, x = self._plant.sense()
        return (self._carried("i", i), self._carried("x", x)) if self._faults else (i, x)

    def drop_sample(self) -> bool:
        """Return whether this tick's STATE is lost on the board."""
        return self._plant.drop_sample()

    def _carried(self, channel: str, pin: float) -> float:
        scale = self._pins[channel]
        for fault in self._faults:
            name, _, kind = fault.name.partition("-")
            if name == channel:
                pin = self._damaged(kind, channel, pin, scale, fault.value)
        return pin

    def _damaged(self, kind: str, channel: str, pin: float, scale: ConverterScale, value: float) -> float:
        match kind:
            case "unplugged":
                return scale.to_si(0)
            case "frozen":
                return self._held.setdefault(channel, pin)
            case "inverted":
                return scale.to_si(self._top) - (pin - scale.to_si(0))
            case "noise":
                return pin + scale.lsb * value * self._random.gauss(0.0, 1.0)
            case _:  # bit
                return scale.to_si(min(scale.to_count(pin), self._top) | 1 << int(value) & self._top)
