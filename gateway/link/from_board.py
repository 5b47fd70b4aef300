"""Supervision of the direction from one board to the host.  No I/O; `to_board.py` supervises the other direction.

Rule: states and other frames are supervised separately: a board that answers but sends no STATE although its stream is
      on is silent, too.
"""

from __future__ import annotations

from dataclasses import dataclass

from gateway.board.scaling import Scaling
from gateway.config import BoardConfig
from protocol.wire.events import Sample
from protocol.wire.messages import Message
from protocol.wire.session import Counters

DIAGNOSE_S = 2.0  # an open port without a handshake for this long gets an explanation
# After a pause of everything the first frame need not be a STATE.  Longer than between two PONGs, shorter than stale_s.
STANDSTILL_S = 0.6


@dataclass(slots=True)
class Known:
    """The data that the board has reported in this session."""

    identity: Message | None = None
    scaling: Scaling | None = None
    parameters: Message | None = None
    stream_period_s: float = 0.0  # the time between two states; 0 if the stream is off or not known
    sample: Sample | None = None

    def board_has(self, parameters: Message) -> None:
        """Note the board's newest parameters."""
        self.parameters = parameters
        if self.identity is not None:
            self.stream_period_s = parameters.int("divider") * self.identity.int("sample_time") * 1e-6

    def forget(self) -> None:
        """Discard the data at the end of a session."""
        self.identity = self.scaling = self.parameters = self.sample = None
        self.stream_period_s = 0.0

    @property
    def highest_reference_m(self) -> float | None:
        """The highest reference that the board takes, m; None if it is not known."""
        if self.scaling is None or self.parameters is None:
            return None
        return self.scaling.x_m(self.parameters.int("x_ref_max"))


class FromBoard:
    """Supervises the direction from one board to the host, by the counters of its frames."""

    def __init__(self, config: BoardConfig, counters: Counters, known: Known) -> None:
        self.bytes_received = 0  # since the gateway's start
        self._config, self._counters, self._known = config, counters, known
        self.began_s = 0.0  # when the time limit of the handshake began
        self.state_s = 0.0  # when the newest state came, or the first one could have come
        self._valid_s = 0.0
        self._valid_at_open = self._bytes_at_open = 0

    def port_opened(self, now_s: float) -> None:
        """Reset the supervision for a newly opened port."""
        self.began_s = self._valid_s = now_s
        self._valid_at_open, self._bytes_at_open = self._counters.valid_frames, self.bytes_received

    def frames_arrived(self, now_s: float, *, states: bool) -> None:
        """Note that valid frames have arrived, with or without STATE frames."""
        if states or now_s - self._valid_s >= STANDSTILL_S:
            self.state_s = now_s
        self._valid_s = now_s

    @property
    def deadline_s(self) -> float:
        """The time at which `silence` is due if nothing arrives."""
        return min(self._valid_s + self._config.stale_s, self.state_s + self._states_limit_s())

    def states_missing(self, now_s: float) -> bool:
        """Return whether no state has arrived for too long although the stream is on."""
        return now_s - self.state_s >= self._states_limit_s()

    def silence(self, now_s: float) -> tuple[str, str] | None:
        """Return name and text of the event if the board has fallen silent, else None."""
        stale_s = self._config.stale_s
        if now_s - self._valid_s >= stale_s:
            return "link-silent", f"No valid frame for {stale_s:g} s."
        if self.states_missing(now_s):
            return (
                "no-states",
                f"The board answers, but no STATE has arrived for {self._states_limit_s():g} s although its stream is"
                " on. Its firmware or the line from it is disturbed.",
            )
        return None

    def no_handshake(self, now_s: float) -> tuple[str, str] | None:
        """Return name and text of the event if the handshake takes too long, with the probable cause, else None."""
        if now_s - self.began_s < DIAGNOSE_S:
            return None
        received = self.bytes_received - self._bytes_at_open
        # By what came since the port was opened: so a cut line is told from another device.
        if self._counters.valid_frames > self._valid_at_open:
            if now_s - self._valid_s < DIAGNOSE_S:
                return "hello-unanswered", "Frames arrive but HELLO is not answered: is the line to the board intact?"
            return "no-answer", "The board fell silent before the handshake."
        if received:
            return (
                "not-a-board",
                f"{received} bytes arrived and none of them is a valid frame: is {self._config.baud} the baud rate,"
                " and is this a Board51?",
            )
        return "no-answer", "The port is open but nothing arrives: is the board powered, are TX and RX crossed?"

    def _states_limit_s(self) -> float:
        period_s = self._known.stream_period_s
        # A slow stream may pause longer than `stale_s` without a fault.
        return max(self._config.stale_s, 3 * period_s) if period_s else float("inf")
