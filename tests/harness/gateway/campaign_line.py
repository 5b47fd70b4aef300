"""An emulated rig behind a running gateway, and `board51 campaign run` on it: in this process, or in one of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

import board51
from gateway.bus import plant_cards
from gateway.emulator.firmware_model.board import Firmware
from gateway.emulator.line import Board
from gateway.emulator.serve import Emulator
from gateway.link import keepalive
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.gateway_peers import Bus, client, gateway_config, running, wait_for

ROOT = Path(__file__).parents[3]
PLANT = '[plant]\nname = "ce152"\nmass_kg = 8.28e-3\ntravel_m = 5.7e-3\nx_max_m = 8.138e-3\n'


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """The rig, its gateway's endpoint, and a client of the bus beside the campaign."""

    emulator: Emulator
    endpoint: str
    bus: Bus
    plant: Path
    started: list[subprocess.Popen[str]] = field(default_factory=list)

    def run(self, folder: Path, *more: str) -> int:
        """Run a campaign in this process, and return its exit code."""
        return board51.main(words(self.endpoint, folder, "--plant", str(self.plant), *more))

    def start(self, folder: Path, *more: str) -> subprocess.Popen[str]:
        """Start a campaign in a process of its own, which ends with the line at the latest."""
        self.started.append(start(self.endpoint, folder, "--plant", str(self.plant), *more))
        return self.started[-1]

    def assert_parked(self, x_ref_m: float = 2.85e-3) -> None:
        """Coil off, ball down, and the reference where it was before."""

        def parked() -> bool:
            state: pb.State = self.bus.states()[-1]
            in_position = abs(state.x_ref_m - x_ref_m) < 2e-6 and state.x_m < 0.2e-3
            return bool(state.mode == pb.MODE_IDLE and state.u_c_v == 0.0 and in_position)

        wait_for(parked, "parked ball")


def words(endpoint: str, folder: Path, *more: str) -> list[str]:
    return ["campaign", "run", str(folder), "--board", "rig", "--connect", endpoint, *more]


def start(endpoint: str, folder: Path, *more: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "board51", *words(endpoint, folder, *more)],
        env={**os.environ, "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@contextmanager
def emulated_line(
    tmp_path: Path,
    *,
    speed: float = 3.0,
    effects: Mapping[str, float] | None = None,
    faults: tuple[str, ...] = (),
    firmware: Callable[..., Board] = Firmware,
    rig: str = "ce152",
    known: str = PLANT,
    seed: int = 5,
    **board: Any,
) -> Iterator[Line]:
    plant = tmp_path / "plant.toml"
    plant.write_text(known)
    with (
        pytest.MonkeyPatch.context() as patch,
        Emulator(
            tcp=False, speed=speed, effects=effects or {}, faults=faults, seed=seed, firmware=firmware, rig=rig
        ) as emulator,
    ):
        # Each campaign waits for these two.  Within 5 s a rig three times as fast sends 7500 samples.
        patch.setattr(keepalive, "PARAMETERS_S", 0.5)
        patch.setattr(plant_cards, "EVERY_S", 0.5)
        # The board's second is a third of ours: a busy machine must not look like a lost host.
        config = gateway_config(emulator.urls[0], **{"host_loss_timeout_s": 6.0, "stale_s": 1.0, **board})
        with running(config), client(config.zenoh.listen[0]) as bus:
            wait_for(bus.states, "first sample")
            line = Line(emulator=emulator, endpoint=config.zenoh.listen[0], bus=bus, plant=plant)
            try:
                yield line
            finally:
                for process in line.started:
                    process.kill()
                    process.communicate()


def summary(captured: pytest.CaptureFixture[str]) -> dict[str, Any]:
    """Return the table that `--json` printed."""
    table: dict[str, Any] = json.loads(captured.readouterr().out)
    return table


def standings(table: Mapping[str, Any]) -> dict[str, str]:
    return {row["name"]: row["standing"] for row in table["experiments"]}
