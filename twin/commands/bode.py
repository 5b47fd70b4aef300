"""Compare a model with the frequency responses of recorded flights: bode.html, bode.json, and an answer in words.

Measures amplifier, plant, loop gain, S and T from flights in closed loop whose reference is excited (multisine, chirp,
PRBS, rectangle), with 95 % bands and margins. `board51 campaign run FOLDER --board rig1 --experiment bode-low
--experiment bode-high` records such flights at two heights.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from protocol.campaign import Campaign
from protocol.files import make_folder
from twin.model.parameters import Model


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = (
        "examples:\n"
        "  board51 bode model.json runs/monday --out report\n"
        "  board51 bode ce152 runs/monday\n"
        "\nexit code 0: the model explains the responses; 1: it does not, or no flight is excited; 2: bad input"
    )
    parser.add_argument("model", metavar="MODEL", help="model.json, or a shipped model: ce152, inteco, magnetoshield")
    parser.add_argument("campaign", type=Path, metavar="CAMPAIGN", help="campaign.toml or the folder that holds it")
    parser.add_argument("--out", type=Path, metavar="DIR", help="gets bode.html and bode.json")
    parser.add_argument("--data", type=Path, metavar="DIR", help="folder of recordings not beside the campaign")
    parser.add_argument("--json", action="store_true", help="print bode.json instead of the answer")


def run(args: argparse.Namespace) -> int:
    """Compare, write, print."""
    # Imported here: --help must not wait for numba, scipy and matplotlib.
    from twin.api.functions import bode
    from twin.api.results import as_text

    campaign, model = Campaign.load(args.campaign), Model.load(args.model)
    if args.out is not None:
        make_folder(args.out)  # before the work
    result = bode(campaign, model, data=args.data)
    if args.out is not None:
        result.save(args.out, title=f"Frequency responses of {campaign.plant.name} and {Path(args.model).name}")
    print(as_text(result.to_json()) if args.json else result.answer)
    if args.out is not None and not args.json:
        print(args.out / "bode.html")
    for note in result.notes:
        print(f"! {note}", file=sys.stderr)
    return 0 if result.explains else 1
