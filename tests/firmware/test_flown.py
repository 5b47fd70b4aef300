"""The firmware in C at the end of a real line: gateway, bus and log know no difference."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
from pathlib import Path

import pytest

from gateway.emulator.native.board import NativeFirmware
from gateway.emulator.serve import Emulator
from protocol.bus import board51_pb2 as pb
from protocol.log.reader import read
from tests.harness.gateway.board_host import skip_without_compiler
from tests.harness.gateway.gateway_peers import gateway_and_client, gateway_config, wait_for
from tests.patience import HANG_S


@pytest.fixture(autouse=True)
def _compiled() -> None:
    skip_without_compiler()


def test_it_lifts_the_ball_through_the_gateway_and_loses_nothing(tmp_path: Path) -> None:
    with (
        Emulator(tcp=False, firmware=NativeFirmware) as emulator,
        gateway_and_client(gateway_config(*emulator.urls, log=tmp_path)) as bus,
    ):
        assert bus.command("m", set_mode=pb.SetMode(mode=pb.MODE_CLOSED_LOOP)).accepted
        assert bus.command("r", set_reference=pb.SetReference(x_ref_m=3e-3)).accepted
        wait_for(lambda: len(bus.states()) > 20 and all(near(s, 3e-3) for s in bus.states()[-20:]), "the ball at 3 mm")
        far = bus.command("f", set_reference=pb.SetReference(x_ref_m=9e-3))
        stop = bus.command("s", stop=pb.Stop())
        wait_for(lambda: bus.states()[-1].mode == pb.MODE_IDLE, "idle")
        capture = pb.Capture(u_from_v=0.0, u_to_v=2.0, duration_s=0.08, pre_s=0.004)
        assert bus.command("c", capture=capture).accepted
        (record,) = wait_for(lambda: bus.messages["rig/capture"], "capture")
        status = bus.messages["rig/status"][-1]

    assert (far.accepted, far.reason) == (False, "out-of-range")
    assert stop.accepted
    assert (len(record.i_c_a), record.step_index) == (2000, 100)
    assert max(record.i_c_a[:100]) < 0.02
    assert record.i_c_a[-1] > 0.3
    assert (status.samples_lost, status.board_bad_frames, bus.bad_frames_while_streaming()) == (0, 0, {})
    (log,) = tmp_path.glob("*.mcap")
    logged = [message for r in read(log, topics=["state"]) if isinstance(message := r.message, pb.State)]
    assert all(b.tick == a.tick + 1 for a, b in itertools.pairwise(logged))


def test_the_gateway_comes_back_after_its_watchdog() -> None:
    with Emulator(firmware=NativeFirmware) as emulator, gateway_and_client(gateway_config(*emulator.urls)) as bus:
        bus.await_states(50)
        emulator.inject("watchdog")

        bus.await_event("reset-watchdog")
        sessions = wait_for(
            lambda: {s.session for s in bus.states()} if len(states_after(bus.states())) else None, "2nd"
        )

    assert len(sessions) == 2


def test_the_command_flies_several_boards_of_it() -> None:
    command = [
        sys.executable,
        "-m",
        "board51",
        "emulate",
        "--firmware",
        "c",
        "--boards",
        "2",
        "--duration",
        "0.4",
        "--json",
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=HANG_S)

    counts = [json.loads(line)["counts"] for line in done.stdout.splitlines() if "counts" in line]
    # 200 ticks of 15 bytes, and the event of the reset: no host has been there for 0.4 s, less than the time-out.
    assert [count["bytes_sent"] for count in counts] == [200 * 15 + 14] * 2


def near(state: pb.State, x_m: float) -> bool:
    return abs(state.x_m - x_m) < 5e-5


def states_after(states: list[pb.State]) -> list[pb.State]:
    """The states of the last session, where there is more than one."""
    return [s for s in states if s.session == states[-1].session] if states[0].session != states[-1].session else []
