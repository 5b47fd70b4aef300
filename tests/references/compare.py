"""Two answers, field by field.  Pure."""

from __future__ import annotations

import fnmatch
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

# Fields that differ from run to run or from folder to folder, and say nothing of the answer.
IGNORED = ("*.stages_s.*",)


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """A field that differs: None is "absent"."""

    field: str
    was: object
    now: object

    def __str__(self) -> str:
        size = ""
        if _number(self.was) and _number(self.now):
            was, now = float(str(self.was)), float(str(self.now))
            size = f"   ({abs(now - was) / max(abs(was), abs(now)):.1e} relative)" if was or now else ""
        return f"{self.field}: {self.was!r} -> {self.now!r}{size}"


def differences(was: object, now: object, *, relative: float = 0.0) -> list[Difference]:
    """The fields in which two trees of dicts, lists and leaves differ.

    Args:
        was: The reference.
        now: What is compared with it.
        relative: Numbers may differ by this share of the larger one; 0: not at all. Whole numbers, names and
            sentences never may; where `relative` is given, digests are left to the numbers beside them.
    """
    before, after = dict(_leaves(was)), dict(_leaves(now))
    changes = []
    for field in sorted(before.keys() | after.keys()):
        if any(fnmatch.fnmatchcase(field, pattern) for pattern in IGNORED):
            continue
        if relative and field.endswith(".sha256"):
            continue
        first, second = before.get(field), after.get(field)
        if field in before and field in after and _same(first, second, relative):
            continue
        changes.append(Difference(field=field, was=first, now=second))
    return changes


def _leaves(tree: object, path: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(tree, dict):
        for key, value in tree.items():
            yield from _leaves(value, f"{path}.{key}")
    elif isinstance(tree, list):
        yield f"{path}.length", len(tree)
        for n, value in enumerate(tree):
            yield from _leaves(value, f"{path}[{n}]")
    else:
        yield path, tree


def _same(was: object, now: object, relative: float) -> bool:
    if isinstance(was, float) and isinstance(now, float):
        return was == now or (math.isnan(was) and math.isnan(now)) or math.isclose(was, now, rel_tol=relative)
    return type(was) is type(now) and was == now


def _number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
