"""Predict a recorded flight under other gains, another law or another reference, before it is flown.

The disturbances of the recorded flight are replayed in closed loop, on the model with its causes.  Gives overshoot,
settling time, effort and time at the limit with intervals, and says whether the ball may be lost.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from protocol.arguments import quantity
from protocol.campaign import Campaign
from protocol.errors import DataError, UsageError
from protocol.files import make_folder
from twin.model.parameters import Model

if TYPE_CHECKING:
    from twin.control import LawNumbers
    from twin.estimation.record import FloatArray
    from twin.validation.source import Source


SAME_T_S = 0.05  # relative difference up to which two T_s count as equal


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = (
        "examples:\n"
        "  board51 design model.json --settling-time 0.1 --out controller.json\n"
        "  board51 what-if monday.mcap --model model.json --gains controller.json --out forecast\n"
        "  board51 what-if monday.mcap --model model.json --reference wider.csv\n"
        "\nexit code 0: the ball stays in flight in every draw; 1: it is lost in some; 2: bad input"
    )
    parser.add_argument("recording", type=Path, metavar="LOG", help="a flight in closed loop: MCAP, CSV or MATLAB")
    parser.add_argument("--model", required=True, metavar="MODEL", help="model of the rig, with its causes")
    parser.add_argument("--gains", type=Path, metavar="FILE", help="controller.json of design (default: as flown)")
    parser.add_argument("--then", type=Path, metavar="LOG", help="the flight that followed under --gains, to compare")
    parser.add_argument("--reference", type=Path, metavar="CSV", help="columns t (s) and x_ref (m) (default: as flown)")
    parser.add_argument("--campaign", type=Path, metavar="CAMPAIGN", help="columns, skip_s and law of the recording")
    parser.add_argument("--data", type=Path, metavar="DIR", help="folder of recordings not beside the campaign")
    parser.add_argument("--board", metavar="BOARD", help="board, for a log of several boards")
    parser.add_argument(
        "--u-max", type=quantity("u_c"), default=5.0, metavar="V", help="largest u_c (of the log, or %(default)s)"
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of the draws (%(default)s)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="gets what_if.html, what_if.json and what_if.csv")
    parser.add_argument("--json", action="store_true", help="print the numbers as JSON")


def run(args: argparse.Namespace) -> int:
    """Predict, write, print."""
    # Imported here: --help must not wait for numba and scipy.
    from twin.api.results import as_text, write_text
    from twin.validation.source import source_at
    from twin.what_if import report
    from twin.what_if.forecast import forecast

    if args.gains is None and args.reference is None:
        raise UsageError("nothing to change", remedy="Give --gains, --reference or both")
    if args.seed < 0:
        raise UsageError(f"--seed {args.seed}", remedy="Give a number from 0")
    model = Model.load(args.model)
    campaign = None if args.campaign is None else Campaign.load(args.campaign)
    source = source_at(args.recording, model, campaign, data=args.data, board=args.board)
    law = _law(args, source)
    x_ref = None if args.reference is None else _reference(args.reference, law.sample_time_s)
    if args.out is not None:
        make_folder(args.out)
    then = None if args.then is None else source_at(args.then, model, board=args.board)
    result = forecast(source, model, law, x_ref_m=x_ref, then=then, seed=args.seed)
    if args.out is not None:
        write_text(args.out / "what_if.json", as_text(report.to_dict(result)) + "\n")
        write_text(args.out / "what_if.html", report.to_html(result))
        write_text(args.out / "what_if.csv", report.to_csv(result))
    print(as_text(report.to_dict(result)) if args.json else report.to_text(result))
    if args.out is not None and not args.json:
        print(f"\n{args.out / 'what_if.html'}")
    for note in result.notes:
        print(f"! {note}", file=sys.stderr)
    return 1 if result.lost else 0


def _law(args: argparse.Namespace, source: Source) -> LawNumbers:
    from twin.control_design.controller_file import numbers_of, read_controller
    from twin.evidence.checks.control_law import WIDE_V

    flown, T_s = source.law, source.record.interval_s
    low, high = (0.0, args.u_max) if flown is None else (flown.u_low, flown.u_high)
    limits = (max(low, 0.0) if low <= -WIDE_V else low, min(high, args.u_max) if high >= WIDE_V else high)
    if args.gains is None:
        if flown is None:
            raise DataError(f"{source.record.name}: its law is not known: {source.without_law}", remedy="Give --gains")
        return flown._replace(u_low=limits[0], u_high=limits[1])
    file = read_controller(args.gains)
    if abs(file.sample_time_s - T_s) > SAME_T_S * T_s:
        raise UsageError(
            f"{args.gains} is designed for T_s = {file.sample_time_s:g} s, the flight is sampled every {T_s:g} s",
            remedy=f"Design with --sample-time {T_s:g}",
        )
    lsb = source.record.lsb[1]
    return numbers_of(file.law, file.gains, file.operating_point, T_s, u_range_v=limits, x_lsb_m=lsb)


def _reference(path: Path, sample_time_s: float) -> FloatArray:
    """Read a reference, held between its rows, at every tick.  Raises DataError."""
    import numpy as np

    from protocol.campaign import Recording
    from twin.readers.campaign import read_recording

    record = read_recording(path, Recording(file=path.name, kind="free", use="judge"))
    if not record.has("x_ref") or len(record.t) < 2 or not np.all(np.diff(record.t) > 0.0):
        raise DataError(f"{path} has no reference", remedy="Give rising times t in s and positions x_ref in m")
    t = np.arange(record.t[0], record.t[-1], sample_time_s)
    return np.asarray(record.x_ref[np.searchsorted(record.t, t + 1e-9, side="right") - 1])
