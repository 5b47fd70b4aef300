"""A diagnosis reports on the causes that it does not name: ruled out but for a size, or seen and too small."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from protocol.campaign import load
from tests.harness.diagnose.hidden_campaign import make_campaign
from tests.harness.diagnose.simulated_rig import THETA, criterion_of, fitted, narrow, strong
from twin.diagnosis.options import Options
from twin.diagnosis.pipeline import diagnose
from twin.diagnosis.report.other_causes import minor_effects_of
from twin.diagnosis.search.candidate_fits import Trial
from twin.diagnosis.search.forward_step import Round
from twin.diagnosis.search.state import Selection
from twin.inference.likelihood import Criterion
from twin.settings import diagnosis as settings

INDUCTANCE = "position-dependent-inductance"


@pytest.mark.sample
def test_what_is_a_hundredth_of_another_cause_is_listed_with_its_size_and_not_ruled_out(tmp_path: Path) -> None:
    growth = 2.4  # of T_A at the upper stop; the catalogue counts it in the middle of the travel
    make_campaign(tmp_path / "two", effects={"slew-rate-limit": 70.0, INDUCTANCE: growth}, seed=41, plant="emulator")

    diagnosis = diagnose(load(tmp_path / "two"), Options(workers=2))

    assert [cause.name for cause in diagnosis.causes] == ["slew-rate-limit"]
    assert [effect.name for effect in diagnosis.minor_effects] == [INDUCTANCE]
    assert diagnosis.minor_effects[0].loglik_gain < 0.015 * diagnosis.causes[0].loglik_gain
    assert INDUCTANCE not in {effect.name for effect in diagnosis.ruled_out}
    size = diagnosis.minor_effects[0].parameters["growth"]
    assert size.ci95 is not None
    bottom, middle, top = 8.1e-3, 5.25e-3, 2.4e-3
    truth = growth * (1 / middle - 1 / bottom) / (1 / top - 1 / bottom)
    assert size.value == pytest.approx(truth, abs=1.5 * (size.ci95[1] - size.ci95[0]) / 2.0)


@pytest.fixture
def refused() -> Iterator[tuple[Criterion, Selection]]:
    """A search that named a constant force, and refused a lag of the sensor beside it."""
    rig = strong("position-sensor-lag", 2e-3, strong("constant-force", 2e-3))
    criterion = criterion_of(narrow(rig))
    base = fitted(criterion, THETA)
    fit = fitted(criterion, strong("constant-force", 2e-3), "constant-force")
    both = fitted(criterion, rig, "constant-force", "position-sensor-lag")
    trial = Trial(cause="position-sensor-lag", fit=replace(both, converged=True), gain=both.loglik - fit.loglik)
    last = Round(scores=(), trials=(trial,), selected="")
    selection = Selection(base=base, fit=fit, causes=("constant-force",), gains={"constant-force": 1.0}, rounds=(last,))
    yield criterion, selection
    criterion.close()


def test_what_chance_makes_what_is_confounded_and_what_belongs_to_another_model_are_no_minor_effects(
    refused: tuple[Criterion, Selection],
) -> None:
    criterion, selection = refused
    trial = selection.rounds[-1].trials[0]

    def listed(**changes: object) -> list[str]:
        return [effect.name for effect in minor_effects_of(criterion, replace(selection, **changes))]  # type: ignore[arg-type]  # one helper

    def after(last: Round) -> tuple[Round, ...]:
        return (last,)

    assert trial.gain > 2.0 * settings.MIN_GAIN
    assert listed() == ["position-sensor-lag"]
    assert listed(rounds=after(replace(selection.rounds[-1], selected="position-sensor-lag"))) == []
    assert (
        listed(rounds=after(replace(selection.rounds[-1], trials=(replace(trial, gain=0.9 * settings.MIN_GAIN),))))
        == []
    )
    assert listed(classes={"constant-force": (trial,)}) == []
    assert listed(causes=["air-gap-offset"]) == []
    assert listed(rounds=[]) == []
