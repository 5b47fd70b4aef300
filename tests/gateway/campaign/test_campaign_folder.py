"""A damaged run.json is refused by key and value; the recordings stay as they are."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from gateway.campaign.folder import Folder
from protocol.errors import DataError
from protocol.experiments import MENU

NAME = MENU[0].name
RECORDING: dict[str, Any] = {"bytes": 3, "seconds": 1.5, "attempts": 1, "plan": {"seed": 1}}
WHOLE: dict[str, Any] = {"format": 1, "identity": {"plant": {}}, "lift_off_v": None, "recordings": {NAME: RECORDING}}


def test_a_list_of_recordings_is_read(tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text(json.dumps(WHOLE))

    assert Folder(tmp_path).retained[NAME].seconds == 1.5


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"format": 2}, "format = 2 is not 1"),
        ({"recordings": None}, "recordings = None is not a table"),
        ({"lift_off_v": "3"}, "lift_off_v = '3' is not a finite number"),
        ({"recordings": {NAME: {**RECORDING, "bytes": "3"}}}, f"recordings.{NAME}.bytes = '3' is not a whole number"),
        ({"recordings": {NAME: {**RECORDING, "said": "x"}}}, f"recordings.{NAME}.said = 'x' is not a list of texts"),
    ],
)
def test_what_is_damaged_is_named(tmp_path: Path, change: dict[str, Any], said: str) -> None:
    (tmp_path / "run.json").write_text(json.dumps({**WHOLE, **change}))

    with pytest.raises(DataError) as refused:
        Folder(tmp_path)

    assert (
        str(refused.value) == f"{tmp_path / 'run.json'}: {said}. Give a new folder; the recordings here stay readable."
    )
