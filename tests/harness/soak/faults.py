"""The faults of a soak: each begins, lasts, and ends; what overlaps is drawn from a seed.

A fault is a generator: it begins before its `yield`, which says how long it lasts, and ends after it.  Two faults of
the same kind never hold the same thing.
"""

from __future__ import annotations

import heapq
import random
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

from gateway.emulator.line import BoardLine
from tests.harness.soak.names import GHOST
from tests.harness.soak.processes import Service
from tests.harness.soak.stage import GATEWAYS, Stage
from tests.patience import HANG_S

Course = Iterator[float]
_PARKED = "ball parked, coil off"  # what a campaign says


@dataclass(slots=True)
class Occurrence:
    """A fault that has happened; `target` is the number of the board or of the gateway.

    It struck between `begin_ns` and `struck_ns`: it takes a busy machine a while to kill a process.
    """

    name: str
    target: int
    begin_ns: int
    struck_ns: int = 0
    end_ns: int = 0


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of fault.

    `targets` says how many things of its sort there are, `weight` how often it comes.
    """

    name: str
    weight: float
    targets: Callable[[Stage], int]
    course: Callable[[Stage, random.Random, int], Course]


def _on_line(fault: str, low: float, high: float, stage: Stage, draw: random.Random, board: int) -> Course:
    """A fault of the line; `fault` has a place for a number from this range, and one for how long a rate lasts."""
    stage.inject(board, fault.format(value=draw.uniform(low, high), length=draw.uniform(0.2, 2.0)))
    yield 2.0


def _reset(stage: Stage, draw: random.Random, board: int) -> Course:
    if draw.random() < 0.5:
        stage.do(stage.lines[board], BoardLine.power_cycle)
    else:
        stage.inject(board, "watchdog@0")
    yield 1.0


def _unplug(stage: Stage, draw: random.Random, board: int) -> Course:
    stage.do(stage.lines[board], BoardLine.disconnect)
    yield draw.uniform(0.1, 2.0)
    renamed = draw.random() < 0.5
    stage.do(stage.lines[board], lambda line: line.reconnect(renamed=renamed))


def _no_router(stage: Stage, draw: random.Random, _: int) -> Course:
    stage.router.kill()
    yield draw.uniform(0.1, 4.0)
    stage.router.start()


def _no_gateway(stage: Stage, draw: random.Random, _: int) -> Course:
    stage.gateways[0].kill()
    yield draw.uniform(0.1, 1.0)
    stage.gateways[0].start()


def _no_reader(stage: Stage, draw: random.Random, _: int) -> Course:
    stage.stopped.signal(signal.SIGSTOP)
    yield draw.uniform(1.0, 12.0)
    stage.stopped.signal(signal.SIGCONT)


def _full_disk(stage: Stage, draw: random.Random, gateway: int) -> Course:
    stage.disks[gateway].fill()
    yield draw.uniform(1.0, 8.0)
    stage.disks[gateway].free()
    yield 1.5  # the log goes on


def _clock_step(stage: Stage, draw: random.Random, gateway: int) -> Course:
    stage.clocks[gateway].step(draw.choice((-1.0, 1.0)) * 10.0 ** draw.uniform(0.0, 4.0))  # a second to three hours
    yield 3.0  # the gateway looks once a second


def _no_twin(stage: Stage, draw: random.Random, _: int) -> Course:
    stage.twin.kill()
    yield draw.uniform(0.1, 2.0)
    stage.twin.start()


def _hand_over(stage: Stage, draw: random.Random, _: int) -> Course:
    stage.hand_over.start("--hand-over", draw.choice(("ce152", "inteco", "magnetoshield")))
    yield draw.uniform(2.0, 12.0)  # done, or killed before
    stage.hand_over.kill()


def _replay(stage: Stage, draw: random.Random, _: int) -> Course:
    board = draw.randrange(len(stage.lines))
    part = draw.choice(stage.logs(board % GATEWAYS))
    words = ("--board", f"rig{board}", "--as", f"{GHOST}{board}", "--speed", f"{draw.uniform(1.0, 20.0):.1f}")
    stage.replay.start(str(part), *words)
    yield draw.uniform(2.0, 12.0)
    stage.replay.kill()


def _campaign(stage: Stage, draw: random.Random, _: int) -> Course:
    """Start or continue a campaign; interrupt it, so that it parks its ball, or kill it; then STOP by hand."""
    stage.campaign.start(str(stage.folder / f"campaign{stage.campaign.codes[0]}"))
    yield draw.uniform(5.0, 40.0)
    if draw.random() < 0.5:
        stage.campaign.signal(signal.SIGINT)
        yield from _ending(stage.campaign)
        stage.note_parked("campaign", reported=_PARKED in stage.campaign.output)
        stage.campaign.kill()
    elif stage.campaign.kill() == -signal.SIGKILL:
        stage.note_parked("killed campaign", reported=False)
    stopped = False
    while not stopped:
        stage.stop.start()
        yield from _ending(stage.stop)
        stopped = stage.stop.kill() == 0
    stage.note_parked("stop", reported=True)


def _ending(service: Service) -> Course:
    end_s = time.monotonic() + HANG_S
    while service.running():
        assert time.monotonic() < end_s, f"{service.name} does not end"
        yield 0.2


def _boards(stage: Stage) -> int:
    return len(stage.lines)


def _disks(stage: Stage) -> int:
    return len([disk for disk in stage.disks if disk.mounted])


def _clocks(stage: Stage) -> int:
    return len([clock for clock in stage.clocks if clock.environment])


KINDS = (
    Kind("bit errors", 4, _boards, partial(_on_line, "flip={value}@0+{length}", 1e-4, 1e-2)),
    Kind("bytes lost", 4, _boards, partial(_on_line, "lost={value}@0+{length}", 1e-4, 1e-2)),
    Kind("bytes doubled", 2, _boards, partial(_on_line, "duplicate={value}@0+{length}", 1e-4, 1e-2)),
    Kind("bytes inserted", 2, _boards, partial(_on_line, "insert={value}@0+{length}", 1e-4, 1e-2)),
    Kind("burst after a stall", 4, _boards, partial(_on_line, "stall={value}@0", 0.02, 1.0)),
    Kind("wrong baud rate", 2, _boards, partial(_on_line, "baud={value}@0", 0.05, 0.8)),
    Kind("board reset", 4, _boards, _reset),
    Kind("unplugged", 4, _boards, _unplug),
    Kind("router killed", 1, lambda _: 1, _no_router),
    Kind("gateway killed", 1, lambda _: 1, _no_gateway),
    Kind("subscriber stopped", 1, lambda _: 1, _no_reader),
    Kind("disk full", 1, _disks, _full_disk),
    Kind("clock stepped", 2, _clocks, _clock_step),
    Kind("twin killed", 0.5, lambda _: 1, _no_twin),
    Kind("model handed over", 1, lambda _: 1, _hand_over),
    Kind("log replayed", 1, lambda _: 1, _replay),
    Kind("campaign", 2, lambda stage: int(stage.plant is not None), _campaign),
)


class Weather:
    """Faults at random times; `happened` lists them."""

    def __init__(self, stage: Stage, seed: int, *, per_s: float) -> None:
        self.happened: list[Occurrence] = []
        self._stage, self._draw, self._per_s = stage, random.Random(seed), per_s
        self._next = 0
        self._under_way: list[tuple[float, int, Course, Occurrence]] = []
        self._busy: Counter[tuple[str, int]] = Counter()

    @property
    def counts(self) -> Counter[str]:
        """Return how often each kind of fault has happened."""
        return Counter(occurrence.name for occurrence in self.happened)

    def blow(self, duration_s: float) -> None:
        """Let faults begin for so long; then all that are under way end.  Each kind comes once at least."""
        first = self._draw.sample(KINDS, len(KINDS))
        end_s = time.monotonic() + duration_s
        begin_s = time.monotonic()
        while (now_s := time.monotonic()) < end_s or self._under_way:
            if self._under_way and self._under_way[0][0] <= now_s:
                self._go_on(*heapq.heappop(self._under_way)[1:])
            elif now_s < end_s and now_s >= begin_s:
                weights = [kind.weight for kind in KINDS]
                self._begin(first.pop() if first else self._draw.choices(KINDS, weights)[0])
                begin_s = now_s + self._draw.expovariate(self._per_s)
            else:
                time.sleep(0.01)

    def _begin(self, kind: Kind) -> None:
        targets = kind.targets(self._stage)
        target = self._draw.randrange(targets) if targets else -1
        if target < 0 or self._busy[kind.name, target]:
            return
        self._busy[kind.name, target] += 1
        occurrence = Occurrence(kind.name, target, time.monotonic_ns())
        self.happened.append(occurrence)
        self._go_on(0, kind.course(self._stage, self._draw, target), occurrence)

    def _go_on(self, _: int, course: Course, occurrence: Occurrence) -> None:
        duration_s = next(course, None)
        occurrence.end_ns = time.monotonic_ns()
        occurrence.struck_ns = occurrence.struck_ns or occurrence.end_ns
        if duration_s is None:
            self._busy[occurrence.name, occurrence.target] -= 1
            return
        self._next += 1
        heapq.heappush(self._under_way, (time.monotonic() + duration_s, self._next, course, occurrence))
