"""Known vulnerabilities of the locked packages, without a network: `python .ci/advisories.py FOLDER`.

FOLDER is a clone of github.com/pypa/advisory-database, or OSV's export for PyPI, unpacked: files in the OSV format
(https://ossf.github.io/osv-schema).  Exits with 1 if an advisory concerns a locked version.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

import yaml
from packaging.version import Version
from sbom import packages

LOCK = Path(__file__).parents[1] / "requirements.lock"


def is_affected(advisory: dict[str, Any], name: str, version: str) -> bool:
    """Return whether an advisory that was not withdrawn concerns a version of a package."""
    entries = [entry for entry in advisory.get("affected", []) if plain(entry["package"]["name"]) == plain(name)]
    return not advisory.get("withdrawn") and any(
        version in entry.get("versions", ())
        or any(is_within(one["events"], Version(version)) for one in entry.get("ranges", ()) if one["type"] != "GIT")
        for entry in entries
    )


def is_within(events: list[dict[str, str]], version: Version) -> bool:
    """Return whether a version lies in a range: introduced here, fixed there, or the last one affected."""
    inside = False
    for event in events:
        ((kind, text),) = event.items()
        limit = Version(text)
        if kind == "introduced":
            inside = inside or version >= limit
        elif (kind == "fixed" and version >= limit) or (kind == "last_affected" and version > limit):
            inside = False
    return inside


def plain(name: str) -> str:
    """Return the normal form of a package's name (PEP 503)."""
    return re.sub(r"[-_.]+", "-", name).lower()


def audit(folder: Path, lock: Path) -> tuple[list[str], str]:
    """Return a line for each vulnerability of a locked version, and what was compared."""
    locked = packages(lock)
    found, newest, count = [], "", 0
    for file in sorted(path for end in ("json", "yaml") for path in folder.rglob(f"*.{end}")):
        text = file.read_text(encoding="utf-8")
        advisory = json.loads(text) if file.suffix == ".json" else yaml.load(text, yaml.CSafeLoader)
        if not isinstance(advisory, dict) or "affected" not in advisory:
            continue
        count, newest = count + 1, max(newest, str(advisory.get("modified", "")))
        what = advisory.get("summary") or advisory.get("details", "").partition("\n")[0]
        for one in locked:
            if is_affected(advisory, one.name, one.version):
                found.append(f"{one.name} {one.version}: {advisory['id']}: {what[:200]}")
    return found, f"{len(locked)} locked packages, {count} advisories, the newest of {newest[:10] or 'no date'}"


if __name__ == "__main__":
    lines, compared = audit(Path(sys.argv[1]), LOCK)
    print(*lines, compared, sep="\n")
    sys.exit(1 if lines or ", 0 advisories" in compared else 0)
