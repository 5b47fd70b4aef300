"""Messages that no gateway of ours would send: what a view makes of them is a picture, and no error."""

from __future__ import annotations

import math
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.views.feed import Feed
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.bus_peers import feed_of, played_gateway
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.hostile_bus import USUAL, show
from tests.harness.hostile_messages import fuzzed, message
from tests.harness.hostile_opcua import serve


@fuzzed
@given(chance=st.randoms(use_true_random=False))
def test_a_view_makes_a_picture_of_whatever_comes(chance: Random) -> None:
    messages = [message(chance, usual) if chance.random() < 0.4 else usual for usual in USUAL]

    show(messages, later_s=chance.choice([0.01, 1.5, 5.0, 20.0]))


@fuzzed
@given(chance=st.randoms(use_true_random=False))
@pytest.mark.slow
def test_opc_ua_sends_whatever_comes(chance: Random) -> None:
    serve(message(chance, usual) if chance.random() < 0.4 else usual for usual in USUAL)


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -1e300])
def test_a_status_with_numbers_of_no_rig_is_refused_and_the_one_before_stays(wrong: float) -> None:
    with played_gateway() as gateway, feed_of(gateway) as feed:
        gateway.send("status", pb.Status(link="streaming", samples_per_s=500.0))
        wait_for(lambda: rate(feed), "a status")
        gateway.send("status", pb.Status(link="streaming", samples_per_s=wrong))
        wait_for(lambda: feed.refused, "a refusal")

        assert rate(feed) == 500.0


def rate(feed: Feed) -> float:
    board = feed.board("rig")
    status = None if board is None else board.latest(pb.Status)
    return 0.0 if status is None else status.samples_per_s
