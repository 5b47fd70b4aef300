"""Tests of the licences of all that is installed: each is known, allows passing on, and is in the bill of materials."""

from __future__ import annotations

import importlib.util
import json
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
LOCK = ROOT / "requirements-run.lock"
# Permissive ones, by the words that packages use.
KNOWN = re.compile(
    r"MIT|BSD|Apache|Python Software Foundation|PSF-2\.0|Zlib|CC0|ISC|MPL-2\.0|Mozilla Public License 2\.0|MIT-CMU"
)
# Used as they are, as libraries of their own: nothing of them is changed or copied.
WEAK_COPYLEFT = {
    "asyncua": "GNU Lesser General Public License v3 or later (LGPLv3+)",
    "eclipse-zenoh": "Eclipse Public License 2.0 (EPL-2.0)",  # or Apache
}


@pytest.fixture(scope="module")
def sbom() -> ModuleType:
    spec = importlib.util.spec_from_file_location("sbom", ROOT / ".ci" / "sbom.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["sbom"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def test_each_installed_package_has_a_licence_that_allows_its_use(sbom: ModuleType) -> None:
    installed = {package.name: package.licences for package in sbom.packages(LOCK) if package.licences}
    unknown = {
        name: licence
        for name, licences in installed.items()
        for licence in licences
        if not KNOWN.search(licence) and WEAK_COPYLEFT.get(name) != licence
    }

    assert len(installed) > 30
    assert unknown == {}, "look at them, then add them to KNOWN or do without the package"


def test_the_bill_of_materials_has_every_package_of_the_lock_with_its_hashes(sbom: ModuleType) -> None:
    document = json.loads(sbom.bill(LOCK, name="board51", version="1.2.3"))
    pinned = re.findall(r"^([A-Za-z0-9._-]+)==([^ ;\\]+)", LOCK.read_text(encoding="utf-8"), re.MULTILINE)

    assert (document["bomFormat"], document["specVersion"]) == ("CycloneDX", "1.6")
    assert [(component["name"], component["version"]) for component in document["components"]] == pinned
    assert all(component["hashes"] for component in document["components"])
    assert len({component["bom-ref"] for component in document["components"]}) == len(pinned)
    assert document["metadata"]["component"]["version"] == "1.2.3"
