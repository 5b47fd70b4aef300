"""The bill of materials of a release: what the container and `pip install 'board51[all]'` bring, from the lock alone.

CycloneDX 1.6 (ECMA-424): name, version, package URL and hashes of each component, licences where the package is
installed here.  The same for every build of a commit in the same environment: no serial number, no time.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

_ENTRY = re.compile(
    r"^(?P<name>[A-Za-z0-9._-]+)==(?P<version>[^ ;\\]+)(?P<hashes>(?:.*\\\n)(?:\s+--hash=sha256:.*\n)+)", re.M
)
_HASH = re.compile(r"--hash=sha256:([0-9a-f]{64})")


@dataclass(frozen=True, slots=True)
class Package:
    """An entry of the lock."""

    name: str
    version: str
    hashes: tuple[str, ...]  # SHA-256 of its files, any of which may be installed

    @property
    def licences(self) -> list[str]:
        """Return what the installed package says of its licence; empty if it is not installed here."""
        try:
            said = metadata.metadata(self.name)
        except metadata.PackageNotFoundError:
            return []
        if "License-Expression" in said:
            return [said["License-Expression"]]
        classifiers = [
            one.rsplit(" :: ", 1)[1] for one in said.get_all("Classifier") or [] if one.startswith("License")
        ]
        return classifiers or ([said["License"].strip()] if "License" in said else [])


def packages(lock: Path) -> list[Package]:
    """Return the entries of a lock, sorted by name; a package may have several versions, for several Pythons."""
    found = _ENTRY.finditer(lock.read_text(encoding="utf-8"))
    return [Package(one["name"], one["version"], tuple(_HASH.findall(one["hashes"]))) for one in found]


def bill(lock: Path, *, name: str, version: str) -> str:
    """Return the bill of materials as JSON."""
    document: dict[str, Any] = {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {"component": {"type": "application", "name": name, "version": version}},
        "components": [
            {
                "type": "library",
                "bom-ref": f"pkg:pypi/{one.name}@{one.version}",
                "name": one.name,
                "version": one.version,
                "purl": f"pkg:pypi/{one.name}@{one.version}",
                "licenses": [{"license": {"name": licence}} for licence in one.licences if licence],
                # Of each file of the release that the lock accepts: one of them is installed.
                "hashes": [{"alg": "SHA-256", "content": content} for content in one.hashes],
            }
            for one in packages(lock)
        ],
    }
    return json.dumps(document, indent=1) + "\n"
