"""A log is served and filled on a guarded bus: by the gateway's account, for everybody who is let in."""

from __future__ import annotations

from pathlib import Path

import pytest
import zenoh

from gateway.access.folder import SecurityFolder
from gateway.client.connection import BusBoard, open_bus
from gateway.sites.filler import Filler
from protocol.errors import ServiceError
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.ports import free_port
from tests.harness.sites.logs import account, answering, flight, write

pytestmark = pytest.mark.xdist_group("guarded-bus")


@pytest.mark.parametrize("account_of_server", ["gateway", "ben"])
def test_the_gateway_s_account_serves_the_log_and_nobody_else(
    keys: SecurityFolder, tmp_path: Path, account_of_server: str
) -> None:
    lab, plant = tmp_path / "lab", tmp_path / "plant"
    plant.mkdir()
    write(lab / "a-000.mcap", flight(500))
    endpoint = f"tls/127.0.0.1:{free_port()}"
    with (
        zenoh.open(zenoh.Config.from_json5(keys.router([endpoint]))),
        open_bus(endpoint, keys.identity(account_of_server)) as serving,
        open_bus(endpoint, keys.identity("vic")) as asking,
        answering(serving, lab),
    ):
        filler = Filler(BusBoard(asking, "board51", "*"), plant, settle_s=1.0, days=1e5)

        def filled() -> bool:
            try:
                return filler.fill().records > 0
            except ServiceError:  # it is not there yet
                return False

        if account_of_server == "gateway":
            wait_for(filled, "records")
            assert account(lab, plant) == (0, 0)
        else:  # a session hears itself without a router
            wait_for(lambda: list(serving.get("board51/_logs/*", payload=b"")), "its own answer")
            list(serving.get("board51/_logs/nobody"))  # there and back: its declaration has arrived
            assert not filled()


def test_a_tree_of_guarded_routers_passes_samples_and_logs_up_and_no_commands_down(
    keys: SecurityFolder, tmp_path: Path
) -> None:
    lab, plant = tmp_path / "lab", tmp_path / "plant"
    plant.mkdir()
    write(lab / "a-000.mcap", flight(500))
    upper, lower = (f"tls/127.0.0.1:{free_port()}" for _ in range(2))
    states, commands = list[zenoh.Sample](), list[zenoh.Query]()
    with (
        zenoh.open(zenoh.Config.from_json5(keys.router([upper]))),
        zenoh.open(zenoh.Config.from_json5(keys.router([lower], [upper], wait_for_router=False))),
        open_bus(lower, keys.identity("gateway")) as gateway,
        open_bus(lower, keys.identity("ben")) as ben,
        open_bus(upper, keys.identity("ben")) as ben_above,
        open_bus(upper, keys.identity("vic")) as vic,
    ):
        vic.declare_subscriber("board51/rig/state", states.append)
        gateway.declare_queryable("board51/rig/command/as/*/*", commands.append)
        with answering(gateway, lab):
            wait_for(lambda: gateway.put("board51/rig/state", b"") or states, "a state above")
            filler = Filler(BusBoard(vic, "board51", "*"), plant, settle_s=1.0, days=1e5)
            wait_for(lambda: list(vic.get("board51/_logs/*", payload=b"")), "the log server, above")
            filler.fill()
            list(ben_above.get("board51/rig/command/as/operator/ben", timeout=1.0))
            above = len(commands)
            ben.get("board51/rig/command/as/operator/ben", timeout=1.0)
            wait_for(lambda: commands, "a command from below")

    assert account(lab, plant) == (0, 0)
    assert above == 0
