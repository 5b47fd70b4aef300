"""Validate a model on recordings: the paper's figures with their numbers, as one HTML page and JSON.

Uses the recordings with use = "judge".  Tests amplifier and ball in open loop, prediction errors against the noise
floor, and the residuals.  Compares simulated and measured step responses in closed loop.  Tests for which the campaign
has no data are reported as such and are not an error.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from protocol.campaign import Campaign
from protocol.files import make_folder
from twin.commands import add_show, progress_printer, show
from twin.model.parameters import Model


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = (
        "examples:\n"
        "  board51 validate runs/monday --model model.json --out report\n"
        "  board51 validate twin/campaigns/inteco.toml --data ../shared/data --model inteco.json --out report\n"
        "\nexit code 0: the report is written and nothing contradicts the model; 1: something does, or nothing in\n"
        "flight could be tested; 2: bad input"
    )
    parser.add_argument("campaign", type=Path, metavar="CAMPAIGN", help="campaign.toml or the folder that holds it")
    parser.add_argument("--model", type=Path, required=True, metavar="MODEL.json", help="the model to judge")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="gets report.html and validation.json")
    parser.add_argument("--data", type=Path, metavar="DIR", help="folder of recordings not beside the campaign")
    parser.add_argument(
        "--figures", choices=("png", "pdf", "svg"), help="also write each figure of the report into --out"
    )
    add_show(parser)
    parser.add_argument("--json", action="store_true", help="print validation.json instead of the answer")


def run(args: argparse.Namespace) -> int:
    """Validate, write, print."""
    # Imported here: --help must not wait for numba, scipy and matplotlib.
    from twin.api.functions import validate
    from twin.api.results import as_text, save_figures

    campaign, model = Campaign.load(args.campaign), Model.load(args.model)
    make_folder(args.out)  # before the work, which takes a minute
    result = validate(campaign, model, data=args.data, progress=progress_printer(quiet=not sys.stderr.isatty()))
    result.save(args.out, title=f"Validation of {args.model.name} on {campaign.plant.name}")
    if args.figures is not None:
        save_figures(result.figures(), args.out / "figures", args.figures)
    print(as_text(result.to_json()) if args.json else f"{result.answer}\n{args.out / 'report.html'}")
    for note in result.notes:
        print(f"! {note}", file=sys.stderr)
    if args.show:
        show(args.out / "report.html")
    return 0 if result.passed else 1
