"""The web page on a guarded bus: https with the plant's authority, people's roles down to the gateway and its log."""

from __future__ import annotations

from pathlib import Path

import httpx
import pytest

from tests.gateway.access.access_peers import PASSWORD, guarded_rig, made_folder
from tests.gateway.gateway_peers import wait_for
from tests.gateway.views.hmi_peers import Page, hmi

pytestmark = pytest.mark.xdist_group("hmi-access")


def test_a_person_s_command_reaches_the_board_under_that_person_s_name_and_role(tmp_path: Path) -> None:
    folder = made_folder(tmp_path / "keys")
    with (
        guarded_rig(folder, tmp_path / "logs") as rig,
        hmi(tmp_path, rig.endpoint, "--security", str(folder.path)) as (port, _),
        rig.join("vic") as bus,
    ):
        page = Page(port, ca=folder.ca)
        cookie = page.log_in("ben", PASSWORD).headers["set-cookie"]

        def known() -> bool:
            return page.post("/api/rig/command", {"ping": {}}).json()["accepted"] is True

        wait_for(known, "the board behind the page", timeout_s=15.0)
        stopped = page.post("/api/rig/stop")
        wait_for(lambda: any(r.command.HasField("stop") for r in bus.records), "the record")
        forbidden = page.post("/api/rig/command", {"set_stream": {"divider": 2}})

        assert "Secure" in cookie
        assert stopped.status_code == 200
        assert "STOP" in rig.board.names()
        record = next(r for r in bus.records if r.command.HasField("stop"))
        assert (record.command.who, record.command.role) == ("ben", "operator")
        assert (forbidden.status_code, forbidden.json()["refused_by"]) == (403, "hmi")
        with pytest.raises(httpx.ConnectError, match="CERTIFICATE_VERIFY_FAILED"):
            httpx.get(f"https://127.0.0.1:{port}/login")
