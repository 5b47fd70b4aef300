"""Diagnoses of many campaigns: the same answers as one by one, also where a worker is killed, and none twice."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import board51
from protocol.errors import ServiceError, UsageError
from twin.api.functions import diagnose
from twin.api.many import RECORD, Answer, _known, diagnose_all

REST = """
[plant]
name = "rig"
mass_kg = 8.28e-3
travel_m = 5.7e-3
[[recording]]
file = "rest.csv"
kind = "equilibria"
use = "fit"
"""


def at_rest(folder: Path, *, d_m: float) -> None:
    """Points of rest of a coil that is `d_m` higher than x_max: a diagnosis of a tenth of a second."""
    x = np.linspace(5e-4, 5e-3, 12)
    current = np.sqrt(8.28e-3 * 9.81 / 6e-6) * (5.7e-3 + d_m - x) * 1e-1
    rows = "".join(f"{a:.9g},{b:.9g}\n" for a, b in zip(x, current, strict=True))
    folder.mkdir(parents=True)
    (folder / "rest.csv").write_text(f"x,i_c\n{rows}", encoding="utf-8")
    (folder / "campaign.toml").write_text(REST, encoding="utf-8")


def content(folder: Path) -> dict[str, Any]:
    """A diagnosis without what depends on the machine."""
    written: dict[str, Any] = json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))
    written.pop("stages_s", None)
    return written


def workers() -> list[int]:
    """The processes that Dask has started for this one."""
    process_ids = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                parent = (entry / "stat").read_text().rpartition(")")[2].split()[1]
                words = (entry / "cmdline").read_bytes()
            except OSError:
                continue
            if int(parent) == os.getpid() and words.startswith(b"dask worker"):
                process_ids.append(int(entry.name))
    return process_ids


@pytest.mark.posix
@pytest.mark.slow
def test_a_killed_worker_loses_nothing_and_the_answers_are_those_of_one_by_one(tmp_path: Path) -> None:
    runs, out = tmp_path / "runs", tmp_path / "out"
    at_rest(runs / "a", d_m=0.0)
    at_rest(runs / "c" / "deep", d_m=1e-3)
    at_rest(runs / "b", d_m=2e-3)
    killed: list[int] = []

    def kill_once(line: str) -> None:
        """The only worker, as soon as the first answer is here: the other two are its tasks."""
        if not killed:
            assert not (out / "c" / "deep" / RECORD).exists(), "too late to kill"
            killed.extend(workers())
            for pid in killed:
                os.kill(pid, signal.SIGKILL)

    with socket.socket() as another:
        with suppress(OSError):  # a cluster of another test may have it
            another.bind(("127.0.0.1", 8787))
            another.listen()
        answers = diagnose_all(runs, out, processes=1, progress=kill_once, quick=True)

    assert killed
    assert [answer.campaign for answer in answers] == ["a", "b", "c/deep"]
    assert not [answer.error for answer in answers if answer.error]
    for answer in answers:
        diagnose(runs / answer.campaign, quick=True).save(tmp_path / "alone" / answer.campaign)
        assert content(out / answer.campaign) == content(tmp_path / "alone" / answer.campaign)


@pytest.mark.slow
def test_only_what_changed_is_computed_again_and_what_fails_costs_no_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs, out = tmp_path / "runs", tmp_path / "out"
    for name, d_m in (("a", 0.0), ("b", 1e-3)):
        at_rest(runs / name, d_m=d_m)
    at_rest(runs / "broken", d_m=0.0)
    (runs / "broken" / "rest.csv").unlink()
    words = ["diagnose", "--all", str(runs), "--out", str(out), "--quick", "--json"]

    assert board51.main(words) == 1
    first = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    written = {name: (out / name / RECORD).stat().st_mtime_ns for name in ("a", "b")}
    shutil.rmtree(runs / "broken")
    at_rest(runs / "broken", d_m=0.0)
    (runs / "b" / "rest.csv").write_text((runs / "a" / "rest.csv").read_text(encoding="utf-8"), encoding="utf-8")
    (out / "a" / "note.txt").write_text("mine", encoding="utf-8")
    board51.main(words)
    second = [json.loads(line) for line in capsys.readouterr().out.splitlines()]

    assert [(row["campaign"], row["verdict"] == "failed") for row in first] == [
        ("a", False), ("b", False), ("broken", True),
    ]  # fmt: skip
    assert "rest.csv" in first[2]["error"]
    assert not [row for row in second if row["error"]]
    assert (out / "a" / RECORD).stat().st_mtime_ns == written["a"]
    assert (out / "b" / RECORD).stat().st_mtime_ns != written["b"]


def test_a_record_of_another_question_or_without_its_answer_is_none(tmp_path: Path) -> None:
    answer = {"campaign": "a", "verdict": "model-adequate", "causes": [], "sentence": "", "error": ""}
    (tmp_path / RECORD).write_text(json.dumps({"key": "k", **answer}), encoding="utf-8")

    assert _known(tmp_path, "k") is None
    (tmp_path / "diagnosis.json").write_text("{}", encoding="utf-8")
    assert _known(tmp_path, "other") is None
    assert _known(tmp_path, "k") == Answer(campaign="a", verdict="model-adequate")


def test_a_folder_without_campaigns_and_a_scheduler_that_is_not_there_are_said(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"no campaign\.toml"):
        diagnose_all(tmp_path, tmp_path / "out")
    at_rest(tmp_path / "a", d_m=0.0)
    with pytest.raises(ServiceError, match="No Dask scheduler answers"):
        diagnose_all(tmp_path, tmp_path / "out", scheduler="nowhere")


@pytest.mark.parametrize("words", [["--live", "2"], ["--hand-over"], ["--figures", "png"], ["--processes", "0"]])
def test_options_that_do_not_fit_are_refused(words: list[str], tmp_path: Path) -> None:
    at_rest(tmp_path / "a", d_m=0.0)

    assert board51.main(["diagnose", str(tmp_path), "--all", "--out", str(tmp_path / "out"), *words]) == 2
