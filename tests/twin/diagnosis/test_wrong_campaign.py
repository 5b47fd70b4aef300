"""A whole campaign of an emulated rig without any cause, whose campaign.toml states something wrong."""

from __future__ import annotations

import gzip
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from protocol.campaign import load
from tests.harness.diagnose.hidden_campaign import make_campaign
from twin.diagnosis import result
from twin.diagnosis.options import Options
from twin.diagnosis.pipeline import diagnose
from twin.diagnosis.result import Diagnosis, Member

pytestmark = pytest.mark.sample
SEED = 5


def answer(folder: Path) -> Diagnosis:
    diagnosis = diagnose(load(folder), Options(quick=True, workers=1))
    result.to_json(diagnosis)  # whether its numbers agree
    return diagnosis


def stated(folder: Path, key: str, change: Callable[[float], float]) -> None:
    """Change a value of campaign.toml."""
    toml = folder / "campaign.toml"

    def changed(match: re.Match[str]) -> str:
        return f"{match[1]}{change(float(match[2])):.8g}"

    text, count = re.subn(rf"^({key} = )(\S+)$", changed, toml.read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert count == 1
    toml.write_text(text, encoding="utf-8")


def scaled(folder: Path, factors: tuple[float, ...]) -> None:
    """Scale the columns t, u_c, i_c, x and x_ref of all recordings; captures have the first three."""
    for path in folder.glob("*.csv.gz"):
        header, *rows = gzip.decompress(path.read_bytes()).decode().splitlines()
        lines = [
            ",".join(
                repr(float(cell) * factor) if cell else ""
                for cell, factor in zip(row.split(","), factors, strict=False)
            )
            for row in rows
        ]
        path.write_bytes(gzip.compress("\n".join([header, *lines, ""]).encode()))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    make_campaign(tmp_path / "campaign", effects={}, seed=SEED, plant="emulator")
    return tmp_path / "campaign"


def members(diagnosis: Diagnosis) -> dict[str, Member]:
    """The class of the only name."""
    (finding,) = diagnosis.causes
    return {member.name: member for member in finding.indistinguishable_from}


def test_a_mass_that_is_6_percent_wrong_is_not_testable_and_a_balance_settles_it(folder: Path) -> None:
    stated(folder, "mass_kg", lambda mass: 1.06 * mass)

    diagnosis = answer(folder)

    (mass,) = (entry for entry in diagnosis.not_testable if entry.name == "stated-mass")
    assert diagnosis.verdict == "model-adequate"
    assert mass.why == "absorbed by K_c; weigh the ball on a kitchen balance"


def test_a_clock_that_is_2_percent_slow_is_in_the_class(folder: Path) -> None:
    scaled(folder, (1.0 / 1.02, 1.0, 1.0, 1.0, 1.0))

    clock = members(answer(folder))["stated-clock"]

    assert clock.parameters["error"].value == pytest.approx(0.02, abs=0.005)


def test_an_x_max_that_is_wrong_by_0_2_mm_is_in_the_class(folder: Path) -> None:
    stated(folder, "x_max_m", lambda x_max: x_max + 0.2e-3)

    x_max = members(answer(folder))["stated-x-max"]

    assert x_max.parameters["error_m"].value == pytest.approx(-0.2e-3, abs=0.01e-3)
