"""Run the twin with a live rig or over a log: twin state, divergence and alarms.

Live, it joins the bus, follows every board of the site and publishes <site>/<board>/twin/state, twin/divergence,
twin/alarm and twin/model until SIGINT or SIGTERM.  With --hand-over it sends a model to the running twins, which use it
from the next sample on.  With --log it runs over a log instead and prints a summary.
"""

from __future__ import annotations

import argparse
import json
import logging
import math
import sys
import threading
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from protocol.bus.endpoint import DEFAULT_ENDPOINT
from protocol.bus.identity import HELP, find_identity, login_name
from protocol.bus.topics import DEFAULT_SITE, check_name
from protocol.ending import end_at_once, note_end, on_end_signal
from protocol.errors import Board51Error, UsageError
from twin.live.shell import endpoints_of
from twin.model.parameters import SHIPPED, Model
from twin.settings.mirror import Settings

REPORT_S = 10.0  # between two lines about each board


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = (
        "examples:\n"
        "  board51 twin                                  every board behind the gateway on this machine\n"
        "  board51 twin --board rig1 --model model.json  one board, parameters as identified\n"
        "  board51 twin --hand-over model.json           the running twins use this model, without a restart\n"
        "  board51 twin --log run.mcap --out twin.mcap   over a log; twin topics into a new one\n"
        "\nexit code 0: done; 1: with --hand-over, a twin refused or none answered; with --fail-on-alarm, an alarm on\n"
        "divergence or innovation was raised; 2: bad input"
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
    parser.add_argument("--identity", metavar="FOLDER", help=HELP)
    parser.add_argument(
        "--hand-over", metavar="FILE", help="give this model (file, or name of a shipped one) to the twins that run"
    )
    parser.add_argument(
        "--who", default="", help="with --hand-over: who does it, for the log (default: the login name)"
    )
    parser.add_argument(
        "--id", default="", help="with --hand-over: the same id is executed at most once (default: a new one)"
    )
    parser.add_argument("--log", type=Path, metavar="LOG.mcap", help="run over a log instead of live")
    parser.add_argument("--out", type=Path, metavar="OUT.mcap", help="with --log: samples and twin topics go there")
    parser.add_argument("--json", action="store_true", help="with --log, --hand-over: print the outcome as JSON")
    parser.add_argument("--fail-on-alarm", action="store_true", help="with --log: exit code 1 where the model is wrong")
    parser.add_argument("--duration", type=float, metavar="S", help="live: stop after this many seconds")
    parser.add_argument(
        "--diagnosis-after",
        type=float,
        default=Settings().diagnosis_after_s,
        metavar="S",
        help="live: alarms that last this long raise diagnosis-wanted (%(default)s; 0: never)",
    )
    parser.add_argument(
        "--no-names", action="store_true", help="live: do not name causes in flight (saves 3 %% of a core per board)"
    )


def add_model_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of every command with a twin."""
    parser.add_argument(
        "--model",
        default=SHIPPED[0],
        metavar="FILE",
        help=f"model.json, or the name of a shipped model: {', '.join(SHIPPED)} (default {SHIPPED[0]})",
    )
    parser.add_argument(
        "--window", type=float, default=Settings().window_s, metavar="S", help="window of RMSE, fit and alarms (1)"
    )
    parser.add_argument(
        "--false-alarms-per-day",
        type=float,
        default=Settings().false_alarms_per_day,
        metavar="RATE",
        help="rate of false alarms of each kind under a right model (%(default)s)",
    )


def chosen_settings(args: argparse.Namespace) -> Settings:
    """The settings of the options.  Raises UsageError for a value out of range."""
    if not (math.isfinite(args.window) and 0.05 <= args.window <= 60.0):
        raise UsageError(f"--window {args.window:g} is outside 0.05 .. 60 s", remedy="Use 1 s")
    rate = args.false_alarms_per_day
    if not (math.isfinite(rate) and 1e-6 <= rate <= 1e4):
        raise UsageError(f"--false-alarms-per-day {rate:g} is outside 1e-6 .. 1e4", remedy="Use 0.1: one in ten days")
    after_s = getattr(args, "diagnosis_after", Settings().diagnosis_after_s)  # `plot` has no live twin
    if not 0.0 <= after_s <= 86400.0:
        raise UsageError(f"--diagnosis-after {after_s:g} is outside 0 .. 86400 s", remedy="Use 30 s, or 0 for never")
    return Settings(window_s=args.window, false_alarms_per_day=rate, diagnosis_after_s=after_s)


def run(args: argparse.Namespace) -> int:
    """Run live or over a log, or hand a model over."""
    if args.board:
        check_name(args.board, what="--board")
    check_name(args.site, what="--site")
    if args.hand_over is None and (args.who or args.id):
        raise UsageError("--who and --id are for a hand-over", remedy="Add --hand-over MODEL.json")
    if args.log and args.hand_over is not None:
        raise UsageError("--log and --hand-over exclude each other", remedy="A twin over a log takes --model")
    if args.log:
        return _over_log(args, Model.load(args.model), chosen_settings(args))
    if args.out or args.fail_on_alarm or (args.json and args.hand_over is None):
        raise UsageError("--out, --json and --fail-on-alarm are for a log", remedy="Add --log LOG.mcap")
    endpoints = endpoints_of(args)
    if args.hand_over is not None:
        return _hand_over(args, endpoints)
    return _live(args, Model.load(args.model), chosen_settings(args), endpoints)


def _hand_over(args: argparse.Namespace, endpoints: tuple[str, ...]) -> int:
    from twin.mirror.bus.client import hand_over
    from twin.mirror.bus.handover import MAX_WORD, believe

    who = args.who or login_name()
    for what, word in (("--who", who), ("--id", args.id)):
        if len(word) > MAX_WORD or not word.isprintable():
            raise UsageError(
                f"{what} {word[:MAX_WORD]!r} is not a name", remedy=f"Use up to {MAX_WORD} printable characters"
            )
    belief = believe(Model.load(args.hand_over), who=who)
    answers = hand_over(
        belief,
        site=args.site,
        board=args.board,
        endpoints=endpoints,
        command_id=args.id,
        identity=find_identity(args.identity),
    )
    if args.json:
        rows = [
            {
                "board": answer.board,
                "accepted": answer.reply.accepted,
                "reason": answer.reply.reason,
                "text": answer.reply.text,
                "from_tick": answer.reply.tick if answer.reply.accepted else None,
            }
            for answer in answers
        ]
        print(json.dumps({"model": belief.model.name, "sha256": belief.sha256, "twins": rows}, indent=2))
    else:
        for answer in answers:
            since = f", from tick {answer.reply.tick}" if answer.reply.accepted and answer.reply.tick else ""
            print(f"{args.site}/{answer}{since}")
    return 0 if all(answer.reply.accepted for answer in answers) else 1


def _live(args: argparse.Namespace, model: Model, settings: Settings, endpoints: tuple[str, ...]) -> int:
    from twin.live.naming.namer import namers
    from twin.mirror.bus.service import TwinService
    from twin.mirror.warm_up import compile_kernels
    from twin.model.simulate import left_out

    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
    log = logging.getLogger("twin")
    deadline = time.monotonic() + args.duration if args.duration else math.inf
    identity = find_identity(args.identity)
    if identity is not None:
        identity.check_valid(datetime.now(UTC))
    end_at_once()  # where nothing is compiled yet the next two take a minute, in which no signal would be heeded
    naming = None if args.no_names else namers(model)
    compile_kernels(model)
    stop = threading.Event()
    on_end_signal(stop.set)
    with TwinService(
        model,
        site=args.site,
        board=args.board,
        endpoints=endpoints,
        settings=settings,
        identity=identity,
        namers=naming,
    ) as service:
        log.info("twin of model %s on %s/%s via %s", model.name, args.site, args.board or "*", endpoints[0])
        for line in left_out(model):
            log.info("%s", line)
        counted: dict[str, int] = {}
        reported_s = time.monotonic()
        while not stop.wait(0.2) and time.monotonic() < deadline and service.failure is None:
            if time.monotonic() - reported_s < REPORT_S:
                continue
            reported_s = time.monotonic()
            for name, watched in list(service.boards.items()):
                new = watched.samples - counted.get(name, 0)
                counted[name] = watched.samples
                active = ", ".join(watched.alarms) or "none"
                log.info(
                    "board %s: model %s, %s, %.0f samples/s, alarms: %s",
                    name,
                    watched.belief.title,
                    watched.mirror.sync,
                    new / REPORT_S,
                    active,
                )
            if not service.boards:
                log.info("no samples yet on %s/%s/state", args.site, args.board or "*")
        note_end()
    log.info("stopped; %d samples dropped, %d messages malformed", service.dropped, service.malformed)
    if isinstance(service.failure, Board51Error):
        raise service.failure
    return 1 if service.failure else 0


def _over_log(args: argparse.Namespace, model: Model, settings: Settings) -> int:
    from twin.mirror.bus.handover import believe
    from twin.mirror.offline import run_log
    from twin.model.simulate import left_out

    started = time.perf_counter()
    for line in left_out(model):
        print(f"! {line}", file=sys.stderr)
    runs, complete = run_log(args.log, model, settings=settings, board=args.board, out=args.out)
    elapsed = time.perf_counter() - started
    summaries = [run.summary() for run in runs]
    if args.json:
        result = {
            "log": str(args.log),
            "complete": complete,
            "model": model.name,
            "model_sha256": believe(model).sha256,
            "boards": summaries,
        }
        print(json.dumps(result, indent=2))
    else:
        if not complete:
            print(f"{args.log} was not closed; it was read as far as possible")
        print(f"model {believe(model).title} throughout")
        for summary in summaries:
            _print(summary)
        samples = sum(run.samples for run in runs)
        print(f"{samples} samples in {elapsed:.1f} s" + (f"; twin topics in {args.out}" if args.out else ""))
    wrong = any(alarm["active"] and alarm["name"] != "out-of-step" for s in summaries for alarm in s["alarms"])
    return 1 if args.fail_on_alarm and wrong else 0


def _print(summary: dict[str, Any]) -> None:
    def formatted(value: float | None, scale: float, unit: str) -> str:
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
    for model in summary["models_logged"]:
        title, whose = f"{model['name']} ({model['sha256'][:12]})", f", handed over by {model['who']}"
        print(f"  the live twin ran on {title} from tick {model['since_tick']}" + (whose if model["who"] else ""))
    if not summary["starts"]:
        print("  no free twin: the log lacks the control law (or no sample could start it); only the observer ran")
    rmse, bias = summary["rmse"], summary["bias"]
    for name, (scale, unit) in {"x_m": (1e6, "um"), "i_c_a": (1e3, "mA"), "u_c_v": (1e3, "mV")}.items():
        if rmse[name] is not None:
            spread, mean = formatted(rmse[name], scale, unit), formatted(bias[name], scale, unit)
            print(f"  measured - twin {name:6}: rms {spread}, mean {mean}")
    if summary["innovations"]:
        innovation = summary["innovation_rmse"]
        print(
            f"  one-step innovation: x {formatted(innovation['x_m'], 1e6, 'um')}, "
            f"i_c {formatted(innovation['i_c_a'], 1e3, 'mA')}, "
            f"NIS mean {summary['nis_mean']:.3g} (a right model: 2), {summary['innovations']} samples"
        )
    for alarm in summary["alarms"]:
        state = "ON " if alarm["active"] else "off"
        print(
            f"  alarm {state} {alarm['name']} at tick {alarm['tick']}: {alarm['value']:.4g} "
            f"(threshold {alarm['threshold_on']:.4g}), {alarm['text']}"
        )
