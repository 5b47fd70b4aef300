"""Twin: samples per second from a log, against real time and against one adaptive solver call per tick.

python tests/bench/twin.py
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

if __name__ == "__main__":  # run as a file: the packages lie two levels up
    sys.path.insert(0, str(Path(__file__).parents[2]))

from protocol.bus import board51_pb2 as pb
from tests.harness.twin.named_flight import AtOnce, NamedFlight
from tests.harness.twin.rig import T_S, Rig
from twin.live.naming.namer import Namer
from twin.mirror.mirror import Mirror
from twin.mirror.offline import run_log
from twin.model.parameters import Model
from twin.readers.log import TwinLog

SAMPLES = 60_000  # two minutes of a board
BASELINE_TICKS = 300
REPEATS = 5
NAMED_S = 40.0  # of flight


def run() -> list[dict[str, Any]]:
    """Rows of the benchmark table."""
    rig = Rig(seed=5)
    rig.hold(2.85e-3)
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        states = []
        with TwinLog(path) as log:
            log.write("board51/rig/parameters", rig.parameters(), message_type=pb.Parameters, log_time_ns=0)
            for state in rig.run(SAMPLES, lambda k: 2.85e-3 if (k // 500) % 2 else 3.2e-3):
                states.append(state)
                log.write("board51/rig/state", state, message_type=pb.State, log_time_ns=state.host_time_ns)
        baseline = _solver_ticks_per_s()

        run_log(path, Model.load("ce152"))  # compiles
        whole = max(_rate(lambda: run_log(path, Model.load("ce152")), SAMPLES) for _ in range(REPEATS))
        real_time = 1.0 / T_S
        rows.append(
            {
                "name": "twin over a log, reading it included",
                "value": round(whole),
                "unit": "samples/s",
                "baseline": real_time,
                "ratio": whole / real_time,
                "note": "baseline: real time at 500 Hz; target 100 x",
            }
        )
        rows.append(
            {
                "name": "twin over a log, against solve_ivp",
                "value": round(whole),
                "unit": "samples/s",
                "baseline": round(baseline),
                "ratio": whole / baseline,
                "note": "baseline: scipy solve_ivp (LSODA) per tick, the plant alone: no log, no observer, no windows",
            }
        )
        handle = max(_rate(lambda: _handle(rig, states), SAMPLES) for _ in range(REPEATS))
        rows.append(
            {
                "name": "Mirror.handle",
                "value": round(handle),
                "unit": "samples/s",
                "baseline": round(baseline),
                "ratio": handle / baseline,
                "note": "messages in memory; best of 5",
            }
        )
    return [*rows, _naming()]


def _naming() -> dict[str, Any]:
    """The share of a core that naming causes takes beside the mirror, from processor time: others do not change it."""
    flight = NamedFlight()
    flight.run(NAMED_S)

    def seconds(*, names: bool) -> float:
        mirror, namer = Mirror(flight.model), Namer(flight.model, AtOnce())
        started = time.process_time()
        for state in flight.states:
            output = mirror.handle(state)
            if names and output is not None:
                namer.take(state, output, mirror.regime)
        return time.process_time() - started

    with_names, without_names = (min(seconds(names=names) for _ in range(2)) for names in (True, False))
    return {
        "name": "naming causes in flight",
        "value": round(100.0 * (with_names - without_names) / NAMED_S, 1),
        "unit": "% of a core",
        "baseline": round(100.0 * without_names / NAMED_S, 1),
        "ratio": with_names / without_names,
        "note": "baseline: Mirror.handle alone; target 3 %",
    }


def _handle(rig: Rig, states: list[pb.State]) -> None:
    mirror = Mirror(Model.load("ce152"))
    mirror.parameters(rig.parameters())
    for state in states:
        mirror.handle(state)


def _rate(work: Any, samples: int) -> float:
    started = time.perf_counter()
    work()
    return float(samples / (time.perf_counter() - started))


def _solver_ticks_per_s() -> float:
    model = Model.load("ce152")
    m, g, x_max = model.plant.mass_kg, model.plant.gravity_m_s2, model.plant.x_max_m
    u = 1.649

    def right(_: float, z: Any) -> list[float]:
        force = model.K_c * z[0] ** 2 / (x_max - z[1]) ** 2
        return [(model.K_A * u - z[0]) / model.T_A, z[2], (force - model.b * z[2]) / m - g]

    z = np.array([0.4897, 2.85e-3, 0.0])
    started = time.perf_counter()
    for _ in range(BASELINE_TICKS):
        solve_ivp(right, (0.0, T_S), z, method="LSODA", rtol=1e-8, atol=1e-10)
    return BASELINE_TICKS / (time.perf_counter() - started)


if __name__ == "__main__":
    for row in run():
        print(f"{row['name']:40} {row['value']:>9} {row['unit']}  {row['ratio']:.1f} x  ({row['note']})")
