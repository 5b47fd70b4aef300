"""The host's side of the protocol with one board: bytes and time in, events and bytes out.  No I/O, no clock.

Read `events.py` (the output), `exchange.py` (commands) and `unwrap.py` (ticks of states) first; `protocol/README.md`
specifies the board's side.

Rule 1: a reset of the board cancels all commands; the handshake is repeated and the session number increases.
Rule 2: the caller passes the time as `now_s` (any monotonic clock, seconds).  Feed the bytes that were read before
        calling `poll`, so that an answer in a buffer does not count as missing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from protocol.wire.decoder import CAUSES, BadFrame, State, StreamDecoder
from protocol.wire.events import BoardEvent, Event, Opened, Restarted, Sample, VersionRefused
from protocol.wire.exchange import Command, CommandExchange
from protocol.wire.messages import RESETS, ROW_OF_NAME, VERSION, EventCode, Message, Reason
from protocol.wire.unwrap import Jump, TickUnwrapper


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


class Session(CommandExchange):
    """Protocol session with one board.  Call `connect` when the port is open, `disconnect` when it is lost.

    `choose_session` gives a random 16-bit number for each handshake.  A command without an answer is repeated `retries`
    times after `timeout_s`, a HELLO every `hello_s`.
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
        # Ids do not start from 1: without a session the board may still keep answers to ids of the previous host, and
        # it would answer a STOP with such an id without executing it.
        super().__init__(timeout_s=timeout_s, retries=retries, hello_s=hello_s, first_id=choose_session() & 0xFF)
        self.number = first_number - 1
        self.counters = Counters()
        self.unwrapper = TickUnwrapper()
        self._choose_session = choose_session
        self._decoder = StreamDecoder()
        self._identity: Message | None = None
        self._last_event: Message | None = None

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

    def connect(self, now_s: float) -> None:
        """Begin the handshake on a new connection."""
        self._decoder = StreamDecoder()
        # What is left of the old connection would be written in front of the first HELLO.
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
                tick = unwrapper.following(item.sequence, now_s)
                if tick is not None:
                    samples += 1
                    events.append(Sample(tick, self.number, 0, item, now_s))
                    continue
                for placed in unwrapper.feed(item, now_s):
                    if isinstance(placed, Jump):
                        self._jumped(placed, now_s, events)
                        break
                    samples += 1
                    events.append(placed)
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
        # A full tick contradicts the count, and a second one, from a PING, decides.
        if unwrapper.in_doubt and not any(c.name == "PING" for c in [*self._outstanding.values(), *self._queue]):
            self.submit("PING", now_s)
        if self._pending or self._queue:
            self._pump(now_s)
        return events + self.take_outcomes() if self._pending else events

    # -- messages from the board

    def _message(self, message: Message, now_s: float, events: list[Event]) -> None:
        if message.name == "EVENT":
            self._event(message, now_s, events)
            return
        if ROW_OF_NAME[message.name].to_board:  # an echo of the host, or noise
            self.counters.stray_answers += 1
            return
        command = self._match(message)
        if command is None:
            self.counters.stray_answers += 1
            self.counters.stray_board_answers += 1
            return
        if command.name == "HELLO":
            self._hello_answered(command, message, now_s, events)
            return
        self._conclude(command, message, now_s)
        if message.name == "NACK":
            if message.int("reason") == Reason.NO_SESSION:
                self._restart(events, "no-session", board_reset=True, now_s=now_s)
            return
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
        self._conclude(hello, message, now_s)
        if message.name == "NACK" or version != VERSION:
            events.append(VersionRefused(version))
            return
        self.number += 1
        self.unwrapper.session = self.number
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

    def _jumped(self, jump: Jump, now_s: float, events: list[Event]) -> None:
        self._restart(events, "tick", board_reset=jump.board_reset, now_s=now_s, doubtful=jump.doubtful)

    def _restart(
        self, events: list[Event], why: str, *, board_reset: bool, now_s: float, doubtful: tuple[int, int] | None = None
    ) -> None:
        """Cancel all commands, discard the identity and repeat the handshake, after a loss of continuity."""
        if not self.is_open:
            return  # the handshake is in progress already
        if board_reset:
            self.counters.board_resets += 1
        self._cancel(lambda _: True, "board-reset")
        events.append(Restarted(why, board_reset, doubtful))
        self._shake(now_s)

    def _shake(self, now_s: float) -> None:
        """Send HELLO with a new session; states are ignored until the answer, which contains the scalings."""
        self.is_open = False
        self._identity = None
        self.unwrapper.give_up()
        self._call(self._choose_session() & 0xFFFF, now_s)

    def _send(self, command: Command, now_s: float) -> None:
        old, new = self.unwrapper.divider, command.values.get("divider")
        if command.name == "SET_STREAM" and old is not None and isinstance(new, int):
            self.unwrapper.divider = max(old, new)  # until the ACK, the rate of a frame is not known
        super()._send(command, now_s)
