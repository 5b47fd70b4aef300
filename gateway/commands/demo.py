"""Fly an emulated board, measure, identify, diagnose, and fly again with a model that includes the cause.

It starts emulator, gateway and twin as a user would, each in its own process.  The ball flies a staircase with the
nominal model in the twin.  Then the demo records a campaign, identifies a model, hands it to the running twin and flies
the staircase again.  It validates the model, diagnoses the physical cause of the rest, hands over the extended model
and flies a third time.  It leaves an MCAP log, a campaign, models, reports and a picture, and stops everything again.
Nothing is installed and no port stays open.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import re
import shutil
import signal
import sys
import tempfile
import textwrap
import time
from pathlib import Path

from gateway.client.message_queue import MessageQueue
from gateway.client.rig import SILENCE_S, Rig
from gateway.demo.findings import Flight, conclusion, gather, sentence, table
from gateway.processes.command import EmulatedLine, call, emulated_line, finish, free_port, listens, running, wait
from protocol.arguments import add_repeatable
from protocol.bus import board51_pb2 as pb
from protocol.diagnosis import Diagnosis, load_diagnosis
from protocol.ending import on_signals
from protocol.errors import ServiceError, require
from protocol.files import make_folder

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
    add_repeatable(parser, "--effect", "NAME=VALUE", "passed on to the emulator; repeat for more")


def run(args: argparse.Namespace) -> int:
    """0 if the ball flew on all models and everything was written."""
    require("twin", "numba", "mcap", "scipy", "matplotlib")  # before processes are started that need them
    make_folder(args.out)

    def interrupt() -> None:
        raise KeyboardInterrupt

    try:
        with on_signals(interrupt, signal.SIGTERM):  # like Ctrl-C: everything stops
            return _demo(args.out, args.effect)
    except KeyboardInterrupt:
        print("\ninterrupted: coil off, everything stopped", file=sys.stderr)
        return 130


def _demo(out: Path, effects: list[str]) -> int:
    began = time.monotonic()
    stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
    campaign, model, report, diagnosis = (
        out / name for name in (f"campaign-{stamp}", "model.json", "report", "diagnosis")
    )
    with tempfile.TemporaryDirectory(prefix="board51-") as scratch, contextlib.ExitStack() as processes:
        endpoint, folder = f"tcp/127.0.0.1:{free_port()}", Path(scratch) / "logs"

        _step(began, "1/8 emulated board, gateway (UART <-> zenoh, MCAP), twin on the nominal CE 152")
        rig, bus = _start(processes, out, emulated_line(Path(scratch)), endpoint, folder, effects)

        _step(began, "2/8 lift the ball, follow a reference")
        flights = [_fly(rig, bus, "nominal")]

        _step(began, "3/8 measure: a quick campaign of the paper's experiments")
        _, lines = call(
            out, "campaign", "run", str(campaign), "--board", BOARD, "--connect", endpoint, "--quick",
            good=NOT_ALL, on_line=_write_experiment,
        )  # fmt: skip
        if not (campaign / "campaign.toml").exists():
            raise ServiceError(f"The campaign recorded nothing: {lines[-1].rstrip('.')}", remedy="Try another --effect")

        _step(began, "4/8 identify; diagnose begins in the background")
        diagnose = processes.enter_context(running(out, "diagnose", str(campaign), "--quick", "--out", str(diagnosis)))
        _identify(out, campaign, model)

        _step(began, "5/8 hand the identified model to the running twin, the same references again")
        _hand_over(out, model, endpoint)
        flights.append(_fly(rig, bus, "identified"))

        _step(began, "6/8 validate: which errors the model leaves")
        _, answer = call(out, "validate", str(campaign), "--model", str(model), "--out", str(report), good=NOT_ALL)
        _wrap(answer[0])

        _step(began, "7/8 diagnose the physical cause; hand the extended model to the twin; a third flight")
        finish(diagnose, out, "diagnose", good=NOT_ALL, limit_s=DIAGNOSIS_LIMIT_S)
        diagnosed = load_diagnosis(diagnosis / "diagnosis.json")
        _wrap(diagnosed.headline)
        if diagnosed.model_offered:
            _hand_over(out, diagnosis / "extended_model.json", endpoint)
            flights.append(_fly(rig, bus, "extended"))
        else:
            _wrap(
                "no model of the diagnosis surely predicts better: the twin keeps the identified one; no third flight"
            )
        time.sleep(0.3)  # for the last samples in the log
        processes.close()

        _step(began, "8/8 what the log says")
        logs = [Path(shutil.move(path, out / path.name)) for path in sorted(folder.glob("*.mcap"))]
    picture = _compare(out, logs, flights, diagnosed)
    for name, path in {
        "log": logs[-1], "campaign": campaign, "model": model, "extended": diagnosis / "extended_model.json",
        "reports": f"{report / 'report.html'}, {diagnosis / 'report.html'}", "picture": picture,
    }.items():  # fmt: skip
        print(f"{name:<9}{path}")
    print(f"{time.monotonic() - began:.0f} s")
    return 0


def _start(
    processes: contextlib.ExitStack, out: Path, wire: EmulatedLine, endpoint: str, folder: Path, effects: list[str]
) -> tuple[Rig, MessageQueue]:
    """Start emulator, gateway and twin; return the rig and its messages once samples of both come."""
    words = [word for effect in effects for word in ("--effect", effect)]
    emulator = processes.enter_context(running(out, "emulate", *wire.options, *words))
    # In any order: the twin looks for the gateway until it is there.
    twin = processes.enter_context(running(out, "twin", "--connect", endpoint, "--board", BOARD))
    wait(wire.served, emulator, "the emulated board")
    gateway = processes.enter_context(
        running(out, "gateway", "--board", f"{BOARD}={wire.url}", "--listen", endpoint, "--log-dir", str(folder))
    )
    wait(lambda: listens(int(endpoint.rpartition(":")[2])), gateway, "the gateway")
    rig = processes.enter_context(Rig(BOARD, connect=endpoint, who="demo"))
    bus = rig.messages("state", "twin/state", "twin/divergence")
    wait(lambda: bus.first(pb.State, 0.0) is not None, gateway, "samples from the board")
    wait(lambda: bus.first(pb.TwinState, 0.0) is not None, twin, "the twin")
    return rig, bus


def _compare(out: Path, logs: list[Path], flights: list[Flight], diagnosed: Diagnosis) -> Path:
    """Print the flights side by side, by their log; return the picture of measurement and twin."""
    if not logs:
        raise ServiceError("The gateway left no log", remedy=f"Its messages are in {out / 'gateway.log'}")
    gather(logs[-1], flights)
    picture = out / "measured-vs-twin.png"
    spans = [f"--span={flight.from_t_s:.3f}:{flight.to_t_s:.3f}=twin on the {flight.name} model" for flight in flights]
    call(out, "plot", str(logs[-1]), "--out", str(picture), *spans)
    print(f"\n{table(flights)}\n")
    for text in (sentence(flights), conclusion(diagnosed)):
        print(textwrap.fill(text, 100, initial_indent="  ", subsequent_indent="  "))
    return picture


def _identify(out: Path, campaign: Path, model: Path) -> None:
    refused, lines = call(out, "identify", str(campaign), "--out", str(model), good=NOT_ALL)
    _show_model(model)
    if refused:
        _write_line("      identify rejects this model; the twin shows how large its errors are:")
        for line in lines:
            if line.startswith("! "):
                _wrap(line)


def _hand_over(out: Path, model: Path, endpoint: str) -> None:
    _, lines = call(
        out, "twin", "--hand-over", str(model), "--board", BOARD, "--connect", endpoint, "--who", "demo",
        log="hand-over",
    )  # fmt: skip
    for line in lines:
        _wrap(line)


def _fly(rig: Rig, bus: MessageQueue, name: str) -> Flight:
    """The staircase; coil off after it."""
    begin_s = _read(bus, 0.0)[0].t_s
    rig.set_reference(REFERENCES_M[0])
    rig.set_mode("closed-loop")
    for x_ref in REFERENCES_M:
        rig.set_reference(x_ref)
        state, rms = _read(bus, HOLD_S)
        _write_line(
            f"      reference {x_ref * 1e3:.2f} mm: ball at {state.x_m * 1e3:.2f} mm, "
            f"twin off by {rms * 1e3:.0f} mA rms in current"
        )
    flight = Flight(name=name, from_t_s=begin_s, to_t_s=_read(bus, 0.0)[0].t_s)
    rig.stop()
    return flight


def _read(bus: MessageQueue, duration_s: float) -> tuple[pb.State, float]:
    """Read for `duration_s` and what is waiting; return the newest sample, and measured minus twin current, A rms."""
    end_s = time.monotonic() + duration_s
    state, errors = bus.first(pb.State, SILENCE_S), []
    if state is None:
        raise ServiceError("No samples come from the board", remedy="Look at gateway.log and emulate.log in --out")
    while (arrival := bus.take(max(0.0, end_s - time.monotonic()))) is not None:
        match arrival.message:
            case pb.State() as message:
                state = message
            case pb.Divergence(i_c_a=current) if math.isfinite(current.error):
                errors.append(current.error)
    return state, math.sqrt(sum(e * e for e in errors) / len(errors)) if errors else math.nan


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
