"""Predict the position N samples ahead along a recording, so that anyone can compute the error.

x_hat of a row is what the model says that the position sensor will show, knowing the readings up to N samples earlier
and the u_c measured in between.  Takes CSV (also .gz), MATLAB or MCAP, and models with or without causes.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from protocol.campaign import Campaign, Recording, load
from protocol.errors import DataError, UsageError

if TYPE_CHECKING:
    from twin.model.parameters import Model
    from twin.prediction import Prediction


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
    parser.add_argument("model", metavar="MODEL", help="model.json, or a shipped model: ce152, inteco")
    parser.add_argument("recording", type=Path, metavar="RECORDING", help="CSV, MATLAB or MCAP")
    parser.add_argument("--horizon", type=int, default=10, metavar="N", help="samples ahead (%(default)s)")
    parser.add_argument("--out", type=Path, metavar="PRED.csv", help="write t, x, x_hat there")
    parser.add_argument(
        "--campaign", type=Path, metavar="CAMPAIGN", help="campaign.toml or its folder: columns and skip_s of RECORDING"
    )
    parser.add_argument("--data", type=Path, metavar="DIR", help="folder of recordings not beside the campaign")
    parser.add_argument("--board", metavar="BOARD", help="in a log of several boards, the one that is meant")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")


def run(args: argparse.Namespace) -> int:
    """Predict, write, print."""
    # Imported here: --help must not wait for numba and scipy.
    from twin.model.nominal import SHIPPED, nominal
    from twin.model.parameters import load_model
    from twin.prediction import predict
    from twin.readers.campaign import read_recording

    if args.horizon < 1:
        raise UsageError(f"--horizon {args.horizon}", remedy="Give a number of samples from 1")
    model = nominal(args.model) if args.model in SHIPPED else load_model(args.model)
    if args.campaign is None:
        recording, path = Recording(file=args.recording.name, kind="closed-loop", use="judge"), args.recording
    else:
        campaign = load(args.campaign)
        recording, path = _listed(campaign, args.recording, args.data)
        _same_plant(campaign, model)
    if args.board is not None:
        recording = replace(recording, board=args.board)
    record = read_recording(path, recording)
    if args.campaign is None:
        record = replace(record, kind="free")  # nobody said whether the loop is closed
    found = predict(model, record, args.horizon)
    if args.out is not None:
        _write(args.out, found)
    numbers = _numbers(found, recording.file)
    print(json.dumps(numbers, indent=2, allow_nan=False) if args.json else _text(found, recording.file))
    for note in found.notes:
        print(f"! {note}", file=sys.stderr)
    return 0 if len(found.x) else 1


def _listed(campaign: Campaign, wanted: Path, data: Path | None) -> tuple[Recording, Path]:
    """The campaign's entry of this file, and where the file is."""
    exact = [r for r in campaign.recordings if wanted in (Path(r.file), campaign.folder / r.file)]
    found = exact or [r for r in campaign.recordings if Path(r.file).name == wanted.name]
    if len(found) != 1:
        listed = ", ".join(r.file for r in campaign.recordings) or "none"
        problem = "is there twice" if found else "is not one of its recordings"
        raise DataError(f"{campaign.where}: {str(wanted)!r} {problem}", remedy=f"Name one of: {listed}")
    return found[0], wanted if wanted.is_file() else campaign.path_of(found[0], data=data)


def _same_plant(campaign: Campaign, model: Model) -> None:
    """Say where the model is of a rig with other constants."""
    for key in ("mass_kg", "travel_m", "x_max_m", "gravity_m_s2"):
        ours, theirs = getattr(model.plant, key), getattr(campaign.plant, key)
        if abs(ours - theirs) > 1e-6 * abs(theirs):
            print(
                f"! {key} is {ours:g} in the model and {theirs:g} in {campaign.where}: the model's is used",
                file=sys.stderr,
            )


def _write(path: Path, found: Prediction) -> None:
    rows = zip(found.t.tolist(), found.x.tolist(), found.x_hat.tolist(), strict=True)
    text = "t,x,x_hat\n" + "".join(f"{t:.9g},{x:.10g},{x_hat:.10g}\n" for t, x, x_hat in rows)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise DataError(f"{path} cannot be written ({error.strerror})", remedy="Give a writable path") from None


def _numbers(found: Prediction, name: str) -> dict[str, Any]:
    return {
        "recording": name,
        "horizon_samples": found.ahead,
        "horizon_s": found.ahead * found.interval_s,
        "rmse_m": found.rmse_m,
        "count": len(found.x),
        "samples": found.samples,
        "left_out": dict(found.left_out),
        "notes": list(found.notes),
    }


def _text(found: Prediction, name: str) -> str:
    horizon = f"{found.ahead} samples ({1e3 * found.ahead * found.interval_s:.3g} ms) ahead"
    lines = [f"{name}: {len(found.x)} of {found.samples} samples predicted {horizon}"]
    if found.rmse_m is not None:
        lines.append(f"rmse of x  {found.rmse_m:.6g} m")
    lines += [f"left out   {count:>7}  {why}" for why, count in found.left_out]
    return "\n".join(lines)
