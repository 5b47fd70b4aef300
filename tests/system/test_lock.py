"""The lock can be installed by old and new installers: with hashes, nothing may be left to resolve."""

from __future__ import annotations

import re
import tomllib
from importlib.metadata import Distribution, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]


def lock() -> dict[str, set[str]]:
    """Return the extras that the lock names, by package."""
    extras: dict[str, set[str]] = {}
    for line in (ROOT / "requirements.lock").read_text().splitlines():
        if line and line[0] not in "# ":
            pinned = Requirement(line.partition(" \\")[0])
            assert [s.operator for s in pinned.specifier] == ["=="], line
            extras.setdefault(canonicalize_name(pinned.name), set()).update(pinned.extras)
    return extras


def requirements_of(package: Distribution, extras: set[str]) -> list[Requirement]:
    """Return what a package asks for here, with these extras of its own."""
    asked = [Requirement(text) for text in package.requires or []]
    return [one for one in asked if one.marker is None or any(one.marker.evaluate({"extra": e}) for e in ("", *extras))]


def our_requirements() -> list[Requirement]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    parts = [project["project"]["dependencies"], *project["project"]["optional-dependencies"].values()]
    parts += project["dependency-groups"].values()
    asked = [Requirement(text) for part in parts for text in part]
    return [one for one in asked if one.name != "board51"]


def test_each_extra_that_is_asked_for_is_named_in_the_lock() -> None:
    """pip 23 resolves `coverage[toml]>=7` anew where the lock pins `coverage` alone, and then refuses it unhashed."""
    pinned = lock()
    asked = {"board51": our_requirements()}
    for name, extras in pinned.items():
        try:
            asked[name] = requirements_of(distribution(name), extras)
        except ModuleNotFoundError:  # for another system or Python
            continue
    missing = [
        f"{who} asks for {one}, the lock has {name}[{','.join(sorted(pinned.get(name, ())))}]"
        for who, requirements in asked.items()
        for one in requirements
        if not one.extras <= pinned.get(name := canonicalize_name(one.name), set())
    ]

    assert missing == []
    assert len(asked) > 100  # the check saw what is installed


def test_the_lock_has_no_address() -> None:
    text = (ROOT / "requirements.lock").read_text()

    assert not re.search(r"https?://|--(extra-)?index-url|--find-links", text)
