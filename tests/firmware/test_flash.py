"""`board51 flash`: what it gives avrdude, which here is a program on PATH that writes down what it was called with."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

import board51
from firmware.sim.avr.board import AvrBoard
from firmware.sim.avr.build import hex_of
from gateway.commands import flashed
from gateway.emulator.firmware_model.board import Firmware
from gateway.emulator.firmware_model.magnetoshield import magnetoshield
from gateway.emulator.serve import Emulator
from protocol.errors import ServiceError
from tests.harness.firmware.avr_bench import skip_without_avr

PROFILE = magnetoshield()


@pytest.fixture
def port() -> Iterator[str]:
    """A serial device with nobody behind it."""
    master, slave = os.openpty()
    yield os.ttyname(slave)
    os.close(master)
    os.close(slave)


@pytest.fixture(autouse=True)
def _no_patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody answers at most of these ports."""
    monkeypatch.setattr(flashed, "ANSWER_S", 0.1)


class Flash:
    """`board51 flash` with an avrdude that keeps its arguments and the image, and ends with `code`."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
        self.folder, self._capsys = folder, capsys
        self.install()
        monkeypatch.setenv("PATH", f"{folder}:{os.environ['PATH']}")

    def install(self, *, code: int = 0, message: str = "") -> None:
        program = self.folder / "avrdude"
        program.write_text(
            f'#!/bin/sh\necho "$@" > {self.folder}/called\nfor word; do :; done\nimage="${{word#flash:w:}}"\n'
            f'cp "${{image%:i}}" {self.folder}/image.hex\necho "{message}" >&2\nexit {code}\n'
        )
        program.chmod(0o755)

    @property
    def called(self) -> list[str] | None:
        """The arguments that avrdude was called with."""
        call_file = self.folder / "called"
        return call_file.read_text().split() if call_file.exists() else None

    def __call__(self, *words: str) -> tuple[int, str, str]:
        """Exit code, stdout, stderr."""
        code = board51.main(["flash", "--board", "magnetoshield", *words])
        captured = self._capsys.readouterr()
        return code, captured.out, captured.err


@pytest.fixture
def flash(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Flash:
    return Flash(tmp_path, monkeypatch, capsys)


def test_it_gives_avrdude_the_image_of_the_profile_and_the_port(flash: Flash, port: str) -> None:
    skip_without_avr()

    code, out, err = flash("--port", port)

    assert (code, err) == (0, "")
    assert "whether the coil is off is not known" in out
    words = flash.called
    assert words is not None
    assert words[:11] == ["-q", "-p", "atmega328p", "-c", "arduino", "-b", "115200", "-P", port, "-D", "-U"]
    expected = flash.folder / "expected.hex"
    hex_of(expected, profile=PROFILE.program)
    assert (flash.folder / "image.hex").read_bytes() == expected.read_bytes()


def test_the_board_that_was_written_says_whether_its_coil_is_off(flash: Flash, monkeypatch: pytest.MonkeyPatch) -> None:
    skip_without_avr()
    monkeypatch.setattr(flashed, "ANSWER_S", 20.0)
    with Emulator(tcp=False, rig="magnetoshield", firmware=AvrBoard) as emulator:
        code, out, err = flash("--port", emulator.urls[0])

    assert (code, err) == (0, "")
    assert "answers: u_c 0.00 V, i_c 0.0 mA, the coil is off" in out


def test_a_board_that_is_silent_while_it_starts_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flashed, "ANSWER_S", 20.0)
    with Emulator(tcp=False) as emulator:
        emulator.inject("stall=0.7:tx")  # longer than the time between two calls

        answer = flashed.query_board(emulator.urls[0], 115200, b"emulated")

    assert answer.startswith("written and verified; build emulated answers")


@pytest.mark.parametrize(
    ("make", "effects", "expected"),
    [(AvrBoard, {"current-sensor-offset": 0.01}, "THE COIL MAY BE ON"), (Firmware, {}, "says build magneto, not")],
)
def test_a_board_that_answers_something_else_is_an_error(
    make: type[AvrBoard] | type[Firmware],
    effects: dict[str, float],
    expected: str,
    flash: Flash,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    skip_without_avr()
    monkeypatch.setattr(flashed, "ANSWER_S", 20.0)
    with Emulator(tcp=False, rig="magnetoshield", firmware=make, effects=effects) as emulator:
        code, out, err = flash("--port", emulator.urls[0])

    assert code == ServiceError.exit_code
    assert expected in err
    assert "the coil is off" not in out + err


def test_what_avrdude_says_is_passed_on(flash: Flash, port: str) -> None:
    skip_without_avr()
    flash.install(code=1, message="avrdude: stk500_recv(): not in sync: resp=0x00")

    code, _, err = flash("--port", port)

    assert code == ServiceError.exit_code
    assert "not in sync" in err
    assert err.count("\n") == 1


def test_a_dry_run_touches_no_port_and_prints_the_command(flash: Flash) -> None:
    skip_without_avr()

    code, out, _ = flash("--port", "/dev/ttyNobody", "--dry-run", "--json")

    report = json.loads(out)
    assert (code, report["command"][9], report["command"][0]) == (0, "/dev/ttyNobody", "avrdude")
    assert 10_000 < report["bytes"] < report["of"]
    assert flash.called is None
    image = Path(report["command"][-1].removeprefix("flash:w:").removesuffix(":i"))
    assert image.read_text().startswith(":1000")  # so the command can be given by hand


def test_the_image_can_be_had_for_another_programmer(flash: Flash) -> None:
    skip_without_avr()

    code, _, err = flash("--out", str(flash.folder / "firmware.hex"))

    assert (code, err) == (0, "")
    lines = (flash.folder / "firmware.hex").read_text().splitlines()
    assert lines[0].startswith(":10000000")
    assert lines[-1] == ":00000001FF"


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ([], "No port is given"),
        (["--port", "/dev/ttyNobody"], "There is no /dev/ttyNobody"),
        (["--port", "/dev/null"], "/dev/null"),
        (["--port", "socket://10.0.0.5:4001"], "not a device of this computer"),
        (["--dry-run", "--baud", "230400"], "within 2.5 %"),
        (["--dry-run", "--baud", "7"], "out of range"),
    ],
)
def test_what_cannot_be_done_is_said_in_a_line(words: list[str], expected: str, flash: Flash) -> None:
    skip_without_avr()

    code, _, err = flash(*words)

    assert code == 2
    assert expected in err
    assert err.count("\n") == 1
    assert flash.called is None


def test_without_compiler_or_avrdude_it_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, flash: Flash, port: str
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path / "nothing"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))

    without_avrdude = flash("--port", port)
    without_compiler = flash("--dry-run")

    assert (without_avrdude[0], without_compiler[0]) == (2, 2)
    assert "apt-get install avrdude" in without_avrdude[2]
    assert "gcc-avr" in without_compiler[2]
