"""Compare a tree's answers with the recorded ones; README.md says how."""

from __future__ import annotations

import argparse
import gzip
import importlib.metadata
import json
import os
import platform
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from tests.references.answers import answers, twin_answers
from tests.references.cases import CASES, ROOT
from tests.references.compare import differences

RECORDED = Path(__file__).parent / "recorded"
TWIN = "twin-over-a-log"
MAX_DIFFERENCES = 12  # differences of one case


def main(arguments: list[str] | None = None) -> int:
    """0: as recorded; 1: something differs; 2: bad usage."""
    parser = argparse.ArgumentParser(prog="python -m tests.references", description=__doc__)
    parser.add_argument("--tree", type=Path, default=ROOT, help="checkout whose commands answer (default: this one)")
    parser.add_argument("--recorded", type=Path, default=RECORDED, help="folder of the references")
    parser.add_argument("--only", action="append", default=[], metavar="TEXT", help="cases whose names hold TEXT")
    parser.add_argument("--relative", type=float, default=0.0, metavar="R", help="numbers may differ by this share")
    parser.add_argument("--accept", action="store_true", help="record the answers instead of comparing them")
    parser.add_argument("--workers", type=int, default=2, help="cases side by side (default: 2)")
    options = parser.parse_args(arguments)
    data = Path(os.environ.get("BOARD51_DATA", ROOT.parent / "shared" / "data"))
    names = [name for name in (*(case.name for case in CASES), TWIN) if _is_selected(name, options.only)]
    if not names:
        parser.error(f"no case's name holds {' or '.join(options.only)}")
    if not options.accept and _machine() != _read_machine(options.recorded):
        print("! recorded on another kind of machine: the last digits may differ", file=sys.stderr)
    began, different = time.monotonic(), 0
    with ProcessPoolExecutor(options.workers) as pool:
        running = {pool.submit(_answer, name, options.tree.resolve(), data): name for name in names}
        for n, future in enumerate(as_completed(running), 1):
            name = running[future]
            path = options.recorded / f"{name}.json.gz"
            now = future.result()
            if now is None:
                verdict = f"left out: no measurements in {data}"
            elif options.accept:
                _write(path, now)
                verdict = "recorded"
            elif not path.exists():
                different += 1
                verdict = "never recorded: --accept does"
            else:
                changes = differences(json.loads(gzip.decompress(path.read_bytes())), now, relative=options.relative)
                different += bool(changes)
                verdict = f"{len(changes)} fields differ" if changes else "as recorded"
                for change in changes[:MAX_DIFFERENCES]:
                    print(f"{name}: {change}")
            print(
                f"[{time.monotonic() - began:5.0f} s] {n}/{len(names)} {name}: {verdict}", file=sys.stderr, flush=True
            )
    if options.accept:
        (options.recorded / "machine.json").write_text(json.dumps(_machine(), indent=1) + "\n", encoding="utf-8")
    print(f"{len(names) - different} of {len(names)} cases as recorded", file=sys.stderr)
    return 1 if different else 0


def _is_selected(name: str, texts: list[str]) -> bool:
    return not texts or any(text in name for text in texts)


def _answer(name: str, tree: Path, data: Path) -> dict[str, Any] | None:
    with tempfile.TemporaryDirectory(prefix="reference-") as scratch:
        folder = Path(scratch)
        if name == TWIN:
            return _without(twin_answers(tree, folder), folder, tree)
        (case,) = (candidate for candidate in CASES if candidate.name == name)
        if case.make is None and not data.is_dir():
            return None
        return _without(answers(case, tree, folder, data), folder, tree)


def _without(answer: dict[str, Any], folder: Path, tree: Path) -> dict[str, Any]:
    """Paths differ from run to run; what is in them does not."""
    text = json.dumps(answer, sort_keys=True)
    for path, name in ((folder, "SCRATCH"), (tree, "TREE")):
        text = text.replace(str(path), name)
    cleaned: dict[str, Any] = json.loads(text)
    return cleaned


def _write(path: Path, answer: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(gzip.compress(json.dumps(answer, sort_keys=True).encode(), mtime=0))


def _machine() -> dict[str, str]:
    """Return the properties of the machine that decide about the last digits."""
    import llvmlite.binding as llvm

    versions = {name: importlib.metadata.version(name) for name in ("numpy", "scipy", "numba", "llvmlite")}
    return {"machine": platform.machine(), "processor": llvm.get_host_cpu_name(), **versions}


def _read_machine(folder: Path) -> object:
    path = folder / "machine.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else None


if __name__ == "__main__":
    sys.exit(main())
