"""Captures a burst of i_c at 25 kHz around a step of u_c: rule 12 of protocol/README.md.

    u_from for 20 ms | u_from, `pre` samples | u_to, the rest of `count` samples | as the mode says
                     ^ sample 0 = `began_tick`

Sample n is taken n * 40 us after the tick `began_tick`; sample `pre` at the instant of the step, so it still shows the
current before it.
"""

from __future__ import annotations

from collections.abc import Callable

from gateway.emulator.firmware_model.flash import CAPTURE_SETTLE_US, CAPTURE_US, T_S_US
from protocol.wire.codec import pack_pair
from protocol.wire.messages import CAPTURE_BLOCK_SAMPLES


class FirmwareCapture:
    """A capture: gives the input over time, and stores the samples."""

    def __init__(self, *, u_from: int, u_to: int, pre: int, count: int, tick: int) -> None:
        self.total = count
        self.began_tick = tick + CAPTURE_SETTLE_US // T_S_US & 0xFFFFFFFF
        self.u_from, self.u_to = u_from, u_to
        self._pre = pre
        self.begun = False  # at its tick
        self.wait_us = CAPTURE_SETTLE_US  # to the next sample; after the last one, to the end of the capture
        self._samples: list[int] = []

    @property
    def step_is_due(self) -> bool:
        """Return whether the step is made at this instant, behind its sample."""
        return len(self._samples) == self._pre and self.wait_us == 0

    @property
    def has_ended(self) -> bool:
        """Return whether all samples are taken and the 40 us of the last one are over."""
        return len(self._samples) == self.total and self.wait_us <= 0

    def take(self, i: int, write: Callable[[int], object]) -> None:
        """Store the sample that is due, and make the step if it is due."""
        steps = self.step_is_due
        self._samples.append(i)
        self.wait_us = CAPTURE_US
        if steps:
            write(self.u_to)

    def block(self, index: int) -> bytes:
        """Return up to 32 samples from `index` on, packed in pairs, filled with 0 to 48 bytes."""
        part = self._samples[index : index + CAPTURE_BLOCK_SAMPLES]
        part += [0] * (CAPTURE_BLOCK_SAMPLES - len(part))
        return b"".join(pack_pair(a, b) for a, b in zip(part[::2], part[1::2], strict=True))
