"""Model files with causes: round trip, and what is refused by name."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from protocol.errors import DataError
from tests.harness.twin.true_model import cause, true_model
from twin.model.causes.catalogue import CATALOGUE, neutral
from twin.model.extension import sentences, vector
from twin.model.parameters import Model, model_from_dict

Data = dict[str, Any]


def test_every_cause_survives_the_round_trip(tmp_path: Path) -> None:
    effects = {cause.name: 0.5 * (cause.strength.low + cause.strength.high) for cause in CATALOGUE}
    model = true_model(effects=effects)
    path = tmp_path / "extended_model.json"
    path.write_text(json.dumps(model.to_json()))

    again = Model.load(path)

    assert again == model
    assert [cause.name for cause in again.causes] == list(effects)
    c = vector(again.causes)
    for entry in CATALOGUE:
        assert c[entry.strength.index] == effects[entry.name]


def test_a_shape_that_a_file_leaves_out_is_that_of_the_usual_form() -> None:
    data = true_model(effects={"core-saturation": 3.0, "coulomb-friction": 1e-3}).to_json()
    for entry, shapes in zip(data["causes"], (["knee"], ["extra", "slow_m_s"]), strict=True):
        for name in shapes:
            del entry["parameters"][name]

    model = model_from_dict(data, where="model.json")

    assert np.array_equal(
        vector(model.causes), vector(true_model(effects={"core-saturation": 3.0, "coulomb-friction": 1e-3}).causes)
    )
    assert model.causes[0].parameters["knee"].verdict == "assumed"


def test_without_causes_the_vector_is_neutral() -> None:
    assert np.array_equal(vector(true_model().causes), neutral())


def test_sentences_name_cause_and_number() -> None:
    assert sentences(true_model(effects={"air-gap-offset": 2.4e-3})) == [
        "air-gap-offset: the coil's plane is higher than x_max (d = 0.0024 m)"
    ]


def changed(**entry: object) -> Callable[[Data], None]:
    def change(data: Data) -> None:
        data["causes"][0]["parameters"]["d_m"].update(entry)

    return change


def renamed(data: Data) -> None:
    data["causes"][0]["name"] = "gremlins"


def stated(data: Data) -> None:
    data["causes"][0]["name"] = "stated-mass"


def without(data: Data) -> None:
    del data["causes"][1]["parameters"]["tau_s"]


def more(data: Data) -> None:
    data["causes"][0]["parameters"]["e_m"] = cause("air-gap-offset", 1e-3)["parameters"]["d_m"]


def twice(data: Data) -> None:
    data["causes"].append(cause("air-gap-offset", 1e-3))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (renamed, "causes 1 (gremlins) is not in the catalogue"),
        (stated, "causes 1 (stated-mass) is not in the catalogue"),
        (without, "causes 2 (amplifier-gain-drift).parameters.tau_s is missing"),
        (more, "causes 1 (air-gap-offset).parameters.e_m is not a parameter"),
        (twice, "causes 3 (air-gap-offset) appears twice"),
        (changed(unit="mm"), "d_m.unit = 'mm' is not 'm'"),
        (changed(value=0.8), "d_m.value = 0.8 is not in -0.002 .. 0.03"),
        (changed(value=None), "d_m.value = None is not"),
        (changed(verdict="sure"), "d_m.verdict = 'sure' is not"),
        (changed(ci95=[1.0]), "d_m.ci95 = [1.0] is not a list of 2 numbers"),
    ],
)
def test_a_cause_that_is_not_one_is_refused_by_name(change: Callable[[Data], None], says: str) -> None:
    data = copy.deepcopy(true_model(effects={"air-gap-offset": 8e-4, "amplifier-gain-drift": 0.05}).to_json())
    change(data)

    with pytest.raises(DataError) as refused:
        model_from_dict(data, where="x.json")

    assert str(refused.value).startswith("x.json: ")
    assert says in str(refused.value)
