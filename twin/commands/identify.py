"""Identify a model from the recordings of a campaign: K_A, T_A, K_c, b with intervals and verdicts, and the noise.

Takes campaign.toml or its folder; recordings may be CSV (also .gz), MATLAB or MCAP.  No initial guess is needed.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from protocol.errors import DataError
from twin.commands import add_show, progress_printer, show_text


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = (
        "examples:\n"
        "  board51 identify runs/monday --out model.json\n"
        "  board51 identify twin/campaigns/inteco.toml --data ../shared/data --out inteco.json\n"
        "\nexit code 0: K_A and K_c are known and the fit converged; 1: otherwise (the best fit so far is written);\n"
        "2: bad input"
    )
    parser.add_argument("campaign", type=Path, metavar="CAMPAIGN", help="campaign.toml or the folder that holds it")
    parser.add_argument("--out", type=Path, metavar="MODEL.json", help="write the model there")
    parser.add_argument("--name", default="", help="name of the model for people (default: plant and day)")
    parser.add_argument("--data", type=Path, metavar="DIR", help="folder of recordings not beside the campaign")
    parser.add_argument("--json", action="store_true", help="print the model as JSON instead of a table")
    add_show(parser)
    parser.add_argument("--quiet", action="store_true", help="no progress on stderr")


def run(args: argparse.Namespace) -> int:
    """Identify, print, write."""
    # Imported here: --help must not wait for numba and scipy.
    from twin.api.functions import identify
    from twin.api.results import as_text

    if args.out is not None and (args.out.is_dir() or not os.access(args.out.parent, os.W_OK)):
        # Before the work, which can take a minute.
        raise DataError(f"{args.out} cannot be written", remedy="Give a file in a writable folder")
    progress = progress_printer(quiet=args.quiet)
    result = identify(args.campaign, name=args.name, data=args.data, progress=progress)
    if args.out is not None:
        result.model.save(args.out)
    print(as_text(result.to_json()) if args.json else result.table())
    if args.json:
        for warning in result.warnings:
            progress(f"! {warning}")
    if not result.usable:
        progress("no usable model; this is the best fit so far" + (f" is in {args.out}" if args.out else ""))
    if args.show:
        page = (args.out or Path("identify")).with_suffix(".html")
        show_text(page, f"Model of {result.model.plant.name}", result.table())
    return 0 if result.usable else 1
