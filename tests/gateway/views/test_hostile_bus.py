"""Messages that no gateway of ours would send: what a view makes of them is a picture, and no error."""

from __future__ import annotations

import json
import math
import threading
from random import Random

import pytest
from google.protobuf.message import Message
from hypothesis import given
from hypothesis import strategies as st

from gateway.views.board_feed import BoardFeed
from gateway.views.feed import Feed
from gateway.views.foxglove.lines import line_of
from gateway.views.hmi import snapshot
from gateway.views.opcua.address_space.extras import EXTRAS, extra_value
from gateway.views.opcua.address_space.parameters import instrument_ranges, nameplate, ranges
from protocol.bus import board51_pb2 as pb
from protocol.bus.encoding import is_plausible
from tests.harness.gateway.bus_peers import feed_of, played_gateway
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.hostile_messages import START_NS, fuzzed, message, usual_messages

EXCITE = pb.Command(id="a", excite=pb.Excite(shape=pb.SHAPE_SAWTOOTH, amplitude=1.0, offset=1.0, duration_s=5.0))
SHELVE = pb.Command(id="b", acknowledge=pb.Acknowledge(alarm="link-down", shelve_s=9.0))
SEEN = pb.Acknowledgement(alarm="link-down", who="a", host_time_ns=START_NS, shelve_s=10.0)
DOWN = pb.Alarm(name="link-down", active=True, text="x", host_time_ns=START_NS)
USUAL: list[Message] = [
    *(one for topic, one in usual_messages() if topic != "raw"),
    pb.Alarms(host_time_ns=START_NS, active=[DOWN], acknowledged=[SEEN]),
    pb.TwinAlarms(active=[pb.Alarm(name="divergence-x", active=True, host_time_ns=START_NS)]),
    pb.TwinModel(session=1, name="n", model_json='{"plant": {"travel_m": 5e-3}}', sha256="ab", who="w"),
    pb.TwinDiagnosis(host_time_ns=START_NS, cause="c", value=1.0, unit="m", others=["d"], for_s=3.0, sentence="s"),
    pb.PlantCard(host_time_ns=START_NS, plant=pb.Plant(mass_kg=8e-3, travel_m=5e-3, x_max_m=8e-3), who="a", board="7"),
    *(
        pb.CommandRecord(received_ns=START_NS, command=command, reply=pb.CommandReply(accepted=True))
        for command in (EXCITE, SHELVE)
    ),
]


@fuzzed
@given(chance=st.randoms(use_true_random=False))
def test_a_view_makes_a_picture_of_whatever_comes(chance: Random) -> None:
    now_s = 100.0
    feed = BoardFeed("rig", lock := threading.Lock(), lambda: now_s)
    tap = feed.tap(pb.State, width_s=1 / 30)
    for usual in USUAL:
        one = message(chance, usual) if chance.random() < 0.4 else usual
        line_of(one, START_NS)
        if not isinstance(one, pb.Status | pb.Parameters) or is_plausible(one):
            with lock:
                feed.take(one, START_NS)
    now_s += chance.choice([0.01, 1.5, 5.0, 20.0])

    for picture in (snapshot.now, snapshot.rest, snapshot.summary):
        json.dumps(picture(feed))
    snapshot.journal(feed.journal()[1])
    tap.take()
    feed.tap(pb.Divergence, width_s=1 / 30)
    for extra in EXTRAS:
        extra_value(feed, extra)
    if (parameters := feed.latest(pb.Parameters)) is not None:
        for read in (nameplate, ranges, instrument_ranges):
            read(parameters)


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
