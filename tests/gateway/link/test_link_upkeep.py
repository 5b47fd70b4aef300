"""Signs of life and settings of one board, with a clock in the test's hand."""

from __future__ import annotations

import itertools

import pytest

from gateway.config import BoardConfig
from gateway.link.keepalive import Keepalive
from protocol.wire.events import Answer
from protocol.wire.exchange import WAIT_S
from protocol.wire.messages import Value
from protocol.wire.session import Session


class Noted(Session):
    """A session that remembers what was submitted when."""

    def __init__(self) -> None:
        super().__init__(choose_session=lambda: 0x1234)
        self.submitted: list[tuple[str, float, int]] = []  # name, when, token

    def submit(self, name: str, now_s: float, wait_s: float = WAIT_S, /, **values: Value) -> int:
        token = super().submit(name, now_s, wait_s, **values)
        self.submitted.append((name, now_s, token))
        return token


@pytest.mark.parametrize("timeout_s", [0.2, 0.5, 1.0, 4.0])
def test_a_ping_is_due_at_least_every_quarter_of_the_host_loss_timeout(timeout_s: float) -> None:
    session = Noted()
    keepalive = Keepalive(BoardConfig(name="rig", port="x", host_loss_timeout_s=timeout_s), session, lambda _: None)

    keepalive.begin(0.0)
    keepalive.host_loss_is(round(timeout_s * 1e3), 0.0)
    while keepalive.deadline_s < 5.0 * timeout_s:
        now_s = keepalive.deadline_s
        keepalive.poll(now_s)
        name, when_s, token = session.submitted[-1]
        assert when_s == now_s, "nothing was due"
        keepalive.answered(Answer(token=token, outcome="timed-out" if name == "PING" else "ack", attempts=1), now_s)

    pings_s = [0.0, *(when_s for name, when_s, _ in session.submitted if name == "PING"), 5.0 * timeout_s]
    assert max(b - a for a, b in itertools.pairwise(pings_s)) <= timeout_s / 4.0 + 1e-9


def test_changes_on_a_line_that_answers_nothing_do_not_fill_the_queue_with_questions() -> None:
    session = Noted()
    keepalive = Keepalive(BoardConfig(name="rig", port="x"), session, lambda _: None)
    session.is_open = True

    for n in range(100):  # every 0.1 s a change, and every 0.5 s all that was asked is given up
        keepalive.read_parameters(n * 0.1)
        if n % 5 == 4:
            for _, _, token in session.submitted:
                keepalive.answered(Answer(token, "timed-out", 0), n * 0.1)
            keepalive.poll(n * 0.1)

    request_times_s = [when_s for name, when_s, _ in session.submitted if name == "GET_PARAMETERS"]
    assert len(request_times_s) <= 2 * 20 + 10  # two in each half second, one a second again
    assert max(request_times_s) > 9.0
