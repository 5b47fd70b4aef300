"""The recordings that judge a model, each with the law that ran on it and the lateness of its input.

Rule 1: recordings with use = "judge" judge.  Those for fitting step in for a part only where there is no other, and
        the report says so.
Rule 2: a late u_c is corrected only for a model whose identification corrected it; otherwise it is the model's error.
Rule 3: the law of a log is the one that its board announced; else the campaign's [controller].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from protocol.bus import board51_pb2 as pb
from protocol.campaign import Campaign, Controller, Plant
from twin.control import LawNumbers, law_numbers
from twin.identify.delay import delayed, input_delay
from twin.identify.fit import Likelihood, Point
from twin.identify.innovations import Series
from twin.identify.prepare import flights, prepare
from twin.identify.reading import read_recording
from twin.identify.record import FloatArray, Record, runs
from twin.model.parameters import Model
from twin.recordings import LogReader, parse

FLYING = ("closed-loop", "prbs", "free")
WIDE_V = 1e6  # an input limit that nobody reaches, where none is known
LIMIT_SAMPLES = 5  # equal extreme inputs in a row: the limit of the input


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """One recording, with what is known beside its samples."""

    record: Record  # as recorded
    law: LawNumbers | None = None
    without_law: str = "the campaign has no [controller] and the recording names no gains"
    u_lsb_v: float = 0.0
    late: int = 0  # samples by which u_c acts later than recorded, where the model knows of it
    unknown_late: int = 0  # the same, where it does not

    @property
    def acting(self) -> Record:
        """The recording with u_c where it acts."""
        return delayed(self.record, self.late)


@dataclass(frozen=True, slots=True, kw_only=True)
class Filtered:
    """A recording under the model's Kalman filter."""

    source: Source
    series: Series
    white: FloatArray  # whitened innovations (i_c, x), shape (n, 2)
    state: FloatArray  # corrected i_c, x, x', shape (n, 3)
    point: Point


def plant_of(model: Model) -> Plant:
    """The constants of the model as the estimators take them."""
    p = model.plant
    return Plant(name=p.name, mass_kg=p.mass_kg, travel_m=p.travel_m, x_max_m=p.x_max_m, gravity_m_s2=p.gravity_m_s2)


def sources_of(campaign: Campaign, model: Model, *, data: Path | None = None) -> list[Source]:
    """All recordings of the campaign that could judge, in its order.

    Raises:
        DataError: a recording is absent or not readable.
    """
    sources = []
    judged = {r.kind in FLYING for r in campaign.recordings if r.use == "judge"}
    for recording in campaign.recordings:
        spare = recording.use == "fit" and (recording.kind in FLYING) in judged  # others of its sort judge
        if recording.kind in ("equilibria", "sawtooth") or spare:
            continue
        path = campaign.path_of(recording, data=data)
        record = read_recording(path, recording)
        announced = _announced(path, recording.board) if record.kind in FLYING else []
        sources.append(source_of(record, model, controller=campaign.controller, announced=announced))
    return sources


def source_of(
    record: Record, model: Model, *, controller: Controller | None = None, announced: Sequence[pb.Parameters] = ()
) -> Source:
    """One recording with its law.

    Args:
        record: of a rig.
        model: that is judged; its provenance tells whether it knows of a late input.
        controller: of the campaign.
        announced: Parameters of the board, in order; the last with a law counts.
    """
    source = Source(record=record)
    laws = [(law, p) for p in announced if (law := law_numbers(p)) is not None]
    if laws:
        law, told = laws[-1]
        source = replace(source, law=law, without_law="", u_lsb_v=abs(told.u_lsb_v))
    elif controller is not None:
        source = replace(source, law=_written(controller, record), without_law="")
    if record.kind in FLYING:
        late = input_delay(record, plant_of(model))
        known = any(usage.get("input_delay") for usage in _usages(model))
        source = replace(source, late=late) if known else replace(source, unknown_late=late)
    return source


def chosen(sources: Sequence[Source]) -> tuple[list[Source], bool]:
    """(those that judge, whether they are of use "fit" for want of others)."""
    judges = [s for s in sources if s.record.use == "judge"]
    return (judges, False) if judges else (list(sources), bool(sources))


def filtered(source: Source, model: Model) -> Filtered | None:
    """The recording under the filter; None where nothing flies."""
    plant = plant_of(model)
    record = replace(source.acting, captures=())
    if not record.has("u_c", "i_c", "x") or not flights(record, plant):
        return None
    series, _ = prepare([record], plant)
    point = point_of(model, record)
    likelihood = Likelihood(series, plant, record.interval_s)
    return Filtered(
        source=source, series=series, white=likelihood.white(point), state=likelihood.states(point), point=point
    )


def point_of(model: Model, record: Record) -> Point:
    """The model with its noise, the converters' steps of this recording added."""
    n = model.noise
    return Point(
        K_A=model.K_A,
        T_A=model.T_A,
        K_c=model.K_c,
        b=model.b,
        sigma_i_c_a=float(np.hypot(n.sigma_i_c_a, record.lsb[0] / np.sqrt(12.0))),
        sigma_x_m=float(np.hypot(n.sigma_x_m, record.lsb[1] / np.sqrt(12.0))),
        process_i_c_a=n.process_i_c_a,
        process_a_m_s2=n.process_a_m_s2,
    )


def _usages(model: Model) -> list[dict[str, object]]:
    listed = model.provenance.get("recordings", [])
    return [usage for usage in listed if isinstance(usage, dict)] if isinstance(listed, list) else []


def _announced(path: Path, board: str) -> list[pb.Parameters]:
    with path.open("rb") as file:
        if not file.read(8).startswith(b"\x89MCAP0"):
            return []
    return [parse(pb.Parameters, entry, path) for entry in LogReader(path, topics=("parameters",), board=board or None)]


def _written(controller: Controller, record: Record) -> LawNumbers | None:
    point = controller.operating_point
    low, high = -WIDE_V, WIDE_V
    u = record.u_c[np.isfinite(record.u_c)]
    if len(u):
        top, bottom = float(u.max()), float(u.min())
        if top > bottom and runs(np.asarray(u >= top), LIMIT_SAMPLES):
            high = top
        if top > bottom and runs(np.asarray(u <= bottom), LIMIT_SAMPLES):
            low = bottom
    return law_numbers(
        pb.Parameters(
            sample_time_s=record.interval_s,
            law=pb.LAW_LQI if controller.kind == "lqi" else pb.LAW_PID,
            gains=controller.gains,
            i_0_a=point.i_c_a,
            x_0_m=point.x_m,
            u_0_v=point.u_c_v,
            u_min_v=low,
            u_max_v=high,
        )
    )
