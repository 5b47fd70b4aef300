"""The headline: at most two short sentences, the difference and what to do."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from tests.harness.diagnose.known_diagnosis import diagnosis
from twin.diagnosis.report.headline import headline_of
from twin.diagnosis.result import Diagnosis, Member, Proposal
from twin.inference.budget import Budget
from twin.model.causes.catalogue import CATALOGUE
from twin.model.causes.cause import Cause

GAP_DIAGNOSIS = diagnosis("air-gap-offset", 5e-4)
UNKNOWN = diagnosis("air-gap-offset", 5e-4, extended=False, quick=True)
GAP = replace(GAP_DIAGNOSIS.causes[0], indistinguishable_from=(), next_experiment=None)
GAP_DIAGNOSIS = replace(GAP_DIAGNOSIS, causes=(GAP,))


def headline(result: Diagnosis, *, blind: bool = False, off: str = "") -> str:
    text = headline_of(result, blind=blind, off=off)
    sentences = re.split(r"(?<=[.!?]) ", text)
    assert len(sentences) <= 2, text
    assert all(len(sentence.split()) <= 25 for sentence in sentences), text
    return text


def with_class(member: str, experiment: str = "") -> Diagnosis:
    members = (Member(name=member, parameters={}, sentence="the ball weighs 6 % more than the campaign says"),)
    command = f"board51 campaign run FOLDER --experiment {experiment}" if experiment else ""
    proposal = Proposal(what="", separation_z=5.0, command=command, experiments=((experiment, {member: 5.0}),))
    return replace(GAP_DIAGNOSIS, causes=(replace(GAP, indistinguishable_from=members, next_experiment=proposal),))


def test_one_cause_is_a_size_and_a_cure() -> None:
    assert headline(GAP_DIAGNOSIS) == (
        "The coil sits 0.500 mm higher than in the model. "
        "Remedy: x_max + d in place of x_max, in the model and in the design."
    )


@pytest.mark.parametrize(("wander_a", "says"), [(0.05, True), (0.001, False)])
def test_an_offset_that_wanders_by_more_than_its_mean_says_so(wander_a: float, says: bool) -> None:
    known = replace(next(iter(GAP.parameters.values())), unit="A", std=1e-4, ci95=None)
    sizes = {"offset_a": replace(known, value=0.003), "wander_a": replace(known, value=wander_a)}
    finding = replace(GAP, name="current-sensor-offset", parameters=sizes)

    assert ("wanders by 50 mA in a minute" in headline(replace(GAP_DIAGNOSIS, causes=(finding,)))) == says


def test_a_class_asks_for_the_experiment_that_splits_it() -> None:
    text = headline(with_class("force-exponent", "steps-low"))

    assert text.endswith("It may be force-exponent instead: the experiment steps-low decides.")


def test_a_class_that_no_experiment_splits_asks_for_a_measurement() -> None:
    assert headline(with_class("residual-magnetism")).endswith("demagnetise and measure again.")


def test_a_stated_value_that_may_be_wrong_is_to_be_measured() -> None:
    text = headline(with_class("stated-mass"))

    assert text.endswith("Or the ball weighs 6 % more than the campaign says: weigh the ball on a kitchen balance.")


def test_several_causes_are_listed() -> None:
    drag = replace(GAP, name="quadratic-drag", share_of_excess_explained=0.1)

    text = headline(replace(GAP_DIAGNOSIS, causes=(drag, GAP)))

    assert text == (
        "Two causes act: quadratic-drag and air-gap-offset. "
        "Begin with air-gap-offset: x_max + d in place of x_max, in the model and in the design."
    )


def test_a_part_is_not_told_as_the_whole() -> None:
    partly = replace(GAP_DIAGNOSIS, verdict="partly-explained", causes=(replace(GAP, confidence=0.99),))

    assert "but not everything is explained." in headline(partly)


def test_nothing_known_says_where() -> None:
    text = headline(UNKNOWN)

    assert text == (
        "The model is wrong, and none of the known causes explains it. The remaining error is largest in x in steps_1."
    )


def test_an_adequate_model_needs_nothing() -> None:
    adequate = replace(UNKNOWN, verdict="model-adequate")

    assert headline(adequate) == "The model is adequate: its errors are sensor noise."
    assert headline(adequate, off="K_A is 5 % too large") == (
        "The form of the model is adequate, but K_A is 5 % too large."
    )
    assert headline(adequate, blind=True).startswith("For the amplifier only, because no recording has x: ")


def test_an_unfinished_search_says_so() -> None:
    text = headline(replace(GAP_DIAGNOSIS, verdict="unfinished", budget=Budget()))

    assert text == "No answer yet: the search used up its budget. So far it points to air-gap-offset."


@pytest.mark.parametrize("cause", CATALOGUE, ids=lambda cause: cause.name)
def test_the_headline_of_every_cause_is_short(cause: Cause) -> None:
    parameters = {known.name: replace(next(iter(GAP.parameters.values())), value=0.0123) for known in cause.parameters}

    headline(replace(GAP_DIAGNOSIS, causes=(replace(GAP, name=cause.name, parameters=parameters),)))
