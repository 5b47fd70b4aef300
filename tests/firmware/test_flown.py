"""The firmware at the end of a real line, in C and as an image in its chip's simulator: gateway, bus and log know no
difference."""

from __future__ import annotations

import itertools
import json
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest

import board51
from firmware.sim.avr.board import AvrBoard
from firmware.sim.mcs51.board import Mcs51Board
from gateway.emulator.line import Board
from gateway.emulator.native.board import NativeFirmware
from gateway.emulator.plant.constants import CE152
from gateway.emulator.serve import Emulator
from protocol.bus import board51_pb2 as pb
from protocol.log.reader import read
from tests.harness.firmware.avr_bench import skip_without_avr
from tests.harness.firmware.mcs51_bench import skip_without_sdcc
from tests.harness.gateway.board_host import skip_without_compiler
from tests.harness.gateway.campaign_line import emulated_line, standings, summary
from tests.harness.gateway.gateway_peers import Bus, gateway_and_client, gateway_config, wait_for
from tests.patience import HANG_S
from twin.model.parameters import Model


@dataclass(frozen=True, kw_only=True)
class Target:
    """A firmware, and what its memory and its start differ in."""

    make: Callable[..., Board]
    skip: Callable[[], None]
    words: tuple[str, ...]  # of the command line
    samples: int  # of a capture
    sample_s: float
    start_ticks: int = 0  # without a frame
    within_m: float = 5e-5


TARGETS = {
    "c": Target(
        make=NativeFirmware, skip=skip_without_compiler, words=("--firmware", "c"), samples=2000, sample_s=40e-6
    ),
    # A count of 10 bits is 6 um, and the ball follows what it reads.
    "avr": Target(
        make=AvrBoard, skip=skip_without_avr, words=("--chip", "avr"), samples=200, sample_s=200e-6, start_ticks=4,
        within_m=6e-5,
    ),
    "8051": Target(
        make=Mcs51Board, skip=skip_without_sdcc, words=("--chip", "8051"), samples=240, sample_s=80e-6, start_ticks=10
    ),
}  # fmt: skip


@pytest.fixture(params=TARGETS)
def target(request: pytest.FixtureRequest) -> Target:
    selected = TARGETS[request.param]
    selected.skip()
    return selected


def test_it_lifts_the_ball_through_the_gateway_and_loses_nothing(target: Target, tmp_path: Path) -> None:
    pre = round(4e-3 / target.sample_s)
    with (
        Emulator(tcp=False, firmware=target.make) as emulator,
        gateway_and_client(gateway_config(*emulator.urls, log=tmp_path)) as bus,
    ):
        assert bus.command("m", set_mode=pb.SetMode(mode=pb.MODE_CLOSED_LOOP)).accepted
        for x_m in (3e-3, 2.2e-3):
            assert bus.command(f"r{x_m}", set_reference=pb.SetReference(x_ref_m=x_m)).accepted
            wait_for(partial(flies_at, bus, x_m, target.within_m), f"the ball at {x_m} m")
        far = bus.command("f", set_reference=pb.SetReference(x_ref_m=9e-3))
        stop = bus.command("s", stop=pb.Stop())
        wait_for(lambda: bus.states()[-1].mode == pb.MODE_IDLE, "idle")
        capture = pb.Capture(u_from_v=0.0, u_to_v=2.0, duration_s=target.samples * target.sample_s, pre_s=4e-3)
        assert bus.command("c", capture=capture).accepted
        (record,) = wait_for(lambda: bus.messages["rig/capture"], "capture")
        status_count = len(bus.messages["rig/status"])
        wait_for(lambda: len(bus.messages["rig/status"]) > status_count, "a status after all that")
        status = bus.messages["rig/status"][-1]

    assert (far.accepted, far.reason) == (False, "out-of-range")
    assert stop.accepted
    assert (len(record.i_c_a), record.step_index) == (target.samples, pre)
    assert max(record.i_c_a[:pre]) < 0.02
    assert record.i_c_a[-1] > 0.3
    # On a busy machine an answer may come after it was asked for again: one of the two is then a stray.
    damaged = bus.bad_frames_while_streaming().keys() - {"stray-answer"}
    assert (status.samples_lost, status.board_bad_frames, damaged) == (0, 0, set())
    (log,) = tmp_path.glob("*.mcap")
    logged = [message for r in read(log, topics=["state"]) if isinstance(message := r.message, pb.State)]
    assert len(logged) > 100
    assert all(b.tick == a.tick + 1 for a, b in itertools.pairwise(logged))


def flies_at(bus: Bus, x_m: float, within_m: float) -> bool:
    states = bus.states()[-20:]
    return len(states) == 20 and all(abs(state.x_m - x_m) < within_m for state in states)


def test_the_gateway_comes_back_after_its_watchdog(target: Target) -> None:
    with Emulator(firmware=target.make) as emulator, gateway_and_client(gateway_config(*emulator.urls)) as bus:
        bus.await_states(50)
        emulator.inject("watchdog")

        bus.await_event("reset-watchdog")
        wait_for(lambda: len({s.session for s in bus.states()}) == 2, "the second session")


def emulate(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "board51", "emulate", *words]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=HANG_S)


@pytest.mark.slow
def test_the_command_flies_several_boards_of_it(target: Target) -> None:
    process = emulate(*target.words, "--boards", "2", "--duration", "0.4", "--json")

    counts = [json.loads(line)["counts"] for line in process.stdout.splitlines() if "counts" in line]
    # A frame of 15 bytes in each tick but those of the start, and the event of the reset: no host has been there for
    # 0.4 s, less than the time-out.
    assert len(counts) == 2
    assert all(14 + 15 * (200 - target.start_ticks) <= count["bytes_sent"] <= 14 + 15 * 200 for count in counts)


@pytest.mark.parametrize(
    ("chip", "baud", "says"),
    [
        ("avr", "1000000000", ""),
        ("avr", "230400", "within 2.5 %"),  # 222222 or 250000 are what 16 MHz gives
        ("8051", "1000000", "does not give 1000000 baud"),
    ],
)
def test_a_baud_rate_that_the_clock_does_not_give_is_refused(
    chip: str, baud: str, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    TARGETS[chip].skip()

    code, errors = board51.main(["emulate", "--chip", chip, "--baud", baud]), capsys.readouterr().err

    assert code == 2
    assert says in errors
    assert errors.count("\n") == 1


@pytest.mark.slow
def test_its_campaign_says_that_the_loop_computes_before_it_acts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The 8051's: 0.26 ms, and 20 us in its captures, which are 19.2 ms long; others hold the 40 ms of the menu."""
    skip_without_sdcc()
    with emulated_line(tmp_path, speed=1.0, firmware=Mcs51Board) as line:
        code = line.run(tmp_path / "c", "--quick", "--json")
        *_, parameters = line.bus.messages["rig/parameters"]
    assert code == 0
    assert standings(summary(capsys))["amplifier-steps"] == "recorded"
    captures = [r.message for r in read(tmp_path / "c" / "amplifier-steps.mcap", topics=["capture"])]
    board51.main(["diagnose", str(with_true_plane(tmp_path / "c")), "--quick", "--out", str(tmp_path / "d"), "--quiet"])
    diagnosis = json.loads((tmp_path / "d" / "diagnosis.json").read_text(encoding="utf-8"))

    assert parameters.capture_s == pytest.approx(240 * 80e-6)
    assert {
        (len(capture.i_c_a), capture.step_index) for capture in captures if isinstance(capture, pb.CaptureRecord)
    } == {(240, 50)}
    (cause,) = diagnosis["causes"]
    assert {cause["name"], *cause["indistinguishable_from"]} == {"actuation-delay", "sampling-delay"}
    assert cause["parameters"]["delay_s"]["value"] == pytest.approx(0.26e-3, abs=0.04e-3)
    assert cause["parameters"]["in_captures"]["value"] < 0.15
    model = Model.load(tmp_path / "d" / "extended_model.json")
    assert model.parameters["T_A"].value == pytest.approx(CE152.amplifier_time_constant_s, rel=0.02)
    assert model.parameters["b"].value == pytest.approx(CE152.drag_n_s_m, rel=0.15)


def with_true_plane(campaign: Path) -> Path:
    """The campaign with the true plane of the coil, which its plant has as published."""
    file = campaign / "campaign.toml"
    plane = CE152.travel_m + CE152.coil_plane_above_stop_m
    text = re.sub(r"(?m)^x_max_m = .*$", f"x_max_m = {plane}", file.read_text(encoding="utf-8"))
    assert str(plane) in text
    file.write_text(text, encoding="utf-8")
    return campaign
