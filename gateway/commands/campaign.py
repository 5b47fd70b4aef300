"""Record the paper's experiments on a live board, in a folder that `identify`, `validate` and `diagnose` read.

It drives the board through its gateway, within its limits, and writes one MCAP per experiment and campaign.toml.
Ctrl-C parks the ball and keeps the recordings; the same command continues where it stopped.
"""

from __future__ import annotations

import argparse
import json
import select
import signal
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from gateway.campaign.options import add_rig_arguments, same_command, write_line
from protocol.arguments import add_repeatable
from protocol.bus.topics import check_name
from protocol.ending import in_thread, on_signals
from protocol.errors import UsageError

if TYPE_CHECKING:
    from gateway.campaign.outcome import Summary
    from protocol.experiments import Experiment


def configure(parser: argparse.ArgumentParser) -> None:
    """`run` and its options."""
    example = (
        "examples:\n  board51 campaign run --list\n  board51 campaign run campaign-1 --board rig1 --plant my-rig.toml\n"
        "  board51 campaign run campaign-1 --board rig1 --experiment chirp --experiment holds"
    )
    parser.epilog = example
    what = parser.add_subparsers(dest="what", required=True, metavar="run")
    run_ = what.add_parser("run", help="perform the experiments", description=__doc__, epilog=example)
    run_.add_argument(
        "folder",
        type=Path,
        nargs="?",
        metavar="FOLDER",
        help="folder of the campaign; made if absent, continued if begun",
    )
    run_.add_argument("--board", default="", help="name of the board")
    add_rig_arguments(run_, who="campaign")
    run_.add_argument("--quick", action="store_true", help="about 25 s of data instead of 90 s")
    add_repeatable(run_, "--experiment", "NAME", "record only this experiment and add it to FOLDER; repeatable")
    run_.add_argument("--list", action="store_true", help="print the menu of experiments and end")
    run_.add_argument("--park", action="store_true", help="if the ball flies, land it first instead of giving up")
    run_.add_argument("--yes", action="store_true", help="you have done the preparation by hand (blocked-ball)")
    run_.add_argument("--json", action="store_true", help="print the summary as JSON")


def run(args: argparse.Namespace) -> int:
    """0 when everything asked for is in the folder, 1 when not."""
    from gateway.campaign.selection import chosen
    from protocol.experiments import EXPERIMENT_OF_NAME

    if args.list:
        _print_menu(as_json=args.json)
        return 0
    if args.folder is None or not args.board:
        raise UsageError("FOLDER and --board are needed", remedy="board51 campaign run FOLDER --board NAME")
    check_name(args.board, what="--board")
    check_name(args.site, what="--site")
    unknown = next((name for name in args.experiment if name not in EXPERIMENT_OF_NAME), None)
    if unknown is not None:
        raise UsageError(f"There is no experiment {unknown!r}", remedy=f"Choose from {', '.join(EXPERIMENT_OF_NAME)}")
    if not 0 <= args.seed <= 600:
        raise UsageError(f"--seed {args.seed} is out of range", remedy="Give a number from 0 to 600")
    return _perform(args, chosen(tuple(args.experiment), quick=args.quick))


def _perform(args: argparse.Namespace, experiments: tuple[Experiment, ...]) -> int:
    from gateway.campaign.control import RigControl, Stopped
    from gateway.campaign.folder import ASSUMED, Folder
    from gateway.campaign.outcome import Wishes
    from gateway.campaign.runner import Runner
    from gateway.campaign.selection import chosen
    from gateway.campaign.subscriber import BoardSubscriber
    from gateway.client.rig import Rig
    from protocol.campaign import load_plant
    from protocol.experiments import LIFT_OFF

    folder = Folder(args.folder)
    plant = load_plant(args.plant) if args.plant is not None else folder.plant
    stop = threading.Event()
    rig = Rig(
        args.board, connect=args.connect, site=args.site, identity=args.identity, who=args.who, stop_on_error=False
    )
    with rig:
        subscriber = BoardSubscriber(rig, args.issued or time.time_ns())
        control = RigControl(rig, subscriber, stop)
        wishes = Wishes(
            experiments=experiments, plant=plant or ASSUMED, lift_off=chosen((LIFT_OFF,), quick=args.quick)[0],
            seed=args.seed, quick=args.quick, park=args.park, u_max_v=args.u_max,
            x_min_m=None if args.x_min is None else args.x_min * 1e-3,
            x_max_m=None if args.x_max is None else args.x_max * 1e-3,
            prepare=lambda experiment: "" if args.yes else _request_preparation(experiment, stop),
        )  # fmt: skip
        try:
            with on_signals(in_thread(stop.set), signal.SIGINT, signal.SIGTERM):
                if args.plant is None and wishes.plant.assumed and (card := control.await_card()) is not None:
                    wishes = replace(wishes, plant=card)
                control.travel_m = wishes.plant.travel_m
                summary = Runner(control, subscriber, folder, args.board, wishes, write_line).run()
            ended_ns = time.time_ns()
        except Stopped:
            write_line("interrupted before the board's first sample: nothing was sent to it")
            return 1
    _report(args, summary, ended_ns)
    return 0 if summary.complete else 1


def _request_preparation(experiment: Experiment, stop: threading.Event) -> str:
    if not sys.stdin.isatty():
        return f"{experiment.person.rstrip('.')}, then say so with --yes"
    write_line(f"    {experiment.person}\n    Done? Type y to continue, anything else to skip it:")
    # Not input(): it would go on waiting after Ctrl-C, which here only sets `stop`.
    while not stop.is_set():
        if (answer := _typed(0.2)) is not None:
            return "" if answer.strip().lower() in ("y", "yes") else "not confirmed"
    return "not confirmed"


def _typed(wait_s: float) -> str | None:
    """Return what was typed, a line (on Windows a key); None if nothing was within `wait_s`."""
    if sys.platform != "win32":
        return sys.stdin.readline() if select.select([sys.stdin], [], [], wait_s)[0] else None
    import msvcrt

    time.sleep(wait_s)
    return msvcrt.getwche() if msvcrt.kbhit() else None


def _print_menu(*, as_json: bool) -> None:
    from protocol.experiments import MENU

    if as_json:
        rows = [
            {"name": e.name, "kind": e.kind, "use": e.use, "about": e.purpose, "duration_s": e.duration_s,
             "default": e.standard, "quick": e.standard and e.quick > 0.0, "person": e.person}
            for e in MENU
        ]  # fmt: skip
        print(json.dumps(rows))
        return
    print(f"{'name':<22}{'kind':<16}{'use':<7}{'s':>4}  what for")
    for e in MENU:
        mark = "" if e.standard else "  (only by --experiment)"
        print(f"{e.name:<22}{e.kind:<16}{e.use:<7}{e.duration_s:>4.0f}  {e.purpose}{mark}")
    seconds = sum(e.duration_s for e in MENU if e.standard)
    print(f"\nThe default run has {seconds:.0f} s of data.")


def _report(args: argparse.Namespace, summary: Summary, ended_ns: int) -> None:
    again = same_command("campaign")
    if args.json:
        rows = [
            {"name": o.experiment.name, "use": o.experiment.use, "standing": o.standing, "seconds": o.seconds,
             "attempts": o.attempts, "said": o.problems}
            for o in summary.outcomes
        ]  # fmt: skip
        content = {
            "folder": str(args.folder), "complete": summary.complete, "interrupted": summary.interrupted,
            "failure": summary.failure, "parked": not summary.parked, "lift_off_v": summary.lift_off_v,
            "rig_s": summary.rig_s, "ended_ns": ended_ns, "experiments": rows, "again": again,
        }  # fmt: skip
        print(json.dumps(content))
    else:
        print(f"{'recording':<24}{'use':<8}{'s':>6}  {'tries':>5}  standing")
        for o in summary.outcomes:
            why = f": {o.problems[-1]}" if o.problems and not o.is_recorded else ""
            standing = o.standing.replace("-", " ")
            print(f"{o.experiment.name:<24}{o.experiment.use:<8}{o.seconds:>6.1f}  {o.attempts:>5}  {standing}{why}")
    for text in summary.restored:
        write_line(text)
    if summary.parked:
        write_line(f"THE COIL MAY BE ON: STOP was not delivered ({summary.parked}). Switch the rig off by hand")
    if summary.failure:
        write_line(summary.failure)
    if summary.complete:
        print(f"board51 identify {args.folder} --out model.json", file=sys.stderr if args.json else sys.stdout)
        return
    recorded = sum(o.is_recorded for o in summary.outcomes)
    why = "interrupted" if summary.interrupted else "not complete"
    parked = "" if summary.parked else "ball parked, coil off; "
    write_line(
        f"{why}: {parked}{recorded} of {len(summary.outcomes)} recordings are in {args.folder}. To continue: {again}"
    )
