"""Events of a board in words, without codes."""

from __future__ import annotations

import pytest

from gateway.link.event_text import of_board
from protocol.wire.events import BoardEvent
from protocol.wire.messages import EventCode


@pytest.mark.parametrize(
    ("code", "detail", "sentence"),
    [
        (EventCode.LIMIT_HIT, 0, "The input u_c has reached its limit."),
        (EventCode.LIMIT_HIT, 1, "The reference has reached its limit."),
        (EventCode.LIMIT_HIT, 7, "The 7 has reached its limit."),
        (EventCode.HOST_LOST, 1, "No frame from the host came in time. The host-loss policy has acted: coil off."),
        (EventCode.MODE_CHANGED, 2, "Mode closed loop."),
    ],
)
def test_an_event_is_said_in_words(code: EventCode, detail: int, sentence: str) -> None:
    assert of_board(BoardEvent(1, code, detail, 0))[2] == sentence
