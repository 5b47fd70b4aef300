"""Weeks of faults in a minute: after it, every sample that a board has taken is accounted for, once.

    BOARD51_SOAK_MINUTES=10 BOARD51_SOAK_BOARDS=16 BOARD51_SOAK_SEED=3 pytest -n0 -s tests/system/test_soak.py

`make soak` is the long form: ten minutes, 16 boards.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Mapping
from pathlib import Path
from subprocess import PIPE

import numpy as np
import pytest

from protocol.bus.endpoint import zenoh_config
from tests.harness.soak.account import DISK_FULL, PUBLISHED, Account, account_of
from tests.harness.soak.faults import KINDS, Weather
from tests.harness.soak.logged import Logged, read_logs
from tests.harness.soak.processes import BLOCKS, Held, Service, slope
from tests.harness.soak.stage import GATEWAYS, Stage, staged
from tests.harness.soak.wall_clock import WallClock

MINUTES = float(os.environ.get("BOARD51_SOAK_MINUTES", "0.5"))
BOARDS = int(os.environ.get("BOARD51_SOAK_BOARDS", "4"))
SEED = int(os.environ.get("BOARD51_SOAK_SEED", "1"))
LOG_QUEUE = 1000 * max(BOARDS, 2)  # messages, of a second or two: a disk is full for longer
LONG_MIN = 5.0  # from so many minutes on the slopes count
MARGIN_NS = 3_000_000_000
CALM_S = 4.0  # before the first fault, and after the last


@pytest.mark.slow
def test_every_sample_is_published_logged_or_lost_for_a_counted_reason(tmp_path: Path) -> None:
    with staged(tmp_path, boards=BOARDS, seed=SEED, log_queue=LOG_QUEUE, plant=MINUTES >= LONG_MIN) as stage:
        time.sleep(CALM_S)
        weather = Weather(stage, SEED, per_s=BOARDS / 4.0)
        weather.blow(60.0 * MINUTES)
        faults = weather.counts
        time.sleep(CALM_S)
        stage.end()
        logs = {n: logged for g in range(GATEWAYS) for n, logged in read_logs(stage.logs(g)).items()}
        account = account_of(stage.ledgers, np.load(stage.published), logs, weather.happened, GATEWAYS)
        print(report(stage, weather, faults, account, logs))

        # All at once: a soak that fails by its account still says what grew.
        assert {what: problems for what, problems in failures(stage, account, logs).items() if problems} == {}


def test_python_and_zenoh_see_a_step_of_their_wall_clock(tmp_path: Path) -> None:
    clock = WallClock(tmp_path, "clock")
    if not clock.environment:
        pytest.skip("no gcc, or not Linux")
    script = f"""
import time, zenoh
session = zenoh.open(zenoh.Config.from_json5({zenoh_config("router")!r}))
while input():
    print(time.time(), session.new_timestamp().get_time().timestamp(), time.monotonic(), flush=True)
"""
    words, environment = [sys.executable, "-c", script], os.environ | clock.environment
    readings = []
    with subprocess.Popen(words, stdin=PIPE, stdout=PIPE, env=environment) as process:
        assert process.stdin
        assert process.stdout
        for _ in range(2):
            process.stdin.write(b"now\n")
            process.stdin.flush()
            readings.append(np.array(process.stdout.readline().split(), np.float64))
            clock.step(7200.0)
        process.communicate(b"\n")
    stepped = readings[1] - readings[0] - (readings[1] - readings[0])[2]
    assert stepped == pytest.approx([7200.0, 7200.0, 0.0], abs=1.0)


def failures(stage: Stage, account: Account, logs: Mapping[int, Logged]) -> dict[str, list[object]]:
    """Return the failures by question; an empty list means none."""
    lines, counted = account.lines, account.counted_no_sample
    never_killed = range(1, BOARDS, GATEWAYS)  # the counts of a gateway that is killed die with it
    full = (lines[PUBLISHED, DISK_FULL], account.counted_dropped["log"])
    return {
        "unexplained": [*account.unexplained],
        "twice": [*account.twice],
        "invented": [*account.invented],
        "too early": [*account.too_early],
        "backwards": [(n, logged.backwards) for n, logged in logs.items() if logged.backwards],
        "sessions used again": [
            (n, s) for n, logged in logs.items() for s, runs in logged.sessions.items() if runs > 1
        ],
        "sum, sensed": [(lines.total(), account.sensed)] if lines.total() != account.sensed else [],
        "parked, but not off": [who for who, reported, off in stage.parked if reported and not off],
        "ignored, but not counted": [n for n in never_killed if account.read_but_no_sample[n] > counted[n]],
        "disk full, and counted": [full] if full[0] > full[1] else [],
        # Subscribers keep what they get, and zenoh one handle for each router that has died.
        "growth": [text for text in map(too_much, (stage.router, *stage.gateways)) if text and MINUTES >= LONG_MIN],
    }


def report(stage: Stage, weather: Weather, faults: Counter[str], account: Account, logs: Mapping[int, Logged]) -> str:
    """Return the report of a soak for a person."""
    lines = [
        f"seed {SEED}, {BOARDS} boards, {MINUTES:g} min",
        "",
        *(f"{kind.name:<72}{faults[kind.name] or 'never':>10}" for kind in KINDS),
    ]
    lines += ["", account.table(), "", f"read but no sample {dict(account.read_but_no_sample)}"]
    lines += [f"steps of the clock that the log has { ({n: logged.steps for n, logged in logs.items()}) }"]
    lines += [f"counted {dict(account.counted_no_sample)}, dropped {dict(account.counted_dropped)}", ""]
    lines += [f"replayed {account.replayed}, parked (who, said, coil off) {Counter(stage.parked)}"]
    lines += [f"{service.name}: ended with {dict(service.codes)}" for service in [*stage.services, *stage.errands]]
    for (location, board), (count, begin_ns, end_ns) in unexplained(account).items():
        events = [o for o in weather.happened if o.begin_ns < end_ns + MARGIN_NS and o.end_ns > begin_ns - MARGIN_NS]
        lines.append(
            f"UNEXPLAINED, {location}, rig{board}: {count}, from {begin_ns / 1e9:.3f} to {end_ns / 1e9:.3f} s, near"
        )
        lines += [f"    {o.name}, {o.target}: {o.begin_ns / 1e9:.3f} to {o.end_ns / 1e9:.3f} s" for o in events]
    for service in stage.services:
        lines.append(f"{service.name}: {growth(service)}")
    return "\n".join(lines)


def unexplained(account: Account) -> dict[tuple[str, int], tuple[int, int, int]]:
    """Place and board -> how many, and the times of the first and the last."""
    times_ns: dict[tuple[str, int], list[int]] = defaultdict(list)
    for location, board, _, at_ns in account.unexplained:
        times_ns[location, board].append(at_ns)
    return {key: (len(times), min(times), max(times)) for key, times in times_ns.items()}


def steady_usage(service: Service) -> list[Held]:
    """The longest life of a process without its first third, in which it takes what it will need."""
    held = max(service.held, key=len)
    return held[len(held) // 3 :]


def growth(service: Service) -> str:
    """Return the resources that a process holds at the end, and their slopes."""
    held = steady_usage(service)
    if len(held) < 2 * BLOCKS:
        return "too short a life"
    texts = [f"{what} {getattr(held[-1], what):.0f} ({slope(held, what)}/min)" for what in Held._fields[1:]]
    whole = [h.resident_mb for h in max(service.held, key=len)]
    means = " ".join(f"{block.mean():.0f}" for block in np.array_split(np.array(whole), BLOCKS))
    return f"{', '.join(texts)}; resident_mb by tenths {means}"


def too_much(service: Service) -> str:
    """Return the resources that a process surely holds more and more of."""
    held = steady_usage(service)
    if len(held) < 60.0 * LONG_MIN / 3.0:
        return ""  # killed too often to tell
    limits = {"resident_mb": 0.5, "handles": 0.2, "threads": 0.2}  # per minute
    grows = [what for what, limit in limits.items() if (s := slope(held, what)).value - s.half_width > limit]
    return f"{service.name}: {', '.join(grows)}" if grows else ""
