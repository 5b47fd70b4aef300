"""A line in the spectrum of the prediction errors, measured as a force."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.harness.diagnose.known_diagnosis import QUIET, steps
from tests.harness.diagnose.simulated_rig import PLANT, TICK_S, strong, trusting
from twin.diagnosis.search import equivalence as confounders
from twin.diagnosis.search.periodic import AMPLITUDE, CAUSE, FREQUENCY, Line, find_line, fit_phases, refine_phases
from twin.diagnosis.search.state import Selection
from twin.evidence.gather import gather
from twin.inference.fisher_scoring import climb
from twin.inference.likelihood import Criterion
from twin.inference.theta import BASE, Theta, coordinates_of
from twin.model.causes.catalogue import BY_NAME
from twin.settings import diagnosis as settings

FORCE_N, FREQUENCY_HZ = 2e-3, 7.3


def with_line(line: Line) -> Theta:
    theta = QUIET.having(AMPLITUDE, line.amplitude_n).having(FREQUENCY, line.frequency_hz)
    return replace(theta, phases_s=line.phases_s)


def test_a_line_is_the_same_after_the_phases_of_another_were_taken_over() -> None:
    """The search asks again in every round; by then the recordings' clocks are shifted for what it found before."""
    rig = strong(CAUSE.name, FORCE_N, QUIET).having(FREQUENCY, FREQUENCY_HZ)
    records = [steps(rig, seed=seed, seconds=20.0) for seed in (3, 4)]
    criterion = Criterion(gather(records, PLANT), PLANT, TICK_S, workers=1)
    try:
        first = find_line(criterion, QUIET)
        assert first is not None
        turned = replace(QUIET, phases_s=first.phases_s)
        again = find_line(criterion, turned)
        theta = turned.having(AMPLITUDE, first.amplitude_n).having(FREQUENCY, first.frequency_hz)
        gain = criterion.value(theta) - criterion.value(QUIET)
    finally:
        criterion.close()

    assert again is not None
    assert (again.amplitude_n, again.gain) == (first.amplitude_n, first.gain)
    assert again.phases_s == first.phases_s
    assert first.frequency_hz == pytest.approx(FREQUENCY_HZ, abs=0.01)
    assert first.amplitude_n == pytest.approx(FORCE_N, rel=0.05)
    assert gain == pytest.approx(first.gain, rel=0.1)


def test_the_frequency_is_found_with_recordings_that_are_a_minute_into_the_campaign() -> None:
    """With phases that turn about t = 0 it stayed where the spectrum had put it, and a tenth of the force was left."""
    rig = strong(CAUSE.name, FORCE_N, QUIET).having(FREQUENCY, FREQUENCY_HZ)
    records = [steps(rig, seed=seed, seconds=8.0) for seed in (3, 4, 5)]
    records = [replace(record, t=record.t + 60.0 + 9.0 * k) for k, record in enumerate(records)]
    criterion = Criterion(gather(records, PLANT), PLANT, TICK_S, workers=1)
    try:
        line = find_line(criterion, QUIET, FREQUENCY_HZ + 0.01)
        assert line is not None
        start = (
            replace(QUIET, phases_s=line.phases_s)
            .having(AMPLITUDE, line.amplitude_n)
            .having(FREQUENCY, line.frequency_hz)
        )
        fit = fit_phases(criterion, climb(criterion, start, (*BASE, AMPLITUDE, FREQUENCY)), settings.PASSES)
    finally:
        criterion.close()

    assert fit.theta.value(FREQUENCY) == pytest.approx(FREQUENCY_HZ, abs=1.5e-3)
    assert fit.theta.value(AMPLITUDE) == pytest.approx(FORCE_N, rel=0.03)


def test_the_form_of_a_force_that_is_no_sinusoid_is_found() -> None:
    form = {f"{CAUSE.name}.sine_3": 1.0 / 3.0, f"{CAUSE.name}.cosine_2": -0.2}
    rig = strong(CAUSE.name, FORCE_N, QUIET).having(FREQUENCY, FREQUENCY_HZ).all_of(form.items())
    criterion = Criterion(
        gather([steps(rig, seed=seed, seconds=20.0) for seed in (3, 4)], PLANT), PLANT, TICK_S, workers=1
    )
    try:
        line = find_line(criterion, QUIET)
        assert line is not None
        free = (*BASE, *coordinates_of(CAUSE.name))
        fit = fit_phases(criterion, climb(criterion, with_line(line), free), settings.PASSES)
    finally:
        criterion.close()

    for name in coordinates_of(CAUSE.name)[2:]:
        assert fit.theta.value(name) == pytest.approx(form.get(name, 0.0), abs=max(4.0 * fit.std(name, PLANT), 0.01))
        assert fit.std(name, PLANT) < 0.05


def test_a_short_recording_has_a_phase_of_its_own() -> None:
    rig = strong(CAUSE.name, FORCE_N, QUIET).having(FREQUENCY, FREQUENCY_HZ)
    long, short = steps(rig, seed=3, seconds=20.0), steps(rig, seed=4, seconds=0.5)
    short = replace(short, t=short.t + 0.05)  # a third of a period: no phase is right by chance
    criterion = Criterion(gather([long, short], PLANT), PLANT, TICK_S, workers=1)
    try:
        line = find_line(criterion, QUIET, FREQUENCY_HZ)
        assert line is not None
        theta = (
            replace(QUIET, phases_s=line.phases_s)
            .having(AMPLITUDE, line.amplitude_n)
            .having(FREQUENCY, line.frequency_hz)
        )
        _, white = criterion.white(theta)
        mask = criterion.evidence.series.recording == 1
    finally:
        criterion.close()

    assert 0.8 < np.nanmean(white[mask, 1] ** 2) < 1.2


@pytest.mark.slow
def test_each_recording_settles_at_the_phase_of_its_own() -> None:
    rig = strong(CAUSE.name, FORCE_N, QUIET).having(FREQUENCY, FREQUENCY_HZ)
    criterion = Criterion(gather([steps(rig, seed=seed) for seed in (3, 4, 5)], PLANT), PLANT, TICK_S, workers=1)
    free = (*BASE, AMPLITUDE, FREQUENCY)
    turn_s = 1.0 / (2.0 * np.pi * FREQUENCY_HZ)
    try:
        best = climb(criterion, rig, free)
        off = climb(criterion, replace(rig, phases_s=(0.0, 0.6 * turn_s, -0.3 * turn_s)), free)
        fit = refine_phases(criterion, off, settings.PASSES)
        turns = [phase / turn_s % (2.0 * np.pi) for phase in fit.theta.phases_s]
    finally:
        criterion.close()

    assert off.loglik < best.loglik - 100.0
    assert best.loglik - 1.0 < fit.loglik < best.loglik + 10.0, "three phases gain a little out of noise"
    assert np.ptp(turns) < 0.1  # all together they may turn with the frequency
    assert fit.theta.value(AMPLITUDE) == pytest.approx(FORCE_N, rel=0.03)


@pytest.mark.sample
def test_a_confounder_has_the_phases_that_belong_to_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """What shakes the ball is read late by a lag of the sensor, and not by one of the field."""
    field, sensor = "eddy-current-lag", "position-sensor-lag"
    rig = strong(field, 3e-3, strong(CAUSE.name, 4e-3, QUIET).having(FREQUENCY, FREQUENCY_HZ))
    criterion = Criterion(gather([steps(rig, seed=seed) for seed in (3, 4)], PLANT), PLANT, TICK_S, workers=1)
    free = (*BASE, AMPLITUDE, FREQUENCY, *coordinates_of(sensor))
    start = strong(sensor, 3e-3, rig.without(field, PLANT))
    answers = {}
    try:
        base = climb(criterion, QUIET, BASE)
        false = refine_phases(
            criterion, fit_phases(criterion, climb(criterion, start, free), settings.PASSES), settings.PASSES
        )
        for candidate_count in (0, 2):
            monkeypatch.setattr(settings, "PHASE_CANDIDATES", candidate_count)
            causes = (CAUSE.name, sensor)
            gained = dict.fromkeys(causes, false.loglik - base.loglik)
            selection = Selection(base=base, fit=false, causes=causes, gains=gained)
            answers[candidate_count] = confounders.find_classes(trusting(criterion, base, BY_NAME[field]), selection)
    finally:
        criterion.close()

    assert set(answers[2].causes) == {CAUSE.name, field}
    assert answers[2].fit.theta.value(f"{field}.tau_s") == pytest.approx(3e-3, rel=0.03)
    assert answers[2].fit.loglik > false.loglik + 50.0
    assert set(answers[0].causes) == {CAUSE.name, sensor}, "else nothing shows that it takes phases"
