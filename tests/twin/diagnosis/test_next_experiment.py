"""diagnosis.json tells `board51 investigate` which experiment would split a class: written here, read there."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import pytest

from gateway.investigate import decide
from protocol.diagnosis import read_diagnosis
from tests.harness.diagnose.known_diagnosis import diagnosis
from twin.diagnosis.experiments import design
from twin.diagnosis.result import Proposal, to_json

CONFOUNDER = "position-sensor-gain"


def test_every_experiment_comes_with_its_separation_from_every_confounder() -> None:
    result = diagnosis("air-gap-offset", 5e-4)
    (cause,) = result.causes
    proposal = Proposal(
        what="hold it",
        separation_z=14.0,
        now_z={CONFOUNDER: 1.25},
        experiments=(("holds", {CONFOUNDER: 14.0}), ("rest", {CONFOUNDER: math.nan})),
    )
    result = replace(result, causes=(replace(cause, next_experiment=proposal),))

    data = json.loads(json.dumps(to_json(result), allow_nan=False))

    (suspect,) = read_diagnosis(data, where="diagnosis.json").suspects
    assert suspect.name == cause.name
    assert suspect.confounders == {CONFOUNDER: 1.25}
    assert suspect.experiments == {"holds": {CONFOUNDER: 14.0}, "rest": {CONFOUNDER: 0.0}}


def test_both_call_two_causes_one_class_up_to_the_same_separation() -> None:
    assert pytest.approx(design.ENOUGH_Z) == decide.ENOUGH_Z
