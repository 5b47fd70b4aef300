"""Find the physical causes of a model's errors, and extend the model by them.

Takes campaign.toml or its folder, tests every cause of the catalogue on all recordings together, and writes
diagnosis.json, report.html and extended_model.json.  The result says if the model is adequate, if no known cause
explains the data, and which causes these data cannot distinguish.  With --live it records the campaign from a running
board; the last quarter of the flights is used to judge.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from protocol.arguments import whole_number
from protocol.errors import UsageError
from twin.commands import progress_printer
from twin.inference.budget import MILLION
from twin.live.shell import check_options, configure_live, give_to_twin, record_live
from twin.settings import diagnosis as settings


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = (
        "examples:\n"
        "  board51 diagnose runs/monday --out diagnosis\n"
        "  board51 diagnose runs/monday --model model.json --quick --out diagnosis\n"
        "  board51 diagnose --all runs --out diagnoses                       every campaign below a folder\n"
        "  board51 diagnose --all runs --out diagnoses --scheduler tcp://10.0.0.5:8786\n"
        "  board51 diagnose --live 2 --board rig1 --out diagnosis --hand-over    the last two minutes of a board\n"
        "\nexit code 0: causes found, possibly for a part, or the model is adequate; 1: the model is wrong and no\n"
        "known cause explains it, or the search ended by its budget; 2: bad input"
    )
    parser.add_argument("campaign", type=Path, nargs="?", metavar="CAMPAIGN", help="campaign.toml, or its folder")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for diagnosis.json, report.html, models")
    parser.add_argument("--model", metavar="MODEL.json", help="the simulation to judge (default: the paper's, fitted)")
    parser.add_argument("--data", type=Path, metavar="DIR", help="folder of recordings not beside the campaign")
    _add_search_options(parser)
    parser.add_argument("--seed", type=int, default=0, help="seed of the bootstrap (0)")
    parser.add_argument("--workers", type=int, default=2, help="threads (2); the result does not depend on it")
    parser.add_argument(
        "--figures", choices=("png", "pdf", "svg"), help="also write each figure of the report into --out"
    )
    parser.add_argument(
        "--all", action="store_true", help="CAMPAIGN is a folder: diagnose each campaign below it, into --out"
    )
    parser.add_argument(
        "--processes", type=whole_number, default=2, metavar="N", help="with --all: number of campaigns at a time (2)"
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="with --all: address of a Dask cluster whose workers see the same folders",
    )
    parser.add_argument("--json", action="store_true", help="print diagnosis.json instead of a summary")
    parser.add_argument("--quiet", action="store_true", help="no progress on stderr")
    configure_live(parser)


def _add_search_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say what is searched, and how thoroughly."""
    parser.add_argument(
        "--quick",
        action="store_true",
        help="fewer candidates, the first seconds of each flight; confidence is then less reliable",
    )
    parser.add_argument(
        "--share",
        type=float,
        default=settings.MIN_SHARE,
        metavar="S",
        help="least part of what is left in a channel that a cause must explain (%(default)s); less, down to 0.01,"
        " lists smaller ones beside a rest that nothing explains: confidence is not calibrated then",
    )
    parser.add_argument(
        "--next-experiment",
        action="store_true",
        help="also with --quick: find the experiment that separates the causes of a class",
    )
    parser.add_argument(
        "--free-form",
        action="store_true",
        help="model the rest by smooth curves also with --quick, and if it looks like noise",
    )
    parser.add_argument(
        "--without",
        action="append",
        default=[],
        metavar="CAUSE",
        help="leave this cause out of the catalogue (again for more): is it missed, or is another named for it?",
    )
    quick, full = settings.BUDGET_QUICK / MILLION, settings.BUDGET_FULL / MILLION
    parser.add_argument(
        "--budget",
        type=float,
        metavar="M",
        help="most that is computed, in millions of filter steps: 5 to 12 take a second of processor time, and the"
        f" answer is the same on any machine ({quick:.0f} with --quick, else {full:.0f})",
    )


def run(args: argparse.Namespace) -> int:
    """Diagnose, print, write."""
    # Imported here: --help must not wait for numba and scipy.
    from twin.api.functions import diagnose
    from twin.api.results import as_text, save_figures

    progress = progress_printer(quiet=args.quiet)
    check_options(args)
    if args.figures is not None and args.out is None:
        raise UsageError("--figures without --out", remedy="Give the folder of the report with --out")
    if args.all:
        return _run_all(args, progress)
    board = ""
    if args.live is not None:
        args.campaign, board = record_live(args, progress)
    result = diagnose(args.campaign, data=args.data, workers=args.workers, progress=progress, **_options(args))
    if args.out is not None:
        result.save(args.out)
        if args.figures is not None:
            save_figures(result.figures(), args.out / "figures", args.figures)
    print(as_text(result.to_json()) if args.json else result.summary(args.out))
    if args.hand_over and result.offered:
        # To stderr beside --json: what is parsed stays one object.
        accepted = give_to_twin(args, args.out / "extended_model.json", board, progress if args.json else print)
        if not accepted:
            return 1
    elif args.hand_over:
        progress("no model of this diagnosis is significantly better than the reference: the twin keeps its model")
    return 1 if result.verdict in ("unknown-cause", "unfinished") else 0


def _options(args: argparse.Namespace) -> dict[str, Any]:
    """Return the options of a diagnosis that its answer depends on."""
    return {
        "model": args.model,
        "quick": args.quick,
        "share": args.share,
        "experiments": args.next_experiment or None,
        "free_form": args.free_form or None,
        "without": args.without,
        "seed": args.seed,
        "budget": args.budget,
    }


def _run_all(args: argparse.Namespace, progress: Callable[[str], None]) -> int:
    """Diagnose each campaign below a folder, and print a line for each."""
    from twin.api.many import diagnose_all

    if args.campaign is None or args.out is None:
        raise UsageError("--all needs a folder of campaigns and --out", remedy="Give both")
    if args.live is not None or args.hand_over or args.figures is not None:
        raise UsageError("--all excludes --live, --hand-over and --figures", remedy="Leave those out")
    if args.processes < 1:
        raise UsageError(f"--processes {args.processes}", remedy="Give a number from 1")
    answers = diagnose_all(
        args.campaign,
        args.out,
        scheduler=args.scheduler,
        processes=args.processes,
        data=args.data and args.data.resolve(),
        progress=progress,
        **_options(args),
    )
    for answer in answers:
        causes = ", ".join(answer.causes) or answer.error or "-"
        print(json.dumps(asdict(answer)) if args.json else f"{answer.campaign}: {answer.verdict}: {causes}")
    return 1 if any(answer.verdict in ("unknown-cause", "unfinished", "failed") for answer in answers) else 0
