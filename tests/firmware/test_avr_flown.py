"""The image of the ATmega328P in its simulator, at the end of a real line: gateway, bus and log know no difference."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
from pathlib import Path

import pytest

from firmware.sim.avr.board import AvrBoard
from gateway.emulator.serve import Emulator
from protocol.bus import board51_pb2 as pb
from protocol.log.reader import read
from tests.harness.firmware.avr_bench import skip_without_avr
from tests.harness.gateway.gateway_peers import gateway_and_client, gateway_config, wait_for
from tests.patience import HANG_S


@pytest.fixture(autouse=True)
def _installed() -> None:
    skip_without_avr()


def test_it_lifts_the_ball_through_the_gateway_and_loses_nothing(tmp_path: Path) -> None:
    with (
        Emulator(tcp=False, firmware=AvrBoard) as emulator,
        gateway_and_client(gateway_config(*emulator.urls, log=tmp_path)) as bus,
    ):
        assert bus.command("m", set_mode=pb.SetMode(mode=pb.MODE_CLOSED_LOOP)).accepted
        assert bus.command("r", set_reference=pb.SetReference(x_ref_m=3e-3)).accepted
        wait_for(lambda: flies_at(bus.states()[-20:], 3e-3), "the ball at 3 mm")
        assert bus.command("r2", set_reference=pb.SetReference(x_ref_m=2.2e-3)).accepted
        wait_for(lambda: flies_at(bus.states()[-20:], 2.2e-3), "the ball at 2.2 mm")
        far = bus.command("f", set_reference=pb.SetReference(x_ref_m=9e-3))
        stop = bus.command("s", stop=pb.Stop())
        wait_for(lambda: bus.states()[-1].mode == pb.MODE_IDLE, "idle")
        capture = pb.Capture(u_from_v=0.0, u_to_v=2.0, duration_s=200 * 200e-6, pre_s=4e-3)
        assert bus.command("c", capture=capture).accepted
        (record,) = wait_for(lambda: bus.messages["rig/capture"], "capture")
        seen = len(bus.messages["rig/status"])
        wait_for(lambda: len(bus.messages["rig/status"]) > seen, "a status after all that")
        status = bus.messages["rig/status"][-1]

    assert (far.accepted, far.reason) == (False, "out-of-range")
    assert stop.accepted
    assert (len(record.i_c_a), record.step_index) == (200, 20)
    assert max(record.i_c_a[:20]) < 0.02
    assert record.i_c_a[-1] > 0.3
    assert (status.samples_lost, status.board_bad_frames, bus.bad_frames_while_streaming()) == (0, 0, {})
    (log,) = tmp_path.glob("*.mcap")
    logged = [message for r in read(log, topics=["state"]) if isinstance(message := r.message, pb.State)]
    assert all(b.tick == a.tick + 1 for a, b in itertools.pairwise(logged))


def test_the_gateway_comes_back_after_its_watchdog() -> None:
    with Emulator(firmware=AvrBoard) as emulator, gateway_and_client(gateway_config(*emulator.urls)) as bus:
        bus.await_states(50)
        emulator.inject("watchdog")

        bus.await_event("reset-watchdog")
        wait_for(lambda: len({s.session for s in bus.states()}) == 2, "the second session")


def test_the_command_flies_several_boards_of_it() -> None:
    arguments = ["--chip", "avr", "--boards", "2", "--duration", "0.4", "--json"]
    command = [sys.executable, "-m", "board51", "emulate", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=HANG_S)

    counts = [json.loads(line)["counts"] for line in done.stdout.splitlines() if "counts" in line]
    # The event of the reset (14 bytes), and a frame of 15 in each tick but those of the start.
    assert len(counts) == 2
    assert all(14 + 15 * 196 <= count["bytes_sent"] <= 14 + 15 * 200 for count in counts)


def test_a_baud_rate_that_the_clock_does_not_give_is_refused() -> None:
    command = [sys.executable, "-m", "board51", "emulate", "--chip", "avr", "--baud", "1000000000"]
    out_of_range = subprocess.run(command, capture_output=True, text=True, check=False, timeout=HANG_S)
    command[-1] = "230400"  # 222222 or 250000 are what 16 MHz gives
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=HANG_S)

    assert out_of_range.returncode == done.returncode == 2
    assert "within 2.5 %" in done.stderr
    assert done.stderr.count("\n") == 1


def flies_at(states: list[pb.State], x_m: float) -> bool:
    """Within 60 um: a count of 10 bits is 6 um, and the ball follows what it reads."""
    return len(states) == 20 and all(abs(state.x_m - x_m) < 6e-5 for state in states)
