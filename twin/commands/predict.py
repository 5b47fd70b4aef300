"""Predict the position N samples ahead along a recording, and compute the error.

x_hat of a row is the reading of the position sensor predicted from the readings up to N samples earlier and the
measured u_c.  Takes CSV (also .gz), MATLAB or MCAP, and models with or without causes.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from protocol.campaign import Campaign
from twin.commands import add_show, show_text
from twin.model.parameters import Model


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = (
        "examples:\n"
        "  board51 predict model.json runs/monday/flight.csv --horizon 10 --out pred.csv\n"
        "  board51 predict extended_model.json flight.csv.gz --campaign runs/monday --horizon 10 --out pred.csv\n"
        "\nRows of --out: t, x, x_hat in s and m, one for each sample that can be predicted; the printed error is\n"
        "sqrt(mean((x - x_hat)^2)) over all of them. No x_hat is farther than a quarter of the travel behind a stop.\n"
        "exit code 0: done; 1: nothing in the recording can be predicted so far ahead; 2: bad input"
    )
    parser.add_argument("model", metavar="MODEL", help="model.json, or a shipped model: ce152, inteco, magnetoshield")
    parser.add_argument("recording", type=Path, metavar="RECORDING", help="CSV, MATLAB or MCAP")
    parser.add_argument("--horizon", type=int, default=10, metavar="N", help="samples ahead (%(default)s)")
    parser.add_argument("--out", type=Path, metavar="PRED.csv", help="write t, x, x_hat there")
    parser.add_argument(
        "--campaign", type=Path, metavar="CAMPAIGN", help="campaign.toml or its folder: columns and skip_s of RECORDING"
    )
    parser.add_argument("--data", type=Path, metavar="DIR", help="folder of recordings not beside the campaign")
    parser.add_argument("--board", metavar="BOARD", help="board, for a log of several boards")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    add_show(parser)


def run(args: argparse.Namespace) -> int:
    """Predict, write, print."""
    # Imported here: --help must not wait for numba and scipy.
    from twin.api.functions import predict
    from twin.api.results import as_text, write_text

    model = Model.load(args.model)
    campaign = None if args.campaign is None else Campaign.load(args.campaign)
    if campaign is not None:
        _same_plant(campaign, model)
    result = predict(
        model, args.recording, horizon_samples=args.horizon, campaign=campaign, data=args.data, board=args.board
    )
    if args.out is not None:
        write_text(args.out, result.to_csv())
    print(as_text(result.to_json()) if args.json else result.table())
    for note in result.details.notes:
        print(f"! {note}", file=sys.stderr)
    if args.show:
        page = (args.out or Path("predict")).with_suffix(".html")
        show_text(page, f"{result.recording} under {Path(args.model).name}", result.table(), figures=[result.figure()])
    return 0 if len(result.x_m) else 1


def _same_plant(campaign: Campaign, model: Model) -> None:
    """Warn if the model is of a rig with other constants."""
    for key in ("mass_kg", "travel_m", "x_max_m", "gravity_m_s2"):
        in_model, in_campaign = getattr(model.plant, key), getattr(campaign.plant, key)
        if abs(in_model - in_campaign) > 1e-6 * abs(in_campaign):
            print(
                f"! {key} is {in_model:g} in the model and {in_campaign:g} in {campaign.where}: the model's is used",
                file=sys.stderr,
            )
