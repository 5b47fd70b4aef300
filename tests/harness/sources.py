"""The product's sources, each parsed once for all tests of a process that read them."""

from __future__ import annotations

import ast
import gc
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]


def trees(package: str) -> Iterator[tuple[str, ast.Module]]:
    """Yield path and tree of each file of a package that nobody generated."""
    for path in sorted((ROOT / package).rglob("*.py")):
        if "_pb2" not in path.name:
            yield path.relative_to(ROOT).as_posix(), parsed(path)


@cache
def parsed(path: Path) -> ast.Module:
    """Return the tree of a file; it stays in memory."""
    gc.disable()  # a tree is no garbage: looking for some in all trees so far takes three times as long as parsing
    try:
        return ast.parse(path.read_text(encoding="utf-8"))
    finally:
        gc.enable()
