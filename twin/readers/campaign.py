"""Read the recordings of a campaign: CSV (also .gz), MATLAB, MCAP.

Rule 1: a bad file is a DataError that names file, column and remedy; a bad cell becomes NaN and a note.
Rule 2: `skip_s` seconds at the beginning of a file are left out; rows are never sorted.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from protocol.campaign import CHANNELS, Campaign, Channel, Column, Recording
from protocol.errors import DataError
from protocol.files import open_regular
from protocol.table_file import LONGEST_LINE, REMEDY, read_csv_bytes, read_header, read_mat
from twin.estimation.record import Capture, FloatArray, Record
from twin.readers.host_clock import ClockError, clock_error, clock_note, combined

if TYPE_CHECKING:
    from protocol.bus import board51_pb2 as pb

_HEAD = 4096  # bytes in which a file is recognised as text
_ON_A_TICK = 1e-3  # of a tick: an instant nearer to one is on it


def read_campaign(campaign: Campaign, *, use: str = "fit", data: Path | None = None) -> list[Record]:
    """Read all recordings of one use (`fit` | `judge`), in the order of the file.

    Raises:
        DataError: a recording is missing or unreadable.
    """
    return [
        read_recording(campaign.path_of(recording, data=data), recording)
        for recording in campaign.recordings
        if recording.use == use
    ]


def read_recording(path: Path, recording: Recording) -> Record:
    """Read one recording; the format is recognised by the file's content (a .mat file also by its suffix).

    Raises:
        DataError: the file is not CSV, MATLAB or MCAP, or lacks a channel that its kind needs.
    """
    with open_regular(path, remedy=REMEDY) as file:
        head = file.read(16)
    if head.startswith(b"\x89MCAP0\r\n"):
        record = _read_log(path, recording)
    elif head.startswith(b"MATLAB") or path.suffix.lower() == ".mat":
        record = _from_columns(path, recording, *read_mat(path))
    else:
        record = _from_columns(path, recording, _csv_columns(path))
    return _skip(record, recording.skip_s)


def read_flight(
    path: Path, campaign: Campaign | None = None, *, data: Path | None = None, board: str | None = None
) -> Record:
    """Read a recording by its path.

    Args:
        path: of the recording.
        campaign: that lists it, with its columns and skip_s; None: the default columns.
        data: folder of the recordings, if it is not that of the campaign.
        board: to read, in a log of several boards.

    Raises:
        DataError: the recording is unreadable, or is not one of the campaign.
    """
    entry, path = located(path, campaign, data=data, board=board)
    record = read_recording(path, entry)
    return record if campaign is not None else replace(record, kind="free")  # whether the loop was closed is unknown


def located(
    recording: Path, campaign: Campaign | None, *, data: Path | None, board: str | None
) -> tuple[Recording, Path]:
    """Return (the entry of a recording, the path of its file); the arguments are those of `read_flight`.

    Raises:
        DataError: the recording is not one of the campaign.
    """
    if campaign is None:
        return Recording(file=recording.name, kind="closed-loop", use="judge", board=board or ""), recording
    exact = [r for r in campaign.recordings if recording in (Path(r.file), campaign.folder / r.file)]
    result = exact or [r for r in campaign.recordings if Path(r.file).name == recording.name]
    if len(result) != 1:
        listed = ", ".join(r.file for r in campaign.recordings) or "none"
        problem = "appears twice" if result else "is not one of its recordings"
        raise DataError(f"{campaign.where}: {str(recording)!r} {problem}", remedy=f"Name one of: {listed}")
    entry = result[0] if board is None else replace(result[0], board=board)
    return entry, recording if recording.is_file() else campaign.path_of(result[0], data=data)


def _skip(record: Record, skip_s: float) -> Record:
    if skip_s <= 0.0 or record.kind == "equilibria" or not len(record.t):
        return record
    keep = record.t >= record.t[0] + skip_s
    if keep.sum() < 2:
        raise DataError(
            f"{record.name}: skip_s = {skip_s:g} leaves nothing of {record.t[-1] - record.t[0]:.3g} s",
            remedy="Give a smaller skip_s",
        )
    return record.part(keep)


# ---- tables


def _csv_columns(path: Path) -> dict[str, FloatArray]:
    # pyarrow parses 30 MB/s per core into columns; csv + float() took 40 times as long, np.loadtxt 15 times.
    import pyarrow as pa
    from pyarrow import csv

    data = read_csv_bytes(path)
    if not data[:_HEAD].decode("utf-8", errors="ignore").strip():
        raise DataError(f"{path} is not text", remedy="Name a CSV file in UTF-8, a .mat or an MCAP file")
    # Bytes, because an hour of samples as a list of lines takes half a gigabyte.
    if data.startswith(b"#") or b"\n#" in data:
        data = b"\n".join(line for line in data.split(b"\n") if not line.startswith(b"#"))
    start = len(data) - len(data.lstrip()) if data[:1].isspace() else 0
    end = data.find(b"\n", start)
    if end < 0 or not data[end : end + _HEAD].strip():
        raise DataError(f"{path} holds no rows", remedy="Name a file with a line of column names and rows of numbers")
    header = data[start:end].decode("utf-8", errors="replace").strip()
    row = data[end + 1 : end + 1 + LONGEST_LINE].lstrip().partition(b"\n")[0].decode("utf-8", errors="replace")
    names, separator = read_header(path, header, row)
    options = {
        "read_options": csv.ReadOptions(column_names=list(names)),
        "parse_options": csv.ParseOptions(delimiter=separator),
    }
    body = memoryview(data)[end + 1 :]
    try:
        # In batches, so that the samples are not in memory as text, Arrow and numpy at the same time.
        lines = data.count(b"\n", end) + data.count(b"\r", end) - data.count(b"\r\n", end) + 1  # as Arrow sees them
        values = np.empty((len(names), lines))
        rows = 0
        for batch in csv.open_csv(pa.BufferReader(body), **options):
            for n, column in enumerate(batch.columns):
                values[n, rows : rows + batch.num_rows] = _numbers(column)
            rows += batch.num_rows
        columns = {name: values[n, :rows] for n, name in enumerate(names)}
        pa.default_memory_pool().release_unused()
        return columns
    except pa.ArrowInvalid:
        pass  # a column changes its type between batches: read the whole table
    try:
        table = csv.read_csv(pa.BufferReader(body), **options)
    except pa.ArrowInvalid as error:
        where = (
            str(error).splitlines()[0].partition(": ")[2]
        )  # "CSV parse error: Row #3: Expected 4 columns, got 2: ROW"
        where = re.sub(r"(got \d+): .*", r"\1", where)
        raise DataError(f"{path} is not a table: {where}", remedy="Complete that line") from None
    return {name: _numbers(table.column(name)) for name in names}


def _numbers(column: object) -> FloatArray:
    import pyarrow as pa

    assert isinstance(column, pa.ChunkedArray | pa.Array)
    if pa.types.is_integer(column.type) or pa.types.is_floating(column.type):
        # Not `safe`: an integer above 2^53, as a time in ns since 1970 is, may be rounded to the nearest double.
        return np.asarray(column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False), dtype=float)
    return np.array([_number(cell) for cell in column.to_pylist()], dtype=float)


def _number(cell: object) -> float:
    try:
        return float(str(cell))
    except ValueError:
        return float("nan")


_NEEDED: dict[str, tuple[Channel, ...]] = {
    "amplifier-step": ("t", "u_c", "i_c"),
    "sawtooth": ("t", "i_c", "x"),
    "prbs": ("t", "u_c", "i_c", "x"),
    "closed-loop": ("t", "u_c", "i_c", "x"),
    "equilibria": ("i_c", "x"),
    "free": ("t",),
}


def _from_columns(
    path: Path,
    recording: Recording,
    columns: Mapping[str, Sequence[float] | FloatArray],
    unusable: Mapping[str, str] = MappingProxyType({}),  # other variables, and why they are not columns
) -> Record:
    channels: dict[str, FloatArray] = {}
    notes = [f"{recording.file}: {name} cannot be used: {why}" for name, why in unusable.items()]
    for channel in CHANNELS:
        mapping = recording.column(channel)
        if mapping.column in columns:
            channels[channel] = _convert(mapping, np.asarray(columns[mapping.column], dtype=float))
            bad = int(np.count_nonzero(~np.isfinite(channels[channel])))
            if channel == "t" and bad == len(channels[channel]):
                raise DataError(
                    f"{path}: no cell of column {mapping.column!r}, mapped to t, is a number",
                    remedy="Give the time in seconds with a decimal point, 0.002; convert dates and clock times",
                )
            if bad:
                notes.append(f"{recording.file}: {bad} cells of {mapping.column} are not numbers and were left out")
        elif channel in recording.columns or channel in _NEEDED[recording.kind]:
            raise DataError(
                f"{path} has no column {mapping.column!r}{_why(mapping.column, unusable)}, which "
                f"{recording.kind} needs for {channel}",
                remedy=f"Map {channel} in columns; the file has: {', '.join(columns)}",
            )
    lengths = {name: len(values) for name, values in channels.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise DataError(f"{path}: columns differ in length: {listed}", remedy="Save vectors of equal length")
    n = next(iter(lengths.values()))
    absent = np.full(n, np.nan)
    t = channels.get("t", np.arange(n, dtype=float))
    return Record(
        name=recording.file,
        kind=recording.kind,
        use=recording.use,
        t=t,
        u_c=channels.get("u_c", absent),
        i_c=channels.get("i_c", absent),
        x=channels.get("x", absent),
        x_ref=channels.get("x_ref", absent),
        instrument=recording.instrument,
        notes=tuple(notes),
    )


def _why(column: str, unusable: Mapping[str, str]) -> str:
    return f" ({unusable[column]})" if column in unusable else ""


def _convert(mapping: Column, raw: FloatArray) -> FloatArray:
    if mapping.table:
        points = np.array(mapping.table)
        right = np.clip(np.searchsorted(points[:, 0], raw, side="right"), 1, len(points) - 1)
        (x0, y0), (x1, y1) = points[right - 1].T, points[right].T
        raw = y0 + (y1 - y0) * ((raw - x0) / (x1 - x0))
    return np.asarray(mapping.offset + mapping.scale * raw)


# ---- logs


def _switched_within(capture: pb.CaptureRecord, T_s: float) -> list[int]:
    """The ticks in whose middle the capture changed u_c, which their STATE does not show.

    The board steps `step_index` samples after the capture's tick and returns to its mode's u_c after the last sample.
    """
    if not T_s > 0.0:
        return []
    ends = (n * capture.sample_time_s / T_s for n in (capture.step_index, len(capture.i_c_a)))
    after = [ticks for ticks in ends if math.isfinite(ticks)]
    return [capture.tick + math.floor(ticks) for ticks in after if abs(ticks - round(ticks)) > _ON_A_TICK]


class _Rows:
    """The samples of a log as rows of t, u_c, i_c, x and x_ref."""

    def __init__(self) -> None:
        self.rows: list[tuple[float, float, float, float, float]] = []
        self.ticks: list[tuple[int, int]] = []  # (session, tick) of each row
        self.arrivals: dict[int, list[tuple[float, int]]] = {}  # by session: time of the board, s, and of arrival, ns
        self.lost = 0
        self.began_ns = 0  # Unix time of the first sample
        self._session: int | None = None
        self._offset_s = 0.0

    def add(self, state: pb.State) -> None:
        """Add a sample.

        A new session restarts the clock: it is placed 10 s later, with a row without readings that ends a piece.
        """
        nan = math.nan
        if self._session is not None and state.session != self._session:
            self._offset_s = self.rows[-1][0] + 10.0 - state.t_s
            self.rows.append((self.rows[-1][0] + 5.0, nan, nan, nan, nan))
            self.ticks.append((-1, 0))
        self._session = state.session
        self.began_ns = self.began_ns or state.host_time_ns
        self.ticks.append((state.session, state.tick))
        self.arrivals.setdefault(state.session, []).append((state.t_s, state.host_time_ns))
        self.lost += state.lost_before
        self.rows.append(
            (
                state.t_s + self._offset_s,
                state.u_c_v if state.HasField("u_c_v") else nan,
                state.i_c_a if state.HasField("i_c_a") else nan,
                state.x_m if state.HasField("x_m") else nan,
                state.x_ref_m if state.HasField("x_ref_m") else nan,
            )
        )

    def clock_error(self) -> ClockError | None:
        """Return the error of the board's clock by the times of arrival; None if they do not show it."""
        sessions = []
        for arrivals in self.arrivals.values():
            first_ns = arrivals[0][1]
            # Differences of whole nanoseconds: a Unix time in ns has more digits than a double.
            pairs = np.array([(t_s, 1e-9 * (host_ns - first_ns)) for t_s, host_ns in arrivals])
            sessions.append(clock_error(pairs[:, 0], pairs[:, 1]))
        return combined(sessions)


def _captured(capture: pb.CaptureRecord) -> list[Capture]:
    """The step of a capture; empty if it has none."""
    if not (0 < capture.step_index < len(capture.i_c_a) and capture.sample_time_s > 0):
        return []
    return [
        Capture(
            sample_time_s=capture.sample_time_s,
            u_from_v=capture.u_from_v,
            u_to_v=capture.u_to_v,
            step_index=capture.step_index,
            i_c_a=np.array(capture.i_c_a),
        )
    ]


def _read_log(path: Path, recording: Recording) -> Record:
    from protocol.bus import board51_pb2 as pb
    from protocol.log.reader import LogReader
    from twin.readers.log import entries, parse

    reader, samples = LogReader(path), _Rows()
    captures: list[Capture] = []
    switched: set[tuple[int, int]] = set()
    T_s, lsb, boards = 0.0, (0.0, 0.0), set()
    for entry in entries(reader, topics=("state", "capture", "parameters"), board=recording.board or None):
        boards.add(entry.board)
        if entry.topic == "state":
            samples.add(parse(pb.State, entry, path))
        elif entry.topic == "parameters":
            parameters = parse(pb.Parameters, entry, path)
            lsb = (abs(parameters.i_lsb_a), abs(parameters.x_lsb_m))
            T_s = parameters.sample_time_s
        else:
            capture = parse(pb.CaptureRecord, entry, path)
            switched |= {(capture.session, tick) for tick in _switched_within(capture, T_s)}
            captures += _captured(capture)
    if len(boards) > 1:
        raise DataError(
            f"{path} holds {len(boards)} boards: {', '.join(sorted(boards))}",
            remedy='Add board = "..." to its [[recording]]',
        )
    if not samples.rows and not captures:
        of_board = f" of board {recording.board!r}" if recording.board else ""
        raise DataError(f"{path} holds no samples{of_board}", remedy="Give a log of a gateway that saw its board")
    table = np.array(samples.rows).reshape(-1, 5)
    # Unknown, not one of the two inputs: both acted within that tick.
    table[np.array([at in switched for at in samples.ticks], np.bool_), 1] = math.nan
    notes = [f"{recording.file}: {samples.lost} samples were lost on the way"] if samples.lost else []
    if not reader.finished:
        notes.append(f"{recording.file}: the log was not closed; it was read as far as possible")
    clock = samples.clock_error()
    notes += clock_note(recording.file, clock)
    return Record(
        name=recording.file,
        kind=recording.kind,
        use=recording.use,
        t=table[:, 0],
        u_c=table[:, 1],
        i_c=table[:, 2],
        x=table[:, 3],
        x_ref=table[:, 4],
        captures=tuple(captures),
        instrument=recording.instrument,
        lsb=lsb,
        notes=tuple(notes),
        clock_error=clock,
        began_ns=samples.began_ns,
    )
