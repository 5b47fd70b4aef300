"""Benchmarks, each against a baseline measured in the same run.  They live in tests/bench of a source checkout."""

from __future__ import annotations

import argparse
import importlib.util
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from protocol.errors import UsageError

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "tests" / "bench"
Row = dict[str, Any]  # name, value, unit, baseline, ratio, note


def names() -> list[str]:
    """The benchmarks that are here."""
    return sorted(path.stem for path in FOLDER.glob("*.py"))


def configure(parser: argparse.ArgumentParser) -> None:
    """Which benchmarks."""
    parser.epilog = "example:\n  board51 bench decoder twin"
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help=f"of {', '.join(names()) or 'none here'} (default: all)"
    )
    parser.add_argument("--json", action="store_true", help="print rows as JSON")


def run(args: argparse.Namespace) -> int:
    """Run and print a table."""
    if not names():
        raise UsageError(f"There are no benchmarks at {FOLDER}", remedy="Run it in a checkout of the source")
    unknown = set(args.names) - set(names())
    if unknown:
        raise UsageError(f"No benchmark is called {sorted(unknown)[0]!r}", remedy=f"There are: {', '.join(names())}")
    rows: list[Row] = []
    for name in args.names or names():
        if not args.json:
            print(f"{name} ...", flush=True)
        for row in load(name)():
            rows.append({"bench": name, **row})
            if not args.json:
                print(_line(row), flush=True)
    if args.json:
        print(json.dumps(rows))
    return 0


def load(name: str) -> Callable[[], list[Row]]:
    """The `run` of tests/bench/NAME.py."""
    if str(ROOT) not in sys.path:
        sys.path.insert(0, str(ROOT))  # benchmarks share plants and loads with the tests
    spec = importlib.util.spec_from_file_location(f"board51_bench_{name}", FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    loaded: Callable[[], list[Row]] = module.run
    return loaded


def _line(row: Row) -> str:
    def number(value: object) -> str:
        return f"{value:.4g}" if isinstance(value, int | float) else "-" if value is None else str(value)

    return (
        f"  {row['name']:<52} {number(row['value']):>10} {row['unit']:<12} baseline {number(row.get('baseline')):>10}"
        f"  ratio {number(row.get('ratio')):>8}  {row.get('note', '')}"
    )
