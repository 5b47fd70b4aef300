"""Does a model explain the recordings?  The paper's figures with numbers under each, as one HTML page and JSON.

Judges by the recordings with use = "judge": amplifier and ball in open loop, prediction errors against the noise
floor, residual tests, closed loop simulated against measured, step by step.  What a campaign cannot test is said, not
an error.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from protocol.campaign import load
from protocol.errors import DataError


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
    parser.add_argument("--json", action="store_true", help="print validation.json instead of the answer")


def run(args: argparse.Namespace) -> int:
    """Validate, write, print."""
    # Imported here: --help must not wait for numba, scipy and matplotlib.
    from twin.model.parameters import load_model
    from twin.validate.report import to_dict, to_html
    from twin.validate.verdict import validate

    campaign, model = load(args.campaign), load_model(args.model)
    _writable(args.out)
    result = validate(campaign, model, data=args.data)
    numbers = to_dict(result)
    text = json.dumps(numbers, indent=2, allow_nan=False)
    title = f"Validation of {args.model.name} on {campaign.plant.name}"
    try:
        (args.out / "validation.json").write_text(text + "\n", encoding="utf-8")
        (args.out / "report.html").write_text(to_html(result, title=title), encoding="utf-8")
    except OSError as error:
        raise DataError(f"{args.out} cannot be written ({error.strerror})", remedy="Give a writable folder") from None
    print(text if args.json else f"{numbers['answer']}\n{args.out / 'report.html'}")
    for note in result.notes:
        print(f"! {note}", file=sys.stderr)
    return 0 if result.passed else 1


def _writable(folder: Path) -> None:
    # Before the work: a minute later is too late to hear of a wrong folder.
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"{folder} is no folder ({error.strerror})", remedy="Give a new or existing folder") from None
