"""Summarises a log in one pass: boards, duration, counts, rates, gaps, ranges, sessions.  Only sums are kept."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path

from protocol.bus import board51_pb2 as pb
from protocol.bus import encoding
from protocol.log.reader import LogReader

CHANNELS = ("i_c_a", "x_m", "u_c_v", "x_ref_m")
GAPS_RETAINED = 1000  # entries in the list; the sums include all gaps


@dataclass(frozen=True, slots=True, kw_only=True)
class Gap:
    """Samples of the board that are missing in the log."""

    board: str
    session: int
    after_tick: int
    missing: int
    at_s: float  # board time of the sample before it


class SampleGaps:
    """Finds gaps in the ticks of one board; a step of `divider` ticks is not a gap."""

    def __init__(self, board: str) -> None:
        self.board = board
        self.gaps: list[Gap] = []
        self.missing = 0
        self.count = 0
        self.sessions = 0
        self.divider = 1  # from the newest parameters
        self._last: pb.State | None = None

    def take(self, state: pb.State) -> None:
        """Process one sample; samples must come in the order of the log."""
        last, self._last = self._last, state
        if last is None or last.session != state.session or state.tick <= last.tick:
            self.sessions += last is None or last.session != state.session
            return
        # The ticks also show losses of the log; `lost_before` also counts losses at a coarser stream.
        missing = max(state.lost_before, (state.tick - last.tick) // self.divider - 1)
        if missing <= 0:
            return
        self.count += 1
        self.missing += missing
        if len(self.gaps) < GAPS_RETAINED:
            self.gaps.append(
                Gap(board=self.board, session=state.session, after_tick=last.tick, missing=missing, at_s=last.t_s)
            )


@dataclass(slots=True)
class Range:
    """The extremes and mean of a channel, SI."""

    count: int = 0
    low: float = math.inf
    high: float = -math.inf
    total: float = 0.0

    def take(self, value: float) -> None:
        """Count a value."""
        self.count += 1
        self.total += value
        self.low = min(self.low, value)
        self.high = max(self.high, value)

    @property
    def mean(self) -> float:
        """The mean; only after a value."""
        return self.total / self.count


@dataclass(slots=True)
class TopicSummary:
    """Statistics of the messages under one key."""

    count: int = 0
    bytes: int = 0
    first_ns: int = 0
    last_ns: int = 0

    @property
    def rate_hz(self) -> float | None:
        """The mean rate over the time from first to last; None for a single message."""
        span_s = (self.last_ns - self.first_ns) / 1e9
        return (self.count - 1) / span_s if span_s > 0 else None


@dataclass(slots=True)
class BoardSummary:
    """The sums of one board."""

    gaps: SampleGaps
    topics: dict[str, TopicSummary] = field(default_factory=dict)
    ranges: dict[str, Range] = field(default_factory=dict)
    resets: int = 0  # by events of the board
    events: dict[str, int] = field(default_factory=dict)
    parameters: pb.Parameters | None = None
    modes: set[str] = field(default_factory=set)
    models: list[pb.TwinModel] = field(default_factory=list)  # of the twin, one entry per change


@dataclass(slots=True)
class LogSummary:
    """The summary of a complete log; its fields are the keys of `as_json`."""

    parts: list[dict[str, object]]
    start_ns: int
    duration_s: float
    boards: dict[str, BoardSummary]
    foreign_messages: Mapping[str, int]
    unparsable_messages: Mapping[str, int]
    damages: list[dict[str, object]]
    metadata: Mapping[str, Mapping[str, str]]
    schemas: list[str]


def summarise(paths: Path | Sequence[Path]) -> LogSummary:
    """Read a log once, damaged or not, and return its summary.

    Raises:
        DataError: a file is absent, empty, not MCAP, or holds no Board51 messages.
    """
    reader = LogReader(paths)
    boards: dict[str, BoardSummary] = {}
    first_ns: int | None = None
    last_ns = 0
    for record in reader.records():
        name = f"{record.site}/{record.board}"
        board = boards.setdefault(name, BoardSummary(SampleGaps(record.board)))
        first_ns = record.time_ns if first_ns is None else min(first_ns, record.time_ns)
        last_ns = max(last_ns, record.time_ns)
        topic = board.topics.setdefault(record.topic, TopicSummary(first_ns=record.time_ns))
        topic.count += 1
        topic.bytes += record.message.ByteSize()
        topic.last_ns = record.time_ns
        match record.message:
            case pb.State() as state:
                _take_state(board, state)
            case pb.Parameters() as parameters:
                board.parameters = parameters
                board.gaps.divider = max(parameters.stream_divider, 1)
            case pb.TwinModel() as model:
                model.ClearField("host_time_ns")  # what repetitions differ in
                if not board.models or board.models[-1] != model:
                    board.models.append(model)
            case pb.Event() as event:
                board.events[event.name] = board.events.get(event.name, 0) + 1
                board.resets += event.source == "board" and event.name.startswith("reset")
    if not boards:
        reader.check(last_ns=None)
    return LogSummary(
        parts=[
            {"file": str(scan.path), "bytes": scan.size, "complete": scan.finished, "library": scan.library}
            for scan in reader.scans
        ],
        start_ns=first_ns or 0,
        duration_s=(last_ns - first_ns) / 1e9 if first_ns is not None else 0.0,
        boards=boards,
        foreign_messages=dict(reader.foreign),
        unparsable_messages=dict(reader.unparsable),
        damages=[{"file": scan.path.name, **asdict(damage)} for scan in reader.scans for damage in scan.damages],
        metadata=reader.metadata,
        schemas=sorted({schema.name for scan in reader.scans for schema in scan.schemas.values()}),
    )


def _take_state(board: BoardSummary, state: pb.State) -> None:
    for name in CHANNELS:
        if state.HasField(name):
            board.ranges.setdefault(name, Range()).take(getattr(state, name))
    board.modes.add(encoding.word_of(pb.Mode, state.mode))
    board.gaps.take(state)


def as_json(summary: LogSummary) -> dict[str, object]:
    """Return the summary as plain data for `--json`."""
    boards = {name: _board_json(board) for name, board in summary.boards.items()}
    return {key.name: getattr(summary, key.name) for key in fields(summary)} | {"boards": boards}


def _board_json(board: BoardSummary) -> dict[str, object]:
    parameters, gaps = board.parameters, board.gaps
    topics = {name: {"count": t.count, "rate_hz": t.rate_hz, "bytes": t.bytes} for name, t in board.topics.items()}
    ranges = {n: {"low": r.low, "high": r.high, "mean": r.mean, "count": r.count} for n, r in board.ranges.items()}
    keys = ("name", "sha256", "session", "since_tick", "who")
    return {
        "topics": topics,
        "ranges": ranges,
        "sessions": gaps.sessions,
        "resets": board.resets,
        "modes": sorted(board.modes),
        "twin_models": [{key: getattr(model, key) for key in keys} for model in board.models],
        "events": board.events,
        "gaps": {"count": gaps.count, "samples_missing": gaps.missing, "list": [asdict(gap) for gap in gaps.gaps]},
        "sample_time_s": parameters.sample_time_s if parameters else None,
        "firmware": parameters.firmware if parameters else None,
        "gains": list(parameters.gains) if parameters else None,
    }


def as_text(summary: LogSummary) -> str:
    """Return the summary as text for people."""
    return "\n".join(_lines(summary))


def _lines(summary: LogSummary) -> Iterable[str]:
    for part in summary.parts:
        state = "complete" if part["complete"] else "without its end (still being written, or killed)"
        yield f"{part['file']}: {part['bytes']} bytes, {state}"
    yield f"duration {summary.duration_s:.3f} s, {len(summary.boards)} board(s)"
    for name, board in summary.boards.items():
        known = board.parameters
        details = f", T_s {known.sample_time_s * 1e3:g} ms, firmware {known.firmware or '-'}" if known else ""
        yield f"\n{name}: {board.gaps.sessions} session(s), {board.resets} reset(s){details}"
        for topic, counts in board.topics.items():
            rate = f"{counts.rate_hz:10.2f} Hz" if counts.rate_hz is not None else " " * 13
            yield f"  {topic:<16}{counts.count:>10} messages {rate} {counts.bytes:>12} bytes"
        for channel, span in board.ranges.items():
            yield f"  {channel:<16}{span.low:>14.6g} .. {span.high:.6g}, mean {span.mean:.6g}"
        if board.modes:
            yield f"  modes           {', '.join(sorted(board.modes))}"
        for model in board.models:
            whose = f", handed over by {model.who}" if model.who else ""
            yield f"  twin's model    {model.name} ({model.sha256[:12]}) from tick {model.since_tick}{whose}"
        if board.events:
            yield "  events          " + ", ".join(f"{event} x{count}" for event, count in board.events.items())
        yield f"  gaps            {board.gaps.count}, {board.gaps.missing} sample(s) missing"
        for gap in board.gaps.gaps[:10]:
            yield f"    after tick {gap.after_tick} ({gap.at_s:.3f} s): {gap.missing} missing"
        if len(board.gaps.gaps) > 10:
            yield f"    and {board.gaps.count - 10} more; --json lists them"
    for topic, count in summary.foreign_messages.items():
        yield f"foreign: {topic}, {count} messages"
    for damage in summary.damages:
        yield f"DAMAGED {damage['file']} at byte {damage['offset']}: {damage['reason']} ({damage['bytes']} bytes)"
    yield f"\nschemas: {', '.join(summary.schemas)}"
    for name, values in summary.metadata.items():
        yield f"metadata {name}: " + ", ".join(f"{key} = {value}" for key, value in values.items())
