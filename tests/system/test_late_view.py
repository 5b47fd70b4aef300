"""A view that starts after the twin has raised an alarm: it lists what it missed, as it was, and what ends, ends."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest
import zenoh

from gateway.views.feed import Feed
from gateway.views.opcua.server import OpcuaSettings
from protocol.bus import topics
from tests.harness.gateway.bus_peers import PlayedGateway, played_gateway
from tests.harness.gateway.gateway_peers import client, wait_for
from tests.harness.gateway.opcua_peers import Served, peer, until
from tests.harness.twin.rig import Rig
from tests.harness.twin.twin_bus import introduce_to, publish_to
from twin.mirror.bus.service import TwinService
from twin.model.parameters import Model
from twin.settings.mirror import Settings

BOARD = "rig"
QUICK = Settings(window_s=0.25, false_alarms_per_day=0.1)
RAISED = {"divergence-i_c", "innovation"}  # by the nominal model on a rig whose coil is elsewhere, while it flies
LASTS = {"out-of-step"}  # raised by the end of the samples, which ends the others
HELD = 2.85e-3
COMPILED_S = 90.0  # the first twin of a checkout compiles its kernels


def fly(session: zenoh.Session, service: TwinService, rig: Rig, ticks: int) -> None:
    """The board of `rig`, known to the twin, for so many ticks."""
    introduce_to(session, service, rig, topics.key("board51", BOARD, "parameters"))
    publish_to(session, topics.key("board51", BOARD, "states"), list(rig.run(ticks, HELD)))


def active(feed: Feed) -> dict[str, int]:
    """Name and first time of the twin's active alarms."""
    board = feed.board(BOARD)
    return {} if board is None else {a.name: a.since_ns for a in board.alarms() if a.of_twin and a.active}


@pytest.mark.slow
def test_a_late_view_lists_the_alarms_of_the_twin_that_last_until_they_end() -> None:
    rig = Rig(K_c=8.28e-3 * 9.81 / 120.364**2, gap_offset_m=2.4377e-3)
    rig.hold(HELD)
    with played_gateway() as gateway, client(gateway.endpoint) as early, client(gateway.endpoint) as other:
        with TwinService(Model.load("ce152"), endpoints=(gateway.endpoint,), settings=QUICK) as twin:
            fly(gateway.session, twin, rig, 1000)

            def lasting() -> dict[str, int] | None:
                latest = {a.name: a for a in early.messages["rig/twin/alarm"]}
                on = {a.name: a.host_time_ns for a in latest.values() if a.active}
                return on if latest.keys() >= RAISED and on.keys() == LASTS else None

            raised = wait_for(lasting, "the alarms of the flight, then that of its end", COMPILED_S)

            second_feed = Feed(other.session)

            def list_alarms() -> dict[str, int]:
                gateway.status(BOARD)
                return active(second_feed)

            listed = wait_for(list_alarms, "an alarm in a view that came late")
            with Served(gateway, OpcuaSettings(port=0)) as server:
                alarm_lines = asyncio.run(read_alarm_list(server.port, gateway, lambda lines: LASTS <= names(lines)))
                wait_for(lambda: len(early.messages["rig/twin/alarms"]) >= 3, "repeats")
                board = second_feed.board(BOARD)
                assert board is not None
                times = {a.times for a in board.alarms() if a.of_twin}

        assert listed == raised, "listed with the time at which it was raised"
        assert all("active, not acknowledged" in line for line in alarm_lines if line.partition(":")[0] in LASTS)
        assert times == {1}, "a repeated alarm is no new one"

        with TwinService(Model.load("ce152"), endpoints=(gateway.endpoint,), settings=QUICK) as another:
            fly(gateway.session, another, Rig(), 100)  # at rest: nothing to be wrong about
            wait_for(lambda: not active(second_feed), "end of the alarms of a twin that is no more")
        second_feed.close()


def names(lines: list[str]) -> set[str]:
    return {line.partition(":")[0] for line in lines}


async def read_alarm_list(port: int, gateway: PlayedGateway, enough: Callable[[list[str]], bool]) -> list[str]:
    """Return `alarms/list` of an OPC UA client, once it is `enough`; a gateway sends its status all the while."""
    async with peer(port) as opcua:

        async def look() -> list[str] | None:
            gateway.status(BOARD)
            lines = (await opcua.read(f"{BOARD}/alarms/list")).Value.Value or []
            return lines if enough(lines) else None

        return await until(look, "alarms over OPC UA")
