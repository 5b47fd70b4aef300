"""The audit without a network: which advisory concerns a locked version."""

from __future__ import annotations

import importlib
import json
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
LOCK = "".join(f"{name} \\\n    --hash=sha256:{'0' * 64}\n" for name in ("some-thing==1.10.0", "other==2.0"))


@pytest.fixture
def advisories(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(ROOT / ".ci")
    return importlib.import_module("advisories")


@pytest.mark.parametrize(
    ("change", "concerned"),
    [
        ({}, True),
        ({"withdrawn": "2026-01-01T00:00:00Z"}, False),
        ({"package": {"name": "Some_Thing"}}, True),
        ({"package": {"name": "some"}}, False),
        ({"events": [{"introduced": "1.9"}, {"fixed": "1.10"}]}, False),
        ({"events": [{"introduced": "1.9"}, {"last_affected": "1.10"}]}, True),
        ({"events": [{"introduced": "1.9"}, {"last_affected": "1.9.9"}]}, False),
        ({"events": [{"introduced": "0"}, {"fixed": "1.2"}, {"introduced": "1.9.1"}]}, True),
        ({"events": [{"introduced": "1.11"}]}, False),
        ({"events": [{"introduced": "1.11"}], "versions": ["1.10.0"]}, True),
    ],
)
@pytest.mark.parametrize("suffix", ["json", "yaml"])  # each JSON is YAML
def test_an_advisory_is_named_for_the_versions_it_concerns(
    advisories: ModuleType, change: dict[str, Any], concerned: bool, suffix: str, tmp_path: Path
) -> None:
    affected = {
        "package": change.get("package", {"name": "some-thing"}),
        "ranges": [{"type": "ECOSYSTEM", "events": change.get("events", [{"introduced": "0"}])}],
        "versions": change.get("versions", []),
    }
    advisory = {"id": "PYSEC-1", "summary": "It leaks.", "modified": "2026-02-03T00:00:00Z", "affected": [affected]}
    advisory |= {key: value for key, value in change.items() if key == "withdrawn"}
    (tmp_path / f"PYSEC-1.{suffix}").write_text(json.dumps(advisory), encoding="utf-8")
    (tmp_path / "requirements.lock").write_text(LOCK, encoding="utf-8")

    findings, compared = advisories.audit(tmp_path, tmp_path / "requirements.lock")

    assert findings == (["some-thing 1.10.0: PYSEC-1: It leaks."] if concerned else [])
    assert compared == "2 locked packages, 1 advisories, the newest of 2026-02-03"
