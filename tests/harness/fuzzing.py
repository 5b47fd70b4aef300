"""Fuzz one parser, guided by coverage: `python -m tests.harness.fuzzing PARSER --minutes 5 --seed 1`.

Needs atheris, which is not in the lock: `pip install atheris`.  Each new finding is written to --out, its input beside
its traceback; fuzzing goes on.  Exits with 1 if there was one.
"""

from __future__ import annotations

import argparse
import re
import shutil
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from random import Random
from types import TracebackType

ROOT = Path(__file__).resolve().parents[2]
SLOW_S = 5.0
LARGEST_MB = 1000  # memory that one input may take
_OURS = ("protocol", "gateway", "twin")


class Findings:
    """The executions of a parser, and each kind of finding once.

    Args:
        run: The parser; raises nothing on any input.
        report: Called with a kind that is new, the input, and what happened.
    """

    def __init__(self, run: Callable[[bytes], None], report: Callable[[str, bytes, str], None]) -> None:
        self._run, self._report = run, report
        self.kinds: set[str] = set()
        self.executions = 0

    def execute(self, data: bytes) -> None:
        """Run the parser on an input."""
        self.executions += 1
        began_s, before_mb = time.monotonic(), _peak_mb()
        try:
            self._run(data)
        except Exception as error:
            self._add(kind_of(error), data, traceback.format_exc())
        took_s, took_mb = time.monotonic() - began_s, _peak_mb() - before_mb
        if took_s > SLOW_S:
            self._add("slow", data, f"{took_s:.1f} s")
        if took_mb > LARGEST_MB:
            self._add("large", data, f"{took_mb:.0f} MB")

    def _add(self, kind: str, data: bytes, what: str) -> None:
        if kind not in self.kinds:
            self.kinds.add(kind)
            self._report(kind, data, what)


def kind_of(error: BaseException) -> str:
    """Return the class of an error and the innermost line of ours at which it was raised."""
    place = "?"
    at: TracebackType | None = error.__traceback__
    while at is not None:
        file = Path(at.tb_frame.f_code.co_filename)
        if file.is_relative_to(ROOT) and file.relative_to(ROOT).parts[0] in (*_OURS, "tests"):
            place = f"{file.relative_to(ROOT)}:{at.tb_lineno}"
        at = at.tb_next
    return f"{type(error).__name__} at {place}"


def _peak_mb() -> float:
    import resource  # not on Windows, where nobody fuzzes

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _compiled_modules() -> list[str]:
    """Return the modules with kernels of numba, which cannot compile what atheris has instrumented."""
    kernels = re.compile(r"twin\.compiled|import numba|from numba")
    files = [file for package in _OURS for file in (ROOT / package).rglob("*.py") if kernels.search(file.read_text())]
    names = [".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__") for file in files]
    return [*names, "twin.compiled"]


def _fuzz(name: str, *, minutes: float, seed: int, out: Path) -> None:
    import atheris  # not in the lock

    with atheris.instrument_imports(include=_OURS, exclude=_compiled_modules()):
        from tests.harness.fuzz_targets import TARGETS

    target, scratch = TARGETS[name], out / "scratch"  # the run ends without a return: the next one clears it up
    shutil.rmtree(scratch, ignore_errors=True)
    corpus = scratch / "corpus"
    corpus.mkdir(parents=True)
    for n, data in enumerate(target.seeds(scratch)):
        (corpus / str(n)).write_bytes(data)

    def report(kind: str, data: bytes, what: str) -> None:
        file = out / f"{name.replace(', ', '-').replace(' ', '-')}-{len(findings.kinds)}"
        file.with_suffix(".bin").write_bytes(data)
        file.with_suffix(".txt").write_text(f"{kind}\n{what}\n")
        print(f"FINDING {kind}", flush=True)

    findings = Findings(lambda data: target.run(scratch, data), report)

    def change(data: bytes, largest: int, chosen: int) -> bytes:
        chance = Random(chosen)
        mutant: bytes = target.change(chance, data) if chance.randrange(2) else atheris.Mutate(data, largest)
        return mutant[:largest]

    options = {
        "max_total_time": round(minutes * 60), "seed": seed, "max_len": 1 << 17, "timeout": 60, "rss_limit_mb": 4096,
        "artifact_prefix": f"{out}/", "verbosity": 0, "print_final_stats": 1,
    }  # fmt: skip
    arguments = [sys.argv[0], *(f"-{key}={value}" for key, value in options.items()), str(corpus)]
    atheris.Setup(arguments, findings.execute, custom_mutator=change)
    atheris.Fuzz()


def main() -> None:
    """Fuzz the parser of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parser", metavar="PARSER")
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("fuzz-out"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    _fuzz(args.parser, minutes=args.minutes, seed=args.seed, out=args.out)


if __name__ == "__main__":
    main()
