"""board51 commands as processes of their own: started, watched, and stopped whatever happens.

Rule: each runs in a session of its own, so Ctrl-C reaches the demo alone, which then stops them in the right order: the
      campaign parks the ball while gateway and board are still there.
"""

from __future__ import annotations

import contextlib
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from gateway.processes.command import end, words_of
from protocol.errors import ServiceError

START_LIMIT_S = 90.0  # compiling the kernels for the first time takes a while on a slow machine
STOP_LIMIT_S = 15.0


@contextlib.contextmanager
def running(out: Path, name: str, *words: str) -> Iterator[subprocess.Popen[bytes]]:
    """A service, or background work, talking into OUT/NAME.log; stopped, after 15 s killed, on the way out."""
    with (out / f"{name}.log").open("wb") as log:
        process = subprocess.Popen(words_of(name, *words), stdout=log, stderr=log, start_new_session=True)
    try:
        yield process
    finally:
        end([process], signal.SIGTERM, STOP_LIMIT_S)


def call(
    out: Path,
    name: str,
    *words: str,
    good: tuple[int, ...] = (0,),
    tell: Callable[[str], None] = lambda _: None,
    log: str = "",
) -> tuple[int, list[str]]:
    """A command to its end; its lines go to OUT/LOG.log (default NAME), and to `tell` as they come.

    Returns:
        Exit code and lines.

    Raises:
        ServiceError: it ended with an exit code that is not `good`; says its last line.
    """
    process = subprocess.Popen(
        words_of(name, *words),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    lines: list[str] = []
    path = out / f"{log or name}.log"
    assert process.stdout is not None
    with process.stdout, path.open("w", encoding="utf-8") as file:
        try:
            for raw in process.stdout:
                file.write(raw)
                lines.append(line := raw.rstrip())
                tell(line)
            code = process.wait()
        finally:
            end([process], signal.SIGINT, STOP_LIMIT_S)  # as a person would: a campaign parks the ball, and says so
            file.write(process.stdout.read())
    _check(code, good, name, lines, path)
    return code, lines


def finish(process: subprocess.Popen[bytes], out: Path, name: str, *, good: tuple[int, ...], limit_s: float) -> int:
    """Wait for work that `running` began; its exit code.

    Raises:
        ServiceError: it takes longer than `limit_s`, or ended with an exit code that is not `good`.
    """
    path = out / f"{name}.log"
    try:
        code = process.wait(timeout=limit_s)
    except subprocess.TimeoutExpired:
        raise ServiceError(
            f"board51 {name} is not done after {limit_s:.0f} s more",
            remedy=f"What it did so far is in {path}; run it alone on the same campaign",
        ) from None
    _check(code, good, name, path.read_text(encoding="utf-8", errors="replace").splitlines(), path)
    return code


def _check(code: int, good: tuple[int, ...], name: str, lines: list[str], path: Path) -> None:
    if code not in good:
        raise ServiceError(
            f"board51 {name} ended with exit code {code}: {lines[-1] if lines else 'it said nothing'}".rstrip("."),
            remedy=f"All it said is in {path}",
        )


def wait(ready: Callable[[], bool], process: subprocess.Popen[bytes], what: str) -> None:
    """Until `ready`.  Raises ServiceError where the process ends first, or does not get there in time."""
    end_s = time.monotonic() + START_LIMIT_S
    while not ready():
        if process.poll() is not None:
            raise ServiceError(
                f"{what} ended with exit code {process.returncode}",
                remedy="Its messages are in the .log files of --out",
            )
        if time.monotonic() > end_s:
            raise ServiceError(
                f"{what} did not appear within {START_LIMIT_S:.0f} s",
                remedy="Its messages are in the .log files of --out",
            )
        time.sleep(0.05)


def free_port() -> int:
    """A TCP port that nobody has now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def listens(port: int) -> bool:
    """Whether somebody does."""
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0
