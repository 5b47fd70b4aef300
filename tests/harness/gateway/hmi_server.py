"""A web page with logins behind which a played gateway has a board: who gets in, and what is refused."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from tests.harness.gateway.bus_peers import PlayedGateway, played_gateway
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.gateway.hmi_peers import Page, frame, hmi, users_file

STOP = "/api/rig/stop"


@dataclass(frozen=True, kw_only=True)
class Server:
    port: int
    folder: Path
    gateway: PlayedGateway
    entered: dict[str, Page] = field(default_factory=dict)

    def page(self, name: str = "", *, again: bool = False) -> Page:
        """A browser of this person, in the same session as before: a log-in takes 0.05 s of processor time."""
        page = Page(self.port)
        if name and (again or name not in self.entered):
            assert page.log_in(name).status_code == 303
            if not again:
                self.entered[name] = page
        elif name:
            page.http.cookies.update(self.entered[name].http.cookies)
            page.token = self.entered[name].token
        return page


@contextmanager
def hmi_with_logins(folder: Path) -> Iterator[Server]:
    """Run a server with logins and some logs; the gateway behind it accepts everything."""
    (folder / "logs").mkdir()
    (folder / "logs" / "a.mcap").write_bytes(b"not a log")
    (folder / "secret.mcap").write_bytes(b"secret")
    (folder / "logs" / "link.mcap").symlink_to(folder / "secret.mcap")
    (folder / "logs" / ".hidden.mcap").write_bytes(b"hidden")
    with (
        played_gateway() as gateway,
        hmi(folder, gateway.endpoint, "--users", str(users_file(folder)), "--reports", str(folder / "data")) as (
            port,
            _,
        ),
    ):
        made = Server(port=port, folder=folder, gateway=gateway)
        viewer_page = made.page("vic")

        def known() -> bool:
            gateway.state()
            gateway.parameters()
            gateway.status()
            time.sleep(0.02)
            with viewer_page.live("/live") as socket:
                return bool(frame(socket)["boards"])

        wait_for(known, "the board on the page")
        yield made
