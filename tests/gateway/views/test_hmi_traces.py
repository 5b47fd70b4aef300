"""The traces of a plot: no spike is lost on the way to a page, and a frame has what came until it was made."""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from starlette.types import Message
from starlette.websockets import WebSocket

from gateway.access.roles import Role
from gateway.views.board_feed import BoardFeed
from gateway.views.feed import Feed
from gateway.views.hmi.live import Live
from gateway.views.hmi.sessions import LoginSessions
from gateway.views.hmi.traces import MAX_ROWS, Traces
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.bus_peers import feed_of, played_gateway
from tests.harness.gateway.gateway_peers import wait_for


@contextmanager
def spike_of_samples(count: int, **values: float) -> Iterator[tuple[Feed, BoardFeed]]:
    """A board of which so many samples came since its traces were begun, one of them a spike of x."""
    with played_gateway() as gateway, feed_of(gateway) as feed:
        gateway.state()
        board = wait_for(lambda: feed.board("rig"), "the board")
        board.companion(Traces).pump()
        for n in range(count):
            gateway.state("rig", x_m=4.5e-3 if n == 333 else 3e-3, **values)
        wait_for(lambda: (s := board.latest(pb.State)) is not None and s.tick == count + 1, "the last sample")
        yield feed, board


def test_what_leaves_the_ring_of_a_plot_is_kept_for_ten_minutes_and_no_spike_is_lost(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("gateway.views.hmi.traces.MAX_ROWS", 30)
    with spike_of_samples(4000) as (_, board):
        traces = board.companion(Traces)
        traces.pump()

    past, (first, *_) = traces.past(), traces.since(0)[0]
    times = [float(str(row[2])) for row in past]
    assert 3 <= len(past) <= 5, "bins of two seconds"
    assert max(float(str(row[4])) for row in past) == pytest.approx(4.5e-3)
    assert times == sorted(times)
    assert times[-1] < float(str(first[2]))


def test_no_spike_is_lost_between_500_hz_and_a_screen() -> None:
    with spike_of_samples(1000, i_c_a=math.nan) as (_, board):
        traces = board.companion(Traces)
        traces.pump()

    rows, cursor = traces.since(0)
    assert 50 < len(rows) < 70, "30 bins a second"
    assert max(float(str(row[4])) for row in rows) == pytest.approx(4.5e-3)
    assert rows[0][6] is None, "what does not exist is null: JSON has no NaN"
    assert traces.since(cursor) == ([], cursor)


def test_a_frame_has_what_came_until_it_was_made() -> None:
    """Nobody else takes in the samples here: the task that does so for all boards is slower than the frames."""
    sessions, sent, received = LoginSessions(idle_s=1e6, lifetime_s=1e6), list[str](), asyncio.Event()
    session = sessions.open("vic", Role.VIEWER, time.monotonic())
    arriving = iter([{"type": "websocket.connect"}])

    async def receive() -> Message:
        if connect := next(arriving, None):
            return connect
        await received.wait()
        return {"type": "websocket.disconnect", "code": 1000}

    async def send(message: Message) -> None:
        if text := message.get("text"):
            sent.append(text)
            received.set()

    scope = {"type": "websocket", "headers": [], "path_params": {"board": "rig"}, "board51_session": session}
    with spike_of_samples(500) as (feed, _):
        asyncio.run(Live(feed, sessions, lambda _: ()).board(WebSocket(scope, receive, send)))

    assert len(json.loads(sent[0])["rows"]) > 25, "30 bins a second"


@pytest.mark.slow
def test_a_reader_that_was_away_gets_what_the_ring_holds_and_no_more() -> None:
    with played_gateway() as gateway, feed_of(gateway) as feed:
        gateway.state()
        board = wait_for(lambda: feed.board("rig"), "the board")
        traces = Traces(board)
        traces.pump()
        for _ in range(MAX_ROWS * 17 // 200 + 3):
            for _ in range(200):
                gateway.state(tick=gateway.tick * 17)
            end = gateway.last.tick
            wait_for(lambda end=end: (s := board.latest(pb.State)) is not None and s.tick == end, "samples")  # type: ignore[misc]  # mypy sees no type for a lambda default
            traces.pump()

    missed, cursor = traces.since(0)
    assert len(missed) == MAX_ROWS
    assert cursor > MAX_ROWS
    json.dumps(missed, allow_nan=False)
