"""Names that should not stand, and where a candidate for the place of one begins."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from protocol.campaign import load
from tests.harness.diagnose.hidden_campaign import make_campaign
from tests.harness.diagnose.simulated_rig import THETA, criterion_of, fitted, narrow, strong, trusting
from twin.diagnosis.options import Options
from twin.diagnosis.pipeline import diagnose
from twin.diagnosis.search import stepwise
from twin.diagnosis.search.candidate_fits import fit_candidates
from twin.diagnosis.search.candidate_starts import start_of
from twin.diagnosis.search.equivalence import find_classes
from twin.diagnosis.search.forward_step import Round
from twin.diagnosis.search.score_test import screen
from twin.diagnosis.search.state import Selection
from twin.inference.fisher_scoring import Fit
from twin.inference.theta import BASE, coordinates_of
from twin.model.causes.catalogue import BY_NAME
from twin.settings import diagnosis as settings

GAP, DRAG, FORCE, FRICTION = (
    "air-gap-offset",
    "quadratic-drag",
    "constant-force",
    "coulomb-friction",
)


def selection(base: Fit, fit: Fit, *causes: str) -> Selection:
    """Return a selection as if these causes had been taken, the last one by the only round that is known."""
    first = Round(scores=(), trials=(), selected=causes[0])
    return Selection(base=base, fit=fit, causes=causes, gains=dict.fromkeys(causes, 100.0), rounds=(first,))


def test_a_cause_that_turns_out_to_explain_nothing_is_dropped() -> None:
    rig = strong(GAP, 5e-4)
    criterion = criterion_of(narrow(rig, seconds=3.0))
    try:
        base = fitted(criterion, THETA)
        selected = selection(base, fitted(criterion, strong(DRAG, 0.1, rig), GAP, DRAG), GAP, DRAG)
        before = selected.fit.loglik
        selected = find_classes(trusting(criterion, base, BY_NAME[FORCE]), selected)
    finally:
        criterion.close()

    assert selected.causes == (GAP,)
    assert set(selected.gains) == {GAP}
    assert selected.fit.free == (*BASE, *coordinates_of(GAP))
    assert selected.fit.loglik > before - settings.MIN_GAIN


def test_a_candidate_starts_with_the_numbers_of_the_causes_that_stood_in_for_it() -> None:
    """Beside an offset of i_c that has taken up a dead zone, the dead zone begins where the offset gives it back."""
    rig = strong("amplifier-dead-zone", 0.24, strong("current-sensor-offset", -0.065))
    criterion = criterion_of(narrow(rig, seconds=3.0))
    try:
        at = fitted(criterion, strong("current-sensor-offset", -0.13), "current-sensor-offset")
        scores = {score.cause: score for score in screen(criterion, at.theta, at.free)}
        gains = [
            criterion.value(start_of(criterion, at.theta, scores[cause])) - at.loglik
            for cause in ("amplifier-dead-zone", "amplifier-offset")
        ]
    finally:
        criterion.close()

    assert at.theta.value("current-sensor-offset.offset_a") < -0.12
    assert min(gains) > 0.0


def test_a_candidate_that_cannot_reach_the_class_is_not_fitted_to_its_end() -> None:
    criterion = criterion_of(narrow(strong(GAP, 5e-4), seconds=3.0))
    try:
        base = fitted(criterion, THETA)
        scores = [score for score in screen(criterion, base.theta, base.free) if score.cause == FORCE]
        ended, far_behind = (
            fit_candidates(criterion, base, scores, cutoff_gain=gain)[0] for gain in (-math.inf, math.inf)
        )
    finally:
        criterion.close()

    assert ended.fit.converged
    assert not far_behind.fit.converged
    assert far_behind.gain <= ended.gain


@pytest.mark.sample
def test_quick_gives_the_first_of_two_causes_the_place_of_one_that_explains_more_beside_the_second(
    tmp_path: Path,
) -> None:
    """Alone, a bent force law takes up some of the friction; beside the friction the plain gap is better."""
    make_campaign(tmp_path, effects={FRICTION: 3e-3}, seed=41, plant="emulator", quick=True, x_max="travel")

    diagnosis = diagnose(load(tmp_path), Options(quick=True))

    assert [cause.name for cause in diagnosis.causes] == [GAP, FRICTION]
    friction = diagnosis.causes[1].parameters["force_n"]
    assert friction.std is not None
    assert abs(friction.value - 3e-3) < 3.0 * friction.std


def test_a_time_constant_that_went_to_zero_beside_a_wrong_model_comes_back_with_the_right_one() -> None:
    """Its logarithm has no slope there, and a lag of the field would be taken for it."""
    rig = strong(GAP, 5e-4)
    criterion = criterion_of(narrow(rig, seconds=3.0))
    try:
        lost = fitted(criterion, replace(rig, T_A=5e-7), GAP)
        back = stepwise._revived(criterion, lost)
    finally:
        criterion.close()

    assert back.theta.T_A == pytest.approx(rig.T_A, rel=0.1)
    assert back.loglik >= lost.loglik
