"""Run benchmarks, each against a baseline measured in the same run.  They are in tests/bench of a source checkout."""

from __future__ import annotations

import argparse
import importlib
import inspect
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
    """Add the arguments: which benchmarks."""
    parser.epilog = (
        "examples:\n"
        "  board51 bench decoder twin\n"
        "  board51 bench diagnosis --part nulls --runs 60 --results nulls.jsonl\n"
        "  board51 bench diagnosis --runs 0 --results matrix.jsonl     # the whole matrix; hours\n"
        "  board51 bench truth --runs 16 --quick --out cases --entry 'mine=python mine.py' --entry diagnose"
    )
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help=f"of {', '.join(names()) or 'none here'} (default: all)"
    )
    parser.add_argument("--json", action="store_true", help="print rows as JSON")
    some = parser.add_argument_group("options of benchmarks that draw trials (diagnosis)")
    some.add_argument("--runs", type=int, metavar="N", help="trials per part; 0: all of them (default: a few)")
    some.add_argument("--seed", type=int, metavar="S", help="seed of the first trial (default: 0)")
    some.add_argument(
        "--part",
        metavar="PART",
        help="diagnosis: causes, nulls, composites, outside, forms, knock-out or gateway (default: all but gateway);"
        " gateway: steps (one frame, step by step) or a number of boards (default: both)",
    )
    some.add_argument("--results", type=Path, metavar="FILE", help="file of JSON lines; trials in it are not run again")
    some.add_argument("--quick", action="store_true", default=None, help="short trials, uncalibrated")
    truth = parser.add_argument_group("options of truth, which also takes --runs, --seed, --part and --quick")
    truth.add_argument("--out", type=Path, metavar="DIR", help="set of cases with its answers; drawn if it is empty")
    truth.add_argument("--draw", action="store_true", default=None, help="draw the set, and no more")
    truth.add_argument("--entry", action="append", metavar="NAME[=COMMAND]", help="who answers (default: ours)")


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
        benchmark = load(name)
        for row in benchmark(**_options(name, benchmark, args)):
            rows.append({"bench": name, **row})
            if not args.json:
                print(_line(row), flush=True)
    if args.json:
        print(json.dumps(rows))
    return 0


def _options(name: str, benchmark: Callable[..., list[Row]], args: argparse.Namespace) -> dict[str, Any]:
    """The options that were given, as the benchmark takes them; `show` is how it prints more than rows."""
    parameters = inspect.signature(benchmark).parameters
    supplied = {key: getattr(args, key) for key in ("runs", "seed", "part", "results", "quick", "out", "draw", "entry")}
    supplied = {key: value for key, value in supplied.items() if value is not None}
    superfluous = [f"--{key}" for key in supplied if key not in parameters]
    if superfluous:
        problem = f"Benchmark {name} does not take {superfluous[0]}"
        raise UsageError(problem, remedy="Name only benchmarks that do, or leave it out")
    if "show" in parameters and not args.json:
        supplied["show"] = print
    return supplied


def load(name: str) -> Callable[..., list[Row]]:
    """The `run` of tests/bench/NAME.py."""
    if str(ROOT) not in sys.path:
        sys.path.insert(0, str(ROOT))  # benchmarks share plants and loads with the tests
    loaded: Callable[..., list[Row]] = importlib.import_module(f"tests.bench.{name}").run
    return loaded


def _line(row: Row) -> str:
    def number(value: object) -> str:
        return f"{value:.4g}" if isinstance(value, int | float) else "-" if value is None else str(value)

    return (
        f"  {row['name']:<52} {number(row['value']):>10} {row['unit']:<12} baseline {number(row.get('baseline')):>10}"
        f"  ratio {number(row.get('ratio')):>8}  {row.get('note', '')}"
    )
