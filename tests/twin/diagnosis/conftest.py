"""Every diagnosis that a test of this folder makes in its own process is asked whether its numbers agree."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from tests.harness.diagnose.agreement import disagreements
from twin.diagnosis import result
from twin.diagnosis.equilibria import to_json as static_json


@pytest.fixture(autouse=True)
def _every_diagnosis_agrees_with_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    def checked(written: Callable[..., dict[str, Any]]) -> Callable[..., dict[str, Any]]:
        def write(diagnosis: Any) -> dict[str, Any]:
            data = written(diagnosis)
            assert not disagreements(data)
            return data

        return write

    monkeypatch.setattr(result, "to_json", checked(result.to_json))
    monkeypatch.setattr(static_json, "to_json", checked(static_json.to_json))
