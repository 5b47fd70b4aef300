"""Fuzz parsers, guided by coverage: `python -m tests.harness.fuzzing "bus, views" campaign --minutes 5 --seed 1`.

Needs atheris, which is not in the lock: `pip install atheris`.  Each new finding is written to --out, its input beside
its traceback; fuzzing goes on.  Exits with 1 if there was one.  `fuzz_targets.py` has the parsers.
"""

from __future__ import annotations

import argparse
import math
import os
import re
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from random import Random
from types import TracebackType
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from tests.harness.fuzz_targets import Target

ROOT = Path(__file__).resolve().parents[2]
SLOW_S = 5.0
LARGEST_MB = 1000  # memory that one input may take
_SOURCE = ("protocol", "gateway", "twin")


class Findings:
    """The executions of a parser, and each kind of finding once.

    Args:
        run: The parser; raises nothing on any input.
        report: Called with a kind that is new, the input, and what happened.
        slow_s: Processor time from which an input is slow, s; without one, no input is.
    """

    def __init__(
        self, run: Callable[[bytes], None], report: Callable[[str, bytes, str], None], *, slow_s: float = math.inf
    ) -> None:
        self._run, self._report, self._slow_s = run, report, slow_s
        self.kinds: set[str] = set()
        self.executions = 0

    def execute(self, data: bytes) -> None:
        """Run the parser on an input."""
        self.executions += 1
        began_s, before_mb = time.process_time(), _peak_mb()  # others may have the processor
        try:
            self._run(data)
        except Exception as error:
            self._add(kind_of(error), data, traceback.format_exc())
        took_s, took_mb = time.process_time() - began_s, _peak_mb() - before_mb
        if took_s > self._slow_s:
            self._add("slow", data, f"{took_s:.1f} s")
        if took_mb > LARGEST_MB:
            self._add("large", data, f"{took_mb:.0f} MB")

    def _add(self, kind: str, data: bytes, what: str) -> None:
        if kind not in self.kinds:
            self.kinds.add(kind)
            self._report(kind, data, what)


def kind_of(error: BaseException) -> str:
    """Return the class of an error and the innermost line of ours at which it was raised."""
    location = "?"
    at: TracebackType | None = error.__traceback__
    while at is not None:
        file = Path(at.tb_frame.f_code.co_filename)
        if file.is_relative_to(ROOT) and file.relative_to(ROOT).parts[0] in (*_SOURCE, "tests"):
            location = f"{file.relative_to(ROOT)}:{at.tb_lineno}"
        at = at.tb_next
    return f"{type(error).__name__} at {location}"


def _peak_mb() -> float:
    import resource  # not on Windows, where nobody fuzzes

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _compiled_modules() -> list[str]:
    """Return the modules with kernels of numba, which cannot compile what atheris has instrumented."""
    kernels = re.compile(r"twin\.compiled|import numba|from numba")
    files = [file for package in _SOURCE for file in (ROOT / package).rglob("*.py") if kernels.search(file.read_text())]
    names = [".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__") for file in files]
    return [*names, "twin.compiled"]


def _fuzz(name: str, target: Target, *, minutes: float, seed: int, out: Path, scratch: Path) -> NoReturn:
    import atheris

    corpus = scratch / "corpus"
    corpus.mkdir()
    for n, data in enumerate(target.seeds(scratch)):
        (corpus / str(n)).write_bytes(data)

    def report(kind: str, data: bytes, what: str) -> None:
        file = out / f"{name.replace(', ', '-').replace(' ', '-')}-{len(findings.kinds)}"
        file.with_suffix(".bin").write_bytes(data)
        file.with_suffix(".txt").write_text(f"{kind}\n{what}\n")
        print(f"{name}: FINDING {kind}", flush=True)

    findings = Findings(lambda data: target.run(scratch, data), report, slow_s=SLOW_S)

    def change(data: bytes, largest: int, chosen: int) -> bytes:
        chance = Random(chosen)
        mutant: bytes = target.change(chance, data) if chance.randrange(2) else atheris.Mutate(data, largest)
        return mutant[:largest]

    end_s, began_s = time.monotonic() + 60 * minutes, time.process_time()

    def execute(data: bytes) -> None:
        findings.execute(data)
        if time.monotonic() > end_s:
            took_s, count = time.process_time() - began_s, len(findings.kinds)
            print(f"{name}: {findings.executions} executions in {took_s:.0f} s, {count} findings", flush=True)
            os._exit(1 if count else 0)

    options = {
        "seed": seed, "max_len": 1 << 17, "timeout": 120, "rss_limit_mb": 4096, "artifact_prefix": f"{out}/",
        "verbosity": 0,
    }  # fmt: skip
    arguments = [sys.argv[0], *(f"-{key}={value}" for key, value in options.items()), str(corpus)]
    atheris.Setup(arguments, execute, custom_mutator=change)
    atheris.Fuzz()  # ends the process
    raise AssertionError


def main() -> int:
    """Fuzz the parsers of the command line, one after the other."""
    import atheris  # not in the lock

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parsers", metavar="PARSER", nargs="+")
    parser.add_argument("--minutes", type=float, default=5.0, help="of each")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("fuzz-out"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    with atheris.instrument_imports(include=_SOURCE, exclude=_compiled_modules()):
        from tests.harness.fuzz_targets import TARGETS

    if unknown := set(args.parsers) - set(TARGETS):
        parser.error(f"no parser {', '.join(sorted(unknown))}; there are: {'; '.join(TARGETS)}")
    failed = False
    for name in args.parsers:
        with tempfile.TemporaryDirectory() as scratch:
            print(f"{name}: {time.strftime('%H:%M:%S')}", flush=True)
            child = os.fork()  # each in a process of its own, but instrumented once
            if child == 0:
                _fuzz(name, TARGETS[name], minutes=args.minutes, seed=args.seed, out=args.out, scratch=Path(scratch))
            _, status = os.waitpid(child, 0)  # not 0 for a finding, a hang, or an interpreter that crashed, too
            failed = failed or status != 0
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
