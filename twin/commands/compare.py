"""Compare two models on the same flights, two flights under one model, or the parameters of models over time.

A campaign in place of a model is identified first.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from protocol.campaign import Campaign
from protocol.errors import UsageError
from twin.commands import progress_printer
from twin.model.parameters import SHIPPED, Model

if TYPE_CHECKING:
    from twin.comparison.comparison import Comparison


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = (
        "examples:\n"
        "  board51 compare model.json extended_model.json --on runs/monday/flight.mcap --out comparison\n"
        "  board51 compare monday.mcap friday.mcap --under model.json --out comparison\n"
        "  board51 compare runs/october runs/november runs/december --out drift\n"
        "\nexit code 0: compared; 2: bad input"
    )
    parser.add_argument("sides", nargs="+", metavar="A", help="models or campaigns; with --under two recordings")
    parser.add_argument("--on", nargs="+", type=Path, metavar="RECORDING", help="flights that judge two models")
    parser.add_argument("--under", metavar="MODEL", help="the model under which two flights are compared")
    parser.add_argument("--campaign", type=Path, metavar="CAMPAIGN", help="columns and skip_s of the recordings")
    parser.add_argument("--data", type=Path, metavar="DIR", help="folder of recordings not beside their campaign")
    parser.add_argument("--board", metavar="BOARD", help="board, for logs of several boards")
    parser.add_argument("--out", type=Path, metavar="DIR", help="gets compare.html and compare.json")
    parser.add_argument("--json", action="store_true", help="print the numbers as JSON")
    parser.add_argument("--quiet", action="store_true", help="no progress on stderr")


def run(args: argparse.Namespace) -> int:
    """Compare, write, print."""
    # Imported here: --help must not wait for numba and scipy.
    from protocol.files import make_folder
    from twin.api.results import as_text, write_text
    from twin.comparison import report

    _check(args)
    if args.out is not None:
        make_folder(args.out)  # before the work
    result = _compared(args)
    if args.out is not None:
        write_text(args.out / "compare.json", as_text(report.to_dict(result)) + "\n")
        write_text(args.out / "compare.html", report.to_html(result))
    print(as_text(report.to_dict(result)) if args.json else report.to_text(result))
    if args.out is not None and not args.json:
        print(f"\n{args.out / 'compare.html'}")
    return 0


def _check(args: argparse.Namespace) -> None:
    """Refuse sides that cannot be compared.  Raises UsageError."""
    given = len(args.sides)
    if args.on and args.under:
        raise UsageError(
            "--on and --under exclude each other", remedy="Two models --on flights, or two flights --under a model"
        )
    if (args.on or args.under) and given != 2:
        what = "models" if args.on else "flights"
        raise UsageError(f"{given} given where two {what} are compared", remedy=f"Name two {what}")
    if given < 2:
        raise UsageError("one side alone", remedy="Name two or more models or campaigns")


def _compared(args: argparse.Namespace) -> Comparison:
    from twin.comparison.comparison import compare_flights, compare_models, compare_over_time
    from twin.readers.campaign import read_flight

    listed = None if args.campaign is None else Campaign.load(args.campaign)
    paths = [Path(side) for side in args.sides] if args.under else args.on or []
    flights = [read_flight(path, listed, data=args.data, board=args.board) for path in paths]
    if args.under:
        return compare_flights(Model.load(args.under), flights)
    progress = progress_printer(quiet=args.quiet)
    models = [_model(side, args.data, quiet=args.quiet) for side in args.sides]
    return compare_models(models, flights, progress=progress) if flights else compare_over_time(models)


def _model(side: str, data: Path | None, *, quiet: bool) -> Model:
    """Load a model; identify it if `side` is a campaign."""
    from twin.api.functions import identify

    if side in SHIPPED or not (Path(side).is_dir() or side.endswith(".toml")):
        return Model.load(side)
    progress = progress_printer(quiet=quiet)
    progress(f"identifying {side}")
    return identify(Path(side), data=data, progress=progress).model
