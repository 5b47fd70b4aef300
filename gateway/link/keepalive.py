"""Periodic commands of a session: settings, PINGs and the reading of parameters.  No I/O.

Rule 1: a PING is sent at least every quarter of the host-loss time-out, so that three may be lost.  It is sent at least
        every PING_S, to check that the board answers.
Rule 2: a setting that the board did not accept is sent again a second later, for as long as the session lasts.
Rule 3: nothing here changes mode or reference: starting or ending the gateway must not drop the ball.
"""

from __future__ import annotations

from collections.abc import Callable

from gateway.board.scaling import WireCommand
from gateway.config import BoardConfig
from protocol.wire.events import Answer
from protocol.wire.messages import HostLoss, Message, Value
from protocol.wire.session import Session

PARAMETERS_S = 5.0
PING_S = 0.25
REDO_S = 1.0
_BOARD_TIMEOUT_S = 0.5  # the board's default host-loss time-out, until the configured one is set
_POLICIES = {"keep": HostLoss.KEEP, "coil-off": HostLoss.COIL_OFF, "hold": HostLoss.HOLD}
_NEVER = float("inf")


class Keepalive:
    """Sends the periodic commands of one board; calls `got_parameters` with each PARAMETERS."""

    def __init__(self, config: BoardConfig, session: Session, got_parameters: Callable[[Message], None]) -> None:
        self.board_bad_frames = self.board_overruns = 0  # as the board counts them, from PONG
        self._config, self._session, self._got_parameters = config, session, got_parameters
        self._under_way: dict[int, tuple[str, dict[str, Value]]] = {}
        self._redo: list[tuple[str, dict[str, Value]]] = []
        self._ping_s = 0.0
        self.end()

    @property
    def deadline_s(self) -> float:
        """The time at which `poll` is due."""
        return min(self._next_ping_s, self._next_parameters_s, self._redo_s)

    def begin(self, now_s: float) -> None:
        """Send the settings and read the parameters, at the start of a session."""
        config = self._config
        self._ping_s = min(_BOARD_TIMEOUT_S, config.host_loss_timeout_s) / 4
        self._next_ping_s = now_s + self._ping_s
        self._next_parameters_s = now_s + PARAMETERS_S
        self._order("SET_STREAM", now_s, divider=config.stream_divider)
        timeout_ms = round(config.host_loss_timeout_s * 1e3)
        self._order("SET_HOST_LOSS", now_s, policy=int(_POLICIES[config.host_loss]), timeout=timeout_ms)
        self._order("GET_PARAMETERS", now_s)

    def end(self) -> None:
        """Stop, at the end of a session."""
        self._under_way.clear()
        self._redo.clear()
        self._next_ping_s = self._next_parameters_s = self._redo_s = _NEVER

    def accepted(self, wire: WireCommand, now_s: float) -> None:
        """Read again the settings that an accepted command of a client has changed."""
        if wire.name == "SET_HOST_LOSS":
            self.host_loss_is(int(wire.values["timeout"]), now_s)
        if wire.name in ("SET_GAINS", "SET_STREAM", "SET_HOST_LOSS"):
            self.read_parameters(now_s)

    def read_parameters(self, now_s: float) -> None:
        """Read the parameters again, after a change."""
        # If two are unanswered, the second has not been sent yet, so it will also read this change.  One request for
        # each change would fill the queue of a lossy line, and users' commands would be refused.
        if sum(name == "GET_PARAMETERS" for name, _ in self._under_way.values()) < 2:
            self._order("GET_PARAMETERS", now_s)

    def host_loss_is(self, timeout_ms: int, now_s: float) -> None:
        """Note the new host-loss time-out of the board."""
        self._ping_s = min(PING_S, timeout_ms / 4e3)
        self._next_ping_s = min(self._next_ping_s, now_s + self._ping_s)

    def answered(self, answer: Answer, now_s: float) -> None:
        """Process the outcome of a command sent here; others are ignored."""
        name, values = self._under_way.pop(answer.token, ("", {}))
        if answer.outcome == "ack" and answer.message is not None:
            if name == "PING":
                self.board_bad_frames = answer.message.int("bad_frames")
                self.board_overruns = answer.message.int("overruns")
            elif name == "GET_PARAMETERS":
                self._got_parameters(answer.message)
            elif name == "SET_HOST_LOSS":
                self.host_loss_is(int(values["timeout"]), now_s)
        # A PING is not repeated, because the next one is due soon. A setting would be missing for the whole session.
        elif name not in ("", "PING") and self._session.is_open:
            if (name, values) not in self._redo:
                self._redo.append((name, values))
            self._redo_s = now_s + REDO_S

    def poll(self, now_s: float) -> None:
        """Send the commands that are due."""
        if now_s >= self._next_ping_s:
            self._next_ping_s = now_s + self._ping_s
            # One PING at a time: if the board does not answer, more of them would only delay other commands.
            if not any(name == "PING" for name, _ in self._under_way.values()):
                self._order("PING", now_s)
        if now_s >= self._next_parameters_s:
            self._next_parameters_s = now_s + PARAMETERS_S
            self.read_parameters(now_s)
        if now_s >= self._redo_s:
            redo, self._redo, self._redo_s = self._redo, [], _NEVER
            for name, values in redo:
                if name == "GET_PARAMETERS":
                    self.read_parameters(now_s)
                else:
                    self._order(name, now_s, **values)

    def _order(self, name: str, now_s: float, /, **values: Value) -> None:
        self._under_way[self._session.submit(name, now_s, **values)] = (name, values)
