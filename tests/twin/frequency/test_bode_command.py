"""`board51 bode` as a user runs it: a page that needs nothing else, JSON, exit codes, one line for bad input."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

import board51
from gateway.views.hmi.html.bode import bode_card
from tests.harness.twin.linear_loops import LAW, TICK_S, Loop, multisine
from tests.harness.twin.true_model import true_model
from twin.model.equilibrium import equilibrium

X = 2.85e-3


def folder(path: Path, rig: Loop, *, law: bool = True, seed: int = 2) -> Path:
    """A campaign of one flight with two multisines, and the right model of `Loop()` beside it."""
    model = true_model()
    i, u = equilibrium(model, X)
    r = np.concatenate(
        [np.zeros(500), multisine(5000, period=500, amplitude=2e-4), multisine(5000, period=125, amplitude=1e-4)]
    )
    flown = rig.fly(r, flights=1, seed=seed)[0] + np.array([[X], [u], [i], [X]])
    table = np.column_stack((np.arange(len(r)) * TICK_S, flown[1], flown[2], flown[3], flown[0]))
    np.savetxt(path / "run.csv", table, delimiter=",", header="t,u_c,i_c,x,x_ref", comments="", fmt="%.12g")
    p = model.plant
    plant = f'[plant]\nname = "<b>"\nmass_kg = {p.mass_kg}\ntravel_m = {p.travel_m}\nx_max_m = {p.x_max_m}\n'
    point = f"{{ i_c_a = {i}, x_m = {X}, u_c_v = {u} }}"
    gains = [LAW.k_i, LAW.k_x, LAW.k_v, -LAW.k_s]
    controller = f'[controller]\nkind = "lqi"\ngains = {gains}\noperating_point = {point}\n' * law
    recording = '[[recording]]\nfile = "run.csv"\nkind = "closed-loop"\nuse = "judge"\n'
    (path / "campaign.toml").write_text(plant + controller + recording)
    model.save(path / "model.json")
    return path


def run(path: Path, *words: str) -> int:
    return board51.main(["bode", str(path / "model.json"), str(path), *words])


@pytest.mark.slow
def test_a_right_model_gives_a_page_with_the_answer_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(folder(tmp_path, Loop()), "--out", str(tmp_path / "report")) == 0

    answer = capsys.readouterr().out.splitlines()[0]
    page = (tmp_path / "report" / "bode.html").read_text()
    assert answer.startswith("The model explains the loop at 1 to ")
    assert page.index(answer.split(":")[0]) < page.index("<img")
    assert page.count("data:image/svg+xml;base64,") == 3  # responses, S and T, residuals
    assert not re.findall(r'(?:src|href)="(?!data:)', page)
    assert "&lt;b&gt;" in page
    numbers = json.loads((tmp_path / "report" / "bode.json").read_text())
    (height,) = numbers["heights"]
    card = bode_card(numbers)
    assert card is not None
    assert len(card["heights"][0][1]) == 4, "the control room draws gain and phase of plant and loop"
    assert set(height["measured"]) == {"amplifier", "ball", "plant", "loop", "S", "T"}
    for name in ("phase_deg", "modulus"):
        measured, model = height["margins"][name], height["model_margins"][name]
        assert model["low"] <= model["value"] <= model["high"]
        assert measured["value"] is None or abs(measured["value"] / model["value"] - 1.0) < 0.3


def test_a_hidden_lag_is_exit_code_1_and_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(folder(tmp_path, Loop(lag_s=3e-3)), "--json") == 1

    numbers = json.loads(capsys.readouterr().out)
    assert numbers["explains"] is False
    assert "phase of the plant (u_c to x) lags" in numbers["answer"]


def test_without_a_law_there_is_no_loop_gain_and_the_notes_say_why(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(folder(tmp_path, Loop(), law=False), "--json") == 0

    captured = capsys.readouterr()
    (height,) = json.loads(captured.out)["heights"]
    assert set(height["measured"]) == {"amplifier", "ball", "plant"}
    assert "no loop gain, because the campaign has no [controller]" in captured.err


def test_another_rig_and_a_campaign_without_excitation(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = folder(tmp_path, Loop())
    assert board51.main(["bode", "ce152", str(path)]) == 2
    assert "describe different rigs" in capsys.readouterr().err

    table = (path / "run.csv").read_text().splitlines()
    (path / "run.csv").write_text("\n".join(table[:501]) + "\n")  # the hover before the first multisine
    assert run(path) == 1
    assert "No recording in closed loop has an excitation" in capsys.readouterr().out
