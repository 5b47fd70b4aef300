"""Minutes of a board cut into recordings: kinds, the judge's quarter, and what is said where there is too little."""

from __future__ import annotations

from itertools import count, pairwise

import pytest

from protocol.bus import board51_pb2 as pb
from protocol.errors import DataError
from twin.live.pieces import REST_S, Piece, cut, moves

T_S = 2e-3
IDLE, OPEN, CLOSED = pb.MODE_IDLE, pb.MODE_OPEN_LOOP, pb.MODE_CLOSED_LOOP


class Board:
    """The samples of a board, spell by spell."""

    def __init__(self) -> None:
        self.states: list[pb.State] = []
        self._tick = count()
        self.session = 1

    def spell(self, mode: pb.Mode, seconds: float, *references_m: float) -> None:
        """Each reference for an equal part of it."""
        n = round(seconds / T_S)
        for k in range(n):
            tick = next(self._tick)
            x_ref = references_m[k * len(references_m) // n] if references_m else 0.0
            self.states.append(pb.State(session=self.session, tick=tick, t_s=tick * T_S, mode=mode, x_ref_m=x_ref))

    def reset(self) -> None:
        self._tick, self.session = count(), self.session + 1


def seconds(pieces: list[Piece], kind: str, use: str) -> list[int]:
    return [round(piece.duration_s) for piece in pieces if (piece.kind, piece.use) == (kind, use)]


def ticks(pieces: list[Piece]) -> set[tuple[int, int]]:
    return {(state.session, state.tick) for piece in pieces for state in piece.states}


def test_each_mode_is_a_recording_and_the_end_of_the_flight_judges() -> None:
    board = Board()
    board.spell(IDLE, 20.0)
    board.spell(OPEN, 3.0)
    board.spell(CLOSED, 12.0, 1e-3, 3e-3, 2e-3, 4e-3, 1e-3, 3e-3)  # a change every 2 s

    pieces = cut(board.states, [], [])

    assert seconds(pieces, "free", "fit") == [round(REST_S)]
    assert seconds(pieces, "prbs", "fit") == [3]
    # Three quarters are 9 s; the changes at 8 s and 10 s are both 1 s away, within the slack of 1.2 s.
    assert seconds(pieces, "closed-loop", "fit") == [8]
    assert seconds(pieces, "closed-loop", "judge") == [4]
    judge = next(piece for piece in pieces if piece.use == "judge")
    flown = [piece for piece in pieces if piece.kind == "closed-loop" and piece.use == "fit"]
    assert judge.states[0].x_ref_m != flown[-1].states[-1].x_ref_m
    assert not ticks([judge]) & ticks(flown)
    assert len({piece.name for piece in pieces}) == len(pieces)
    assert moves(pieces)


def test_a_flight_without_a_change_is_cut_at_three_quarters() -> None:
    board = Board()
    board.spell(CLOSED, 12.0, 2e-3)

    pieces = cut(board.states, [], [])

    assert seconds(pieces, "closed-loop", "fit") == [9]
    assert seconds(pieces, "closed-loop", "judge") == [3]
    assert not moves(pieces)


def test_later_flights_judge_whole_and_nothing_crosses_a_reset_or_other_gains() -> None:
    board = Board()
    board.spell(CLOSED, 6.0, 1e-3, 3e-3)
    board.reset()
    board.spell(CLOSED, 8.0, 1e-3, 3e-3)
    board.spell(IDLE, 2.0)
    board.spell(CLOSED, 2.0, 2e-3)

    pieces = cut(board.states, [], [(2, 1000)])

    assert all(len({state.session for state in piece.states}) == 1 for piece in pieces)
    assert not any(a.tick < 1000 <= b.tick for p in pieces for a, b in pairwise(p.states) if a.session == 2)
    assert pieces[-1].use == "judge"
    assert sum(seconds(pieces, "closed-loop", "judge")) == 4, "a quarter of 16 s"


def test_captures_are_a_recording_of_their_own() -> None:
    board = Board()
    board.spell(CLOSED, 10.0, 1e-3, 3e-3)

    pieces = cut(board.states, [pb.CaptureRecord(session=1)], [])

    assert [(piece.kind, len(piece.captures)) for piece in pieces if piece.captures] == [("amplifier-step", 1)]


def test_too_little_flight_says_how_much_there_is_and_what_to_fly() -> None:
    board = Board()
    board.spell(IDLE, 30.0)
    board.spell(CLOSED, 5.0, 2e-3)

    with pytest.raises(DataError, match=r"only 5 s of the 35 s .* 8 s are needed.*campaign run .*wide-steps"):
        cut(board.states, [], [])


def test_nothing_at_all_is_too_little() -> None:
    with pytest.raises(DataError, match="only 0 s"):
        cut([], [], [])
