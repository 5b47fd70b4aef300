"""The model in step with a live rig, or over a log: twin state, divergence and alarms.

Live, it joins the bus, follows every board of the site and publishes <site>/<board>/twin/state, twin/divergence and
twin/alarm until SIGINT or SIGTERM.  With --log it runs over a log instead and prints what it saw.
"""

from __future__ import annotations

import argparse
import json
import logging
import math
import signal
import threading
import time
from pathlib import Path
from typing import Any

from protocol.bus.endpoint import DEFAULT_ENDPOINT, check_endpoint
from protocol.bus.topics import DEFAULT_SITE, check_name
from protocol.errors import UsageError
from twin.mirror.settings import Settings
from twin.model.nominal import SHIPPED, nominal
from twin.model.parameters import Model, load_model

REPORT_S = 10.0  # between two lines about each board


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = (
        "examples:\n"
        "  board51 twin                                  every board behind the gateway on this machine\n"
        "  board51 twin --board rig1 --model model.json  one board, parameters as identified\n"
        "  board51 twin --log run.mcap --out twin.mcap   over a log; twin topics into a new one\n"
        "\nexit code 0: done; 1: with --fail-on-alarm, a divergence or innovation alarm was raised; 2: bad input"
    )
    add_model_options(parser)
    parser.add_argument("--site", default=DEFAULT_SITE, help="first chunk of the keys (default %(default)s)")
    parser.add_argument("--board", help="only this board (default: all)")
    parser.add_argument(
        "--connect",
        metavar="ENDPOINT",
        action="append",
        help=f"where the gateway or a router listens (default {DEFAULT_ENDPOINT})",
    )
    parser.add_argument("--log", type=Path, metavar="LOG.mcap", help="run over a log instead of live")
    parser.add_argument("--out", type=Path, metavar="OUT.mcap", help="with --log: samples and twin topics go there")
    parser.add_argument("--json", action="store_true", help="with --log: print the summary as JSON")
    parser.add_argument("--fail-on-alarm", action="store_true", help="with --log: exit code 1 where the model is wrong")
    parser.add_argument("--duration", type=float, metavar="S", help="live: stop after so many seconds")


def add_model_options(parser: argparse.ArgumentParser) -> None:
    """Options that every command with a twin has."""
    parser.add_argument(
        "--model",
        default=SHIPPED[0],
        metavar="FILE",
        help=f"model.json, or the name of a shipped model: {', '.join(SHIPPED)} (default %(default)s)",
    )
    parser.add_argument(
        "--window", type=float, default=Settings().window_s, metavar="S", help="window of RMSE, fit and alarms (1)"
    )
    parser.add_argument(
        "--false-alarms-per-day",
        type=float,
        default=Settings().false_alarms_per_day,
        metavar="RATE",
        help="of each alarm under a right model (%(default)s)",
    )


def chosen_model(args: argparse.Namespace) -> Model:
    """The model of `--model`."""
    return nominal(args.model) if args.model in SHIPPED else load_model(args.model)


def chosen_settings(args: argparse.Namespace) -> Settings:
    """Window and rate, checked."""
    if not (math.isfinite(args.window) and 0.05 <= args.window <= 60.0):
        raise UsageError(f"--window {args.window:g} is outside 0.05 .. 60 s", remedy="Use 1 s unless you know better")
    rate = args.false_alarms_per_day
    if not (math.isfinite(rate) and 1e-6 <= rate <= 1e4):
        raise UsageError(f"--false-alarms-per-day {rate:g} is outside 1e-6 .. 1e4", remedy="Use 0.1: one in ten days")
    return Settings(window_s=args.window, false_alarms_per_day=rate)


def run(args: argparse.Namespace) -> int:
    """Live, or over a log."""
    model, settings = chosen_model(args), chosen_settings(args)
    if args.board:
        check_name(args.board, what="--board")
    check_name(args.site, what="--site")
    if args.log:
        return _over_log(args, model, settings)
    if args.out or args.json or args.fail_on_alarm:
        raise UsageError("--out, --json and --fail-on-alarm are for a log", remedy="Add --log LOG.mcap")
    endpoints = tuple(check_endpoint(one, where="--connect") for one in args.connect or [DEFAULT_ENDPOINT])
    return _live(args, model, settings, endpoints)


def _live(args: argparse.Namespace, model: Model, settings: Settings, endpoints: tuple[str, ...]) -> int:
    from twin.mirror.service import TwinService

    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    log = logging.getLogger("twin")
    deadline = time.monotonic() + args.duration if args.duration else math.inf
    with TwinService(model, site=args.site, board=args.board, endpoints=endpoints, settings=settings) as service:
        log.info("twin of model %s on %s/%s via %s", model.plant.name, args.site, args.board or "*", endpoints[0])
        counted: dict[str, int] = {}
        told = time.monotonic()
        while not stop.wait(0.2) and time.monotonic() < deadline and service.failure is None:
            if time.monotonic() - told < REPORT_S:
                continue
            told = time.monotonic()
            for name, watched in service.boards.items():
                new = watched.samples - counted.get(name, 0)
                counted[name] = watched.samples
                active = ", ".join(alarm for alarm, on in watched.alarms.items() if on) or "none"
                log.info("board %s: %s, %.0f samples/s, alarms: %s", name, watched.mirror.sync, new / REPORT_S, active)
            if not service.boards:
                log.info("no samples yet on %s/%s/state", args.site, args.board or "*")
    log.info("stopped; %d samples dropped, %d messages malformed", service.dropped, service.malformed)
    return 1 if service.failure else 0


def _over_log(args: argparse.Namespace, model: Model, settings: Settings) -> int:
    from twin.mirror.offline import run_log

    started = time.perf_counter()
    runs, complete = run_log(args.log, model, settings=settings, board=args.board, out=args.out)
    elapsed = time.perf_counter() - started
    summaries = [run.summary() for run in runs]
    if args.json:
        result = {"log": str(args.log), "complete": complete, "model": model.plant.name, "boards": summaries}
        print(json.dumps(result, indent=2))
    else:
        if not complete:
            print(f"{args.log} was not closed; read as far as it goes")
        for summary in summaries:
            _print(summary)
        samples = sum(run.samples for run in runs)
        print(f"{samples} samples in {elapsed:.1f} s" + (f"; twin topics in {args.out}" if args.out else ""))
    wrong = any(alarm["active"] and alarm["name"] != "out-of-step" for s in summaries for alarm in s["alarms"])
    return 1 if args.fail_on_alarm and wrong else 0


def _print(summary: dict[str, Any]) -> None:
    def shown(value: float | None, scale: float, unit: str) -> str:
        return "-" if value is None else f"{value * scale:.4g} {unit}"

    print(
        f"board {summary['board']}: {summary['samples']} samples, "
        f"{summary['from_t_s']:.2f} .. {summary['to_t_s']:.2f} s"
    )
    print(
        f"  in step {summary['in_step']}, settling {summary['settling']}, out of step {summary['out_of_step']}, "
        f"bridged ticks {summary['bridged_ticks']}"
    )
    for why, count in summary["why_out_of_step"].items():
        print(f"  lost step {count} x: {why}")
    if not summary["starts"]:
        print("  no free twin: the log does not say which law ran (or no sample could start it); the observer alone")
    rmse, bias = summary["rmse"], summary["bias"]
    for name, (scale, unit) in {"x_m": (1e6, "um"), "i_c_a": (1e3, "mA"), "u_c_v": (1e3, "mV")}.items():
        if rmse[name] is not None:
            spread, mean = shown(rmse[name], scale, unit), shown(bias[name], scale, unit)
            print(f"  measured - twin {name:6}: rms {spread}, mean {mean}")
    if summary["innovations"]:
        innovation = summary["innovation_rmse"]
        print(
            f"  one-step innovation: x {shown(innovation['x_m'], 1e6, 'um')}, "
            f"i_c {shown(innovation['i_c_a'], 1e3, 'mA')}, "
            f"NIS mean {summary['nis_mean']:.3g} (a right model: 2), {summary['innovations']} samples"
        )
    for alarm in summary["alarms"]:
        state = "ON " if alarm["active"] else "off"
        print(
            f"  alarm {state} {alarm['name']} at tick {alarm['tick']}: {alarm['value']:.4g} "
            f"(threshold {alarm['threshold_on']:.4g}), {alarm['text']}"
        )
