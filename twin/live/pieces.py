"""The newest minutes of a board, cut into recordings: what to fit, and what judges.  Pure.

    idle          -> `free`, the ball at rest (5 s of it are enough: noise, and where the stop is)
    open loop     -> `prbs`
    closed loop   -> `closed-loop`; the last quarter of the flight judges
    captures      -> `amplifier-step`, all in one

Rule 1: a recording has one session, one mode and one set of gains; a reset ends it.
Rule 2: fit and judge never share a sample.  The flight is cut where the reference changes next to three quarters, so
        that an episode is not torn; exactly there where it does not change.
Rule 3: too little flight is an error that says what is there and which experiment to fly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from protocol.bus import board51_pb2 as pb
from protocol.campaign import Kind, Use
from protocol.errors import DataError

SHORTEST_S = 1.0  # of a recording: less says nothing
REST_S = 5.0  # of each idle spell
FLIGHT_S = 8.0  # least of closed loop in all: 6 s to fit, 2 s to judge
JUDGE_SHARE = 0.25
SLACK_SHARE = 0.1  # of the flight: as far from three quarters the cut may be to meet a change of reference
MOVES_M = 2e-4  # a reference that moves less leaves force and drag untold
_KINDS: dict[int, tuple[str, Kind]] = {
    pb.MODE_IDLE: ("rest", "free"),
    pb.MODE_OPEN_LOOP: ("open-loop", "prbs"),
    pb.MODE_CLOSED_LOOP: ("flight", "closed-loop"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """A stretch of samples that will become a recording."""

    name: str
    kind: Kind
    use: Use
    states: tuple[pb.State, ...]
    captures: tuple[pb.CaptureRecord, ...] = ()

    @property
    def duration_s(self) -> float:
        """Return the duration on the board's clock, s."""
        return self.states[-1].t_s - self.states[0].t_s if self.states else 0.0


def cut(
    states: Sequence[pb.State], captures: Sequence[pb.CaptureRecord], changes: Sequence[tuple[int, int]]
) -> list[Piece]:
    """The recordings.

    Args:
        states: of one board, in the order of time.
        captures: of the same minutes.
        changes: (session, tick) from which other gains were in force.

    Raises:
        DataError: too little of it is flight.
    """
    spells = [spell for spell in _spells(states, set(changes)) if _long(spell)]
    flights = [spell for spell in spells if spell[0].mode == pb.MODE_CLOSED_LOOP]
    flown_s = sum(spell[-1].t_s - spell[0].t_s for spell in flights)
    if flown_s < FLIGHT_S:
        total_s = sum(spell[-1].t_s - spell[0].t_s for spell in spells)
        raise DataError(
            f"only {flown_s:.0f} s of the {total_s:.0f} s at hand are closed-loop flight; {FLIGHT_S:.0f} s are needed",
            remedy="Fly steps of the reference for a while, or perform an experiment with "
            "`board51 campaign run FOLDER --experiment wide-steps`, then run it again",
        )
    # A share of all flight, not of each spell, which would be torn for a second of judging.
    judge_from = _judges(flights, flown_s)
    pieces: list[Piece] = []
    for spell in spells:
        name, kind = _KINDS[spell[0].mode]
        parts: list[tuple[Use, list[pb.State]]] = [("fit", spell)]
        if kind == "free":
            parts = [("fit", [state for state in spell if state.t_s - spell[0].t_s < REST_S])]
        elif kind == "closed-loop":
            # A flight that is not listed ended before the cut: all of it is fitted.
            index = judge_from.get((spell[0].session, spell[0].tick), len(spell))
            parts = [("fit", spell[:index]), ("judge", spell[index:])]
        for use, part in parts:
            if _long(part):
                number = f"{name}-{len(pieces) + 1:02d}" + ("-judge" if use == "judge" else "")
                pieces.append(Piece(name=number, kind=kind, use=use, states=tuple(part)))
    if captures:
        pieces.append(Piece(name="captures", kind="amplifier-step", use="fit", states=(), captures=tuple(captures)))
    return pieces


def moves(pieces: Sequence[Piece]) -> bool:
    """Return whether the reference moves far enough in the flights for a fit."""
    heights = [s.x_ref_m for p in pieces if (p.kind, p.use) == ("closed-loop", "fit") for s in p.states]
    return bool(heights) and max(heights) - min(heights) > MOVES_M


def _long(spell: Sequence[pb.State]) -> bool:
    return len(spell) > 2 and spell[-1].t_s - spell[0].t_s >= SHORTEST_S


def _spells(states: Sequence[pb.State], changes: set[tuple[int, int]]) -> list[list[pb.State]]:
    spells: list[list[pb.State]] = []
    last: pb.State | None = None
    for state in states:
        follows = (
            last is not None
            and (state.session, state.mode) == (last.session, last.mode)
            and state.tick > last.tick
            and not any(s == state.session and last.tick < tick <= state.tick for s, tick in changes)
        )
        if not follows:
            spells.append([])
        spells[-1].append(state)
        last = state
    return spells


def _judges(flights: Sequence[list[pb.State]], flown_s: float) -> dict[tuple[int, int], int]:
    """Choose for each flight, by (session, tick) of its first sample, the index from which it judges."""
    target_s, slack_s = (1.0 - JUDGE_SHARE) * flown_s, SLACK_SHARE * flown_s
    best = (math.inf, 0, 0)  # cost, flight, index of its sample
    before_s = 0.0
    for number, flight in enumerate(flights):
        start_s = flight[0].t_s
        for index, state in enumerate(flight):
            away_s = abs(before_s + state.t_s - start_s - target_s)
            changed = index == 0 or state.x_ref_m != flight[index - 1].x_ref_m
            # Where nothing changes within the slack, the plain place at three quarters remains the nearest.
            cost = away_s if changed and away_s < slack_s else slack_s + away_s
            best = min(best, (cost, number, index))
        before_s += flight[-1].t_s - start_s
    _, chosen, start = best
    return {(flight[0].session, flight[0].tick): 0 if n else start for n, flight in enumerate(flights[chosen:])}
