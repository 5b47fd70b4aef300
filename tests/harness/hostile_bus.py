"""Messages that views show, and everything that they do with them."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterable

from google.protobuf.message import Message

from gateway.views.board_feed import BoardFeed
from gateway.views.foxglove.derived import Derived
from gateway.views.hmi import snapshot
from gateway.views.hmi.api import rigs
from gateway.views.hmi.model.plant import plant_card
from gateway.views.opcua.address_space.extras import EXTRAS, extra_value
from gateway.views.opcua.address_space.parameters import instrument_ranges, nameplate, ranges
from gateway.views.opcua.address_space.values import StampClock, datetime_of
from protocol.bus import board51_pb2 as pb
from protocol.bus.encoding import is_plausible, stamp_ns
from tests.harness.hostile_messages import START_NS, usual_messages

EXCITE = pb.Command(id="a", excite=pb.Excite(shape=pb.SHAPE_SAWTOOTH, amplitude=1.0, offset=1.0, duration_s=5.0))
SHELVE = pb.Command(id="b", acknowledge=pb.Acknowledge(alarm="link-down", shelve_s=9.0))
ACKNOWLEDGED = pb.Acknowledgement(alarm="link-down", who="a", host_time_ns=START_NS, shelve_s=10.0)
DOWN = pb.Alarm(name="link-down", active=True, text="x", host_time_ns=START_NS)
USUAL: list[Message] = [
    *(message for topic, message in usual_messages() if topic != "raw"),
    pb.Alarms(host_time_ns=START_NS, active=[DOWN], acknowledged=[ACKNOWLEDGED]),
    pb.TwinAlarms(host_time_ns=START_NS, active=[pb.Alarm(name="divergence-x", active=True, host_time_ns=START_NS)]),
    pb.TwinModel(
        host_time_ns=START_NS, session=1, name="n", model_json='{"plant": {"travel_m": 5e-3}}', sha256="ab", who="w"
    ),
    pb.TwinDiagnosis(host_time_ns=START_NS, cause="c", value=1.0, unit="m", others=["d"], for_s=3.0, sentence="s"),
    pb.PlantCard(host_time_ns=START_NS, plant=pb.Plant(mass_kg=8e-3, travel_m=5e-3, x_max_m=8e-3), who="a", board="7"),
    *(
        pb.CommandRecord(received_ns=START_NS, command=command, reply=pb.CommandReply(accepted=True))
        for command in (EXCITE, SHELVE)
    ),
]


def show(messages: Iterable[Message], *, later_s: float) -> None:
    """Take messages as a view does, and look at everything `later_s` after the last."""
    now_s = 100.0
    feed = BoardFeed("rig", lock := threading.Lock(), lambda: now_s)
    tap = feed.tap(pb.State, width_s=1 / 30)
    derived = Derived()
    for message in messages:
        for _, panel in derived.take("board51", "rig", message, stamp_ns(message) or START_NS):
            panel.encode()
        _describe(message)
        if not isinstance(message, pb.Status | pb.Parameters) or is_plausible(message):
            with lock:
                feed.take(message, START_NS)
    now_s += later_s

    for picture in (snapshot.now, snapshot.rest, snapshot.summary):
        json.dumps(picture(feed))
    snapshot.journal(feed.journal()[1])
    rigs.entry(feed), rigs.rig(feed), rigs.alarms(feed)
    plant_card(feed.latest(pb.PlantCard), "rig")
    tap.take()
    feed.tap(pb.Divergence, width_s=1 / 30)
    for extra in EXTRAS:
        extra_value(feed, extra)
    if (parameters := feed.latest(pb.Parameters)) is not None:
        for read in (nameplate, ranges, instrument_ranges):
            read(parameters)


def _describe(message: Message) -> None:
    """Give a message as the HTTP API does, and a sample the time that OPC UA gives it."""
    match message:
        case pb.State():
            rigs.csv_line(rigs.state(message))
            clock = StampClock()
            for _ in range(2):
                datetime_of(clock.stamp(session=message.session, t_s=message.t_s, host_time_ns=message.host_time_ns))
        case pb.Event():
            rigs.event(message)
        case pb.CaptureRecord():
            rigs.capture(message)
            rigs.capture_csv(message)
