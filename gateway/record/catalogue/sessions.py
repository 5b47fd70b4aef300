"""The rows of a log in the catalogue: one for each session of a board, from a single pass.  Only sums are kept."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from gateway.record.summary import Range, SampleGaps
from protocol.bus import board51_pb2 as pb
from protocol.log.reader import LogReader

_TOPICS = ("state", "parameters", "event", "twin/model", "twin/diagnosis", "twin/alarm", "twin/divergence")


@dataclass(frozen=True, slots=True, kw_only=True)
class Session:
    """A row of the catalogue: a session of a board in one log.  The fields are the columns; units are in their names.

    Means of the twin are over the samples in step with it, and None without a twin.
    """

    site: str
    board: str
    session: int
    board_id: int | None  # serial number
    firmware: str
    began: str  # UTC, "2026-05-01 12:00:00"
    ended: str
    duration_s: float
    samples: int
    missing: int  # samples that the board made and that are not in the log
    flown_s: float  # in closed loop
    x_low_m: float | None
    x_high_m: float | None
    model: str  # of the twin, the last one; empty without a twin
    causes: str  # that the twin named in flight, with commas between them
    alarms: str  # of the twin
    faults: str  # events of this severity
    divergence_x_m: float | None  # rms of measured minus twin
    divergence_i_c_a: float | None
    innovation_x_m: float | None  # rms of measured minus predicted one sample ahead
    nis: float | None  # mean normalised innovation squared: 2 under a right model


@dataclass(slots=True)
class _Sums:
    """The sums of a session so far."""

    gaps: SampleGaps
    parameters: pb.Parameters | None = None
    first_ns: int = 0
    last_ns: int = 0
    samples: int = 0
    flown_s: float = 0.0
    last_t_s: float | None = None  # of the last sample in closed loop
    x: Range = field(default_factory=Range)
    model: str = ""
    causes: dict[str, None] = field(default_factory=dict)
    alarms: dict[str, None] = field(default_factory=dict)
    faults: dict[str, None] = field(default_factory=dict)
    # Of the squares:
    error_x: Range = field(default_factory=Range)
    error_i_c: Range = field(default_factory=Range)
    innovation: Range = field(default_factory=Range)
    nis: Range = field(default_factory=Range)


def sessions_of(path: Path) -> tuple[list[Session], str]:
    """Return (the rows of a log in the order of their beginning, what is wrong with the log; empty if nothing).

    Raises:
        DataError: the file is absent, empty or not MCAP.
    """
    reader, sums = LogReader(path), dict[tuple[str, str, int], _Sums]()
    newest: dict[tuple[str, str], int] = {}
    for record in reader.records(topics_=_TOPICS):
        board, message = (record.site, record.board), record.message
        session = int(getattr(message, "session", 0)) or newest.get(board, 0)
        newest[board] = session
        known = sums.setdefault((*board, session), _Sums(SampleGaps(record.board), first_ns=record.time_ns))
        known.last_ns = max(known.last_ns, record.time_ns)
        match message:
            case pb.State():
                _take_state(known, message)
            case pb.Divergence() if message.sync == "in-step":
                _take_divergence(known, message)
            case pb.Parameters():
                known.parameters = message
                known.gaps.divider = max(message.stream_divider, 1)
            case pb.TwinModel():
                known.model = message.name
            case pb.TwinDiagnosis() if message.cause:
                known.causes[message.cause] = None
            case pb.Alarm() if message.active:
                known.alarms[message.name] = None
            case pb.Event() if message.severity == "fault":
                known.faults[message.name] = None
    damages = [damage.reason for scan in reader.scans for damage in scan.damages if not damage.is_cut]
    # Messages without a sample, such as a model from before the board answered, are not a session.
    return [_row(*key, known) for key, known in sums.items() if known.samples], "; ".join(damages)


def _take_state(known: _Sums, state: pb.State) -> None:
    known.samples += 1
    known.gaps.take(state)
    if state.HasField("x_m"):
        known.x.take(state.x_m)
    flies = state.mode == pb.MODE_CLOSED_LOOP
    if flies and known.last_t_s is not None:
        known.flown_s += max(state.t_s - known.last_t_s, 0.0)
    known.last_t_s = state.t_s if flies else None


def _take_divergence(known: _Sums, divergence: pb.Divergence) -> None:
    errors = (divergence.x_m.error, divergence.i_c_a.error)
    squares = [(known.error_x, errors[0] * errors[0]), (known.error_i_c, errors[1] * errors[1])]
    if divergence.innovation_valid:
        innovation = divergence.innovation_x_m
        squares += [(known.innovation, innovation * innovation), (known.nis, max(divergence.nis, 0.0))]
    for sums, square in squares:
        if math.isfinite(square):
            sums.take(square)


def _row(site: str, board: str, session: int, known: _Sums) -> Session:
    parameters, x = known.parameters, known.x
    return Session(
        site=site, board=board, session=session,
        board_id=None if parameters is None else parameters.board_id,
        firmware="" if parameters is None else parameters.firmware,
        began=_text(known.first_ns), ended=_text(known.last_ns), duration_s=(known.last_ns - known.first_ns) / 1e9,
        samples=known.samples, missing=known.gaps.missing, flown_s=known.flown_s,
        x_low_m=x.low if x.low <= x.high else None, x_high_m=x.high if x.low <= x.high else None,
        model=known.model, causes=",".join(known.causes), alarms=",".join(known.alarms), faults=",".join(known.faults),
        divergence_x_m=_root(known.error_x), divergence_i_c_a=_root(known.error_i_c),
        innovation_x_m=_root(known.innovation), nis=known.nis.mean if known.nis.count else None,
    )  # fmt: skip


def _root(squares: Range) -> float | None:
    return math.sqrt(squares.mean) if squares.count else None


def _text(time_ns: int) -> str:
    return datetime.fromtimestamp(time_ns / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S")
