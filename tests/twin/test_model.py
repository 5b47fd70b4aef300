"""Model files: what is refused, and that the shipped ones say what their sources say."""

from __future__ import annotations

import copy
import csv
import json
import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import linear_regression
from typing import Any

import numpy as np
import pytest

from protocol.errors import DataError
from twin.model.parameters import SHIPPED, Model, model_from_dict

DATA = Path(os.environ.get("BOARD51_DATA", Path(__file__).parents[3] / "shared" / "data"))


def put(path: str, value: object) -> Callable[[dict[str, Any]], None]:
    def change(data: dict[str, Any]) -> None:
        *parents, last = path.split(".")
        for parent in parents:
            data = data[parent]
        if value is None:
            del data[last]
        else:
            data[last] = value

    return change


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (put("plant", None), "x.json: plant is missing"),
        (put("plant.mass_kg", None), "plant.mass_kg is missing"),
        (put("plant.mass_kg", 8.28e3), "plant.mass_kg: 8280 kg is outside 0.1 g .. 2 kg"),
        (put("plant.travel_m", 5.7), "plant.travel_m: 5.7 m is outside"),
        (put("plant.x_max_m", 5.6e-3), "x_max_m: 5.6 mm lies within the travel of 5.7 mm"),
        (put("parameters.K_c", None), "parameters.K_c is missing"),
        (put("parameters.T_A.unit", "ms"), "parameters.T_A.unit = 'ms' is not 's'"),
        (put("parameters.T_A.value", math.nan), "parameters.T_A.value = nan is not a finite number"),
        (put("parameters.T_A.value", 0.0), "parameters.T_A.value = 0 is not in 1e-07 .. 1"),
        (put("parameters.b.value", -1.0), "parameters.b.value = -1 is not in"),
        (put("parameters.K_A.value", "0.3"), "parameters.K_A.value = '0.3' is not"),
        (put("parameters.K_A.value", True), "parameters.K_A.value = True is not"),
        (put("parameters.K_A.ci95", [1.0]), "parameters.K_A.ci95"),
        (put("parameters.K_A.verdict", "sure"), "parameters.K_A.verdict = 'sure' is not one of"),
        (put("noise.sigma_x_m", 0.0), "noise.sigma_x_m = 0.0 is not in"),
        (put("causes", [{"name": "air-gap-offset"}]), "causes 1 (air-gap-offset).parameters is missing"),
        (put("noise.sigma_x_mm", 5e-3), "noise.sigma_x_mm = 0.005 is not a key. Did you mean sigma_x_m"),
        (put("provenance", None), "provenance is missing"),
        (put("parameters.T_A.verdict", None), "parameters.T_A.verdict is missing"),
        (put("parameters.K_B", {}), "parameters.K_B.verdict is missing"),
        (put("causes", {}), "causes = {} is not a list"),
    ],
)
def test_a_model_that_is_not_one_is_refused_by_key(change: Callable[[dict[str, Any]], None], says: str) -> None:
    data = copy.deepcopy(Model.load("ce152").to_json())
    change(data)

    with pytest.raises(DataError, match=r"x\.json") as refused:
        model_from_dict(data, where="x.json")

    assert says in str(refused.value)


@pytest.mark.parametrize("text", ["", "[]", "3", "{", '{"plant": 1}', "\x00\x01"])
def test_a_file_that_is_not_a_model_gives_one_clear_error(text: str, tmp_path: Path) -> None:
    file = tmp_path / "model.json"
    file.write_text(text)

    with pytest.raises(DataError, match=r"model\.json"):
        Model.load(file)


def test_an_absent_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"nowhere\.json"):
        Model.load(tmp_path / "nowhere.json")


@pytest.mark.parametrize("name", SHIPPED)
def test_a_model_survives_its_own_json(name: str) -> None:
    model = Model.load(name)

    again = model_from_dict(json.loads(json.dumps(model.to_json())), where="again")

    assert again == model


def lift_off_current(gap_m: Sequence[float], i_c_a: Sequence[float], at_gap_m: float) -> float:
    """Current that just carries the ball at `at_gap_m`, A, by linear regression through measured equilibria.

    By (6) at rest i = sqrt(m g / K_c) * gap, so equilibria lie on a line for any origin of the gap.

    Args:
        gap_m: gaps of the equilibria, m, shape (n,).
        i_c_a: their coil currents, A, shape (n,).
        at_gap_m: gap of the ball at its lower stop, m.
    """
    slope, intercept = linear_regression(gap_m, i_c_a)
    return slope * at_gap_m + intercept


def force_constant(*, mass_kg: float, gravity_m_s2: float, gap_m: float, lift_off_a: float) -> float:
    """K_c of (8): m g gap^2 / i^2 at the instant of lift-off, N m^2/A^2."""
    return mass_kg * gravity_m_s2 * gap_m**2 / lift_off_a**2


def test_nominal_force_constant_follows_from_the_measured_equilibria() -> None:
    file = DATA / "ce152-equilibria" / "equilibria.csv"
    if not file.exists():
        pytest.skip(f"{file} is absent; set BOARD51_DATA")
    with file.open() as rows:
        points = [(float(row["gap_m"]), float(row["current_A"])) for row in csv.DictReader(rows)]
    model = Model.load("ce152")
    plant = model.plant

    lift_off = lift_off_current([gap for gap, _ in points], [i for _, i in points], plant.travel_m)
    k_c = force_constant(
        mass_kg=plant.mass_kg, gravity_m_s2=plant.gravity_m_s2, gap_m=plant.x_max_m, lift_off_a=lift_off
    )

    assert abs(model.K_c / k_c - 1.0) < 1e-4  # the file holds five digits


def test_inteco_force_constant_is_the_median_of_the_lift_off_ramps() -> None:
    folder = DATA / "inteco-mls2em"
    if not folder.exists():
        pytest.skip(f"{folder} is absent; set BOARD51_DATA")
    plant = Model.load("inteco").plant
    constants = []
    for ramp in sorted(folder.glob("force_*.csv.gz")):
        table = np.genfromtxt(ramp, delimiter=",", names=True)
        gap, current = table["gap_m"], table["i1_A"]
        ramp_starts = max(int(np.argmax(table["duty1"] > 0.02)), 200)
        rest = float(np.median(gap[10:ramp_starts]))
        left = np.flatnonzero(gap < rest - 0.4e-3)
        left = left[left > 50]
        if not 4.8e-3 < rest < 19e-3 or len(left) == 0:  # below the sensor's range, or resting on the coil's edge
            continue
        lift_off = float(np.median(current[left[0] - 12 : left[0] - 4]))
        constants.append(
            force_constant(mass_kg=plant.mass_kg, gravity_m_s2=plant.gravity_m_s2, gap_m=rest, lift_off_a=lift_off)
        )

    assert len(constants) == 15
    assert abs(float(np.median(constants)) / Model.load("inteco").K_c - 1.0) < 1e-3
