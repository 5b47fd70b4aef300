"""The whole line on an emulated board: lift the ball, follow a reference, show what the twin sees going wrong.

Starts emulator, gateway and twin as a user would, each in its own process; leaves an MCAP log and a picture; stops
everything again.  Nothing is installed and no port stays open.
"""

from __future__ import annotations

import argparse
import contextlib
import queue
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import zenoh

from gateway.client import open_bus, send
from gateway.record.reader import read
from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.bus.encoding import parse
from protocol.errors import ServiceError

BOARD = "demo"
HOLD_S = 2.5  # at each reference: the slowest closed-loop mode has long decayed
REFERENCES_M = (2.85e-3, 1.5e-3, 3.0e-3, 4.5e-3, 2.85e-3)
START_LIMIT_S = 90.0  # compiling the kernels for the first time takes a while on a slow machine


def configure(parser: argparse.ArgumentParser) -> None:
    """Where the results go."""
    parser.epilog = "example:\n  board51 demo --out demo-out"
    parser.add_argument("--out", type=Path, default=Path("demo-out"), help="folder for log and picture (demo-out)")
    parser.add_argument(
        "--effect", action="append", default=[], metavar="NAME=VALUE", help="passed on to the emulator; repeat for more"
    )


def run(args: argparse.Namespace) -> int:
    """0 if the ball flew and log and picture were written."""
    args.out.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="board51-") as scratch, contextlib.ExitStack() as processes:
        port = _free_port()
        endpoint = f"tcp/127.0.0.1:{port}"
        tty = str(Path(scratch) / "ttyBoard51")
        folder = Path(scratch) / "logs"

        _say("1/6 emulated board on a pty")
        effects = [word for effect in args.effect for word in ("--effect", effect)]
        emulator = processes.enter_context(_process(args.out, "emulate", "--pty", tty, *effects))
        _wait(lambda: Path(tty).exists(), emulator, "the emulated board")

        _say("2/6 gateway: UART <-> zenoh, MCAP")
        gateway = processes.enter_context(
            _process(args.out, "gateway", "--board", f"{BOARD}={tty}", "--listen", endpoint, "--log-dir", str(folder))
        )
        _wait(lambda: _listens(port), gateway, "the gateway")
        session = processes.enter_context(open_bus(endpoint))
        bus = _Bus(session)
        _wait(lambda: bus.count("state") > 100, gateway, "samples from the board")

        _say("3/6 twin: the nominal CE 152 in step")
        twin = processes.enter_context(_process(args.out, "twin", "--connect", endpoint, "--board", BOARD))
        _wait(lambda: bus.count("twin/state") > 10, twin, "the twin")

        _say("4/6 lift the ball, then follow a reference")
        bus.command(pb.Command(set_reference=pb.SetReference(x_ref_m=REFERENCES_M[0])))
        bus.command(pb.Command(set_mode=pb.SetMode(mode=pb.MODE_CLOSED_LOOP)))
        for x_ref in REFERENCES_M:
            bus.command(pb.Command(set_reference=pb.SetReference(x_ref_m=x_ref)))
            x, rmse = bus.hold(HOLD_S)
            _say(f"      reference {x_ref * 1e3:.2f} mm: ball at {x * 1e3:.2f} mm, twin off by {rmse * 1e3:.3f} mm rms")

        _say("5/6 coil off, everything stops")
        bus.command(pb.Command(stop=pb.Stop()))
        bus.hold(0.3)
        processes.close()

        _say("6/6 what the log says")
        logs = [Path(shutil.move(path, args.out / path.name)) for path in sorted(folder.glob("*.mcap"))]
    if not logs:
        raise ServiceError("The gateway left no log", remedy=f"Its messages are in {args.out / 'gateway.log'}")
    picture = args.out / "measured-vs-twin.png"
    subprocess.run([*_board51(), "plot", str(logs[-1]), "--out", str(picture)], check=True, stdout=subprocess.DEVNULL)
    print(_findings(logs[-1]))
    print(f"\nlog      {logs[-1]}\npicture  {picture}\n{time.monotonic() - began:.0f} s")
    return 0


def _findings(log: Path) -> str:
    """Measured against twin at rest under each reference: where the model is wrong, in the units of the rig."""
    measured: dict[int, pb.State] = {}
    rows: dict[float, list[tuple[pb.State, pb.TwinState]]] = {}
    alarms: list[str] = []
    for record in read(log, topics=["state", "twin/state", "twin/alarm"]):
        message = record.message
        if isinstance(message, pb.State) and message.mode == pb.MODE_CLOSED_LOOP:
            measured[message.tick] = message
        elif isinstance(message, pb.TwinState) and message.tick in measured and message.sync == "in-step":
            state = measured[message.tick]
            rows.setdefault(round(state.x_ref_m * 1e3, 2), []).append((state, message))
        elif isinstance(message, pb.Alarm) and message.active:
            alarms.append(f"{message.name} ({message.text})" if message.text else message.name)
    lines = [
        "",
        "  x_ref      current i_c [A]           input u_c [V]",
        "   [mm]    rig    twin    error     rig    twin    error",
    ]
    errors: list[float] = []
    for x_ref, pairs in sorted(rows.items()):
        # The last half second under this reference: at rest, so that only the force balance is compared.
        rest = pairs[-250:]
        n = len(rest)
        i, i_twin = sum(s.i_c_a for s, _ in rest) / n, sum(t.i_c_a for _, t in rest) / n
        u, u_twin = sum(s.u_c_v for s, _ in rest) / n, sum(t.u_c_v for _, t in rest) / n
        lines.append(
            f"  {x_ref:5.2f}  {i:6.3f}  {i_twin:6.3f}  {i - i_twin:+7.3f}  {u:6.3f}  {u_twin:6.3f}  {u - u_twin:+7.3f}"
        )
        errors.append(i - i_twin)
    if errors:
        kind = "more" if min(errors) > 0 else "less" if max(errors) < 0 else ""
        trend = ", the more the higher the ball" if errors == sorted(errors, key=abs) and len(errors) > 2 else ""
        lines += ["", f"  To hold the ball the rig takes {min(errors):+.3f} to {max(errors):+.3f} A against the model"]
        lines[-1] += f": always {kind}{trend}." if kind else "."
    lines += [f"  Alarms raised: {len(alarms)}" + "".join(f"\n    {text}" for text in dict.fromkeys(alarms))]
    return "\n".join(lines)


class _Bus:
    """The demo's view of the bus: counts, newest values, commands."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._counts: dict[str, int] = {}
        self._samples: queue.SimpleQueue[tuple[str, bytes]] = queue.SimpleQueue()
        for name in ("state", "twin/state", "twin/divergence"):
            session.declare_subscriber(topics.key(topics.DEFAULT_SITE, BOARD, name), self._arrived)

    def _arrived(self, sample: zenoh.Sample) -> None:
        place = topics.split(str(sample.key_expr))
        if place is not None:
            self._counts[place[2]] = self._counts.get(place[2], 0) + 1
            self._samples.put((place[2], sample.payload.to_bytes()))

    def count(self, topic: str) -> int:
        return self._counts.get(topic, 0)

    def command(self, command: pb.Command) -> None:
        command.who = "demo"
        reply = send(self._session, topics.DEFAULT_SITE, BOARD, command)
        if not reply.accepted:
            what = command.WhichOneof("what")
            raise ServiceError(
                f"{what} was refused by {reply.refused_by}: {reply.reason}: {reply.text.rstrip('.')}",
                remedy="Run it step by step with board51 emulate, gateway and send",
            )

    def hold(self, duration_s: float) -> tuple[float, float]:
        """Watch for a while; the last position and the rms of measured minus twin position."""
        end = time.monotonic() + duration_s
        x, squares, n = float("nan"), 0.0, 0
        while (left := end - time.monotonic()) > 0:
            with contextlib.suppress(queue.Empty):
                topic, data = self._samples.get(timeout=left)
                if topic == "state":
                    state = parse(pb.State, data)
                    x = state.x_m if state else x
                elif topic == "twin/divergence" and (divergence := parse(pb.Divergence, data)):
                    squares, n = squares + divergence.x_m.error**2, n + 1
        return x, (squares / n) ** 0.5 if n else float("nan")


def _say(text: str) -> None:
    print(text, flush=True)


def _board51() -> list[str]:
    return [sys.executable, "-m", "board51"]


@contextlib.contextmanager
def _process(out: Path, name: str, *words: str) -> Iterator[subprocess.Popen[bytes]]:
    """A board51 process that talks into OUT/NAME.log; terminated, and after 15 s killed, on the way out."""
    with (out / f"{name}.log").open("wb") as log:
        process = subprocess.Popen([*_board51(), name, *words], stdout=log, stderr=log)
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(timeout=15)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _wait(ready: Callable[[], bool], process: subprocess.Popen[bytes], what: str) -> None:
    end = time.monotonic() + START_LIMIT_S
    while not ready():
        if process.poll() is not None:
            raise ServiceError(
                f"{what} ended with exit code {process.returncode}",
                remedy="Its messages are in the .log files of --out",
            )
        if time.monotonic() > end:
            raise ServiceError(
                f"{what} did not appear within {START_LIMIT_S:.0f} s",
                remedy="Its messages are in the .log files of --out",
            )
        time.sleep(0.05)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0
