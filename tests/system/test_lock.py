"""The lock can be installed by old and new installers: with hashes, nothing may be left to resolve."""

from __future__ import annotations

import re
import tomllib
from importlib.metadata import Distribution, distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
LOCK, RUN = "requirements.lock", "requirements-run.lock"


def lock(file: str = LOCK) -> dict[str, set[str]]:
    """Return the extras that the lock names, by package."""
    extras: dict[str, set[str]] = {}
    for line in (ROOT / file).read_text().splitlines():
        if line and line[0] not in "# ":
            pinned = Requirement(line.partition(" \\")[0])
            assert [s.operator for s in pinned.specifier] == ["=="], line
            extras.setdefault(canonicalize_name(pinned.name), set()).update(pinned.extras)
    return extras


def requirements_of(package: Distribution, extras: set[str]) -> list[Requirement]:
    """Return what a package asks for here, with these extras of its own."""
    requirements = [Requirement(text) for text in package.requires or []]
    return [
        requirement
        for requirement in requirements
        if requirement.marker is None or any(requirement.marker.evaluate({"extra": e}) for e in ("", *extras))
    ]


def our_requirements() -> list[Requirement]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    parts = [project["project"]["dependencies"], *project["project"]["optional-dependencies"].values()]
    parts += project["dependency-groups"].values()
    requirements = [Requirement(text) for part in parts for text in part]
    return [requirement for requirement in requirements if requirement.name != "board51"]


def test_each_extra_that_is_asked_for_is_named_in_the_lock() -> None:
    """pip 23 resolves `coverage[toml]>=7` anew where the lock pins `coverage` alone, and then refuses it unhashed."""
    pinned = lock()
    package_requirements = {"board51": our_requirements()}
    for name, extras in pinned.items():
        try:
            package_requirements[name] = requirements_of(distribution(name), extras)
        except ModuleNotFoundError:  # for another system or Python
            continue
    missing = [
        f"{who} asks for {requirement}, the lock has {name}[{','.join(sorted(pinned.get(name, ())))}]"
        for who, requirements in package_requirements.items()
        for requirement in requirements
        if not requirement.extras <= pinned.get(name := canonicalize_name(requirement.name), set())
    ]

    assert missing == []
    assert len(package_requirements) > 100  # the check saw what is installed


def pins(file: str) -> dict[str, set[str]]:
    """Return the hashes in the lock, by name and version."""
    hashes: dict[str, set[str]] = {}
    for line in (ROOT / file).read_text().splitlines():
        if line and line[0] not in "# ":
            name = line.partition(" ")[0]
            hashes[name] = set()
        elif "--hash=" in line:
            hashes[name].add(line.strip(" \\"))
    return hashes


def test_what_runs_is_locked_as_it_was_tested() -> None:
    run, tested = pins(RUN), pins(LOCK)

    assert len(run) > 40
    assert all(run.values())
    assert run == {name: tested.get(name) for name in run}


def test_the_lock_of_what_runs_has_every_part_and_no_tool_of_development() -> None:
    content = tomllib.loads((ROOT / "pyproject.toml").read_text())
    parts = [content["project"]["dependencies"], *content["project"]["optional-dependencies"].values()]
    required, tools = (
        {canonicalize_name(Requirement(text).name) for part in some for text in part} - {"board51"}
        for some in (parts, [content["dependency-groups"]["dev"], content["dependency-groups"]["docs"]])
    )
    locked = lock(RUN).keys()

    assert required <= locked
    assert (tools - required) & locked == {"websockets"}  # which uvicorn needs, too


@pytest.mark.parametrize("file", [LOCK, RUN])
def test_the_lock_has_no_address(file: str) -> None:
    text = (ROOT / file).read_text()

    assert not re.search(r"https?://|--(extra-)?index-url|--find-links", text)
