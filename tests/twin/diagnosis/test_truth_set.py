"""A drawn set tells nothing but its readings, stays as it was published, and can be answered from end to end."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from protocol.campaign import load
from protocol.errors import DataError, UsageError
from tests.bench.truth import run
from tests.harness.diagnose.draws import Hidden
from tests.harness.truth.draw import NAMES, OTHER, _truth, draw_set, load_truths, write_case

pytestmark = pytest.mark.xdist_group("truth-set")
ECHO = """
import csv, json, pathlib, sys
case, out = map(pathlib.Path, sys.argv[1:])
assert not list(case.parent.glob("*truth*"))
(out / "predictions.csv").write_text("recording,t_s,x_m\\n")
answer = {"verdict": "nothing", "probabilities": {"nothing": 1.0}, "place": "", "class": [], "seconds": 0.0}
(out / "answer.json").write_text(json.dumps(answer | {"predictions": "predictions.csv"}))
"""


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = tmp_path_factory.mktemp("set") / "set"
    draw_set(folder, seed=5, count=2, part="nulls", quick=True)
    return folder


def described(case: Path) -> dict[str, tuple[int, int, str]]:
    """Mode, time and first line of each file."""
    files = [case, *sorted(case.iterdir())]
    return {
        path.name if path != case else ".": (
            path.stat().st_mode,
            path.stat().st_mtime_ns,
            path.read_text(encoding="utf-8").splitlines()[0] if path.is_file() else "",
        )
        for path in files
    }


def test_two_cases_that_differ_in_the_effect_differ_in_the_readings_alone(tmp_path: Path) -> None:
    null = Hidden(part="nulls", seed=8675309, plant="independent")
    drag = replace(null, part="causes", effects={"quadratic-drag": 4.0}, grade="strong")

    for name, hidden in (("null", null), ("drag", drag)):
        write_case(tmp_path / name, hidden, quick=True)

    assert described(tmp_path / "null") == described(tmp_path / "drag")
    for file in ("campaign.toml", "names.csv"):
        assert (tmp_path / "null" / file).read_bytes() == (tmp_path / "drag" / file).read_bytes()
    texts = [path.read_text(encoding="utf-8") for path in (tmp_path / "drag").iterdir() if path.name != "names.csv"]
    assert not any(word in text for text in texts for word in ("drag", "8675309", "independent", "causes"))
    assert texts != [path.read_text(encoding="utf-8") for path in (tmp_path / "null").iterdir()]


def test_an_effect_that_is_not_on_the_list_has_the_answer_other(tmp_path: Path) -> None:
    hidden = Hidden(
        part="forms", seed=8675310, plant="textbook", effects={"current-sensor-lag": 2e-3}, form="current-filtered"
    )
    write_case(tmp_path, hidden, quick=True)

    truth = _truth(tmp_path, hidden)

    assert (truth.names, truth.places) == ((OTHER,), ("current",))


def test_the_units_are_in_the_headers_and_the_campaign_is_ours(drawn: Path) -> None:
    case = drawn / "case-01"

    assert (case / "closed_loop_5.csv").read_text(encoding="utf-8").splitlines()[0] == "t_s,u_c_V,i_c_A,x_m,x_ref_m"
    assert (case / "step_1.csv").read_text(encoding="utf-8").splitlines()[0] == "t_s,u_c_V,i_c_A"
    assert len(load(case).recordings) == 17
    assert (case / "names.csv").read_text(encoding="utf-8").count("\n") == 1 + len(NAMES)


def test_the_seed_gives_the_set(drawn: Path, tmp_path: Path) -> None:
    draw_set(tmp_path / "again", seed=5, count=2, part="nulls", quick=True)

    assert (tmp_path / "again" / "manifest.json").read_bytes() == (drawn / "manifest.json").read_bytes()
    assert {truth.names for truth in load_truths(drawn)} == {("nothing",)}


def test_a_changed_truth_is_noticed(drawn: Path, tmp_path: Path) -> None:
    for name in ("manifest.json", "truth.json"):
        (tmp_path / name).write_bytes((drawn / name).read_bytes())
    (tmp_path / "case-01").symlink_to(drawn / "case-01")
    (tmp_path / "case-02").symlink_to(drawn / "case-02")
    assert load_truths(tmp_path) == load_truths(drawn)

    sealed = json.loads((tmp_path / "truth.json").read_text(encoding="utf-8"))
    sealed["cases"][0]["names"] = ["quadratic-drag"]
    (tmp_path / "truth.json").write_text(json.dumps(sealed), encoding="utf-8")

    with pytest.raises(DataError, match=r"truth\.json is not the file of manifest"):
        load_truths(tmp_path)


def test_a_full_folder_a_file_and_an_unknown_part_are_refused(drawn: Path, tmp_path: Path) -> None:
    for used in (drawn, drawn / "truth.json"):
        with pytest.raises(UsageError, match="is not an empty folder"):
            draw_set(used, seed=1, count=1)
    with pytest.raises(UsageError, match="no part 'knock-out'"):
        draw_set(tmp_path, seed=1, count=1, part="knock-out")


@pytest.mark.sample
def test_a_set_is_answered_and_scored_from_end_to_end(drawn: Path, tmp_path: Path) -> None:
    program = tmp_path / "echo.py"
    program.write_text(ECHO, encoding="utf-8")
    pages: list[str] = []

    rows = run(out=drawn, entry=["base", "bic", f"echo=python3 {program}", "broken=false"], show=pages.append)

    lines = {line.split("|")[1].strip(): line for line in pages[0].splitlines() if line.startswith("| ")}
    assert [row["name"].split(":")[1].strip() for row in rows] == ["base", "bic", "echo", "broken"]
    assert "| 0 of 2 |" in lines["base"]  # no false alarm
    assert lines["echo"].startswith("| echo | 1.00 | -0.00 |") or lines["echo"].startswith("| echo | 1.00 | 0.00 |")
    assert "broken (2 unanswered)" in lines
    # An answer is kept, and not asked for again.
    program.unlink()
    assert run(out=drawn, entry=[f"echo=python3 {program}"])[0]["value"] == 0.0
    run(out=drawn, runs=1, entry=[f"echo=python3 {program}"], show=pages.append)
    assert "1 cases" in pages[1]  # the first one of the set
