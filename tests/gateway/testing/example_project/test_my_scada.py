"""A SCADA client, tested against a gateway with an emulated board: values, an alarm, a gateway that dies."""

from __future__ import annotations

import asyncio
import urllib.request

import pytest
from asyncua import Client, ua

from gateway.client import CommandNotDeliveredError
from gateway.testing import EmulatorFactory, GatewayFactory


class MyDisplay:
    """The subject of this project: a display that shows the height of the ball, read over OPC UA."""

    def __init__(self, url: str) -> None:
        self.url = url

    async def height_mm(self) -> float:
        async with Client(self.url, timeout=120) as client:
            namespace = await client.get_namespace_index("urn:board51:board51")
            node = client.get_node(ua.NodeId("rig1/state/x_m", namespace))
            return 1e3 * float(await node.read_value())


def test_my_display_shows_where_the_ball_is(board51_gateway: GatewayFactory) -> None:
    gateway = board51_gateway(effects={"quadratic-drag": 1.0}, opcua=True)
    display = MyDisplay(gateway.opcua_url)

    with gateway.rig() as rig:
        rig.set_reference(0.003)
        rig.set_mode("closed-loop")
        rig.read(1.0)
        displayed_mm = asyncio.run(display.height_mm())
        rig.stop()

    assert displayed_mm == pytest.approx(3.0, abs=0.3)


def test_my_script_hears_of_a_reset_on_a_bad_line(board51_gateway: GatewayFactory) -> None:
    gateway = board51_gateway(faults=["flip=1e-5"])

    with gateway.rig() as rig:
        events = rig.messages("event", timeout_s=60.0)
        gateway.emulators[0].reset_board()

        assert any(event.name.startswith("reset-") for event in events)  # type: ignore[attr-defined]  # of any message


def test_my_script_survives_a_gateway_that_dies(
    board51_emulator: EmulatorFactory, board51_gateway: GatewayFactory
) -> None:
    gateway = board51_gateway(board51_emulator(boards=2, port="pty"))
    assert gateway.boards == ["rig1", "rig2"]

    with gateway.rig("rig2", timeout_s=1.0) as rig:
        gateway.kill()
        with pytest.raises(CommandNotDeliveredError):
            rig.ping()
        gateway.start()
        rig.stop()

    assert list((gateway.folder / "logs").glob("*.mcap"))


def test_my_browser_finds_the_page(board51_gateway: GatewayFactory) -> None:
    gateway = board51_gateway(hmi=True, log=False, config="[log]\nqueue = 1000\n")

    request = urllib.request.Request(gateway.hmi_url, headers={"Accept": "text/html"})
    with urllib.request.urlopen(request, timeout=60.0) as page:
        assert b"<html" in page.read().lower()
