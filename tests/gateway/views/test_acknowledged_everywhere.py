"""An alarm that an operator acknowledges on the web page is acknowledged over OPC UA too, and the log says by whom."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import pytest

from protocol.bus import board51_pb2 as pb
from protocol.log.reader import read
from tests.harness.gateway.gateway_peers import ScriptedBoard, client, gateway_config, running, wait_for
from tests.harness.gateway.hmi_peers import Page, Process, hmi, users_file
from tests.harness.gateway.opcua_peers import peer, until
from tests.harness.ports import free_port

ALARM = "divergence-x"


async def acknowledged_in(port: int) -> str:
    """The line of the alarm over OPC UA, once it is acknowledged."""
    async with peer(port) as opcua:

        async def look() -> str | None:
            lines = (await opcua.read("rig/alarms/list")).Value.Value or []
            return next((line for line in lines if line.startswith(ALARM) and ", acknowledged" in line), None)

        return await until(look, "acknowledgement over OPC UA")


@pytest.mark.slow
def test_an_acknowledgement_on_the_page_is_seen_over_opc_ua_and_logged_with_its_name(tmp_path: Path) -> None:
    logs = tmp_path / "gateway-log"
    with ScriptedBoard() as board:
        config = gateway_config(board.url, log=logs)
        endpoint, port = config.zenoh.listen[0], free_port()
        opcua = ("opcua", "--connect", endpoint, "--listen", f"127.0.0.1:{port}")
        with (
            running(config),
            client(endpoint) as bus,
            Process(tmp_path, *opcua) as server,
            hmi(tmp_path, endpoint, "--users", str(users_file(tmp_path))) as (page_port, _),
        ):
            server.wait_for_words("rig is served")
            raised = pb.Alarm(name=ALARM, active=True, text="off", host_time_ns=time.time_ns())
            ben = Page(page_port)
            ben.log_in("ben")

            def is_acknowledged() -> bool:
                bus.session.put("board51/rig/twin/alarm", raised.SerializeToString())  # a repetition is no new alarm
                return ben.post("/api/rig/acknowledge", {"name": ALARM}).status_code == 200

            wait_for(is_acknowledged, "an alarm to acknowledge on the page")
            line = asyncio.run(acknowledged_in(port))
            vic = Page(page_port)
            vic.log_in("vic")
            assert vic.post("/api/rig/acknowledge", {"name": ALARM}).status_code == 403

    assert line == f"{ALARM}: warning, active, acknowledged: off"
    logged = [m.message for log in logs.glob("*.mcap") for m in read(log)]
    records = [m for m in logged if isinstance(m, pb.CommandRecord) and m.command.WhichOneof("what") == "acknowledge"]
    assert [(r.command.who, r.command.acknowledge.alarm, r.reply.accepted) for r in records] == [("ben", ALARM, True)]
