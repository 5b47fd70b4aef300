"""The whole line on an emulated board: fly, measure, identify, diagnose, and fly on with a model that has the cause.

Starts emulator, gateway and twin as a user would, each in its own process; flies a staircase with the nominal model in
the twin; measures a campaign, identifies a model from it, hands it to the running twin and flies the staircase again;
validates it and diagnoses the campaign: which physical cause is left over?  Hands the extended model over and flies a
third time.  Leaves an MCAP log, a campaign, models, reports and a picture; stops everything again.  Nothing is
installed and no port stays open.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import re
import shutil
import signal
import sys
import tempfile
import textwrap
import time
from pathlib import Path
from types import FrameType

from gateway.client.connection import open_bus
from gateway.demo.bus import BusView
from gateway.demo.findings import Flight, conclusion, gather, sentence, table
from gateway.demo.processes import call, finish, free_port, listens, running, wait
from protocol.bus import board51_pb2 as pb
from protocol.errors import ServiceError, UsageError, require

BOARD = "demo"
HOLD_S = 2.0  # at each reference: the slowest closed-loop mode has long decayed
REFERENCES_M = (2.85e-3, 1.5e-3, 3.0e-3, 4.5e-3)
DIAGNOSIS_LIMIT_S = 120.0
EXPERIMENT = re.compile(r"\[\d+/\d+\]")  # how a campaign's line about an experiment begins
NOT_ALL = (0, 1)  # exit codes of work that was done and says no: shown, not the end of the demo


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments: where the results go."""
    parser.epilog = "examples:\n  board51 demo --out demo-out\n  board51 demo --effect coulomb-friction=1e-4"
    parser.add_argument("--out", type=Path, default=Path("demo-out"), help="folder for the results (demo-out)")
    parser.add_argument(
        "--effect", action="append", default=[], metavar="NAME=VALUE", help="passed on to the emulator; repeat for more"
    )


def run(args: argparse.Namespace) -> int:
    """0 if the ball flew on all models and everything was written."""
    require("twin", "numba", "mcap", "scipy", "matplotlib")  # before processes are started that need them
    try:
        args.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{args.out} is not a folder ({error.strerror})", remedy="Give another --out") from None

    def interrupted(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    previous = signal.signal(signal.SIGTERM, interrupted)  # like Ctrl-C: everything stops
    try:
        return _demo(args.out, args.effect)
    except KeyboardInterrupt:
        print("\ninterrupted: coil off, everything stopped", file=sys.stderr)
        return 130
    finally:
        signal.signal(signal.SIGTERM, previous)


def _demo(out: Path, effects: list[str]) -> int:
    began = time.monotonic()
    stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
    campaign, model, report, diagnosis = (
        out / name for name in (f"campaign-{stamp}", "model.json", "report", "diagnosis")
    )
    with tempfile.TemporaryDirectory(prefix="board51-") as scratch, contextlib.ExitStack() as processes:
        port = free_port()
        endpoint, tty, folder = f"tcp/127.0.0.1:{port}", str(Path(scratch) / "ttyBoard51"), Path(scratch) / "logs"

        _step(began, "1/8 emulated board on a pty, gateway (UART <-> zenoh, MCAP), twin on the nominal CE 152")
        words = [word for effect in effects for word in ("--effect", effect)]
        emulator = processes.enter_context(running(out, "emulate", "--pty", tty, *words))
        # In any order: the twin looks for the gateway until it is there.
        twin = processes.enter_context(running(out, "twin", "--connect", endpoint, "--board", BOARD))
        wait(lambda: Path(tty).exists(), emulator, "the emulated board")
        gateway = processes.enter_context(
            running(out, "gateway", "--board", f"{BOARD}={tty}", "--listen", endpoint, "--log-dir", str(folder))
        )
        wait(lambda: listens(port), gateway, "the gateway")
        bus = BusView(processes.enter_context(open_bus(endpoint)), BOARD)
        wait(lambda: bus.count("state") > 100, gateway, "samples from the board")
        wait(lambda: bus.count("twin/state") > 10, twin, "the twin")

        _step(began, "2/8 lift the ball, follow a reference")
        flights = [_fly(bus, "nominal")]

        _step(began, "3/8 measure: a quick campaign of the paper's experiments")
        _, lines = call(
            out, "campaign", "run", str(campaign), "--board", BOARD, "--connect", endpoint, "--quick",
            good=NOT_ALL, on_line=_write_experiment,
        )  # fmt: skip
        if not (campaign / "campaign.toml").exists():
            raise ServiceError(f"The campaign recorded nothing: {lines[-1].rstrip('.')}", remedy="Try another --effect")

        _step(began, "4/8 identify; diagnose begins in the background")
        diagnose = processes.enter_context(running(out, "diagnose", str(campaign), "--quick", "--out", str(diagnosis)))
        refused, lines = call(out, "identify", str(campaign), "--out", str(model), good=NOT_ALL)
        _show_model(model)
        if refused:
            _write_line("      identify rejects this model; the twin shows how large its errors are:")
            for line in lines:
                if line.startswith("! "):
                    _wrap(line)

        _step(began, "5/8 hand the identified model to the running twin, the same references again")
        _hand_over(out, model, endpoint)
        flights.append(_fly(bus, "identified"))

        _step(began, "6/8 validate: what the model leaves unexplained")
        _, answer = call(out, "validate", str(campaign), "--model", str(model), "--out", str(report), good=NOT_ALL)
        _wrap(answer[0])

        _step(began, "7/8 diagnose: which physical cause is it? the extended model to the twin, a third flight")
        finish(diagnose, out, "diagnose", good=NOT_ALL, limit_s=DIAGNOSIS_LIMIT_S)
        diagnosed = json.loads((diagnosis / "diagnosis.json").read_text(encoding="utf-8"))
        _wrap(diagnosed["sentence"])
        if diagnosed["extended_model"]["offered"]:
            _hand_over(out, diagnosis / "extended_model.json", endpoint)
            flights.append(_fly(bus, "extended"))
        else:
            _wrap(
                "no model of the diagnosis surely predicts better: the twin keeps the identified one, and flies no more"
            )
        bus.hold(0.3)
        processes.close()

        _step(began, "8/8 what the log says")
        logs = [Path(shutil.move(path, out / path.name)) for path in sorted(folder.glob("*.mcap"))]
    if not logs:
        raise ServiceError("The gateway left no log", remedy=f"Its messages are in {out / 'gateway.log'}")
    gather(logs[-1], flights)
    picture = out / "measured-vs-twin.png"
    spans = [f"--span={flight.from_t_s:.3f}:{flight.to_t_s:.3f}=twin on the {flight.name} model" for flight in flights]
    call(out, "plot", str(logs[-1]), "--out", str(picture), *spans)
    print(f"\n{table(flights)}\n")
    for text in (sentence(flights), conclusion(diagnosed)):
        print(textwrap.fill(text, 100, initial_indent="  ", subsequent_indent="  "))
    for name, path in {
        "log": logs[-1], "campaign": campaign, "model": model, "extended": diagnosis / "extended_model.json",
        "reports": f"{report / 'report.html'}, {diagnosis / 'report.html'}", "picture": picture,
    }.items():  # fmt: skip
        print(f"{name:<9}{path}")
    print(f"{time.monotonic() - began:.0f} s")
    return 0


def _hand_over(out: Path, model: Path, endpoint: str) -> None:
    _, lines = call(
        out, "twin", "--hand-over", str(model), "--board", BOARD, "--connect", endpoint, "--who", "demo",
        log="hand-over",
    )  # fmt: skip
    for line in lines:
        _wrap(line)


def _fly(bus: BusView, name: str) -> Flight:
    """The staircase; coil off after it."""
    begin_s = bus.catch_up()
    bus.command(pb.Command(set_reference=pb.SetReference(x_ref_m=REFERENCES_M[0])))
    bus.command(pb.Command(set_mode=pb.SetMode(mode=pb.MODE_CLOSED_LOOP)))
    for x_ref in REFERENCES_M:
        bus.command(pb.Command(set_reference=pb.SetReference(x_ref_m=x_ref)))
        x, rms = bus.hold(HOLD_S)
        _write_line(
            f"      reference {x_ref * 1e3:.2f} mm: ball at {x * 1e3:.2f} mm, "
            f"twin off by {rms * 1e3:.0f} mA rms in current"
        )
    flight = Flight(name=name, from_t_s=begin_s, to_t_s=bus.catch_up())
    bus.command(pb.Command(stop=pb.Stop()))
    return flight


def _show_model(path: Path) -> None:
    try:
        parameters = json.loads(path.read_text(encoding="utf-8"))["parameters"]
    except (OSError, ValueError, KeyError) as error:
        raise ServiceError(f"identify wrote no model ({error})", remedy="Try another --effect") from None
    for name, estimate in parameters.items():
        low, high = estimate["ci95"] or (float("nan"), float("nan"))
        interval = f"{low:.5g} .. {high:.5g}"
        _write_line(
            f"      {name:<4}{estimate['value']:>12.6g} {estimate['unit']:<11} {interval}  {estimate['verdict']}"
        )


def _wrap(text: str) -> None:
    _write_line(textwrap.fill(text, 100, initial_indent=" " * 6, subsequent_indent=" " * 6))


def _step(began: float, text: str) -> None:
    _write_line(f"[{time.monotonic() - began:3.0f} s] {text}")


def _write_experiment(line: str) -> None:
    if EXPERIMENT.match(line):
        _write_line("      " + line.partition(":")[0])


def _write_line(text: str) -> None:
    print(text, flush=True)
