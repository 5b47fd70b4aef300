"""`board51 selftest` as it is typed: lines, JSON, report, exit codes; and the coil is off whatever ends it."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import board51
from gateway.commands import selftest as command
from gateway.emulator.firmware_model.board import Firmware
from gateway.emulator.line import BoardLine
from gateway.emulator.serve import Emulator
from gateway.selftest.report import Report, write_report
from gateway.selftest.table import CHECKS
from gateway.selftest.verdict import Result, Verdict, fault, judge, line, quantity, skipped
from protocol.wire.messages import Mode
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.gateway.selftest_bench import virtual_bench
from tests.patience import HANG_S

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def emulator() -> Iterator[Emulator]:
    with Emulator(speed=4.0) as emulator:  # its clock is four times too fast: without the check of the link
        yield emulator


def _url(emulator: Emulator) -> str:
    return emulator.urls[0].replace("socket://", "tcp://")


def test_it_prints_a_line_each_and_writes_its_report(
    emulator: Emulator, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--only", "identity", "--only", "converters", "--quick", "--log-dir", str(tmp_path / "logs")]

    code = board51.main(["selftest", "--board", _url(emulator), *words])

    out = capsys.readouterr().out
    assert code == 0
    assert "ok       identity" in out
    assert "No fault: " in out
    (content,) = [json.loads(path.read_text()) for path in (tmp_path / "logs").glob("selftest-*.json")]
    (page,) = [path.read_text() for path in (tmp_path / "logs").glob("selftest-*.html")]
    assert content["answer"] in out
    assert content["answer"] in page
    assert {verdict["check"] for verdict in content["verdicts"]} == {"identity", "converters", "end"}


def test_faults_are_exit_code_1_and_each_line_of_json_is_one_object(
    emulator: Emulator, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--rig", "magnetoshield", "--only", "identity", "--json", "--log-dir", str(tmp_path)]

    code = board51.main(["selftest", "--board", _url(emulator), *words])

    *verdicts, end = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert code == 1
    assert "scalings" in [verdict["name"] for verdict in verdicts if verdict["result"] == "FAULT"]
    assert end["faults"] >= 1
    assert all(Path(path).exists() for path in end["report"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "No board is given"),
        (["--board", "/dev/absent", "--yes"], "There is no /dev/absent"),
        (["--board", "tcp://127.0.0.1:1", "--yes"], "is the serial server running"),
        (["--board", "/dev/null"], "Current will flow, and there is no terminal to ask"),
        (["--board", "/dev/null", "--only", "link", "--skip", "link"], "No check is left"),
        (["--board", "/dev/null", "--only", "link", "--calibrate"], "Add --only calibration"),
    ],
)
def test_what_cannot_run_is_exit_code_2(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    code = board51.main(["selftest", *words])

    assert code == 2
    assert message in capsys.readouterr().err


class _Person:
    def __init__(self, answer: str) -> None:
        self._answer = answer

    def isatty(self) -> bool:
        return True

    def readline(self) -> str:
        return self._answer


@pytest.mark.parametrize(
    ("answer", "message"), [("n\n", "Not confirmed"), ("", "Not confirmed"), ("y\n", "/dev/absent")]
)
def test_it_asks_before_current_flows(
    answer: str, message: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stdin", _Person(answer))

    code = board51.main(["selftest", "--board", "/dev/absent"])

    assert code == 2
    err = capsys.readouterr().err
    assert "within reach? [y/N]" in err
    assert message in err


def test_the_list_has_each_check(capsys: pytest.CaptureFixture[str]) -> None:
    assert board51.main(["selftest", "--list"]) == 0

    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == [check.name for check in CHECKS]


@pytest.mark.parametrize("check", [check.name for check in CHECKS if check.current])
@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_the_coil_is_off_whatever_ends_it(check: str, error: type[BaseException]) -> None:
    boards: list[Firmware] = []

    def break_off(board: BoardLine) -> None:
        assert isinstance(board.firmware, Firmware)
        if board.firmware.u and not boards:
            boards.append(board.firmware)
            raise error

    verdicts: list[Verdict] = []
    bench = virtual_bench(each_tick=break_off)

    with pytest.raises(error):
        command.run_to_the_end(bench, [row for row in CHECKS if row.name == check], verdicts.append)

    assert boards[0].u == 0
    assert verdicts[-1].name == "coil-off"
    assert verdicts[-1].result == Result.OK


@pytest.mark.slow
@pytest.mark.posix
def test_ctrl_c_is_a_stop(tmp_path: Path) -> None:
    with Emulator() as emulator:
        words = ["selftest", "--board", emulator.urls[0], "--only", "staircase", "--yes", "--log-dir", str(tmp_path)]
        process = subprocess.Popen([sys.executable, "-m", "board51", *words], cwd=ROOT, stdout=subprocess.PIPE)
        board = emulator._server.lines[0].firmware
        wait_for(lambda: board.mode == Mode.OPEN_LOOP, "open loop")
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=HANG_S)

        assert process.returncode == 130
        assert b"the coil at the end: off" in out
        assert board.mode == Mode.IDLE


def test_a_line_says_verdict_value_bound_and_what_to_do() -> None:
    verdict = judge("k", "K_A", 0.2, "A/V", good=(0.28, 0.31), possible=(0.1, 0.4), remedy="look at the shunt")

    assert line(verdict) == "warning               K_A 0.2 A/V (0.28 to 0.31 A/V): look at the shunt"
    assert line(skipped("w", "watchdog", "no")) == "skipped               watchdog: no"
    assert judge("k", "n", float("nan"), "", good=(0, 1), possible=(-9, 9)).result == Result.FAULT


@pytest.mark.parametrize(
    ("value", "text"), [(0.0, "0 V"), (-1e-9, "0 V"), (12345.6, "12346 V"), (0.012345, "0.0123 V"), (-5.678, "-5.68 V")]
)
def test_a_quantity_is_readable(value: float, text: str) -> None:
    assert quantity(value, "V") == text


def test_the_answer_leads_with_the_cause_and_with_what_is_unsafe(tmp_path: Path) -> None:
    verdicts = [
        fault("no-current", "K_A", "0 A/V", remedy="look at the coil"),
        fault("current-sensor", "i_c", "0 A", remedy="<plug> it in"),
        fault("coil-off", "the coil", "on", remedy="CUT THE SUPPLY OF THE COIL"),
    ]
    report = Report(verdicts=verdicts[:2], rig="CE 152", port="/dev/x", started_s=0.0, duration_s=1.0)
    unsafe = Report(verdicts=verdicts, rig="CE 152", port="/dev/x", started_s=0.0, duration_s=1.0)

    assert report.answer == "2 faults; repair first (): i_c 0 A. <plug> it in."
    assert unsafe.answer.endswith("CUT THE SUPPLY OF THE COIL.")
    page = next(path for path in write_report(report, tmp_path) if path.suffix == ".html").read_text()
    assert "&lt;plug&gt; it in" in page
