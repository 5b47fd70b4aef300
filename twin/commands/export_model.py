"""Export an identified model, with the causes that a diagnosis added, for other tools.

An FMU simulates the rig as the twin does, in closed loop under x_ref or in open loop under u_c, without Python.
docs/howto/export.md describes the content and the limits of each format.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from protocol.arguments import quantity
from protocol.errors import UsageError


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = (
        "examples:\n"
        "  board51 export-model extended_model.json --to fmu --out rig.fmu\n"
        "  board51 export-model ce152 --to fmu --fmi 3.0\n"
        "  board51 export-model model.json --to fmu --controller controller.json\n"
        "\nexit code 0: done; 2: bad input, or a part of the model that the format cannot have"
    )
    parser.add_argument("model", metavar="MODEL", help="model.json, or a shipped model: ce152, inteco, magnetoshield")
    parser.add_argument("--to", required=True, choices=("fmu", "matlab", "python", "latex", "modelica"), help="format")
    parser.add_argument("--out", type=Path, metavar="PATH", help="file of an FMU, else folder (named after the rig)")
    parser.add_argument("--fmi", choices=("2.0", "3.0"), default="2.0", help="version of FMI of an FMU (%(default)s)")
    parser.add_argument(
        "--controller", type=Path, metavar="CONTROLLER.json", help="law of the closed loop (a design for the model)"
    )
    parser.add_argument(
        "--operating-point",
        type=quantity("x"),
        metavar="X_M",
        help="operating point of the design, m, up from the bottom stop (mid-travel)",
    )
    parser.add_argument("--law", choices=("lqi", "pid"), default="lqi", help="of the design (%(default)s)")
    parser.add_argument(
        "--sample-time", type=quantity("t"), default=2e-3, metavar="S", help="T_s of the design (%(default)s)"
    )
    parser.add_argument(
        "--u-max", type=quantity("u_c"), default=5.0, metavar="V", help="end of the input's range (%(default)s)"
    )
    parser.add_argument(
        "--compiler", metavar="CC", help="C compiler of an FMU's binary (gcc, cc or clang); '': sources only"
    )


def run(args: argparse.Namespace) -> int:
    """Design or name the law, export, write."""
    # Imported here: --help must not wait for numba and scipy.
    from twin.api.exports import export_model
    from twin.api.functions import design

    law = args.controller
    if args.controller is None:
        law = design(
            args.model, x_m=args.operating_point, law=args.law, sample_time_s=args.sample_time, u_max_v=args.u_max
        )
    elif args.operating_point is not None:
        raise UsageError("--controller with --operating-point", remedy="The file has one: leave out the one or other")
    exported = export_model(
        args.model, args.to, controller=law, u_max_v=args.u_max, fmi=args.fmi, compiler=args.compiler
    )
    default = next(iter(exported.files)) if len(exported.files) == 1 else Path(args.model).stem
    for path in exported.save(args.out or default):
        print(path)
    for note in exported.notes:
        print(f"! {note}", file=sys.stderr)
    return 0
