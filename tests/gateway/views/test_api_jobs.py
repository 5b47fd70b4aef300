"""Jobs of the API that succeed: validate, design and hand-over on a simulated campaign, with a twin on the bus."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from tests.harness.gateway.api_peers import Program, users_with_tokens
from tests.harness.gateway.bus_peers import PlayedGateway, played_gateway
from tests.harness.gateway.design_files import CAMPAIGN
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.gateway.hmi_peers import hmi
from tests.patience import WORK_S
from twin.commands.compile import _campaign as simulated_campaign
from twin.mirror.bus.service import TwinService
from twin.model.parameters import Model, model_text

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("hmi-api-jobs")]
MODEL = f"{CAMPAIGN}/model.json"


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[PlayedGateway, Program]]:
    """A played gateway with a board `rig`, and an engineer's program; the campaign has its recordings and a model."""
    root = tmp_path_factory.mktemp("api-jobs")
    users, tokens = users_with_tokens(root)
    folder = root / "data" / "campaigns" / CAMPAIGN
    folder.mkdir(parents=True)
    model = Model.load("ce152")
    simulated_campaign(folder, model)
    (folder / "model.json").write_text(model_text(model))
    with played_gateway() as gateway, hmi(root, gateway.endpoint, "--users", str(users)) as (port, _):
        program = Program(port, tokens["ana"])

        def known() -> bool:
            gateway.state()
            gateway.parameters()
            answer = program.get("/rigs/rig")
            return answer.status_code == 200 and answer.json()["limits"] is not None

        wait_for(known, "the board at the API")
        yield gateway, program


def run_job(program: Program, kind: str, **more: object) -> dict[str, Any]:
    """Start a job and wait for its end."""
    started = program.post("/rigs/rig/jobs", {"job": kind, **more})
    assert started.json()["executed"], started.text

    def ended() -> dict[str, Any] | None:
        latest: dict[str, Any] = {job["kind"]: job for job in program.json("/rigs/rig/jobs")["jobs"]}[kind]
        return None if latest["running"] else latest

    return wait_for(ended, "its end", WORK_S)


def test_a_model_is_validated_on_the_recordings_that_judge(line: tuple[PlayedGateway, Program]) -> None:
    _, program = line

    job = run_job(program, "validate")

    assert (job["failed"], job["who"]) == (False, "ana"), job
    result = program.json("/rigs/rig/results/validation", campaign=CAMPAIGN)
    assert "judge.csv" in str(result)


def test_gains_are_designed_and_come_as_the_command_that_loads_them(line: tuple[PlayedGateway, Program]) -> None:
    gateway, program = line

    job = run_job(program, "design", model=MODEL, x_m=2.85e-3)

    assert not job["failed"], job
    result = program.json("/rigs/rig/results/design", campaign=CAMPAIGN)
    assert (result["problem"], result["command"]["law"], result["command"]["x_0_m"]) == ("", "lqi", 2.85e-3)
    assert program.command(**result["command"]).json()["executed"]
    assert list(gateway.commands[-1][1].set_gains.gains) == pytest.approx(result["command"]["gains"])


def test_a_model_is_handed_over_to_the_twin_that_runs(line: tuple[PlayedGateway, Program]) -> None:
    gateway, program = line
    with TwinService(Model.load("inteco"), endpoints=(gateway.endpoint,)) as service:

        def served() -> bool:
            gateway.parameters()
            gateway.state()
            return "rig" in service.boards

        wait_for(served, "the board at the twin")
        job = run_job(program, "hand-over", model=MODEL)
        title, who = service.boards["rig"].belief.title, service.boards["rig"].belief.who

    assert not job["failed"], job
    assert title.startswith("ce152")
    assert who == "ana"
