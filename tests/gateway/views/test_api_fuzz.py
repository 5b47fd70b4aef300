"""The API against schemathesis: whatever its own description makes possible, and much that it forbids."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.harness.gateway.api_peers import Program, users_with_tokens
from tests.harness.gateway.bus_peers import played_gateway, ticking
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.gateway.hmi_peers import hmi
from tests.patience import HANG_S

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("hmi-api")]
SCHEMATHESIS = Path(sys.executable).parent / "schemathesis"


def test_no_request_gets_an_answer_that_is_not_described(tmp_path: Path) -> None:
    """As an operator: what an operator may not do is refused for each role alike, and starts no campaign here.

    Rules between keys are in no schema (an excitation has a duration or is endless), so valid data may be refused.
    """
    users, tokens = users_with_tokens(tmp_path)
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "a.mcap").write_bytes(b"log")
    (tmp_path / "schemathesis.toml").write_text('[parameters]\n"path.rig" = "rig"\n')
    with played_gateway() as gateway, hmi(tmp_path, gateway.endpoint, "--users", str(users)) as (port, process):
        program = Program(port, tokens["ben"])
        with ticking(gateway):
            wait_for(lambda: program.get("/rigs/rig/state").status_code == 200, "the board at the API")
            fuzzer = subprocess.run(
                [SCHEMATHESIS, "run", f"http://127.0.0.1:{port}/api/v1/openapi.json", "--header",
                 f"Authorization: Bearer {tokens['ben']}", "--url", f"http://127.0.0.1:{port}/api/v1",
                 "--exclude-path", "/rigs/{rig}/stream", "--exclude-path", "/rigs/{rig}/events/stream",
                 "--phases", "coverage,fuzzing", "--seed", "1",
                 "--max-examples", "25", "--exclude-checks",
                 "positive_data_acceptance", "--generation-database", "none", "--no-color"],
                cwd=tmp_path, capture_output=True, text=True, timeout=5 * HANG_S, check=False,
            )  # fmt: skip
            alive = program.get("/rigs/rig/state").json()

    assert fuzzer.returncode == 0, fuzzer.stdout[-6000:]
    assert "500" not in process.log_file.read_text(errors="replace")
    assert "Traceback" not in process.log_file.read_text(errors="replace")
    assert time.time() - alive["host_time_s"] < HANG_S
    kinds = {command.WhichOneof("what") for _, command in gateway.commands}
    assert {"set_mode", "set_reference", "stop"} <= kinds, "commands came through, so the rest was really refused"
