"""The host's side of the protocol with one board: bytes and time in, events and bytes out.  No I/O, no clock.

Read `events.py` (the output) and `unwrap.py` (ticks of states) first; `protocol/README.md` specifies the board's side.

Rule 1: one command is outstanding; the others wait in order.  STOP does not wait: it is sent at once.  It
        cancels the waiting commands that could move the ball: a command given before STOP must not act after it.
Rule 2: a command is repeated with the same id, at most `retries` times.  Every submitted command ends in exactly one
        `Answer`, also when the board restarts or the connection ends.  STOPs that share a token share one `Answer`.
Rule 3: a reset of the board cancels all commands; the handshake is repeated and the session number increases.
Rule 4: frames do not wait in a buffer of bytes (`outgoing.py`): a command that was given up or cancelled is not sent.
Rule 5: a pipe may accept frames that the board reads much later.  A command that changes something is therefore sent
        only if the board has answered within PROVEN_S and no command was given up since; otherwise a PING is sent
        first.  A command that was not begun within its `wait_s` is given up with 0 attempts: it has not acted and
        never will.
Rule 6: the caller passes the time as `now_s` (any monotonic clock, seconds).  Feed the bytes that were read before
        calling `poll`, so that an answer in a buffer does not count as missing.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from protocol.wire.codec import encode_body
from protocol.wire.decoder import CAUSES, BadFrame, State, StreamDecoder
from protocol.wire.events import Answer, BoardEvent, Event, Opened, Outcome, Restarted, Sample, VersionRefused
from protocol.wire.messages import RESETS, ROW_OF_NAME, VERSION, EventCode, Message, Reason, Value
from protocol.wire.outgoing import ANSWERS, Command, SendQueue
from protocol.wire.unwrap import Jump, TickUnwrapper

MOVERS = frozenset({"SET_MODE", "SET_REFERENCE", "SET_GAINS", "EXCITE", "CAPTURE"})
WAIT_S = 2.0  # a command that cannot be sent within this time is given up: its sender no longer expects it to act
PROVEN_S = 0.5  # twice the time between two PINGs at the default host-loss time-out
MAX_STOPS = 8  # unanswered at a time: more would fill the line with STOPs and delay the answers


@dataclass(slots=True, kw_only=True)
class Counters:
    """The counters of one board's sessions, over all connections."""

    valid_frames: int = 0
    states: int = 0  # valid STATE frames; each is a sample, counted by the unwrapper, or ignored, see `states_ignored`
    samples: int = 0
    states_without_session: int = 0  # the scalings were not known
    bad_frames: dict[str, int] = field(default_factory=lambda: dict.fromkeys(CAUSES, 0))
    stray_answers: int = 0  # answers without an outstanding command: late, duplicated, or an echo
    stray_board_answers: int = 0  # stray answers of types that only a board sends
    events_lost: int = 0
    board_resets: int = 0


class Session:
    """Protocol session with one board.  Call `connect` when the port is open, `disconnect` when it is lost.

    Args:
        choose_session: gives a random 16-bit number for each handshake.
        timeout_s: wait for an answer before repeating.
        retries: repetitions before giving up.
        hello_s: time between two HELLO without an answer.
        first_number: of the first session; later ones count up.
    """

    def __init__(
        self,
        *,
        choose_session: Callable[[], int],
        timeout_s: float = 0.1,
        retries: int = 4,
        hello_s: float = 0.25,
        first_number: int = 1,
    ) -> None:
        self.number = first_number - 1
        self.counters = Counters()
        self.unwrapper = TickUnwrapper()
        self.is_open = False
        self.deadline_s = float("inf")  # when `poll` has something to do
        self._choose_session = choose_session
        self._timeout_s, self._retries, self._hello_s = timeout_s, retries, hello_s
        self._decoder = StreamDecoder()
        self._sending = SendQueue()
        self._queue: deque[Command] = deque()
        self._outstanding: dict[int, Command] = {}  # at most one command, and a STOP
        self._hello: Command | None = None
        # Ids do not start from 1: without a session the board may still keep answers to ids of the previous host, and
        # it would answer a STOP with such an id without executing it.
        self._next_id = choose_session() & 0xFF
        self._next_token = 0
        self._proven_s = -math.inf  # the board has answered
        self._identity: Message | None = None
        self._last_event: Message | None = None
        self._pending: list[Event] = []  # outcomes that occurred outside `feed` and `poll`

    @property
    def states_ignored(self) -> dict[str, int]:
        """The valid STATE frames that gave no sample, by cause; at most two more wait for their successor."""
        unwrapper = self.unwrapper
        return {
            "no-session": self.counters.states_without_session,
            "unplaced": unwrapper.unplaced,
            "implausible": unwrapper.implausible,
            "duplicate": unwrapper.duplicates,
        }

    @property
    def waiting(self) -> int:
        """The number of commands that are not answered yet."""
        return len(self._queue) + len(self._outstanding)

    def connect(self, now_s: float) -> None:
        """Begin the handshake on a new connection."""
        self._decoder = StreamDecoder()
        self._sending.clear()
        self._shake(now_s)

    def disconnect(self) -> list[Event]:
        """Cancel all commands, after the loss of the port."""
        self._cancel(lambda _: True, "disconnected")
        if self._hello is not None:
            self._sending.drop(self._hello)
        self.is_open = False
        self._hello = self._identity = None
        self.unwrapper.give_up()
        self.deadline_s = float("inf")
        return self.take_outcomes()

    def submit(self, name: str, now_s: float, wait_s: float = WAIT_S, /, **values: Value) -> int:
        """Queue a command and return its token; it waits for the handshake, STOP does not.

        While MAX_STOPS are not answered, and repeated until they are, further STOPs share the STOP after them, and
        its token.

        Args:
            name: of the message.
            now_s: now.
            wait_s: it is given up where it cannot begin to go out within this.
            values: of its fields.

        Raises:
            ValueError: a value is out of the range of its field.
        """
        encode_body(name, id=1, **values)  # refuse invalid values before queueing
        if name == "STOP":
            self._cancel(lambda c: c.name in MOVERS, "stop")
            shared = next((c for c in self._queue if c.name == "STOP"), None)
            if shared is not None:
                return shared.token
        self._next_token += 1
        command = Command(self._next_token, name, values, deadline_s=now_s + min(wait_s, WAIT_S))
        self._queue.append(command)
        self._pump(now_s)
        return command.token

    def output(self) -> bytes:
        """Return the next bytes for the UART: one frame, or the rest of one; b"" if there is none."""
        return self._sending.output()

    def wrote(self, count: int) -> None:
        """Note that the port has accepted `count` bytes of `output`."""
        self._sending.wrote(count)

    def take_output(self) -> bytes:
        """Return all bytes to write, for a port that accepts any number of bytes."""
        return self._sending.take()

    def take_outcomes(self) -> list[Event]:
        """Return the outcomes of commands that ended within `submit`, because a STOP cancelled them."""
        pending, self._pending = self._pending, []
        return pending

    def feed(self, data: bytes, now_s: float) -> list[Event]:
        """Process bytes read at `now_s` and return the events; never raises."""
        events: list[Event] = []
        good = states = samples = 0
        unwrapper = self.unwrapper
        for item in self._decoder.feed(data):
            if type(item) is State:
                states += 1
                if self._identity is None:
                    self.counters.states_without_session += 1
                    continue
                for placed in unwrapper.feed(item, now_s):
                    if isinstance(placed, Jump):
                        self._jumped(placed, now_s, events)
                        break
                    samples += 1
                    events.append(Sample(placed[0], self.number, placed[1], placed[2], placed[3]))
            elif type(item) is BadFrame:
                self.counters.bad_frames[item.cause] += 1
            else:
                assert isinstance(item, Message)
                good += 1
                self._message(item, now_s, events)
        if samples:
            self.counters.samples += samples
            if self.is_open:
                unwrapper.settle(now_s)
        self.counters.states += states
        self.counters.valid_frames += good + states
        if unwrapper.in_doubt:
            self._request_tick(now_s)
        if self._pending or self._queue:
            self._pump(now_s)
        return events + self.take_outcomes() if self._pending else events

    def poll(self, now_s: float) -> list[Event]:
        """Repeat or give up commands that were not answered in time."""
        if self._hello is not None and now_s >= self._hello.deadline_s:
            self._transmit(self._hello, now_s, self._hello_s)
        for command in list(self._outstanding.values()):
            if now_s < command.deadline_s:
                continue
            if command.tries > self._retries:
                del self._outstanding[command.id]
                self._sending.drop(command)
                self._sending.spare(command)
                self._proven_s = -math.inf
                self._answer(command, "timed-out")
            else:
                self._transmit(command, now_s, self._timeout_s)
        for command in [c for c in self._queue if now_s >= c.deadline_s]:
            self._queue.remove(command)
            self._answer(command, "timed-out")
        self._pump(now_s)
        return self.take_outcomes()

    # -- messages from the board

    def _message(self, message: Message, now_s: float, events: list[Event]) -> None:
        if message.name == "EVENT":
            self._event(message, now_s, events)
            return
        if ROW_OF_NAME[message.name].to_board:  # an echo of the host, or noise
            self.counters.stray_answers += 1
            return
        hello = self._hello
        if hello is not None and message.int("id") == hello.id and hello.accepts_answer(message):
            self._hello_answered(hello, message, now_s, events)
            return
        command = self._outstanding.get(message.int("id"))
        if command is None or not command.accepts_answer(message):
            self.counters.stray_answers += 1
            self.counters.stray_board_answers += 1
            return
        del self._outstanding[command.id]
        self._sending.withdraw(command)
        self._proven_s = now_s
        if message.name == "NACK":
            self._answer(command, "nack", message)
            if message.int("reason") == Reason.NO_SESSION:
                self._restart(events, "no-session", board_reset=True, now_s=now_s)
            return
        self._answer(command, "ack", message)
        # A repeated PING gets the stored answer: its tick is that of the first PING.
        if message.name == "PONG" and command.attempts == 1:
            self._witness(message.int("tick"), now_s, events)
        elif command.name == "SET_STREAM":
            self.unwrapper.stream(int(command.values["divider"]))
        elif message.name == "PARAMETERS" and not any(c.name == "SET_STREAM" for c in self._queue):
            self.unwrapper.stream(message.int("divider"))

    def _hello_answered(self, hello: Command, message: Message, now_s: float, events: list[Event]) -> None:
        if message.name == "NACK" and message.int("reason") != Reason.VERSION:
            self._shake(hello.deadline_s)  # BUSY: the id was another command's; the next HELLO has a new one
            return
        version = message.int("version" if message.name == "IDENTITY" else "detail")
        self._sending.withdraw(hello)
        self._hello = None
        self._proven_s = now_s
        if message.name == "NACK" or version != VERSION:
            events.append(VersionRefused(version))
            return
        self.number += 1
        self._identity = message
        self._last_event = None
        self.unwrapper.divider = None
        self.unwrapper.restart(message.int("tick"), now_s, sample_time_s=message.int("sample_time") * 1e-6)
        self.is_open = True
        events.append(Opened(message, self.number))

    def _event(self, message: Message, now_s: float, events: list[Event]) -> None:
        last, self._last_event = self._last_event, message
        if last is not None and last.values == message.values:
            return  # a duplicate
        code = EventCode(message.int("code"))
        missed = 0
        if last is not None and code not in RESETS:  # a reset restarts the numbers
            missed = (message.int("number") - last.int("number") - 1) & 0xFF
            self.counters.events_lost += missed
        events.append(BoardEvent(message.int("tick"), code, message.int("detail"), missed))
        # Also of a reset: answers overtake events on the line, so it may follow the IDENTITY that was asked for later.
        self._witness(message.int("tick"), now_s, events)

    def _witness(self, tick: int, now_s: float, events: list[Event]) -> None:
        if self.is_open:
            jump = self.unwrapper.witness(tick, now_s)
            if jump is not None:
                self._jumped(jump, now_s, events)

    def _request_tick(self, now_s: float) -> None:
        """Send a PING soon: a full tick contradicts the count, and a second one decides."""
        if not any(c.name == "PING" for c in [*self._outstanding.values(), *self._queue]):
            self.submit("PING", now_s)

    def _jumped(self, jump: Jump, now_s: float, events: list[Event]) -> None:
        self._restart(events, "tick", board_reset=jump.board_reset, now_s=now_s, doubtful=jump.doubtful)

    def _restart(
        self,
        events: list[Event],
        why: str,
        *,
        board_reset: bool,
        now_s: float,
        doubtful: tuple[int, int] | None = None,
    ) -> None:
        """Cancel all commands, discard the identity and repeat the handshake, after a loss of continuity."""
        if not self.is_open:
            return  # the handshake is in progress already
        if board_reset:
            self.counters.board_resets += 1
        self._cancel(lambda _: True, "board-reset")
        events.append(Restarted(why, board_reset, doubtful))
        self._shake(now_s)

    # -- commands to the board

    def _shake(self, now_s: float) -> None:
        """Send HELLO with a new session; states are ignored until the answer, which contains the scalings."""
        self.is_open = False
        self._identity = None
        self.unwrapper.give_up()
        session = self._choose_session() & 0xFFFF
        if self._hello is not None:
            self._sending.withdraw(self._hello)
        self._hello = Command(
            0, "HELLO", {"session": session, "version_min": VERSION, "version_max": VERSION}, deadline_s=now_s
        )
        self._hello.number(self._free_id())
        self.deadline_s = now_s

    def _pump(self, now_s: float) -> None:
        stops = sum(c.name == "STOP" for c in self._outstanding.values())
        if stops < MAX_STOPS:
            for stop in [c for c in self._queue if c.name == "STOP"]:
                self._queue.remove(stop)
                self._send(stop, now_s)
        queued = [c for c in self._queue if c.name != "STOP"]
        if self.is_open and queued and not any(c.name != "STOP" for c in self._outstanding.values()):
            proven = now_s - self._proven_s <= PROVEN_S
            following = next((c for c in queued if proven or c.name in ANSWERS), None)
            if following is not None:
                self._queue.remove(following)
            self._send(following or Command(0, "PING", {}), now_s)
        self._set_deadline()

    def _send(self, command: Command, now_s: float) -> None:
        command.number(self._free_id())
        self._outstanding[command.id] = command
        old, new = self.unwrapper.divider, command.values.get("divider")
        if command.name == "SET_STREAM" and old is not None and isinstance(new, int):
            self.unwrapper.divider = max(old, new)  # until the ACK, the rate of a frame is not known
        self._transmit(command, now_s, self._timeout_s)
        self._set_deadline()

    def _transmit(self, command: Command, now_s: float, timeout_s: float) -> None:
        command.tries += 1
        command.deadline_s = now_s + timeout_s
        self._sending.add(command)

    def _free_id(self) -> int:
        used_ids = self._outstanding.keys() | ({self._hello.id} if self._hello else set())
        while True:
            self._next_id = self._next_id % 255 + 1
            if self._next_id not in used_ids:
                return self._next_id

    def _answer(self, command: Command, outcome: Outcome, message: Message | None = None, why: str = "") -> None:
        if command.token:
            self._pending.append(Answer(command.token, outcome, command.attempts, message, why))

    def _cancel(self, which: Callable[[Command], bool], why: str) -> None:
        for command in [*self._outstanding.values(), *self._queue]:
            if which(command):
                self._outstanding.pop(command.id, None)
                self._sending.drop(command)
                self._answer(command, "cancelled", why=why)
        self._queue = deque(c for c in self._queue if not which(c))

    def _set_deadline(self) -> None:
        deadlines = [c.deadline_s for c in (*self._outstanding.values(), *self._queue)]
        if self._hello is not None:
            deadlines.append(self._hello.deadline_s)
        self.deadline_s = min(deadlines, default=float("inf"))
