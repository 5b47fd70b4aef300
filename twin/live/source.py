"""The newest minutes of a board: from the gateway's log if it is on this machine, otherwise from the bus.

Rule 1: the gateway names the log that it writes (`Status.log_file`).  A file of that name without this board's session
        belongs to another gateway and is not used.
Rule 2: an unfinished part is read as far as it goes; older messages are taken from the parts before it.
Rule 3: only the requested minutes are kept in memory.
"""

from __future__ import annotations

import re
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import zenoh

from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.bus.encoding import parse
from protocol.errors import ServiceError, UsageError
from protocol.log.reader import LogReader
from twin.readers.log import entries

STATUS_WAIT_S = 3.5  # it comes once a second
PROGRESS_S = 10.0
TOPICS = ("state", "parameters", "plant", "capture", "twin/model")
_PART = re.compile(r"(?P<run>.+)-(?P<number>\d{3,})\.mcap")
Progress = Callable[[str], None]


@dataclass(slots=True)
class LiveData:
    """The messages of one board, in the order of time."""

    states: deque[pb.State] = field(default_factory=deque)
    captures: list[pb.CaptureRecord] = field(default_factory=list)
    parameters: list[pb.Parameters] = field(default_factory=list)
    card: pb.PlantCard | None = None  # the newest
    model_json: str = ""  # the model of the live twin
    where: str = ""

    def take(self, topic: str, data: bytes) -> None:
        """Store a message; data that cannot be parsed is left out."""
        match parse(topics.TOPIC_OF_NAME[topic].message, data):
            case pb.State() as state:
                self.states.append(state)
            case pb.CaptureRecord() as capture:
                self.captures.append(capture)
            case pb.Parameters() as parameters:
                # The gateway repeats them every 5 s: only another law is a new entry.
                if not self.parameters or in_force(parameters) != in_force(self.parameters[-1]):
                    self.parameters.append(parameters)
            case pb.PlantCard() as card:
                self.card = card
            case pb.TwinModel() as model:
                self.model_json = model.model_json

    def newest(self, span_s: float) -> None:
        """Drop messages older than `span_s`, by the host's clock."""
        if not self.states:
            return
        since_ns = self.states[-1].host_time_ns - round(span_s * 1e9)
        while self.states and self.states[0].host_time_ns < since_ns:
            self.states.popleft()
        self.captures = [capture for capture in self.captures if capture.host_time_ns >= since_ns]


def find_board(session: zenoh.Session, site: str, board: str | None) -> tuple[str, pb.Status]:
    """Return the chosen board and the status from its gateway.

    Raises:
        ServiceError: no gateway reports it.
        UsageError: there are several, and none was named.
    """
    boards: dict[str, pb.Status] = {}

    def arrived(sample: zenoh.Sample) -> None:
        parts = topics.split(str(sample.key_expr))
        status = parse(pb.Status, sample.payload.to_bytes())
        if parts is not None and status is not None:
            boards[parts[1]] = status

    subscriber = session.declare_subscriber(topics.key(site, board or "*", "status"), arrived)
    deadline = time.monotonic() + STATUS_WAIT_S
    # A named board is known with its first status; without a name all are awaited, because two must be refused.
    while time.monotonic() < deadline and not (board and boards):
        time.sleep(0.05)
    subscriber.undeclare()
    if not boards:
        raise ServiceError(
            f"No gateway reports {site}/{board or '*'}",
            remedy="Start `board51 gateway`, or check --site and --board",
        )
    if len(boards) > 1:
        raise UsageError(f"Several boards report: {', '.join(sorted(boards))}", remedy="Choose one with --board")
    return next(iter(boards.items()))


def from_log(status: pb.Status, folder: Path, site: str, board: str, span_s: float) -> LiveData | None:
    """Return the newest `span_s` of the log that the gateway is writing; None if it is not in `folder`.

    Raises:
        DataError: the file is there and cannot be read.
    """
    current = folder / status.log_file
    if not status.log_file or not current.is_file():
        return None
    files = [current]
    if part := _PART.fullmatch(current.name):
        older = [folder / f"{part['run']}-{number:03d}.mcap" for number in range(int(part["number"]))]
        files = [path for path in older if path.is_file()] + files
    live = LiveData(where=str(current))
    # Backwards until the parts cover the span: an older part is read only where it is needed.
    for first in reversed(range(len(files))):
        live = LiveData(where=str(current))
        for path in files[first:]:
            for entry in entries(LogReader(path), topics=TOPICS, board=board):
                if entry.site != site:
                    continue
                live.take(entry.topic, entry.data)
                # While reading, not at the end: a log of a day must not be in memory for its last minutes.
                if entry.topic == "state" and len(live.states) % 1000 == 0:
                    live.newest(span_s)
        whole_s = 1e-9 * (live.states[-1].host_time_ns - live.states[0].host_time_ns) if live.states else 0.0
        if whole_s >= 0.99 * span_s:
            break
    live.newest(span_s)
    if not live.states or live.states[-1].session != status.session:
        return None
    return live


def from_bus(session: zenoh.Session, site: str, board: str, span_s: float, progress: Progress) -> LiveData:
    """Listen for `span_s`.  Raises ServiceError if no samples arrive."""
    live = LiveData(where="the bus")
    queue: deque[tuple[str, bytes]] = deque()

    def arrived(sample: zenoh.Sample) -> None:
        parts = topics.split(str(sample.key_expr))
        if parts is not None and parts[2] in TOPICS:
            queue.append((parts[2], sample.payload.to_bytes()))

    subscriber = session.declare_subscriber(f"{site}/{board}/**", arrived)
    began = reported_s = time.monotonic()
    progress(f"the gateway's log is not on this machine: listening for {span_s:.0f} s")
    # zenoh's thread only queues: parsing there would hold up the next message.
    while (now := time.monotonic()) - began < span_s:
        time.sleep(0.05)
        while queue:
            live.take(*queue.popleft())
        if now - reported_s >= PROGRESS_S:
            reported_s = now
            progress(f"{now - began:.0f} of {span_s:.0f} s, {len(live.states)} samples")
    subscriber.undeclare()
    if not live.states:
        raise ServiceError(
            f"No sample of {site}/{board} came within {span_s:.0f} s", remedy="See `board51 watch --topic status`"
        )
    return live


def in_force(parameters: pb.Parameters) -> tuple[int, int, tuple[float, ...], float, float, float]:
    """Return (session, law, gains, i_0, x_0, u_0), which is equal for two messages with the same law."""
    p = parameters
    return p.session, p.law, tuple(p.gains), p.i_0_a, p.x_0_m, p.u_0_v
