"""The serial thread: one selector over all boards, without blocking calls.

Rule 1: a ready port is read once, completely, and the data gets one time stamp.
Rule 2: operations that may block run elsewhere.  Helper threads open the ports, the publisher's threads send messages
        and replies, the log has its own thread.
Rule 3: there is no write buffer here: what the port does not accept stays in the session, which drops commands that
        have expired.
Rule 4: an error in the handling of one board closes the connection to that board only.
"""

from __future__ import annotations

import contextlib
import logging
import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from gateway.access.authorize import Sender
from gateway.link.driver import BoardDriver
from gateway.link.port import Port, PortProblem, open_port
from gateway.link.sink import Reply

POLL_S = 0.005  # the shortest time between two polls; the shortest configurable time-out is 20 ms
IDLE_S = 1.0  # the longest
# The shortest time between two rounds, so that a round of many boards finds several ready: one wake-up and one
# hand-over for all of them.  A board alone needs none.
ROUND_S = 0.00025
CLOSE_PATIENCE_S = 1.0  # at the end, for ports that are slow to close
_logger = logging.getLogger("gateway.link")


@dataclass(slots=True)
class _Line:
    """A board's driver with its port and the state of the loop."""

    driver: BoardDriver
    port: Port | None = None
    opening: bool = False
    next_open_s: float = 0.0
    waits_for_room: bool = False


class LinkThread:
    """Serves all boards until `stop`; calls `round_over` after each round of reads, in the serial thread."""

    def __init__(self, drivers: Sequence[BoardDriver], round_over: Callable[[], None] = lambda: None) -> None:
        self._lines = [_Line(driver) for driver in drivers]
        self._line_of_driver = {id(line.driver): line for line in self._lines}
        self._round_over = round_over
        self._selector = selectors.DefaultSelector()
        self._wake_read, self._wake_write = socket.socketpair()  # a selector of Windows takes nothing but sockets
        self._wake_read.setblocking(False)
        self._wake_write.setblocking(False)
        self._selector.register(self._wake_read, selectors.EVENT_READ, None)
        self._actions: deque[Callable[[], None]] = deque()
        self._due_s = 0.0  # the next poll
        self._closing: list[threading.Thread] = []
        self._stopping = False
        self._gate = threading.Lock()  # nobody writes to the closed socket
        self._ended = False
        self._thread = threading.Thread(target=self._work, name="link", daemon=True)

    def start(self) -> None:
        """Begin to open ports."""
        self._thread.start()

    def post(self, action: Callable[[], None]) -> bool:
        """Schedule `action` in the serial thread, from any thread; return False if that thread has ended."""
        with self._gate:
            if self._ended:
                return False
            self._actions.append(action)
            with contextlib.suppress(BlockingIOError):  # a full socket wakes as well as an empty one with a byte
                self._wake_write.send(b"\x00")
            return True

    def command(self, driver: BoardDriver, payload: bytes, reply: Reply, sender: Sender) -> None:
        """Pass a query to a board's driver; from any thread."""

        def act() -> None:
            line = self._line_of_driver[id(driver)]
            self._attempt(line, "after a command", driver.command, payload, reply, time.monotonic(), sender)

        if not self.post(act):
            act()  # says that the link is down

    def stop(self) -> None:
        """Close all ports and end the thread.  Nothing is sent to the boards: their host-loss policy applies."""
        self._stopping = True
        self.post(lambda: None)
        self._thread.join()
        deadline_s = time.monotonic() + CLOSE_PATIENCE_S
        for closing in self._closing:
            closing.join(max(0.0, deadline_s - time.monotonic()))

    # -- in the serial thread

    def _work(self) -> None:
        try:
            while not self._stopping:
                began_s = self._round(max(0.0, self._due_s - time.monotonic()))
                now_s = time.monotonic()
                if now_s >= self._due_s:
                    self._poll(now_s)
                if len(self._lines) > 1 and (rest_s := began_s + ROUND_S - time.monotonic()) > 0:
                    time.sleep(rest_s)
        finally:
            for line in self._lines:
                # No STOP is sent: a restart for an update must not drop the ball. The board follows its host-loss
                # policy.
                self._close(line, "The gateway ends.", severity="info")
            with self._gate:
                self._ended = True
            self._run_actions()  # answer queries that came meanwhile: the link is down
            self._selector.close()
            self._wake_read.close()
            self._wake_write.close()

    def _round(self, pause_s: float) -> float:
        """Wait at most `pause_s` for bytes, and serve all ports that are ready; return when they were, monotonic."""
        # One selector, not a thread for each board: 32 threads that read would compete for the interpreter.
        ready = self._selector.select(pause_s)
        began_s = time.monotonic()
        for key, mask in ready:
            line: _Line | None = key.data
            if line is None:
                self._run_actions()
            else:
                self._attempt(line, "while reading", self._serve, line, mask)
        self._round_over()
        return began_s

    def _serve(self, line: _Line, mask: int) -> None:
        if mask & selectors.EVENT_WRITE:
            self._write_output(line)
        if not mask & selectors.EVENT_READ or line.port is None:
            return
        data = line.port.read()
        now_ns = time.monotonic_ns()
        if data:
            line.driver.received(data, now_ns)
        elif data is not None:
            self._close(line, f"{line.port.name} is gone.")

    def _poll(self, now_s: float) -> None:
        """Process what is due on all boards, and plan the next poll."""
        self._due_s = now_s + IDLE_S
        for line in self._lines:
            if line.port is None:
                if not line.opening and now_s >= line.next_open_s:
                    self._begin_opening(line)
            elif now_s >= line.driver.deadline_s:
                self._attempt(line, "while something was due", line.driver.poll, now_s)
            self._plan(line)
        self._due_s = max(self._due_s, now_s + POLL_S)

    def _plan(self, line: _Line) -> None:
        """Let the next poll come in time for what is due on this board."""
        if line.port is not None:
            self._due_s = min(self._due_s, line.driver.deadline_s)
        elif not line.opening:
            self._due_s = min(self._due_s, line.next_open_s)

    def _run_actions(self) -> None:
        with contextlib.suppress(BlockingIOError):
            self._wake_read.recv(4096)
        for _ in range(len(self._actions)):
            action = self._actions.popleft()
            try:
                action()
            except Exception:
                _logger.exception("an action of the link thread failed")

    def _attempt(self, line: _Line, doing: str, work: Callable[..., None], *arguments: object) -> None:
        """Do work of one board and write its output; an internal error closes only the connection to this board."""
        try:
            work(*arguments)
            self._write_output(line)
        except Exception:
            _logger.exception("%s: %s", line.driver.config.name, doing)
            self._close(line, "An internal error; see the gateway's log.")
        self._plan(line)

    # -- opening and closing

    def _begin_opening(self, line: _Line) -> None:
        line.opening = True
        config = line.driver.config

        # In a thread of its own: a TCP port or a stuck driver may block for seconds, and all boards would wait.
        def work() -> None:
            try:
                result = open_port(config.port, config.baud)
            except Exception as error:  # a driver's own bug: this port does not open, the others live on
                result = PortProblem("port-failed", f"{config.port} cannot be opened: {error}.")
            if not self.post(lambda: self._opened(line, result)) and not isinstance(result, PortProblem):
                result.close()

        threading.Thread(target=work, name=f"open-{config.name}", daemon=True).start()

    def _opened(self, line: _Line, result: Port | PortProblem) -> None:
        now_s = time.monotonic()
        line.opening = False
        line.next_open_s = now_s + line.driver.config.reconnect_s
        if isinstance(result, PortProblem):
            line.driver.port_absent(result.kind, result.text)
            self._plan(line)
            return
        if self._stopping:
            result.close()
            return
        line.port = result
        line.waits_for_room = False
        self._selector.register(result.fd, selectors.EVENT_READ, line)
        line.driver.port_opened(result.name, now_s)
        self._write_output(line)
        self._plan(line)

    def _close(self, line: _Line, text: str, *, severity: str = "warning") -> None:
        port, line.port = line.port, None
        if port is None:
            return
        self._selector.unregister(port.fd)
        # Closing may block as opening may: a tty drains what the adapter no longer takes, pyserial's socket sleeps.
        closing = threading.Thread(target=port.close, name=f"close-{line.driver.config.name}", daemon=True)
        closing.start()
        self._closing = [*(t for t in self._closing if t.is_alive()), closing]
        now_s = time.monotonic()
        line.next_open_s = now_s + line.driver.config.reconnect_s
        line.driver.port_lost(text, now_s, severity=severity)

    # -- writing

    def _write_output(self, line: _Line) -> None:
        if line.port is None:
            return
        while data := line.driver.output():
            written = line.port.write(data)
            if written is None:
                self._close(line, f"{line.port.name} is gone.")
                return
            line.driver.wrote(written)
            # The rest stays in the session. From a buffer here, a command could act after its sender was told of a
            # time-out.
            if written < len(data):
                break
        if bool(data) != line.waits_for_room:
            line.waits_for_room = bool(data)
            event_mask = selectors.EVENT_READ | (selectors.EVENT_WRITE if data else 0)
            self._selector.modify(line.port.fd, event_mask, line)
