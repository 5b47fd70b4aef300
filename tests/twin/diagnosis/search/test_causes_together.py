"""Two causes of one size hide each other: each alone explains less than a fifth, together they leave noise."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from protocol.campaign import load
from tests.harness.diagnose.hidden_campaign import make_campaign
from tests.harness.diagnose.simulated_rig import THETA, criterion_of, fitted, narrow, strong, trusting
from twin.diagnosis.report.sentences import round_sentence
from twin.diagnosis.search import forward_step as forward
from twin.diagnosis.search import stepwise as search
from twin.diagnosis.search.candidate_fits import Trial
from twin.diagnosis.search.candidate_starts import substitute_start
from twin.diagnosis.search.equivalence import _refit_from, find_classes
from twin.diagnosis.search.score_test import probed, screen
from twin.diagnosis.search.state import Selection
from twin.diagnosis.search.task import Search
from twin.evidence.gather import gather
from twin.inference.fisher_scoring import Fit, climb
from twin.inference.initial_guess import start_theta, with_noise_bounds
from twin.inference.likelihood import Criterion
from twin.inference.noise_floor import Floor, floor_of
from twin.inference.theta import BASE, STOPS, coordinates_of
from twin.model.causes.catalogue import BY_NAME
from twin.readers.campaign import read_campaign
from twin.settings import diagnosis as settings

OFFSET, DELAY = "current-sensor-offset", "actuation-delay"
HIDDEN = {"quadratic-drag": 2.0, "air-gap-offset": 3e-4}
TRIED = tuple(BY_NAME[name] for name in (*HIDDEN, "constant-force"))


@pytest.mark.slow
def test_causes_that_hide_each_other_are_selected_together_or_not_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without the rule of the benefit, which would take the first of these two by itself."""
    monkeypatch.setattr(settings, "MIN_BENEFIT", 1.0)
    make_campaign(tmp_path / "both", effects=HIDDEN, seed=310, plant="independent", quick=True)
    campaign = load(tmp_path / "both")
    records = read_campaign(campaign)
    criterion = Criterion(gather(records, campaign.plant), campaign.plant, 2e-3, workers=1)
    try:
        start = with_noise_bounds(start_theta(records, campaign.plant), criterion.evidence)
        base = climb(criterion, start, (*BASE, *STOPS))
        floor = floor_of(criterion, base.theta)
        task = Search(criterion=criterion, floor=floor, candidates=TRIED)
        single = search.select(replace(task, candidates=(TRIED[1], TRIED[2])), base, classes=False)
        both = search.select(replace(task, quick=True), base, classes=False)
        right = floor.under(criterion, both.fit.theta)
    finally:
        criterion.close()

    assert single.causes == ()  # the other is not among the candidates: no pair explains nearly all
    assert set(both.causes) == set(HIDDEN)
    assert [(step.selected, step.partner) for step in both.rounds[:2]] == [both.causes, both.causes[::-1]]
    assert round_sentence(both.rounds[0]).startswith(f"together with {both.causes[1]}, log-likelihood +")
    assert not right.material(both.fit.loglik)
    assert abs(right.excess(both.fit.loglik)) < right.tolerance
    assert both.fit.theta.value("quadratic-drag.c_n_s2_m2") == pytest.approx(2.0, rel=0.05)
    assert both.fit.theta.value("air-gap-offset.d_m") == pytest.approx(3e-4, rel=0.05)


@pytest.mark.slow
def test_one_cause_takes_the_place_of_two_that_are_confounded_with_it(tmp_path: Path) -> None:
    three = ("position-sensor-nonlinearity", "residual-magnetism", "quadratic-drag")
    make_campaign(tmp_path / "both", effects=HIDDEN, seed=310, plant="independent", quick=True)
    campaign = load(tmp_path / "both")
    criterion = Criterion(gather(read_campaign(campaign), campaign.plant), campaign.plant, 2e-3, workers=1)
    try:
        base = climb(criterion, start_theta(read_campaign(campaign), campaign.plant), (*BASE, *STOPS))
        free = (*base.free, *(name for cause in three for name in coordinates_of(cause)))
        fit = climb(criterion, probed(base.theta, BY_NAME["quadratic-drag"], 2.0), free)
        gains = dict(zip(three, (1.0, 2.0, 3.0), strict=True))
        at_first = Selection(base=base, fit=fit, causes=three, gains=gains)
        emf, magnetism = BY_NAME["motional-emf"], BY_NAME["residual-magnetism"]
        task = trusting(criterion, base, emf)
        unmoved = find_classes(task, at_first)
        exchanged = find_classes(replace(task, candidates=(*TRIED, magnetism)), at_first)
    finally:
        criterion.close()

    assert unmoved.causes == three
    assert set(exchanged.causes) == set(exchanged.gains) == set(HIDDEN)
    assert exchanged.fit.loglik > fit.loglik - settings.EQUIVALENT_GAIN
    assert exchanged.fit.theta.value("air-gap-offset.d_m") == pytest.approx(3e-4, rel=0.05)


@pytest.fixture(scope="module")
def leaders() -> Iterator[tuple[Search, Fit, dict[str, Fit]]]:
    """A rig with an offset of i_c and a delay: a search for the offset, the fit with neither and those with one."""
    sizes = {OFFSET: 0.02, DELAY: 1e-3}
    criterion = criterion_of(narrow(strong(DELAY, sizes[DELAY], strong(OFFSET, sizes[OFFSET])), seconds=3.0))
    try:
        base = fitted(criterion, THETA)
        fits = {name: fitted(criterion, strong(name, size, base.theta), name) for name, size in sizes.items()}
        yield trusting(criterion, base, BY_NAME[OFFSET]), base, fits
    finally:
        criterion.close()


@pytest.mark.parametrize(("lead", "first"), [(1.1, DELAY), (1.3, OFFSET)])
def test_the_next_cause_decides_between_candidates_that_gain_nearly_as_much(
    lead: float, first: str, leaders: tuple[Search, Fit, dict[str, Fit]]
) -> None:
    """Only the offset is left to be asked: beside the delay it explains more, beside itself nothing does."""
    task, _, fits = leaders
    gains = {OFFSET: lead * 1000.0, DELAY: 1000.0}
    trials = [Trial(cause=name, fit=fits[name], gain=gain) for name, gain in gains.items()]
    order = forward._with_next(task, task.floor, trials)

    assert order[0].cause == first
    assert sorted(trial.cause for trial in order) == [DELAY, OFFSET]


def test_a_candidate_that_explains_as_much_alone_comes_before_two(
    leaders: tuple[Search, Fit, dict[str, Fit]],
) -> None:
    """A gap and an offset of the sensor explained 5 more together than the offset alone, which was right."""
    task, _, fits = leaders
    (score,) = screen(task.criterion, fits[DELAY].theta, fits[DELAY].free, [BY_NAME[OFFSET]])
    following = score.gain - score.chance
    gains = {OFFSET: 11.0 * following - 0.5 * settings.MIN_GAIN, DELAY: 10.0 * following}
    trials = [Trial(cause=name, fit=fits[name], gain=gain) for name, gain in gains.items()]

    assert forward._with_next(task, task.floor, trials)[0].cause == OFFSET


def test_a_candidate_that_leaves_less_than_noise_is_not_put_behind_for_that(
    leaders: tuple[Search, Fit, dict[str, Fit]],
) -> None:
    """Where only a stop is misplaced, log-likelihood beyond the floor once counted against the better fit."""
    task, base, fits = leaders
    worse, better = sorted(fits, key=lambda name: fits[name].loglik)
    gain = fits[better].loglik - base.loglik
    trials = [Trial(cause=name, fit=fits[name], gain=share * gain) for name, share in ((worse, 0.9), (better, 1.0))]
    floor = replace(task.floor, logliks=(base.loglik, 0.0), misplaced_m=2.0 * settings.MISPLACED_STOP_M)

    assert floor.excess(fits[worse].loglik) < 0.0
    assert floor.material(fits[better].loglik)
    assert forward._with_next(task, floor, trials)[0].cause == better


@pytest.mark.parametrize(("share", "selected"), [(0.0, OFFSET), (1.0, DELAY)])
@pytest.mark.slow
def test_a_forward_step_asks_for_the_next_cause_of_all_leaders(
    share: float, selected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Alone the delay gains most; with the offset first, the two explain more together."""
    monkeypatch.setattr(settings, "LEADERS_SHARE", share)
    delay, offset = BY_NAME[DELAY], BY_NAME[OFFSET]
    criterion = criterion_of(narrow(strong(delay.name, 1e-3, strong(offset.name, 0.1)), seconds=3.0))
    try:
        base = fitted(criterion, THETA)
        task = replace(trusting(criterion, base, offset), candidates=(offset, delay))
        step = forward.forward(task, base, base)
    finally:
        criterion.close()

    assert step.selected == selected
    assert max(step.trials, key=lambda trial: trial.gain).cause == delay.name


@pytest.mark.slow
def test_a_cause_that_only_led_another_to_a_higher_maximum_is_removed() -> None:
    rig = strong("coulomb-friction", 4e-3)
    criterion = criterion_of(narrow(rig, seconds=3.0))
    try:
        base = fitted(criterion, THETA)
        low = base.theta.having("coulomb-friction.force_n", 1e-5)
        stuck = Fit(
            theta=low,
            free=(*base.free, *coordinates_of("coulomb-friction")),
            loglik=criterion.value(low),
            covariance=np.eye(1),
            converged=True,
        )
        both = fitted(criterion, strong("coulomb-friction", 3e-3, base.theta), "coulomb-friction", "constant-force")
        causes = ("coulomb-friction", "constant-force")
        at_first = Selection(base=base, fit=both, causes=causes, gains=dict.fromkeys(causes, 1.0)).with_fits([stuck])
        reduced = search.backward(trusting(criterion, base, BY_NAME["constant-force"]), at_first)
    finally:
        criterion.close()

    assert reduced.causes == ("coulomb-friction",)
    # The likelihood of dry friction has kinks, at which the climb with both may end below that with one.
    assert reduced.fit.loglik > both.loglik - settings.MIN_GAIN
    assert both.loglik - stuck.loglik > 10.0 * settings.MIN_GAIN


def test_a_dead_zone_begins_with_the_size_of_the_offset_that_it_may_stand_for() -> None:
    """One in V, one in A: between the values of a grid the likelihood is 100 000 lower, and no climb began there."""
    offset, zone = BY_NAME["amplifier-offset"], BY_NAME["amplifier-dead-zone"]
    rig = strong(offset.name, -0.0611)
    criterion = criterion_of(narrow(rig, seconds=4.0))
    try:
        zone_start = substitute_start(criterion, rig, offset, zone)
        back = substitute_start(criterion, zone_start, zone, offset)
    finally:
        criterion.close()

    assert zone_start.value("amplifier-dead-zone.width_v") == pytest.approx(0.0611 / rig.K_A)
    assert back.value("amplifier-offset.offset_a") == pytest.approx(-0.0611)


def test_a_candidate_is_fitted_again_from_a_start_that_is_worse_than_its_fit() -> None:
    """An offset and a dead zone differ beside a drift of the gain: exchanged, they begin below a local maximum."""
    zone, offset, drift = "amplifier-dead-zone", "amplifier-offset", "amplifier-gain-drift"
    rig = strong(zone, 0.34, strong(drift, 0.08))
    criterion = criterion_of(narrow(rig, seconds=6.0))
    try:
        none = fitted(criterion, strong(drift, 0.08), drift)
        right = fitted(criterion, rig, zone, drift)
        fit = fitted(criterion, strong(offset, -0.102, strong(drift, 0.08)), offset, drift)
        selected = Trial(cause=offset, fit=fit, gain=fit.loglik - none.loglik)
        start = substitute_start(criterion, fit.theta, BY_NAME[offset], BY_NAME[zone])
        width = right.theta.value("amplifier-dead-zone.width_v")
        stuck = right.theta.having("amplifier-dead-zone.width_v", 1.01 * width)
        low = replace(right, theta=stuck, loglik=criterion.value(stuck))
        again = _refit_from(criterion, selected, Trial(cause=zone, fit=low, gain=low.loglik - none.loglik))
        hopeless = Trial(cause=zone, fit=low, gain=low.loglik - criterion.value(start))
        unmoved = _refit_from(criterion, selected, hopeless)
        begun = criterion.value(start)
    finally:
        criterion.close()

    assert none.loglik < begun < low.loglik < fit.loglik - settings.EQUIVALENT_GAIN
    assert again.fit.loglik > right.loglik - settings.EQUIVALENT_GAIN
    assert again.gain == pytest.approx(again.fit.loglik - none.loglik)
    assert unmoved is hopeless, "from a start that explains nothing no climb is made"


@pytest.mark.sample
@pytest.mark.xfail(
    reason="eddy-current-lag is selected in the third round since steps are computed in another order of rounding, and "
    "position-sensor-lag stays beside the three hidden causes"
)
def test_what_was_refused_beside_a_confounder_is_asked_again_beside_the_right_cause(tmp_path: Path) -> None:
    """A lag of the sensor stands for one of the force, and beside it a drag explains a hundredth of what is left."""
    hidden = {"eddy-current-lag": 3.7e-3, "quadratic-drag": 1.0, "periodic-disturbance": 5e-3}
    make_campaign(tmp_path / "three", effects=hidden, seed=6, plant="emulator", quick=True)
    campaign = load(tmp_path / "three")
    records = read_campaign(campaign)
    criterion = Criterion(gather(records, campaign.plant), campaign.plant, 2e-3, workers=1)
    tried = tuple(BY_NAME[name] for name in (*hidden, "position-sensor-lag"))
    try:
        start = with_noise_bounds(start_theta(records, campaign.plant), criterion.evidence)
        base = climb(criterion, start, (*BASE, *STOPS))
        task = Search(criterion=criterion, floor=floor_of(criterion, base.theta), candidates=tried)
        selection = search.select(task, base)
    finally:
        criterion.close()

    assert [step.selected for step in selection.rounds][:3] == ["position-sensor-lag", "periodic-disturbance", ""]
    assert set(selection.causes) == set(selection.gains) == set(selection.classes) == set(hidden)


def test_a_ball_that_is_held_is_well_predicted_and_that_proves_no_friction(monkeypatch: pytest.MonkeyPatch) -> None:
    """Prediction pays for a cause that explains little of what is left, but not for one that stops the ball."""
    rig = strong("coulomb-friction", 1.5e-3)
    criterion = criterion_of(narrow(rig, seconds=3.0))
    try:
        base = fitted(criterion, THETA)
        rubs = fitted(criterion, rig, "coulomb-friction")
        # Sensors ten times better than those of the rig: much is left that no cause explains.
        floor = Floor(sigma_i_c_a=2e-4, sigma_x_m=5e-7, measured=True).under(criterion, base.theta)
        trial = Trial(cause="coulomb-friction", fit=rubs, gain=rubs.loglik - base.loglik)
        held = forward.decide(criterion, base, base, floor, [], [trial], settings.MIN_SHARE)
        monkeypatch.setattr(forward, "HOLDS", frozenset())
        other = forward.decide(criterion, base, base, floor, [], [trial], settings.MIN_SHARE)
    finally:
        criterion.close()

    assert trial.gain > 100.0
    assert held.selected == ""
    assert held.refusal == "small share"
    assert 0.0 < held.share < settings.MIN_SHARE
    assert f"explains {100.0 * held.share:.0f} % of what is left" in round_sentence(held)
    assert other.selected == "coulomb-friction"


def test_dry_friction_is_climbed_to_from_a_wrong_model() -> None:
    """A filter that takes a slow ball for held, or for free, has a likelihood that no climb gets up."""
    rig = strong("coulomb-friction", 4e-3)
    criterion = criterion_of(narrow(rig, seconds=3.0))
    try:
        base = fitted(criterion, THETA)
        fit = fitted(criterion, strong("coulomb-friction", 1e-3, base.theta), "coulomb-friction")
    finally:
        criterion.close()

    at_rest = fit.theta.value("coulomb-friction.force_n") * (1.0 + fit.theta.value("coulomb-friction.extra"))
    assert at_rest == pytest.approx(4e-3, rel=0.02)  # so narrow a motion leaves open how it changes with the speed
    assert fit.theta.process_a_m_s2 < 0.1 * base.theta.process_a_m_s2
