"""Three sites in a tree, each with a gateway: one is cut off, and its samples follow from its log."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
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
from tests.harness.gateway.gateway_peers import ScriptedBoard, client, gateway_config, running, wait_for
from tests.harness.ports import free_endpoint
from tests.harness.sites.logs import account, answering, held
from tests.harness.sites.relay import Relay

CUT_S = 10.0


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


def filled(endpoint: str, folder: Path) -> Tally:
    """Fill until nothing is too young any more."""
    total = Tally()

    def complete() -> bool:
        tally = filler.fill()
        total.records += tally.records
        total.servers = tally.servers
        return not tally.settling

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
        tally, again = filled(plant, recorded), filled(plant, recorded)
    merge(recorded, tmp_path / "whole.mcap")

    assert missing[0] > missing[1] > missing[2]
    assert tally.servers == 3
    assert tally.records == sum(missing)
    assert again.records == 0
    assert [account(folder, recorded)[0] for folder in logs.values()] == [0, 0, 0]
    assert account(recorded, recorded) == (0, 0)
    summary = summarise(tmp_path / "whole.mcap")
    states = {key: n for key, n in held(recorded).items() if key[0].endswith("/state")}
    assert sum(board.topics["state"].count for board in summary.boards.values()) == len(states)
    assert all(pb.State.FromString(data).tick for _, data in states)
