"""Run `board51 campaign run` and `board51 diagnose` as child processes.

Rule: each has a process session of its own.  So Ctrl-C reaches only this process, which forwards it and waits until the
      campaign has parked the ball.  The child also ends if this process is killed (gateway/processes/child.py).
"""

from __future__ import annotations

import json
import signal
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from gateway.processes.command import Process, order, start
from protocol.errors import ServiceError, UsageError
from protocol.files import parse_json, read_small

WriteLine = Callable[[str], None]
DIAGNOSIS = "diagnosis"  # folder beside the recordings


class Interrupted(Exception):  # noqa: N818  # not an error: somebody wanted it
    """The user ends the investigation."""


class Work:
    """The commands of one investigation.

    `rig` are the options of `campaign run`: board, bus, plant, limits.  A STOP since `ordered_ns`, Unix time, ends the
    investigation, also during a diagnosis.
    """

    def __init__(
        self, folder: Path, rig: Sequence[str], *, ordered_ns: int, workers: int, write_line: WriteLine
    ) -> None:
        self._folder, self._rig, self._workers, self._write_line = folder, tuple(rig), workers, write_line
        self._ordered_ns = ordered_ns
        self._process: Process | None = None
        self.stopped = False  # `stop` was called
        self._ending = signal.SIGTERM

    def stop(self) -> None:
        """End the running command with a signal; no other command is begun."""
        self.stopped = True
        if self._process is not None and self._process.poll() is None:
            order(self._process, self._ending)

    def perform(self, experiments: Sequence[str]) -> dict[str, Any]:
        """Make experiments; returns the summary of `campaign run --json`.

        Raises:
            Interrupted: `stop` was called and there is no summary; the ball has not moved.
            UsageError, ServiceError: the command failed before the ball moved.
        """
        options = [word for name in experiments for word in ("--experiment", name)]
        self._ending = signal.SIGINT  # as Ctrl-C: the command parks the ball and prints its summary
        options += ["--issued", str(self._ordered_ns)]
        code, out, last = self._call("campaign", "run", str(self._folder), *self._rig, *options, "--json")
        try:
            summary: dict[str, Any] = json.loads(out)
        except ValueError:
            raise self._failed("campaign run", code, last) from None
        self._ordered_ns = int(summary["ended_ns"])  # the run itself parks the ball with a STOP
        return summary

    def diagnose(self, *, thorough: bool) -> dict[str, Any]:
        """Diagnose the recordings; returns the content of diagnosis.json.

        Raises:
            Interrupted: `stop` was called.
            UsageError, ServiceError: the command failed.
        """
        out = self._folder / DIAGNOSIS
        quick = () if thorough else ("--quick", "--next-experiment")
        self._ending = signal.SIGTERM
        code, _, last = self._call(
            "diagnose", str(self._folder), "--out", str(out), "--workers", str(self._workers), *quick
        )
        if code not in (0, 1) or self.stopped:
            raise self._failed("diagnose", code, last)
        path = out / "diagnosis.json"
        diagnosis: dict[str, Any] = parse_json(read_small(path, remedy="Run it again"), where=str(path))
        return diagnosis

    def _call(self, *words: str) -> tuple[int, str, str]:
        """Return (exit code, stdout, last line of stderr)."""
        if self.stopped:
            raise Interrupted
        self._process = process = start(
            *words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, errors="replace"
        )
        last = ""
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stderr is not None
        with process.stdin, process.stdout as printed, process.stderr as lines:
            if self.stopped:  # `stop` was called while the process started
                self.stop()
            for line in lines:
                last = line.rstrip() or last
                if not line.startswith("board51 identify"):  # the hint after a campaign; here a diagnosis follows
                    self._write_line(f"    {line.rstrip()}")
            out = printed.read()
            return process.wait(), out, last

    def _failed(self, what: str, code: int, last: str) -> Exception:
        if self.stopped:
            return Interrupted()
        message = last.partition(": ")[2] if last.startswith("board51 ") else last
        problem = f"{what} ended with exit code {code}: {message}".rstrip(".")
        error = UsageError if code == 2 else ServiceError
        return error(problem, remedy="Correct this; the same command continues where it stopped")
