"""The processes of a soak: they are killed, stopped and started again, and what they hold is looked at each second."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from tests.harness.repeated import repeated
from tests.patience import HANG_S

LOOK_S = 1.0
BLOCKS = 10  # of the means from which a slope's interval is: neighbouring looks are not independent
T_95 = 2.306  # Student's t, 95 % two-sided, BLOCKS - 2 degrees of freedom


class Held(NamedTuple):
    """The resources that a process holds at a moment."""

    at_s: float
    resident_mb: float
    handles: int
    threads: int


class Slope(NamedTuple):
    """A slope per minute with half the width of its 95 % interval."""

    value: float
    half_width: float

    def __str__(self) -> str:
        return f"{self.value:+.3f} +- {self.half_width:.3f}"


def slope(held: Sequence[Held], what: str) -> Slope:
    """Return the slope of one quantity, by a line through the means of blocks in time."""
    blocks = np.array_split(np.array([(h.at_s / 60.0, getattr(h, what)) for h in held], np.float64), BLOCKS)
    t, y = np.array([block.mean(0) for block in blocks]).T
    (value, offset), spread = np.polyfit(t, y, 1), ((t - t.mean()) ** 2).sum()
    residual = ((y - value * t - offset) ** 2).sum() / (BLOCKS - 2)
    return Slope(float(value), float(T_95 * np.sqrt(residual / spread)))


class Service:
    """A program that can die and come back.

    Args:
        name: For messages, and for the file of what it says.
        folder: For that file.
        words: After `python`.
        ready: A line of its output begins with this when it is ready; empty: it is not awaited.
        environment: Variables beside those of this process.
    """

    def __init__(
        self,
        name: str,
        folder: Path,
        *words: str,
        ready: str = "",
        environment: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        self.name, self._file, self._words, self._ready = name, folder / f"{name}.txt", words, ready
        self._environment = environment
        self.held: list[list[Held]] = []  # for each life
        self.codes: Counter[int] = Counter()  # with which it ended; -9: killed
        self._begin = 0  # of what it says in this life
        self._process: subprocess.Popen[bytes] | None = None

    def start(self, *words: str) -> None:
        """Start it, with these words after its own, and wait until it is ready."""
        environment = {k: v for k, v in os.environ.items() if not k.startswith("BOARD51_")} | dict(self._environment)
        with self._file.open("ab") as out:
            self._begin = out.tell()
            self._process = subprocess.Popen(
                [sys.executable, *self._words, *words],
                stdout=out,
                stderr=out,
                stdin=subprocess.DEVNULL,
                env=environment,
            )
        self.held.append([])
        end_s = time.monotonic() + HANG_S
        while self._ready and self._ready not in self.output:
            assert self.running(), f"{self.name} has ended: {self.output}"
            assert time.monotonic() < end_s, f"{self.name} is not ready"
            time.sleep(0.02)

    def kill(self) -> int | None:
        """kill -9, unless it has ended by itself; return the exit code, which `codes` counts."""
        process, self._process = self._process, None
        if process is None:
            return None
        process.kill()
        self.codes[code := process.wait(HANG_S)] += 1
        return code

    @property
    def output(self) -> str:
        """Return its output since its last start."""
        return self._file.read_bytes()[self._begin :].decode(errors="replace")

    def running(self) -> bool:
        """Return whether it runs."""
        return self._process is not None and self._process.poll() is None

    def end(self) -> int | None:
        """SIGTERM; return its exit code."""
        assert self._process is not None
        self._process.terminate()
        self._process.wait(HANG_S)
        return self.kill()

    def signal(self, number: signal.Signals) -> None:
        """Send SIGSTOP, SIGCONT, SIGINT."""
        assert self._process is not None
        self._process.send_signal(number)

    def look(self) -> None:
        """Note what it holds, where it runs."""
        process = self._process
        if process is None or process.poll() is not None:
            return
        process_folder = Path(f"/proc/{process.pid}")
        with suppress(OSError, KeyError):  # it ends at this moment
            lines = (process_folder / "status").read_text(encoding="ascii").splitlines()
            status = dict(line.split(":", 1) for line in lines if ":" in line)
            resident = float(status["VmRSS"].split()[0]) / 1024.0
            handles, threads = len(list((process_folder / "fd").iterdir())), int(status["Threads"])
            self.held[-1].append(Held(time.monotonic(), resident, handles, threads))


@contextmanager
def looked_at(services: Sequence[Service]) -> Iterator[None]:
    """Look at them each second; at the end of the block whatever still runs is killed."""

    def look() -> None:
        for service in services:
            service.look()

    try:
        with repeated(look, LOOK_S):
            yield
    finally:
        for service in services:
            service.kill()
