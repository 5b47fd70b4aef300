"""Gains designed on the page of a model: what is shown of a design, who may load it, and what is refused in words."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.bus_peers import PlayedGateway
from tests.harness.gateway.design_files import CAMPAIGN, DESIGN, GAINS, MODEL, campaign, designed
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.gateway.hmi_peers import Page, served

START = {"act": "start", "campaign": CAMPAIGN}
WISH = START | {"kind": "design", "law": "lqi", "x_mm": "2.85", "settling_ms": "", "model": f"{CAMPAIGN}/model.json"}


def state_parameters(gateway: PlayedGateway, page: Page, gains: list[float]) -> None:
    """The board states them, and the page has heard it."""
    parameters = pb.Parameters(
        sample_time_s=2e-3, gains=gains, x_ref_min_m=0.3e-3, x_ref_max_m=5.2e-3, u_max_v=5.0, i_lsb_a=5e-4,
        x_lsb_m=1.5e-6, u_lsb_v=1.25e-3, i_0_a=0.49, x_0_m=2.85e-3, u_0_v=1.65,
    )  # fmt: skip
    gateway.send("parameters", parameters)
    wait_for(lambda: f"<td>{gains[1]:g}</td><td>1761</td>" in page.open("/model/rig"), "the gains on the page")


@pytest.mark.slow
def test_margins_before_and_after_are_seen_by_all_and_loaded_by_an_engineer(tmp_path: Path) -> None:
    folder = campaign(tmp_path / "data")
    designed(folder)
    with served(tmp_path, MODEL) as (gateway, port):
        viewer, engineer = Page(port), Page(port)
        viewer.log_in("vic")
        engineer.log_in("ana")
        state_parameters(gateway, viewer, [0.49, 1700.0, 17.7, -17600.0])
        viewer_page, able = viewer.open("/model/rig"), engineer.open("/model/rig")
        sent = json.loads(able.partition('data-command="')[2].partition('"')[0].replace("&#34;", '"'))
        forbidden = viewer.post("/api/rig/command", sent)
        fly = engineer.post("/api/rig/job", START | {"kind": "campaign", "fly": True}).json()
        gateway.answer = lambda _, c: pb.CommandReply(
            id=c.id, refused_by="board", reason="out-of-range", text="Gain 2."
        )
        refused = engineer.post("/api/rig/command", sent)
        # As the board holds them: rounded to its format.
        state_parameters(gateway, viewer, [gain * (1.0 + 2e-5) for gain in GAINS])
        loaded = engineer.open("/model/rig")
        (designed(folder, x_0_m=5.5e-3) / "what_if.json").unlink()
        outside = engineer.open("/model/rig")
        (folder / "designs" / DESIGN / "analysis.json").write_text("{")
        failed = engineer.open("/model/rig")

    assert "<td>phase margin, deg</td><td>unstable</td><td>24.5</td>" in viewer_page
    assert "<td>gain margin, factors</td><td>unstable</td><td>0.36 to no limit</td>" in viewer_page
    assert "\u25b2 small phase margin: 24 deg" in viewer_page
    assert ">K_A 0.297</div><table" in viewer_page
    assert ">without them: i_c = 0.4 A<" in viewer_page
    assert "The ball is lost in 3 of 100 draws." in viewer_page
    assert "<td>overshoot, %</td><td>25</td><td>10 (5 to 15)</td><td>12</td>" in viewer_page
    assert "<td>settling time, ms</td><td>\u2013</td><td>\u2013</td><td>\u2013</td>" in viewer_page
    assert ">Load on the board<" not in viewer_page
    assert sent["set_gains"]["gains"] == GAINS
    assert sent["set_gains"]["x_0_m"] == 2.85e-3
    assert forbidden.status_code == 403
    assert (fly["reason"], fly["text"]) == (
        "not-loaded",
        "The board does not have the gains of this design. Load them first.",
    )
    assert (refused.status_code, refused.json()["text"]) == (409, "Gain 2.")
    assert ">\u25cf on the board<" in loaded
    assert ">Load on the board<" not in loaded
    assert "These gains cannot be loaded. x_0 = 5.5 mm is outside the board" in outside.replace("&#39;", "'")
    assert ">Load on the board<" not in outside
    assert ">This design gave no gains." in failed


@pytest.mark.parametrize(
    ("change", "reason", "text"),
    [
        ({"campaign": "none"}, "no-campaign", "no such campaign"),
        ({"model": ""}, "no-model", "Choose one of the models in the list first."),
        ({"law": "mpc"}, "no-law", "Choose a law: LQI or PID."),
        ({"law": []}, "no-law", "Choose a law: LQI or PID."),
        ({"x_mm": "5.3"}, "out-of-range", "within the board's range, 0.3 to 5.2 mm"),
        ({"x_mm": ""}, "out-of-range", "within the board's range, 0.3 to 5.2 mm"),
        ({"settling_ms": "-1"}, "out-of-range", "a positive number of ms"),
        ({"settling_ms": "soon"}, "out-of-range", "a positive number of ms"),
        ({"kind": "forecast", "campaign": "none"}, "no-design", "Design first."),
        ({"kind": "forecast"}, "no-flight", "No flight of the steps is recorded"),
        ({"kind": "campaign", "fly": True, "campaign": ""}, "no-design", "Design first."),
    ],
)
def test_a_design_is_refused_in_words(
    change: dict[str, object], reason: str, text: str, engineer: tuple[Page, Path]
) -> None:
    page, folder = engineer

    answer = page.post("/api/rig/job", WISH | change).json()

    assert (answer["accepted"], answer["reason"]) == (False, reason)
    assert text in answer["text"]
    assert [path.name for path in (folder / "designs").iterdir()] == [DESIGN], "nothing is left of it"


@pytest.fixture(scope="module")
def engineer(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Page, Path]]:
    """An engineer's page of a rig with a design, and the campaign's folder."""
    root = tmp_path_factory.mktemp("designs")
    folder = campaign(root / "data")
    designed(folder)
    with served(root, MODEL) as (gateway, port):
        page = Page(port)
        page.log_in("ana")
        state_parameters(gateway, page, [0.49, 1700.0, 17.7, -17600.0])
        yield page, folder


@pytest.mark.slow
def test_without_the_right_or_what_the_board_states_nothing_is_written(tmp_path: Path) -> None:
    folder = campaign(tmp_path / "data")
    with served(tmp_path, MODEL | {"causes": ["another"]}) as (_, port):
        viewer, engineer = Page(port), Page(port)
        viewer.log_in("vic")
        engineer.log_in("ana")
        hand_over = viewer.post("/api/rig/job", START | {"kind": "hand-over", "model": WISH["model"]})
        forbidden = viewer.post("/api/rig/job", WISH)
        early = engineer.post("/api/rig/job", WISH).json()

    assert (forbidden.status_code, early["reason"]) == (403, "no-parameters")
    assert not (folder / "designs").exists()
    assert hand_over.status_code == 403
    assert not (tmp_path / "data" / "models").exists(), "the twin's model is not kept for who may not replace it"
