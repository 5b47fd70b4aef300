"""Errors of one token in the C of law, limits and loop, and which of them no test notices.

    python -m tests.harness.firmware.mutants [--file law.c ...] [--every N] [--first N]

Each operator, constant and comparison is changed in turn.  The mutant is compiled for this machine and played against
the model in Python (the law alone, then a random host); what survives meets the tests of the rules.  A mutant whose
object code is that of the original is the same program; one of `firmware/mutants.md` does what the original does.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import re
import resource
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import pytest

from gateway.emulator.native import board as native_board
from gateway.emulator.native.build import build_option, compiler
from gateway.emulator.native.flags import SOURCES, flags
from protocol.wire.messages import Law
from tests.firmware import test_core_law as of_law
from tests.harness.firmware.core import Core
from tests.harness.firmware.random_host import play

FILES = ("law.c", "reference.c", "output.c", "loop.c")
SWAPS = {
    "<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "==", "+": "-", "-": "+", "&&": "||", "||": "&&",
    "++": "--", "--": "++", "+=": "-=", "-=": "+=", "|=": "&=", "!": "", "true": "false", "false": "true",
}  # fmt: skip
_PARTS = "session commands faults capture frames law output excitation overload calibration"
RULES = [
    *(f"tests/gateway/emulator/test_firmware_{part}.py" for part in _PARTS.split()),
    "tests/firmware/test_modes.py",
]
_SKIPPED = re.compile(r'/\*.*?\*/|"[^"]*"|#include[^\n]*|B51_STATIC_ASSERT\([^;]*;|#if[^\n]*', re.S)
_TOKEN = re.compile(r"->|\+\+|--|[-+|]=|[<>=!]=|&&|\|\||<<|>>|[-+<>!]|\b\d+(?=U?\b)|\btrue\b|\bfalse\b")
_ROW = re.compile(r"^\| `(\w+\.c)` \| `` ?(.+?) ?`` \| (.+) \|$", re.M)
_MAX_CPU_S = 150  # ten times what a survivor takes


@dataclass(frozen=True, slots=True)
class Mutant:
    """A single change in the C source."""

    file: str
    at: int
    line: int
    column: int
    old: str
    new: str

    @property
    def changed(self) -> str:
        """The line with the change."""
        text = (SOURCES / "core" / self.file).read_text(encoding="utf-8").splitlines()[self.line - 1]
        at = self.column - 1
        return (text[:at] + self.new + text[at + len(self.old) :]).strip()

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}: `{self.old}` to `{self.new or 'nothing'}`: `{self.changed}`"


def equivalents() -> dict[tuple[str, str], str]:
    """Return the mutants that no test can notice, by file and changed line, each with its reason."""
    text = (SOURCES / "mutants.md").read_text(encoding="utf-8").replace("\\|", "|")
    return {(file, line): reason for file, line, reason in _ROW.findall(text)}


def mutants(file: str) -> Iterator[Mutant]:
    """Yield each change of a file."""
    text = (SOURCES / "core" / file).read_text(encoding="utf-8")
    code = _SKIPPED.sub(lambda match: " " * len(match[0]), text)
    for token in _TOKEN.finditer(code):
        old = token[0]
        new = str(int(old) + 1) if old.isdigit() else SWAPS.get(old)
        if new is not None:
            at = token.start()
            yield Mutant(file, at, text.count("\n", 0, at) + 1, at - text.rfind("\n", 0, at), old, new)


class Bench:
    """The objects of the core, compiled once, and a mutant linked with them."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._options = [word for word in flags("POSIX_FLAGS") if word != "-shared"]
        self._objects: dict[str, Path] = {}
        for source in [*SOURCES.glob("core/*.c"), *SOURCES.glob("posix/*.c")]:
            self._objects[source.name] = self._compile(source, folder / f"{source.stem}.o")

    def original(self) -> Path:
        """Return the library without a mutant."""
        return self._link("original", self._objects.values())

    def link(self, mutant: Mutant) -> Path | str:
        """Return the library with the mutant; or why there is none: it is the same program, or none."""
        text = (SOURCES / "core" / mutant.file).read_text(encoding="utf-8")
        source = self._folder / mutant.file  # the name of the original: it is in the object
        source.write_text(text[: mutant.at] + mutant.new + text[mutant.at + len(mutant.old) :], encoding="utf-8")
        try:
            changed = self._compile(source, self._folder / "changed.o")
        except subprocess.CalledProcessError:
            return "does not compile"
        if changed.read_bytes() == self._objects[mutant.file].read_bytes():
            return "same program"
        objects = [changed if name == mutant.file else path for name, path in self._objects.items()]
        return self._link(f"{mutant.file}-{mutant.at}", objects)

    def _link(self, name: str, objects: Iterable[Path]) -> Path:
        library = self._folder / f"{name}.so"
        command = [str(compiler()), *flags("POSIX_FLAGS", "POSIX_LINUX"), *map(str, objects), "-o", str(library)]
        subprocess.run(command, check=True)
        return library

    def _compile(self, source: Path, target: Path) -> Path:
        command = [str(compiler()), *self._options, build_option(), f"-I{SOURCES / 'core'}", "-c", str(source)]
        subprocess.run([*command, "-o", str(target)], check=True, capture_output=True)
        return target


def judge(library: Path) -> None:
    """End this process with 0 if no test notices the library."""
    resource.setrlimit(resource.RLIMIT_CPU, (_MAX_CPU_S, _MAX_CPU_S))
    sys.stdout = sys.stderr = open(os.devnull, "w", encoding="utf-8")
    core = Core(library)
    of_law.fly_both(core, 1, 6_000)
    of_law.test_before_rounding_the_accumulator_is_that_of_python(core)
    of_law.test_within_two_counts_of_its_ends_the_integral_is_that_of_python(core)
    for law, integral in product(Law, (-1, 0, 1)):
        of_law.test_at_its_limits_and_a_count_beside_them_the_integral_is_that_of_python(core, law, integral)
    of_law.test_the_next_value_of_a_signal_is_computed_ahead(core)
    for seed in range(19, 23):
        play(seed, 1_500, path=library)
    for seed in range(19, 23):
        play(seed, 7_500, path=library)
    vars(native_board)["library"] = lambda: library
    os._exit(pytest.main(["-q", "-x", "-n0", "-p", "no:cacheprovider", *RULES]))


def noticed(library: Path) -> bool:
    """Judge in a process of its own: a mutant may crash it or never end."""
    process = multiprocessing.get_context("fork").Process(target=judge, args=(library,))
    process.start()
    process.join()
    return process.exitcode != 0


def main() -> int:
    """Print each survivor, and the share that was killed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--file", action="append", choices=FILES, help="of firmware/core; none: all four")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="judge every Nth mutant")
    parser.add_argument("--first", type=int, default=0, metavar="N", help="begin with this one")
    args = parser.parse_args()
    chosen = [mutant for file in args.file or FILES for mutant in mutants(file)][args.first :: args.every]
    counts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder))
        if noticed(bench.original()):
            sys.exit("mutants: the tests notice the original")
        for mutant in chosen:
            library = bench.link(mutant)
            fate = library if isinstance(library, str) else "killed" if noticed(library) else "survives"
            if fate == "survives" and (mutant.file, mutant.changed) in equivalents():
                fate = "equivalent"
            counts[fate] += 1
            if fate == "survives":
                print(mutant, flush=True)
    total = counts["killed"] + counts["survives"]
    print(f"{counts['killed']} of {total} killed ({100 * counts['killed'] / max(total, 1):.1f} %); {dict(counts)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
