"""`board51 plot --span`: parts of a flight side by side."""

from __future__ import annotations

import json
from pathlib import Path

import matplotlib.image
import pytest

import board51
from protocol.bus import board51_pb2 as pb
from tests.harness.twin.rig import Rig
from twin.mirror.bus.handover import believe
from twin.model.parameters import Model
from twin.readers.log import TwinLog

HELD = 2.85e-3
TICKS = 1500


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log with the twin's topics."""
    folder, rig = tmp_path_factory.mktemp("flown"), Rig(seed=4)
    with TwinLog(folder / "plain.mcap") as log:
        log.write("lab/rig/parameters", rig.parameters(), message_type=pb.Parameters, log_time_ns=10**18)
        rig.hold(HELD)
        for state in rig.run(TICKS, HELD):
            log.write("lab/rig/state", state, message_type=pb.State, log_time_ns=state.host_time_ns)
    assert board51.main(["twin", "--log", str(folder / "plain.mcap"), "--out", str(folder / "run.mcap")]) == 0
    return folder / "run.mcap"


def test_the_log_of_a_rerun_says_which_model_ran(flown: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert board51.main(["twin", "--log", str(flown), "--json"]) == 0

    result = json.loads(capsys.readouterr().out)
    (model,) = result["boards"][0]["models_logged"]
    assert (model["name"], model["since_tick"], model["who"]) == ("ce152", 0, "")
    assert model["sha256"] == believe(Model.load("ce152")).sha256 == result["model_sha256"]


def test_info_names_the_model_of_the_twin(flown: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert board51.main(["info", str(flown)]) == 0

    assert f"ce152 ({believe(Model.load('ce152')).sha256[:12]}) from tick 0" in capsys.readouterr().out


def test_a_span_more_is_a_column_more(flown: Path, tmp_path: Path) -> None:
    widths = []
    for spans in (["0.5:1.2"], ["0.5:1.2", "1.5:2.5=after"]):
        out = tmp_path / f"{len(spans)}.png"
        words = [word for span in spans for word in ("--span", span)]
        assert board51.main(["plot", str(flown), "--out", str(out), *words]) == 0
        widths.append(matplotlib.image.imread(out).shape[1])

    assert widths[1] == 2 * widths[0]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--span", "2:1"], "is not FROM:TO"),
        (["--span", "x"], "is not FROM:TO"),
        (["--span", "nan:3"], "is not FROM:TO"),
        (["--span", "10:20"], "no samples in --span 10:20. Choose from 0.0 to 3.0 s, by the clock of rig"),
        (["--span", "1:2", "--from", "0"], "exclude each other"),
    ],
)
def test_a_span_that_is_none_is_one_clear_line(
    words: list[str], message: str, flown: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        code = board51.main(["plot", str(flown), "--out", str(tmp_path / "p.png"), *words])
    except SystemExit as stop:  # argparse
        code = int(stop.code or 0)

    assert code == 2
    assert message in capsys.readouterr().err
