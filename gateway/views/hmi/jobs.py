"""Jobs that a page starts (recordings, campaigns, diagnoses, replays ...), each a `board51` command in its own process.

Rule 1: one job of a kind and board at a time.  Jobs end with this process, also after kill -9.  They are interrupted as
        by Ctrl-C, so that a campaign parks the ball and a recording closes its file.
Rule 2: memory is bounded: the newest LINES lines that a job prints are kept, each cut at WIDTH.
Rule 3: arguments are a list, never a shell's line.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from gateway.processes.command import Process, end, order, start
from gateway.views.hmi.texts import text_of, texts_of
from protocol.bus.identity import VARIABLE as IDENTITY_VARIABLE
from protocol.errors import UsageError

LINES, WIDTH = 200, 400
_STEP = re.compile(r"\[(\d+)/(\d+)\]")  # of a line: the step that has begun, and their number
_SHARE = re.compile(r"^\[[ \d.]+ s\] +(\d+) %")  # of a diagnosis
_JUDGES = ("bode", "compare", "diagnose", "validate")  # a no is their answer, which the page shows
_PATIENT = ("campaign", "record")  # park the ball, and write what they have
END_S, QUICK_END_S = 15.0, 3.0  # a campaign parks the ball in the first


@dataclass(slots=True, kw_only=True)
class Job:
    """A `board51` command that runs for a page."""

    kind: str  # a key of the texts job_kind
    board: str
    title: str
    who: str
    process: Process
    began_s: float  # monotonic
    lines: deque[str] = field(default_factory=lambda: deque(maxlen=LINES))
    listener: threading.Thread = field(default_factory=threading.Thread)  # reads its output

    @property
    def running(self) -> bool:
        """Return whether the job is running."""
        return self.process.poll() is None

    @property
    def standing(self) -> str:
        """Return the state of the job in words."""
        code = self.process.poll()
        if code is None:
            return text_of("job.running", seconds=f"{time.monotonic() - self.began_s:.0f}")
        if code in (0, 1):  # 1: the work was done, and its answer is no
            return text_of("job.done") if code == 0 or self.kind in _JUDGES else text_of("job.incomplete")
        # The last line of a command that cannot go on is its error: what, where, what to do.
        return text_of("job.failed", problem=self.lines[-1] if self.lines else f"exit code {code}")

    @property
    def failed(self) -> bool:
        """Return whether the job ended without an answer."""
        return self.process.poll() not in (None, 0, 1)

    @property
    def progress(self) -> float | None:
        """Return the share of its work that is done; None if it says nothing of it."""
        steps = (_STEP.search(line) for line in reversed(list(self.lines)))
        step = next(filter(None, steps), None)
        share = next(filter(None, map(_SHARE.search, reversed(list(self.lines)))), None)
        if step is None and share is not None:
            return int(share[1]) / 100.0
        return (int(step[1]) - 1) / max(int(step[2]), 1) if step is not None else None


class Jobs:
    """The jobs of this process."""

    def __init__(self) -> None:
        # The options of a job state its identity on the bus; that of this process must not replace it.
        self._environment = {name: value for name, value in os.environ.items() if name != IDENTITY_VARIABLE}
        self._jobs: dict[tuple[str, str], Job] = {}
        self._lock = threading.Lock()

    def start(self, kind: str, board: str, words: Sequence[str], *, title: str, who: str) -> Job:
        """Start `board51 WORDS`.

        Raises:
            UsageError: such a job runs already.
        """
        with self._lock:
            present = self._jobs.get((kind, board))
            if present is not None and present.running:
                raise _busy(present)
            process = start(*words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=self._environment)
            job = Job(kind=kind, board=board, title=title, who=who, process=process, began_s=time.monotonic())
            self._jobs[(kind, board)] = job
        job.listener = threading.Thread(target=_listen, args=(job,), name=f"job-{kind}", daemon=True)
        job.listener.start()
        return job

    def get(self, kind: str, board: str) -> Job | None:
        """Return the latest job of this kind on a board."""
        return self._jobs.get((kind, board))

    def of(self, board: str) -> list[Job]:
        """Return the latest job of each kind on a board."""
        return [job for (_, of), job in sorted(self._jobs.items()) if of == board]

    def stop(self, kind: str, board: str) -> bool:
        """Interrupt it, as Ctrl-C would; False where nothing runs.

        A job that does not end by itself, such as a replay whose session of the bus hangs, is killed: the next one must
        be able to start.  A campaign, which parks the ball, and a recording, which finishes its file, are not killed.
        """
        job = self._jobs.get((kind, board))
        if job is None or not job.running:
            return False
        if kind in _PATIENT:
            order(job.process, signal.SIGINT)
        else:
            threading.Thread(target=end, args=([job.process], signal.SIGINT, END_S), daemon=True).start()
        return True

    def tell(self, kind: str, board: str, line: str) -> bool:
        """Write a line to its standard input; False where nothing runs."""
        job = self._jobs.get((kind, board))
        if job is None or not job.running or job.process.stdin is None:
            return False
        try:
            job.process.stdin.write(f"{line}\n".encode())
            job.process.stdin.flush()
        except (OSError, ValueError):  # it has just ended
            return False
        return True

    def close(self) -> None:
        """End them all; those that leave nothing undone within QUICK_END_S."""
        patient = [job.process for (kind, _), job in self._jobs.items() if kind in _PATIENT]
        quick = [job.process for (kind, _), job in self._jobs.items() if kind not in _PATIENT]
        thread = threading.Thread(target=end, args=(quick, signal.SIGINT, QUICK_END_S))
        thread.start()
        end(patient, signal.SIGINT, END_S)
        thread.join()
        for job in self._jobs.values():
            job.listener.join(1.0)


def _busy(job: Job) -> UsageError:
    if job.board == "*":
        problem = text_of("job.busy_replay", who=job.who)
    else:
        problem = text_of("job.busy", kind=texts_of("job_kind")[job.kind], rig=job.board, who=job.who)
    return UsageError(problem, remedy=text_of("job.busy_remedy"))


def _listen(job: Job) -> None:
    assert job.process.stdout is not None
    assert job.process.stdin is not None
    with job.process.stdin, job.process.stdout as stream:
        while line := stream.readline(4096):
            job.lines.append(line.decode("utf-8", errors="replace").rstrip()[:WIDTH])
        job.process.wait()
