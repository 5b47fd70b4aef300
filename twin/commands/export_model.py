"""Export an identified model, with the causes that a diagnosis added, for other tools.

An FMU simulates the rig as the twin does, in closed loop under x_ref or in open loop under u_c, without Python.
docs/howto/export.md shows what each format has and what it cannot have.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path

from protocol.errors import UsageError
from protocol.files import make_folder, writing


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
        "--operating-point", type=float, metavar="X_M", help="of the design, m, up from the bottom stop (mid-travel)"
    )
    parser.add_argument("--law", choices=("lqi", "pid"), default="lqi", help="of the design (%(default)s)")
    parser.add_argument("--sample-time", type=float, default=2e-3, metavar="S", help="T_s of the design (%(default)s)")
    parser.add_argument("--u-max", type=float, default=5.0, metavar="V", help="end of the input's range (%(default)s)")
    parser.add_argument(
        "--compiler", metavar="CC", help="C compiler of an FMU's binary (gcc, cc or clang); '': sources only"
    )


def run(args: argparse.Namespace) -> int:
    """Design or read the law, export, write."""
    # Imported here: --help must not wait for numba and scipy.
    from twin.control_design.design import Specification, design
    from twin.export import controller
    from twin.export.formats import export
    from twin.model.parameters import Model

    model = Model.load(args.model)
    if args.controller is None:
        specification = Specification(
            law=args.law, x_m=args.operating_point, sample_time_s=args.sample_time, u_max_v=args.u_max
        )
        law = controller.of_design(design(model, specification), u_max_v=args.u_max)
    elif args.operating_point is None:
        law = controller.of_file(args.controller, u_max_v=args.u_max)
    else:
        raise UsageError("--controller with --operating-point", remedy="The file has one: leave out the one or other")
    made = export(model, law, args.to, fmi=args.fmi, compiler=args.compiler)
    for path in _written(made.files, args.out, Path(args.model).stem):
        print(path)
    for note in made.notes:
        print(f"! {note}", file=sys.stderr)
    return 0


def _written(files: Mapping[str, bytes], out: Path | None, name: str) -> list[Path]:
    """Write the files, one to `out`, several below it; returns where they are."""
    if len(files) == 1:
        ((default, content),) = files.items()
        placed = {out or Path(default): content}
    else:
        folder = out or Path(name)
        make_folder(folder)
        placed = {folder / key: content for key, content in files.items()}
    for path, content in placed.items():
        with writing(path):
            path.write_bytes(content)
    return list(placed)
