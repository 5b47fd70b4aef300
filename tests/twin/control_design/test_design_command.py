"""`board51 design` as a user meets it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import board51


def test_it_writes_what_a_board_is_to_be_loaded_with(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "controller.json"

    code = board51.main(["design", "ce152", "--observer", "--out", str(out)])

    output = capsys.readouterr().out
    written = json.loads(out.read_text())
    assert code == 0
    assert written["law"] == "lqi"
    assert len(written["gains"]) == 4
    assert written["sample_time_s"] == 2e-3
    assert written["operating_point"]["x_0_m"] == pytest.approx(2.85e-3)
    assert written["observer"]["runs_on_board"] is False
    assert "the backward difference costs" in output
    assert "cannot run it" in output
    assert "robustness was not checked" in output


def test_json_holds_everything(capsys: pytest.CaptureFixture[str]) -> None:
    code = board51.main(["design", "ce152", "--law", "pid", "--json"])

    report = json.loads(capsys.readouterr().out)
    assert code == 0
    assert report["stable"]
    assert report["gains"][3] == 0.0
    assert [loop["name"] for loop in report["loops"]][1] == "backward difference"
    assert report["loops"][2]["delay_margin_s"] > 0.0


def test_the_gains_to_be_replaced_stand_beside_the_new_ones_and_thin_margins_are_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before, after = tmp_path / "before.json", tmp_path / "analysis.json"
    assert board51.main(["design", "ce152", "--out", str(before)]) == 0
    table = json.loads(before.read_text())
    before.write_text(json.dumps({name: value for name, value in table.items() if name != "weights"}))
    capsys.readouterr()

    code = board51.main(["design", "ce152", "--law", "pid", "--before", str(before), "--analysis", str(after)])

    output, analysis = capsys.readouterr().out, json.loads(after.read_text())
    assert code == 0
    assert analysis["before"]["phase_margin_deg"] == pytest.approx(40.9, abs=0.1)
    assert analysis["before"]["gain_margin"][1] > 2.0 > analysis["loops"][2]["gain_margin"][1]
    assert "small phase margin: 26 deg" in output
    assert "small gain margin: stable for 0.30 to 1.59 times the gain" in output
    assert board51.main(["design", "ce152", "--sample-time", "0.001", "--before", str(before)]) == 2
    assert "are for T_s = 0.002 s, not 0.001 s" in capsys.readouterr().err
    assert board51.main(["design", "ce152", "--out", str(before)]) == 0
    assert "thin" not in capsys.readouterr().out


def test_an_unstable_loop_is_not_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "controller.json"

    # A coil of 28 ms cannot be taken for one that follows at once, which the PID gains do.
    code = board51.main(["design", "inteco", "--law", "pid", "--u-max", "12", "--out", str(out)])

    assert code == 1
    assert "UNSTABLE" in capsys.readouterr().out
    assert not out.exists()


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["nowhere.json"], "cannot be read"),
        (["ce152", "--operating-point", "0.0057"], "not between the stops"),
        (["ce152", "--operating-point=-1mm"], "not between the stops"),
        (["ce152", "--operating-point", "1e-4", "--u-max", "2"], "no equilibrium"),
        (["ce152", "--Q", "1", "1", "1", "0"], "weight of the integral"),
        (["ce152", "--R", "-1"], "weight of u_c"),
        (["ce152", "--settling-time", "0"], "settling time"),
        (["ce152", "--sample-time", "0.1"], "--sample-time"),
        (["ce152", "--x-lsb", "0"], "x_lsb_m"),
        (["ce152", "--law", "pid", "--observer"], "--observer"),
        (["ce152", "--send", "rig1", "--observer"], "cannot run an observer"),
        (["ce152", "--send", "rig1", "--connect", "7447"], "not a zenoh endpoint"),
        (["ce152", "--send", "Rig 1"], "is not a name"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(words: list[str], text: str, capsys: pytest.CaptureFixture[str]) -> None:
    code = board51.main(["design", *words])

    err = capsys.readouterr().err
    assert code == 2
    assert text in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("name", ["K_A", "K_c"])
def test_a_placeholder_is_not_designed_for(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = json.loads((Path(board51.__file__).parent / "twin/model/ce152.json").read_text())
    model["parameters"][name] |= {"verdict": "not-identifiable", "method": "placeholder, no recording shows it"}
    (tmp_path / "m.json").write_text(json.dumps(model))

    code = board51.main(["design", str(tmp_path / "m.json")])

    error = capsys.readouterr().err
    assert code == 2
    assert f"{name} = " in error
    assert "not identifiable" in error
    assert error.count("\n") == 1


def test_what_is_not_known_for_sure_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = json.loads((Path(board51.__file__).parent / "twin/model/ce152.json").read_text())
    model["parameters"]["b"] |= {"verdict": "not-identifiable", "method": "placeholder"}
    model["provenance"] = {"recordings": [{"name": "flight", "input_delay": 1}]}
    (tmp_path / "m.json").write_text(json.dumps(model))

    code = board51.main(["design", str(tmp_path / "m.json")])

    output = capsys.readouterr().out
    assert code == 0
    assert "b = 0.02 N s/m is not-identifiable" in output
    assert "1 sample(s) late" in output
