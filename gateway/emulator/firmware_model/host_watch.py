"""Supervision of the host by the board: rule 10 of protocol/README.md."""

from __future__ import annotations

from collections.abc import Callable

from gateway.emulator.firmware_model.control_loop import ControlLoop
from gateway.emulator.firmware_model.flash import T_S_US
from protocol.wire.messages import EventCode, HostLoss, Mode

HOST_LOSS_MS = 500


class HostWatch:
    """Acts on the loop when no frame of the host has come for `timeout_ms`.

    Args:
        loop: The control loop.
        emit: Sends an event with its detail.
    """

    def __init__(self, loop: ControlLoop, emit: Callable[[EventCode, int], None]) -> None:
        self.policy = HostLoss.COIL_OFF
        self.timeout_ms = HOST_LOSS_MS
        self._loop, self._emit = loop, emit
        self._silent_us = 0

    def heard(self) -> None:
        """Note a frame of the host."""
        self._silent_us = 0
        if self._loop.host_lost:
            self._loop.host_lost = False
            self._emit(EventCode.HOST_BACK, 0)

    def watch(self) -> None:
        """Count one tick of silence; act once, when the host is lost."""
        self._silent_us += T_S_US
        if self._loop.host_lost or self._silent_us < self.timeout_ms * 1000:
            return
        self._loop.host_lost = True
        self._emit(EventCode.HOST_LOST, self.policy)
        if self.policy == HostLoss.HOLD and self._loop.mode == Mode.CLOSED_LOOP:
            self._loop.end_excitation()
        elif self.policy != HostLoss.KEEP:
            self._loop.switch_off()
