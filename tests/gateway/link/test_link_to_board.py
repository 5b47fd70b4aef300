"""The direction to the board: what its missing answers say and what they do not.  Time in the test's hand."""

from __future__ import annotations

from gateway.link.to_board import ANSWERING, UNANSWERED, UNANSWERED_S, UNKNOWN, ToBoard

STATE_S = 0.002
PING_S = 0.125


class Line:
    """A host that pings and repeats, and a board that streams; either may be held up, the answers may be missing."""

    def __init__(self) -> None:
        self.states: list[str] = []
        self.to_board = ToBoard(self.states.append)
        self.answers = True
        self.period_s = STATE_S
        self.ping_s = PING_S
        self._ms = 0

    def run(self, seconds: float, *, frames: bool = True) -> None:
        for _ in range(round(seconds * 1e3)):
            self._ms += 1
            now_s = self._ms * 1e-3
            if frames and self._ms % round(self.period_s * 1e3) == 0:
                self.to_board.frames_arrived(now_s, self.period_s)
            if self._ms % round(self.ping_s * 1e3) == 0:
                self.to_board.sent(now_s)
                if frames and self.answers:
                    self.to_board.frames_arrived(now_s, self.period_s)
                    self.to_board.answered()
            if now_s >= self.to_board.deadline_s:
                self.to_board.judge(now_s)


def test_it_is_told_once_within_two_seconds_and_ended_by_the_first_answer() -> None:
    line = Line()
    line.run(3.0)
    line.answers = False
    line.run(UNANSWERED_S + 4 * PING_S)
    state = line.to_board.state
    line.run(20.0)
    line.answers = True
    line.run(0.5)

    assert state == UNANSWERED
    assert line.states == [ANSWERING, UNANSWERED, ANSWERING]


def test_a_line_that_was_cut_before_the_first_answer_is_unanswered_too() -> None:
    line = Line()
    line.answers = False

    line.run(UNANSWERED_S + 4 * PING_S)

    assert line.states == [UNANSWERED]


def test_a_pause_of_the_frames_says_nothing_about_the_other_direction() -> None:
    line = Line()
    line.ping_s = 0.43  # so that pauses end at every place between two of them
    line.run(1.0)
    for n in range(40):
        line.run(0.3 + 0.05 * n, frames=False)
        line.run(0.7)

    assert line.states == [ANSWERING]


def test_a_slow_stream_is_no_pause() -> None:
    line = Line()
    line.period_s = 0.5
    line.run(3.0)
    line.answers = False
    line.run(3.0)

    assert line.states == [ANSWERING, UNANSWERED]


def test_another_port_is_another_line() -> None:
    line = Line()
    line.answers = False
    line.run(3.0)
    line.to_board.begin()

    assert line.states == [UNANSWERED, UNKNOWN]
    assert line.to_board.unanswered_s(9.0) == 0.0
