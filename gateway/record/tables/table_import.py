"""Imports a recording in a table (CSV, MATLAB) into a log, as State messages like those of a board.

Rule 1: a channel that is missing in the table is absent in every State, a cell that is not a finite number in its
        State; nothing is filled in.
Rule 2: T_s is the median step of t; `tick` counts in T_s from the first row.  A step of more than 1.5 T_s is a gap:
        the tick jumps, `lost_before` says by how much.  `t_s` stays the table's own time, to the bit.
Rule 3: log time is the table's time from the epoch 0: an imported log has no date.
Rule 4: the log's metadata contain its source (file, SHA-256, columns, campaign).
Rule 5: a table that `export` wrote is read back as it was (`exported_states`), unless its columns are mapped.  Of other
        topics (twin/state, capture) the columns are found by the names that `export` gives them: t_s, u_c_v ...
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from gateway.record.tables.export import exported_states, is_export
from gateway.record.tables.table import FloatArray, Table, read_csv, read_mat, read_parquet
from gateway.record.writer import LogWriter
from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.campaign import CHANNELS, Campaign, Channel, Column, Recording
from protocol.errors import DataError, quoted
from protocol.units import MAX_PLAUSIBLE, NOT_MEASURED, UNITS, scale_of_size

GAP_STEPS = 1.5  # a step longer than this lost at least one sample
LARGEST_GAP = 1 << 31  # samples: `lost_before` counts in 32 bits
JITTER_SHARE = 0.1  # a step off a whole number of T_s by more than this share is irregular
_FIELDS: dict[Channel, str] = {"u_c": "u_c_v", "i_c": "i_c_a", "x": "x_m", "x_ref": "x_ref_m"}


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportReport:
    """The summary of an import, with warnings."""

    source: Path
    log: Path
    board: str
    rows: int
    channels: tuple[Channel, ...]
    sample_time_s: float  # 0 where the rows are not in time
    duration_s: float
    gaps: int
    samples_missing: int
    irregular_steps: int = 0
    worst_step_s: float = 0.0  # the step farthest from a whole number of T_s
    # Values for which a look-up table was extrapolated, by channel.
    beyond_table: Mapping[str, int] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()  # implausible values, and columns that cannot be used


def open_table(path: Path) -> Table:
    """Open a CSV, MATLAB or Parquet file, according to its name.

    Raises:
        DataError: the file cannot be read.
    """
    if path.suffix == ".mcap":
        raise DataError(f"{path} is a log already", remedy="Use it as it is")
    return {".mat": read_mat, ".parquet": read_parquet}.get(path.suffix, read_csv)(path)


def import_recording(
    source: Path,
    log: Path,
    recording: Recording,
    *,
    site: str = topics.DEFAULT_SITE,
    board: str,
    campaign: Campaign | None = None,
) -> ImportReport:
    """Write one recording as a log.

    Each row of `equilibria` is a session of its own, without time.  A campaign gives gains and plant, if it is known.

    Raises:
        DataError: the table does not match the recording; the message names file, line, column and value.
        LogError: the log exists or cannot be written.
    """
    table = open_table(source)
    if is_export(table) and not recording.columns:
        states = exported_states(table)
        report = _report_of(source, log, board, states)
        _write(f"{site}/{board}", report, recording, campaign, states)
        return report
    recording = _with_field_names(table, recording)
    values, extrapolated = _channels(table, recording)
    in_time = recording.kind != "equilibria"
    time_s = values.pop("t") if in_time else np.arange(table.rows, dtype=float)
    if not values:
        problem = f"{source} has none of the channels {', '.join(CHANNELS[1:])}"
        raise DataError(problem, remedy=f"Map them; its columns are: {', '.join(table.names)}")
    steps = _check_time(table, recording, time_s) if in_time else np.ones(table.rows - 1)
    sample_time_s = _round(float(np.median(steps))) if in_time else 0.0
    ticks_per_step = np.maximum(1, np.ceil(steps / (sample_time_s or 1.0) - (GAP_STEPS - 1.0))).astype(int)
    off = np.abs(steps - ticks_per_step * sample_time_s) if in_time else np.zeros(0)
    report = ImportReport(
        source=source,
        log=log,
        board=board,
        rows=table.rows,
        channels=tuple(values),
        sample_time_s=sample_time_s,
        duration_s=float(time_s[-1] - time_s[0]),
        gaps=int(np.count_nonzero(ticks_per_step > 1)),
        samples_missing=int(np.sum(ticks_per_step - 1)),
        irregular_steps=int(np.count_nonzero(off > JITTER_SHARE * sample_time_s)),
        worst_step_s=float(steps[np.argmax(off)]) if off.size else 0.0,
        beyond_table=extrapolated,
        warnings=(
            *_missing(table, recording, values),
            *_implausible(recording, values, steps),
            *(f"column {name!r} cannot be used: {why}" for name, why in table.unusable.items()),
        ),
    )
    _write(f"{site}/{board}", report, recording, campaign, _states(recording, time_s, ticks_per_step, values))
    return report


def _report_of(source: Path, log: Path, board: str, states: Sequence[pb.State]) -> ImportReport:
    """Return the summary of samples that were exported; T_s is the median step of the board's clock."""
    steps = [
        (new.t_s - old.t_s) / (new.tick - old.tick)
        for old, new in pairwise(states)
        if new.session == old.session and new.tick > old.tick
    ]
    return ImportReport(
        source=source,
        log=log,
        board=board,
        rows=len(states),
        channels=tuple(channel for channel, field in _FIELDS.items() if any(state.HasField(field) for state in states)),
        sample_time_s=_round(float(np.median(steps))) if steps else 0.0,
        duration_s=(states[-1].host_time_ns - states[0].host_time_ns) / 1e9,
        gaps=sum(state.lost_before > 0 for state in states),
        samples_missing=sum(state.lost_before for state in states),
    )


def _with_field_names(table: Table, recording: Recording) -> Recording:
    """Return the recording with the columns of an export for channels that have none of their own name."""
    exported: dict[Channel, Column] = {
        channel: Column(column=name)
        for channel, name in {"t": "t_s", **_FIELDS}.items()
        if name in table.names and recording.column(channel).column not in table.names
    }
    return replace(recording, columns={**exported, **recording.columns})


def _channels(table: Table, recording: Recording) -> tuple[dict[Channel, FloatArray], dict[str, int]]:
    """Return the converted values of the present channels, and the numbers of values beyond a look-up table."""
    values: dict[Channel, FloatArray] = {}
    extrapolated: dict[str, int] = {}
    for channel in CHANNELS:
        column = recording.column(channel)
        mapped = channel in recording.columns
        if not mapped and column.column not in table.names and (channel != "t" or recording.kind == "equilibria"):
            continue
        raw = table.numbers(column.column)
        values[channel] = _convert(column, raw)
        _check_measured(table, channel, column, values[channel])
        count = sum(column.extrapolates(value) for value in raw[np.isfinite(raw)].tolist())
        if count:
            extrapolated[channel] = count
    return values, extrapolated


def _check_measured(table: Table, channel: Channel, column: Column, values: FloatArray) -> None:
    missing = np.flatnonzero(np.isnan(values))
    if channel == "t" and missing.size:
        raise table.bad(column.column, int(missing[0]))
    bad = np.flatnonzero(np.abs(values) > NOT_MEASURED[channel])
    if bad.size:
        row = int(bad[0])
        raise DataError(
            f"{table.path}, {table.label(row)}: {column.column} = {quoted(table.cell(column.column, row))} gives "
            f"{values[row]:.3g} {UNITS[channel]} for {channel}, which cannot be a measurement",
            remedy="Correct the cell, leave that row out, or give the column another scale",
        )


def _missing(table: Table, recording: Recording, values: Mapping[Channel, FloatArray]) -> Iterator[str]:
    """Yield one line for each channel with missing readings."""
    for channel, column in values.items():
        if (missing := np.flatnonzero(np.isnan(column))).size:
            name, where = recording.column(channel).column, table.label(int(missing[0]))
            yield f"{missing.size} cells of {name} are not numbers and were left out, the first in {where}"


def _implausible(recording: Recording, values: Mapping[Channel, FloatArray], steps: FloatArray) -> Iterator[str]:
    """Yield one line for each channel with implausible values, with the scale that would make it plausible."""
    sizes: dict[Channel, float] = {} if recording.kind == "equilibria" else {"t": float(np.median(steps))}
    sizes |= {channel: float(np.nanpercentile(np.abs(column), 99)) for channel, column in values.items()}
    for channel, size in sizes.items():
        scale = scale_of_size(size, channel)
        if scale is not None:
            what = "its samples are {:.3g} s apart" if channel == "t" else f"it reaches {{:.3g}} {UNITS[channel]}"
            column = recording.column(channel)
            yield (
                f"{channel} (column {column.column!r}): {what.format(size)}, more than the {MAX_PLAUSIBLE[channel]:g} "
                f"{UNITS[channel]} of any rig of this kind; scale = {column.scale * scale:g} would make it plausible"
            )


def _convert(column: Column, raw: FloatArray) -> FloatArray:
    if column == Column(column=column.column):
        return raw  # to the bit
    return np.array([column.convert(value) for value in raw.tolist()])


def _check_time(table: Table, recording: Recording, time_s: FloatArray) -> FloatArray:
    """Check the time column and return its steps, s, shape (rows - 1,)."""
    name = recording.column("t").column
    if table.rows < 2:
        raise DataError(f"{table.path} has one row", remedy="Give at least two rows, to determine T_s")
    steps = np.diff(time_s)
    median_s = float(np.median(steps))
    torn = np.flatnonzero(steps > LARGEST_GAP * median_s) if median_s > 0.0 else np.zeros(0, dtype=int)
    if torn.size:
        row = int(torn[0]) + 1
        raise DataError(
            f"{table.path}, {table.label(row)}: {name} jumps by {steps[row - 1]:.3g} s, {LARGEST_GAP} samples and more",
            remedy="Split the file there, or correct the cell",
        )
    bad = np.flatnonzero(steps <= 0.0)
    if bad.size:
        row = int(bad[0]) + 1
        raise DataError(
            f"{table.path}, {table.label(row)}: {name} = {table.cell(name, row)} does not come after "
            f"{table.cell(name, row - 1)}",
            remedy="Time must rise from row to row: sort the rows, or split the file where it starts again",
        )
    return steps


def _round(step_s: float) -> float:
    """Round to six digits where that is the same step: a difference of large times is 0.00200000000018 for 0.002."""
    return float(f"{step_s:.6g}") if abs(float(f"{step_s:.6g}") - step_s) < 1e-6 * step_s else step_s


def _write(
    prefix: str, report: ImportReport, recording: Recording, campaign: Campaign | None, states: Iterable[pb.State]
) -> None:
    metadata = _provenance(report, recording, campaign)
    with LogWriter(report.log, metadata=metadata, compression="zstd") as writer:
        for number, state in enumerate(states):
            if number == 0:
                parameters = _parameters(report, recording, campaign)
                parameters.session, parameters.host_time_ns = state.session, state.host_time_ns
                writer.write(f"{prefix}/parameters", parameters.SerializeToString(), state.host_time_ns)
            writer.write(f"{prefix}/state", state.SerializeToString(), state.host_time_ns)


def _states(
    recording: Recording,
    time_s: FloatArray,
    ticks_per_step: np.ndarray[tuple[int], np.dtype[np.int_]],
    values: Mapping[Channel, FloatArray],
) -> Iterator[pb.State]:
    shift_s = min(0.0, float(time_s[0]))  # log time is unsigned
    closed = recording.kind in ("closed-loop", "equilibria")
    mode = pb.MODE_CLOSED_LOOP if closed else pb.MODE_OPEN_LOOP
    columns = [(_FIELDS[channel], column.tolist()) for channel, column in values.items()]
    in_time = recording.kind != "equilibria"
    tick = 0
    for row, at_s in enumerate(time_s.tolist()):
        step = int(ticks_per_step[row - 1]) if row else 1
        tick += step if row else 0
        state = pb.State(
            sequence=tick & 0xFFFF,
            tick=tick,
            session=1 if in_time else row + 1,
            host_time_ns=round((at_s - shift_s) * 1e9),
            mode=mode,
            t_s=at_s,
            lost_before=step - 1,
        )
        for name, column in columns:
            if not math.isnan(column[row]):
                setattr(state, name, column[row])
        yield state


def _parameters(report: ImportReport, recording: Recording, campaign: Campaign | None) -> pb.Parameters:
    """Return the known parameters; all others are 0, which for limits and converters means unknown."""
    parameters = pb.Parameters(firmware="import", sample_time_s=report.sample_time_s, stream_divider=1)
    if campaign is not None:
        parameters.x_ref_max_m = campaign.plant.travel_m
        if campaign.controller is not None and recording.kind == "closed-loop":
            point = campaign.controller.operating_point
            parameters.law = pb.LAW_PID if campaign.controller.kind == "pid" else pb.LAW_LQI
            parameters.gains.extend(campaign.controller.gains)
            parameters.i_0_a, parameters.x_0_m, parameters.u_0_v = point.i_c_a, point.x_m, point.u_c_v
    return parameters


def _provenance(report: ImportReport, recording: Recording, campaign: Campaign | None) -> dict[str, dict[str, str]]:
    mapped: tuple[Channel, ...] = ("t", *report.channels)
    columns = {channel: asdict(recording.column(channel)) for channel in mapped}
    provenance = {
        "import": {
            "file": report.source.name,
            "sha256": hashlib.sha256(report.source.read_bytes()).hexdigest(),
            "kind": recording.kind,
            "use": recording.use,
            "skip_s": repr(recording.skip_s),
            "columns": json.dumps(columns),
            "sample_time_s": repr(report.sample_time_s),
            "samples_missing": str(report.samples_missing),
            "irregular_steps": str(report.irregular_steps),
        }
    }
    if campaign is not None:
        provenance["plant"] = {name: str(value) for name, value in asdict(campaign.plant).items()}
    return provenance
