"""Run campaign and diagnosis in turns on a live board, until one name is left.

It records a few experiments and diagnoses them.  Then it chooses the experiment of `board51 campaign run` that tells
most, for its time, about the open question.  It records that experiment, diagnoses all recordings again, and gives the
reason of each step.  It ends when one name is left, when only noise is left, or when the budget is spent.  Diagnoses
that choose an experiment are --quick; the last one is thorough.  Ctrl-C parks the ball.  The same command continues
where it stopped, also in a folder that `campaign run` made.
"""

from __future__ import annotations

import argparse
import json
import math
import signal
import time
from pathlib import Path
from typing import TYPE_CHECKING

from gateway.campaign.options import add_rig_arguments, same_command, write_line
from protocol.bus.topics import check_name
from protocol.ending import on_signals
from protocol.errors import UsageError, require

if TYPE_CHECKING:
    from gateway.investigate.decide import Offer
    from gateway.investigate.journal import Journal

BUDGET_S = 240.0  # twice the default campaign


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = (
        "examples:\n"
        "  board51 investigate rig1 --plant my-rig.toml\n"
        "  board51 investigate rig1 --out monday --budget 120\n"
        "  board51 investigate rig1 --dry-run                    only print the first steps; sends nothing\n"
        "\nexit code 0: the answer stands; 1: it does not (no known cause, the budget is spent, interrupted, or the\n"
        "board is gone); 2: bad input"
    )
    parser.add_argument("board", metavar="RIG", help="name of the board")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="made or continued (default: investigation-RIG)")
    add_rig_arguments(parser, who="investigate")
    parser.add_argument(
        "--budget", type=float, default=BUDGET_S, metavar="S", help=f"longest time on the rig ({BUDGET_S:.0f} s)"
    )
    parser.add_argument("--quick", action="store_true", help="shorter recordings, and no thorough diagnosis at the end")
    parser.add_argument("--dry-run", action="store_true", help="print the plan and end")
    parser.add_argument("--workers", type=int, default=2, help="threads of a diagnosis (2)")
    parser.add_argument("--json", action="store_true", help="print the steps and the answer as JSON")


def run(args: argparse.Namespace) -> int:
    """Investigate; return 0 if the answer stands, otherwise 1."""
    require("twin", "numba", "mcap", "scipy", "matplotlib")  # before the rig moves for a diagnosis that cannot be made
    from gateway.investigate.investigator import investigate, menu_of
    from gateway.investigate.journal import open_journal
    from gateway.investigate.work import Work

    check_name(args.board, what="RIG")
    check_name(args.site, what="--site")
    if not (math.isfinite(args.budget) and args.budget > 0.0):
        raise UsageError(f"--budget {args.budget:g} s", remedy="Give the seconds on the rig, such as 120")
    folder = args.out or Path(f"investigation-{args.board}")
    journal, menu = open_journal(folder, args.board), menu_of(quick=args.quick)
    if args.dry_run:
        _print_plan(args, journal, menu)
        return 0
    ordered_ns = args.issued or time.time_ns()
    work = Work(folder, _rig_words(args), ordered_ns=ordered_ns, workers=args.workers, write_line=write_line)

    def write_step(line: str) -> None:
        write_line(f"[{journal.rig_s:3.0f} s on the rig] {line}")

    # Ctrl-C and SIGTERM end the step, not this process: the ball is parked first.
    with on_signals(work.stop, signal.SIGINT, signal.SIGTERM):
        try:
            investigate(work, journal, menu, budget_s=args.budget, quick=args.quick, write_line=write_step)
        finally:
            if journal.ended is None and journal.steps:
                write_line(f"To continue: {same_command('investigate')}")
    _report(args, journal)
    return 0 if journal.ended is not None and journal.ended.stands else 1


def _rig_words(args: argparse.Namespace) -> list[str]:
    """Return the options of `campaign run`."""
    words = ["--board", args.board, "--connect", args.connect, "--site", args.site, "--who", args.who]
    words += ["--seed", str(args.seed), *["--quick"] * args.quick]
    for option in ("identity", "plant", "u_max", "x_min", "x_max"):
        value = getattr(args, option)
        if value is not None:
            words += [f"--{option.replace('_', '-')}", str(value)]
    return words


def _print_plan(args: argparse.Namespace, journal: Journal, menu: dict[str, Offer]) -> None:
    from gateway.investigate.decide import next_action
    from gateway.investigate.investigator import sentence

    action = next_action(journal.known(budget_s=args.budget, quick=args.quick), menu)
    if args.json:
        offers = [
            {"name": name, "seconds": offer.seconds, "by_hand": offer.preparation} for name, offer in menu.items()
        ]
        print(json.dumps({"next": sentence(action), "rig_s": journal.rig_s, "menu": offers}))
        return
    print(f"{args.board}: {journal.rig_s:.0f} of {args.budget:.0f} s on the rig are spent, {len(journal.steps)} steps")
    print(f"next: {sentence(action)}")
    print("then: diagnose; separate equivalent causes; judge the answer; diagnose thoroughly. To choose from:")
    for name, offer in menu.items():
        print(f"  {name:<22}{offer.seconds:>4.0f} s  {offer.purpose}{'  (by hand)' * bool(offer.preparation)}")


def _report(args: argparse.Namespace, journal: Journal) -> None:
    answer, newest = journal.answer(), journal.diagnosed
    if args.json:
        more = {"folder": str(journal.folder), "answer": None if newest is None else newest.found}
        print(json.dumps(journal.to_json() | more))
        return
    if answer is None or newest is None:
        print("no diagnosis yet")
        return
    for suspect in answer.suspects:
        confounders = "".join(f", or {confounder}" for confounder in suspect.confounders)
        calibration = "" if newest.thorough else ", not calibrated"
        print(f"{suspect.name}{confounders} (confidence {suspect.confidence:.2f}{calibration})")
    print(f"{answer.verdict}: {answer.sentence}")
    ending = journal.ended.why if journal.ended is not None else "interrupted; the ball is parked"
    print(f"{ending}. {journal.rig_s:.0f} s on the rig, {len(newest.recordings)} recordings")
    print(f"report   {journal.folder / 'diagnosis' / 'report.html'}")
