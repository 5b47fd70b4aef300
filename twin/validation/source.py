"""The recordings for validation, each with its control law and the delay of its input.

Rule 1: recordings with use = "judge" are used.  A part without such a recording uses those for fitting, and the report
        says so.
Rule 2: a delay of u_c is corrected only if the identification of the model corrected it; otherwise it is an error of
        the model.
Rule 3: the law of a log is the one that its board announced, otherwise the campaign's [controller].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from protocol.bus import board51_pb2 as pb
from protocol.campaign import Campaign, Controller
from protocol.files import open_regular
from protocol.log.reader import LogReader
from twin.control import LawNumbers, law_numbers
from twin.estimation.ekf.filter import filtered as run_filter
from twin.estimation.gate import gate
from twin.estimation.innovations import FLIES, USE_I, USE_X, Series, whitened
from twin.estimation.prepare import flights, prepare
from twin.estimation.propagate import delay_s
from twin.estimation.record import FloatArray, Record, runs
from twin.estimation.structures import System
from twin.evidence.checks.control_law import WIDE_V, numbers_of
from twin.evidence.checks.dead_channels import without_dead
from twin.evidence.checks.plausibility import inspect
from twin.evidence.dead_time import delayed
from twin.identification.delays import input_delay
from twin.identification.pipeline import grouped
from twin.model.parameters import Model
from twin.readers.campaign import located, read_recording
from twin.readers.log import entries, parse
from twin.validation.extended import as_readings, system_of

FLYING = ("closed-loop", "prbs", "free")
MAX_WILD = 0.01  # of the readings: more outliers are an error of the model or the sensor, and are retained
LIMIT_SAMPLES = 5  # equal extreme inputs in a row that show a limit of the input


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """A recording with its control law and the delay of its input."""

    record: Record  # as recorded
    law: LawNumbers | None = None
    without_law: str = "the campaign has no [controller] and the recording names no gains"
    u_lsb_v: float = 0.0
    delay: int = 0  # delay of u_c, samples, that the identification of the model corrected
    unknown_delay: int = 0  # further delay of u_c, samples

    @property
    def acting(self) -> Record:
        """The recording with u_c delayed by `delay`."""
        return delayed(self.record, self.delay)


@dataclass(frozen=True, slots=True, kw_only=True)
class Filtered:
    """A recording filtered with the model."""

    source: Source
    series: Series
    white: FloatArray  # whitened innovations (i_c, x), shape (n, 2)
    system: System
    state: FloatArray  # corrected states of `extended.py`, shape (n, STATES)
    readings: FloatArray  # readings of i_c and x of these states, and x', shape (n, 3)
    wild: int  # number of outliers left out


def sources_of(
    campaign: Campaign, model: Model, *, data: Path | None = None, spare: bool = False
) -> tuple[list[Source], list[str]]:
    """Return (the recordings of the campaign that can be used, in its order; sentences about them).

    Args:
        campaign: of `Campaign.load`.
        model: to judge.
        data: folder of the recordings, if it is not that of the campaign.
        spare: whether to read those for fitting also where there are some for judging.

    Raises:
        DataError: a recording is missing, unreadable or implausible.
    """
    records: list[Record] = []
    announcements: list[list[pb.Parameters]] = []
    judge_kinds = {r.kind in FLYING for r in campaign.recordings if r.use == "judge"}
    for recording in campaign.recordings:
        # Whether there are judge recordings of its sort.
        needless = recording.use == "fit" and (recording.kind in FLYING) in judge_kinds and not spare
        if recording.kind in ("equilibria", "sawtooth") or needless:
            continue
        path = campaign.path_of(recording, data=data)
        records.append(read_recording(path, recording))
        announcements.append(_announced(path, recording.board) if recording.kind in FLYING else [])
    plant = model.plant
    # The checks before a fit: wrong units must not appear as errors of the model.
    messages = inspect(records, plant, None)
    records, left_out = without_dead(records, plant)
    sources = [
        source_of(record, model, controller=campaign.controller, announced=announced)
        for record, announced in zip(records, announcements, strict=True)
    ]
    return sources, grouped(messages + left_out, [record.name for record in records])


def source_at(
    recording: Path,
    model: Model,
    campaign: Campaign | None = None,
    *,
    data: Path | None = None,
    board: str | None = None,
) -> Source:
    """Read a flight with its control law, by the path of its recording; arguments and errors as `read_flight`."""
    entry, path = located(recording, campaign, data=data, board=board)
    controller = None if campaign is None else campaign.controller
    return source_of(read_recording(path, entry), model, controller=controller, announced=_announced(path, entry.board))


def source_of(
    record: Record, model: Model, *, controller: Controller | None = None, announced: Sequence[pb.Parameters] = ()
) -> Source:
    """Pair a recording with its control law.

    Args:
        record: of a rig.
        model: to validate; its provenance contains the delay of u_c.
        controller: of the campaign.
        announced: Parameters of the board, in order; the last one with a law is used.
    """
    source = Source(record=record)
    laws = [(law, p) for p in announced if (law := law_numbers(p)) is not None]
    if laws:
        law, parameters = laws[-1]
        source = replace(source, law=law, without_law="", u_lsb_v=abs(parameters.u_lsb_v))
    elif controller is not None:
        source = replace(source, law=_written(controller, record), without_law="")
    if record.kind in FLYING:
        total_delay = input_delay(record, model.plant)
        # Never more than this recording shows: in those of the identification u_c may have been later.
        known = min(total_delay, _known_delay(model))
        # Its causes may have the rest.
        modelled = math.ceil(delay_s(system_of(model, record).c) / record.interval_s) if total_delay > known else 0
        source = replace(source, delay=known, unknown_delay=max(total_delay - known - modelled, 0))
    return source


def chosen(sources: Sequence[Source]) -> tuple[list[Source], bool]:
    """Return (the sources to use, whether they are those with use "fit" because there are no others)."""
    judges = [s for s in sources if s.record.use == "judge"]
    return (judges, False) if judges else (list(sources), bool(sources))


def filtered(source: Source, model: Model) -> Filtered | None:
    """Filter the recording with the model; None without a flight."""
    plant = model.plant
    record = replace(source.acting, captures=())
    if not record.has("u_c", "i_c", "x") or not flights(record, plant):
        return None
    series, _ = prepare([record], plant)
    system = system_of(model, record)
    run = run_filter(system, series.samples, state=True)
    # Filtered twice: an outlier is known by its innovation only, and it has moved the estimates after it.
    gated, dropped = gate(series, whitened(run.innovations), 1)
    if 0 < dropped[0] <= MAX_WILD * len(series):
        series = gated
        run = run_filter(system, series.samples, state=True)
    source, wild = _without_wild(source, series)
    return Filtered(
        source=source,
        series=series,
        white=whitened(run.innovations),
        system=system,
        state=run.state,
        readings=as_readings(run.state, model),
        wild=wild,
    )


def _without_wild(source: Source, series: Series) -> tuple[Source, int]:
    """Return (the recording without the readings in flight that the filter did not use, their number)."""
    r = source.record
    flies = (series.flags & FLIES) != 0
    i = flies & ((series.flags & USE_I) == 0) & np.isfinite(r.i_c)
    x = flies & ((series.flags & USE_X) == 0) & np.isfinite(r.x)
    record = replace(r, i_c=np.where(i, np.nan, r.i_c), x=np.where(x, np.nan, r.x))
    return replace(source, record=record), int(i.sum() + x.sum())


def _known_delay(model: Model) -> int:
    """Return the median delay of u_c in the recordings that the model was identified from, samples."""
    delays = [
        delay
        for usage in _usages(model)
        if usage.get("kind") in FLYING and isinstance(delay := usage.get("input_delay"), int)
    ]
    # The median: one recording whose delay was misjudged does not move it.
    return round(float(np.median(delays))) if delays else 0


def _usages(model: Model) -> list[dict[str, object]]:
    listed = model.provenance.get("recordings", [])
    return [usage for usage in listed if isinstance(usage, dict)] if isinstance(listed, list) else []


def _announced(path: Path, board: str) -> list[pb.Parameters]:
    with open_regular(path, remedy="Name a recording") as file:
        if not file.read(8).startswith(b"\x89MCAP0"):
            return []
    return [
        parse(pb.Parameters, entry, path)
        for entry in entries(LogReader(path), topics=("parameters",), board=board or None)
    ]


def _written(controller: Controller, record: Record) -> LawNumbers | None:
    low, high = -WIDE_V, WIDE_V
    u = record.u_c[np.isfinite(record.u_c)]
    if len(u):
        top, bottom = float(u.max()), float(u.min())
        # [controller] states no limits of u_c.  A flat top is one; a single largest sample may be chance.
        if top > bottom and runs(np.asarray(u >= top), LIMIT_SAMPLES):
            high = top
        if top > bottom and runs(np.asarray(u <= bottom), LIMIT_SAMPLES):
            low = bottom
    return numbers_of(controller, record.interval_s, u_low=low, u_high=high)
