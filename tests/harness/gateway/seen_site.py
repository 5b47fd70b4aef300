"""A played gateway with two boards, for pages that a browser looks at."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.bus_peers import PlayedGateway, ticking


class Site:
    """A played gateway with two boards, and the page's server."""

    def __init__(self, gateway: PlayedGateway, port: int) -> None:
        self.gateway, self.url = gateway, f"http://127.0.0.1:{port}"
        self.mode: dict[str, int] = {"mode": pb.MODE_CLOSED_LOOP}

    @contextmanager
    def live(self) -> Iterator[None]:
        with ticking(self.gateway, "rig", "two", values=lambda _: self.mode):
            yield

    def stopped(self) -> list[str]:
        """The boards that got a STOP."""
        return [key.split("/")[1] for key, command in self.gateway.commands if command.HasField("stop")]


def stop_turns_the_coil_off(site: Site) -> None:
    """Make a STOP turn the coil off as a board does: samples say so.

    A STOP that comes after its test moves nothing of the next one.
    """
    mode = site.mode

    def answer(_: str, command: pb.Command) -> pb.CommandReply:
        if command.HasField("stop"):
            mode["mode"] = pb.MODE_IDLE
        return pb.CommandReply(id=command.id, accepted=True, tick=site.gateway.tick + 1)

    site.gateway.answer = answer


def raise_alarms(site: Site, count: int) -> None:
    for n in range(count):
        site.gateway.send(
            "twin/alarm", pb.Alarm(name=f"alarm-{n}", active=True, text="What is wrong, at some length. " * 3)
        )
