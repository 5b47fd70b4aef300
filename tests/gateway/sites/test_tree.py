"""Sites in a tree, with gateways and a twin: one is cut off, and what it sent follows from its log."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import pytest
import zenoh

from gateway.client.connection import BusBoard, open_bus
from gateway.client.recording import Recording
from gateway.config import ZenohConfig
from gateway.record.merge import merge
from gateway.record.summary import summarise
from gateway.sites.filler import Filler, Tally
from protocol.bus import board51_pb2 as pb
from protocol.bus.endpoint import zenoh_config
from protocol.errors import ServiceError
from protocol.log.reader import LogReader
from tests.harness.gateway.gateway_peers import ScriptedBoard, client, gateway_config, running, wait_for
from tests.harness.ports import free_endpoint
from tests.harness.sites.logs import account, answering, held
from tests.harness.sites.relay import Relay
from tests.harness.twin.rig import T_S
from tests.twin.mirror.bus.test_handover import HELD, QUICK, offset_rig, right_model
from twin.mirror.bus.handover import believe
from twin.mirror.bus.watched import REPEAT_S, Watched
from twin.model.parameters import Model

CUT_S = 10.0
REPEATED = ("twin/model", "twin/alarms")


@contextmanager
def router(*connect: str) -> Iterator[str]:
    endpoint = free_endpoint()
    config = zenoh_config("router", listen=[endpoint], connect=connect, wait_for_router=False)
    with zenoh.open(zenoh.Config.from_json5(config)):
        yield endpoint


@contextmanager
def serving(endpoint: str, folder: Path) -> Iterator[None]:
    with open_bus(endpoint) as session, answering(session, folder):
        yield


def filled(endpoint: str, folder: Path, *, servers: int) -> Tally:
    """Fill from so many log servers until nothing is too young any more."""
    total = Tally()

    def complete() -> bool:
        try:
            tally = filler.fill()
        except ServiceError:
            if total.servers:
                raise
            return False  # that a server has started may not have passed all routers yet
        total.records += tally.records
        total.servers = tally.servers
        return tally.servers == servers and not tally.settling

    with open_bus(endpoint) as session:
        filler = Filler(BusBoard(session, "board51", "*"), folder, settle_s=1.0)
        wait_for(complete, "all blocks old enough")
    return total


@pytest.mark.slow
def test_a_site_that_was_cut_off_is_filled_in_through_a_tree_of_routers(tmp_path: Path) -> None:
    logs = {site: tmp_path / site for site in ("lab", "site", "plant")}
    recorded = tmp_path / "recorded"
    with ExitStack() as outer:
        plant = outer.enter_context(router())
        upper = outer.enter_context(Relay(plant))
        site = outer.enter_context(router(upper.endpoint))
        lower = outer.enter_context(Relay(site))
        lab = outer.enter_context(router(lower.endpoint))
        endpoints = {"lab": lab, "site": site, "plant": plant}
        with ExitStack() as flying:
            session = flying.enter_context(open_bus(plant))
            recording = Recording(BusBoard(session, "board51", "*"), recorded, connect=plant)
            flying.enter_context(recording.start())
            bus = flying.enter_context(client(plant))
            for number, (name, endpoint) in enumerate(endpoints.items()):
                logs[name].mkdir()
                board = flying.enter_context(ScriptedBoard())
                config = gateway_config(board.url, log=logs[name])
                boards = tuple(replace(each, name=f"rig{number}") for each in config.boards)
                zenoh_ = ZenohConfig(mode="client", connect=(endpoint,))
                flying.enter_context(running(replace(config, boards=boards, zenoh=zenoh_)))
            for number in range(3):
                bus.await_states(200, f"rig{number}")
            lower.cut()
            threading.Event().wait(CUT_S)  # the fault lasts
            lower.mend()
            bus.await_states(200, "rig0")
            upper.cut()
            threading.Event().wait(CUT_S / 2)
            upper.mend()
            bus.await_states(200, "rig0")
        missing = [account(folder, recorded)[0] for folder in logs.values()]
        for name in endpoints:
            outer.enter_context(serving(endpoints[name], logs[name]))
        tally, again = filled(plant, recorded, servers=3), filled(plant, recorded, servers=3)
    merge(recorded, tmp_path / "whole.mcap")

    assert missing[0] > missing[1] > missing[2]
    assert tally.records == sum(missing)
    assert again.records == 0
    assert [account(folder, recorded)[0] for folder in logs.values()] == [0, 0, 0]
    assert account(recorded, recorded) == (0, 0)
    summary = summarise(tmp_path / "whole.mcap")
    states = {key: n for key, n in held(recorded).items() if key[0].endswith("/state")}
    assert sum(board.topics["state"].count for board in summary.boards.values()) == len(states)
    assert all(pb.State.FromString(data).tick for _, data in states)


def messages(folder: Path, topic: str) -> list[bytes]:
    """The records of this topic of all parts."""
    parts = [path for path in folder.glob("*.mcap") if path.stat().st_size]
    return [record.data for path in parts for record in LogReader(path).raw(topics_=[topic])]


class Flight:
    """A rig with a twin of another model, whose clock runs as fast as the samples are computed."""

    def __init__(self, session: zenoh.Session) -> None:
        self._rig = offset_rig()
        self.twin = Watched(session, "board51", "flown", believe(Model.load("ce152")), QUICK)
        self.twin.mirror.parameters(self._rig.parameters())
        self._began_ns = time.time_ns() - 120 * 10**9

    def fly(self, ticks: int) -> None:
        for state in self._rig.run(ticks, HELD):
            state.host_time_ns = self._began_ns + round(state.t_s * 1e9)
            self.twin.take(state, state.t_s)
            self.twin.send_batch()
            self.twin.look_at_the_clock(state.t_s)

    def is_in(self, folder: Path) -> bool:
        """Return whether the log in `folder` has everything that the twin has sent."""
        return len(messages(folder, "twin/divergence")) == self.twin.samples


@pytest.mark.slow
def test_models_and_alarms_of_a_twin_that_changed_during_a_cut_are_filled_in_once(tmp_path: Path) -> None:
    log, recorded = tmp_path / "lab", tmp_path / "recorded"
    log.mkdir()
    ticks = round(2.4 * REPEAT_S / T_S)
    with ExitStack() as outer:
        plant = outer.enter_context(router())
        line = outer.enter_context(Relay(plant))
        lab = outer.enter_context(router(line.endpoint))
        with ExitStack() as flying:
            session = flying.enter_context(open_bus(plant))
            flying.enter_context(Recording(BusBoard(session, "board51", "*"), recorded, connect=plant).start())
            board = flying.enter_context(ScriptedBoard())
            config = replace(gateway_config(board.url, log=log), zenoh=ZenohConfig(mode="client", connect=(lab,)))
            flying.enter_context(running(config))
            flying.enter_context(client(plant)).await_states(10)
            flight = Flight(flying.enter_context(open_bus(lab)))
            arrived = 0

            def comes() -> bool:
                flight.fly(50)
                return len(messages(recorded, "twin/divergence")) > arrived

            wait_for(comes, "twin in the recording")  # it sends ticks alone once it knows of a subscriber
            flight.fly(ticks)
            wait_for(lambda: flight.is_in(log), "twin in the log")
            line.cut()
            flight.fly(ticks)
            flight.twin.use(believe(right_model()))
            flight.fly(ticks)
            line.mend()
            arrived = len(messages(recorded, "twin/divergence"))
            wait_for(comes, "twin after the cut")
            flight.fly(ticks)
            wait_for(lambda: flight.is_in(log), "twin in the log")
        lacked = [len(messages(log, topic)) - len(messages(recorded, topic)) for topic in REPEATED]
        outer.enter_context(serving(lab, log))
        filled(plant, recorded, servers=1)
        again = filled(plant, recorded, servers=1)

    assert min(lacked) >= 4  # repetitions of a cut, before and after the change
    assert again.records == 0
    assert account(log, recorded) == (0, 0)
    for topic in REPEATED:
        assert sorted(messages(recorded, topic)) == sorted(messages(log, topic))
    models = [pb.TwinModel.FromString(data) for data in messages(log, "twin/model")]
    assert [name for name, _ in groupby(message.name for message in models)] == ["ce152", "moved"]
    raised = [pb.TwinAlarms.FromString(data) for data in messages(log, "twin/alarms")]
    assert [is_any for is_any, _ in groupby(bool(message.active) for message in raised)] == [False, True, False]
