"""The stretch of a recording that is replayed, under one model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from protocol.errors import DataError
from twin.control import LawNumbers, integral_behind
from twin.estimation.record import FloatArray, Record, runs
from twin.estimation.rollout import SETTLE_S
from twin.model.parameters import Model
from twin.validation.extended import system_of
from twin.validation.source import Source, filtered
from twin.what_if.replay import Disturbances, Reference, disturbances, replay

SHORTEST_S = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Flight:
    """A flight split by one model; arrays have shape (n,)."""

    model: Model
    source: Source
    part: slice  # of the recording
    begin: FloatArray  # corrected state at the first sample, shape (STATES,)
    step: FloatArray  # s, since the sample before
    disturbed: Disturbances

    @property
    def record(self) -> Record:
        """Return what was recorded of it."""
        return self.source.record.part(self.part)


def longest_flight(source: Source) -> slice:
    """Return the longest stretch with all channels at a steady sampling time.

    Raises:
        DataError: no stretch is long enough, or no reference was recorded.
    """
    r = source.record
    if not r.has("x_ref"):
        raise DataError(f"{r.name}: no reference was recorded", remedy="Give a log of a gateway, or a column for x_ref")
    step = np.diff(r.t, prepend=r.t[0] - r.interval_s)
    # Steady steps: the law runs once for each sample.
    known = np.isfinite(r.u_c) & np.isfinite(r.x_ref) & (np.abs(step - r.interval_s) < 0.05 * r.interval_s)
    stretches = runs(np.asarray(known), round(SHORTEST_S / r.interval_s))
    if not stretches:
        raise DataError(
            f"{r.name}: no {SHORTEST_S:g} s with u_c and x_ref at a steady sampling time", remedy="Give a longer flight"
        )
    return max(stretches, key=lambda piece: piece.stop - piece.start)


def split(source: Source, model: Model) -> Flight:
    """Filter the recording with the model, and split its longest flight.

    Raises:
        DataError: there is no flight of `SHORTEST_S`.
    """
    run = filtered(source, model)
    piece = longest_flight(source)
    if run is None:
        raise DataError(f"{source.record.name} shows no ball in flight", remedy="Give a recording in closed loop")
    flies = np.isfinite(run.state[:, 0])
    flies[: piece.start], flies[piece.stop :] = False, False
    # The first corrections are those of an unknown start, not disturbances of the rig.
    settle = round(SETTLE_S / source.record.interval_s)
    flights = runs(np.asarray(flies), settle + round(SHORTEST_S / source.record.interval_s))
    if not flights:
        raise DataError(f"{source.record.name}: no flight of {SHORTEST_S:g} s", remedy="Give a longer flight")
    longest = max(flights, key=lambda flight: flight.stop - flight.start)
    part = slice(longest.start + settle, longest.stop)
    r, s = run.source.record, run.series
    return Flight(
        model=model,
        source=run.source,
        part=part,
        begin=run.state[part.start],
        step=s.step[part],
        disturbed=disturbances(
            run.system, s.u[part], s.step[part], run.state[part], np.column_stack([r.i_c[part], r.x[part]])
        ),
    )


def fly(flight: Flight, law: LawNumbers, reference: Reference) -> tuple[FloatArray, int]:
    """Replay a flight's disturbances under a law.

    Returns:
        (i_c in A, x in m and u_c in V, shape (3, n); the sample at which the ball is lost, NEVER if it is not).
    """
    record, first = flight.source.record, flight.part.start
    system = system_of(flight.model, record)
    i, x, x_before = float(record.i_c[first]), float(record.x[first]), float(record.x[first - 1])
    if not np.isfinite([i, x, x_before]).all():
        raise DataError(f"{record.name}: the flight begins with an outlier", remedy="Give another skip_s")
    # As where gains are loaded in flight: the new law goes on from the input in force.
    free = law._replace(u_low=-np.inf, u_high=np.inf)
    s = integral_behind(free, i=i, x=x, x_prev=x_before, x_ref=float(reference.x_ref[0]), u=float(record.u_c[first]))
    delay = flight.source.delay
    out = np.full((3, len(reference.x_ref)), np.nan)
    lost = replay(
        system.base,
        system.c,
        tuple(law),
        reference,
        flight.disturbed,
        flight.begin,
        np.asarray(record.u_c[first - delay : first], dtype=float),
        np.array([i, x, x_before, 0.0 if s is None else s]),
        flight.source.u_lsb_v,
        out,
    )
    return out, int(lost)
