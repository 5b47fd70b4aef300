"""A right model passes on a rig that shares no code with it; a wrong one does not, and the reason is said."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.harness.twin.judged_ball import BALL, TICKS, captured, controller_of, model_of, steps, validate_records
from twin.estimation.record import Record
from twin.estimation.step_figures import FIGURES, Compared, find_steps, measure, together
from twin.validation.report import to_html
from twin.validation.source import source_of
from twin.validation.verdict import Validation, validate_sources


@pytest.fixture(scope="module")
def records() -> list[Record]:
    flight = replace(BALL.closed_loop(steps(100), TICKS, seed=200), use="judge")
    return [captured(BALL, 5), flight]


@pytest.fixture(scope="module")
def right(records: list[Record]) -> Validation:
    return validate_records(records, model_of(BALL))


@pytest.fixture(scope="module")
def heavy_handed(records: list[Record]) -> Validation:
    """Provide the validation by a model with three times the force."""
    return validate_records(records, model_of(BALL, K_c=3.0))


@pytest.mark.slow
def test_a_plant_that_nobody_stated_and_an_error_at_one_horizon_in_the_report(records: list[Record]) -> None:
    model = model_of(BALL)
    result = validate_records(records, replace(model, plant=replace(model.plant, assumed=True)))

    page = to_html(replace(result, ahead=result.ahead[:1]), title="t")

    ball = f"for an assumed ball of {BALL.m * 1e3:.3g} g"
    assert ball in result.notes[0]
    assert f"K_c and b {ball}" in page
    assert 'alt="error over the horizon"' not in page  # of one point: a table
    assert f"<td>{result.ahead[0].horizon_s * 1e3:.0f} ms</td>" in page


def test_a_step_figure_that_just_misses_among_five_is_no_difference() -> None:
    rows = [Compared(name=name, rig=1.0, simulation=1.0, difference=0.1, ci95=(0.01, 0.2), count=9, steps=9,
                     rig_count=9, simulation_count=9, chance=chance)
            for name, chance in zip(FIGURES, (0.04, 0.5, 0.6, 0.7, 0.8), strict=True)]  # fmt: skip

    assert not any(row.significant for row in together(rows))
    assert [row.significant for row in together([replace(rows[0], chance=1e-4), *rows[1:]])] == [True, *[False] * 4]


def test_right_model_passes_every_part(right: Validation) -> None:
    assert right.passed, right.failures()
    assert [round(row.horizon_s * 1e3) for row in right.ahead] == [2, 10, 20, 40]
    assert all(row.at_floor for row in right.ahead)
    # Both ways: a floor stated too high would pass anything.
    assert all(row.ratio_ci95[1] > 0.95 for row in right.ahead)
    assert not isinstance(right.channels, str)
    assert [c.name for c in right.channels] == ["i_c", "x"]
    assert all(c.passed for c in right.channels)
    assert not isinstance(right.amplifier, str)
    # RMSE of 1000 samples scatters by 1/sqrt(2000) = 2.2 %; four of these.
    assert right.amplifier.rmse_a == pytest.approx(BALL.sigma_i, rel=0.09)
    assert not isinstance(right.loop, str)
    settling = next(row for row in right.loop.steps if row.name == "settling_s")
    assert settling.count > 20
    assert settling.ci95 is not None
    low, high = settling.ci95
    # 1.85 half widths of 95 % are the 99.9 % interval of t with 20 degrees; the coverage test counts those of 95 %.
    assert abs(low + high) / 2 <= 1.85 * (high - low) / 2
    differs = any(row.significant for row in right.loop.steps)
    assert right.answer().endswith("The closed loop agrees.") == (not differs)
    assert right.answer().count(". ") <= 1


def test_wrong_force_constant_is_refused(records: list[Record]) -> None:
    result = validate_records(records, model_of(BALL, K_c=0.8))

    assert result.passed is False
    # After 40 ms a force 20 % wrong is 0.2 g t^2 / 2 = 1.5 mm off at least; noise leaves tens of micrometres.
    assert result.ahead[-1].ratio > 10.0
    assert not result.ahead[-1].at_floor
    assert not isinstance(result.channels, str)
    assert not result.channels[1].passed
    assert result.answer().startswith("The model does not explain")


def test_wrong_amplifier_gain_shows_in_figure_7(records: list[Record], right: Validation) -> None:
    wrong = validate_records(records, model_of(BALL, K_A=1.1))

    assert not isinstance(right.amplifier, str)
    assert not isinstance(wrong.amplifier, str)
    assert wrong.amplifier.rmse_a > 10.0 * right.amplifier.rmse_a
    assert wrong.passed is False
    assert any("(1) misses" in text for text in wrong.failures())


def test_a_reference_that_moves_on_before_the_ball_settles_is_said() -> None:
    levels = np.random.default_rng(8).uniform(2.3e-3, 3.7e-3, 20)
    flight = replace(BALL.closed_loop(lambda k: float(levels[k // 80]), 1600, seed=9), use="judge")

    result = validate_records([flight], model_of(BALL))

    assert not isinstance(result.loop, str)
    settling = next(row for row in result.loop.steps if row.name == "settling_s")
    assert settling.rig_count < settling.steps  # 0.16 s are less than the 0.18 s that settling takes
    assert f"settled in {settling.rig_count} of {settling.steps - settling.too_small} steps" in result.pace()


def test_a_delay_the_model_does_not_have_is_refused(records: list[Record]) -> None:
    step, flight = records
    # Logged a tick before it acts: the response of rig and record is then one tick later than (1) says.
    early = replace(flight, u_c=np.append(flight.u_c[1:], flight.u_c[-1]))

    result = validate_records([step, early], model_of(BALL))

    assert result.passed is False
    assert any("u_c acts 1 sample(s) later" in note for note in result.notes)


def test_a_rig_with_other_dynamics_settles_differently() -> None:
    """Drag ten times the model's moves the rise by a measurable time."""
    heavy = replace(BALL, b=0.3)
    flight = replace(heavy.closed_loop(steps(3), TICKS, seed=4), use="judge")

    result = validate_records([flight], model_of(BALL))

    assert not isinstance(result.loop, str)
    rise = {row.name: row for row in result.loop.steps}["rise_s"]
    assert rise.ci95 is not None
    assert not rise.ci95[0] <= 0.0 <= rise.ci95[1]
    assert f"rise time 10-90 % {rise.rig * 1e3:.4g} ms for the rig" in result.pace()


def test_the_answer_names_the_largest_measurable_difference_first(heavy_handed: Validation) -> None:
    """Each figure that differs, by its size."""
    assert not isinstance(heavy_handed.loop, str)
    different = {row.name: row for row in heavy_handed.loop.steps if row.significant}
    shares = {
        name: abs(row.difference) / (1.0 if name == "overshoot" else max(row.rig, row.simulation))
        for name, row in different.items()
    }
    answer = heavy_handed.pace()
    titles = {name: FIGURES[name][0] for name in sorted(shares, key=lambda name: -shares[name])}
    places = [answer.index(title) for title in list(titles.values())[:3]]
    assert len(different) > 3
    assert places == sorted(places)
    assert "more below" in answer


@pytest.mark.slow
def test_nothing_settles_before_it_has_risen() -> None:
    """Steps of all sizes, down to some that noise drowns: those have no settling time, and the band is said."""
    ball = replace(BALL, sigma_x=2.0 * BALL.sigma_x)
    levels = 3e-3 + np.array([0, 0.1, 0, 0.2, 0, 0.4, 0, 0.8, 0]) * 1e-3
    flight = replace(ball.closed_loop(lambda k: float(levels[k // 250]), 2250, seed=9), use="judge")

    result = validate_records([flight], model_of(ball))

    assert not isinstance(result.loop, str)
    rows = []
    for run in result.loop.runs:
        for step in find_steps(run.x_ref_m, ball.tick, ball.sigma_x):
            rows.append(measure(run.x_m, run.u_c_v, run.x_ref_m, step, ball.tick, run.expected_std_m))
    finite_rows = [row for row in rows if np.isfinite(row[1])]
    assert 0 < len(finite_rows) < len(rows)
    assert all(settling > rise for rise, settling, *_ in finite_rows)
    settling = next(row for row in result.loop.steps if row.name == "settling_s")
    assert settling.bands is not None
    assert settling.bands[1] <= 0.1
    assert settling.too_small > 0
    assert f"within ±{100 * settling.bands[0]:.2g}" in to_html(result, title="t")


def test_a_ball_that_is_pulled_too_hard_is_stopped_by_the_stop(heavy_handed: Validation) -> None:
    assert not isinstance(heavy_handed.windows, str)
    simulated_m = heavy_handed.windows.simulated_m[np.isfinite(heavy_handed.windows.simulated_m)]
    assert simulated_m.max() == pytest.approx(BALL.travel, rel=1e-3)  # it gets there
    assert 0.0 <= simulated_m.min() < simulated_m.max() <= BALL.travel * (1.0 + 1e-9)
    assert heavy_handed.windows.rmse_m < BALL.travel


@pytest.mark.slow
def test_a_model_that_is_worse_than_x_stays_is_not_called_good(records: list[Record]) -> None:
    """Its file states so much noise of the sensor that its own floor is above its errors at the shorter horizons."""
    wrong = model_of(BALL, K_c=1.3)
    noisy = replace(wrong, noise=replace(wrong.noise, process_a_m_s2=9.9, sigma_x_m=6e-5))

    result = validate_records(records, noisy)

    hidden = [row for row in result.ahead if row.at_floor]
    assert hidden
    assert not any(row.beats_still for row in result.ahead)
    assert any("it predicts nothing" in text for text in result.failures())
    page = to_html(result, title="t")
    assert page.count("<td>worse than a constant x</td>") == len(hidden)


def test_a_controller_that_did_not_run_is_said(records: list[Record]) -> None:
    other = replace(controller_of(BALL), gains=(0.49, 1000.0, 9.0, -8000.0))

    result = validate_records(records, model_of(BALL), other)

    assert isinstance(result.loop, str)
    assert "does not give the recorded u_c" in result.loop
    assert result.passed  # the prediction errors do not need the law


def test_lost_and_wild_readings_do_not_hide_the_law(records: list[Record]) -> None:
    flight = records[1]
    x = flight.x.copy()
    x[300] = np.nan
    x[900:903] = np.nan
    x[1200] += 0.4e-3

    result = validate_records([replace(flight, x=x)], model_of(BALL))

    assert not isinstance(result.loop, str), result.loop


@pytest.mark.parametrize("samples", [1, 40, 100])
def test_a_short_flight_passes_nothing(records: list[Record], samples: int) -> None:
    whole = records[1]
    n = slice(samples)
    part = replace(whole, t=whole.t[n], u_c=whole.u_c[n], i_c=whole.i_c[n], x=whole.x[n], x_ref=whole.x_ref[n])

    result = validate_records([part], model_of(BALL))

    assert result.passed is None


def test_constant_channels_are_no_error(records: list[Record]) -> None:
    whole = records[1]
    constant = replace(whole, x=np.full(TICKS, 3e-3), u_c=np.full(TICKS, 2.0), i_c=np.full(TICKS, 0.6))

    assert validate_records([constant], model_of(BALL)).passed is False


def test_one_step_has_no_interval() -> None:
    flight = replace(BALL.closed_loop(lambda k: 2.6e-3 if k < 250 else 3.4e-3, 700, seed=6), use="judge")

    result = validate_records([flight], model_of(BALL))

    assert not isinstance(result.loop, str)
    assert {row.count for row in result.loop.steps} == {1}
    assert all(row.ci95 is None for row in result.loop.steps)
    assert "no interval" in result.pace()


def test_missing_pieces_are_not_testable_and_say_why(records: list[Record]) -> None:
    model = model_of(BALL)
    step, flight = records

    step_result = validate_sources([source_of(step, model)], model)
    no_law = validate_sources([source_of(flight, model)], model)
    empty = validate_sources([], model)

    assert step_result.passed is None
    assert "flight" in str(step_result.channels)
    assert "flight" in str(step_result.windows)
    assert isinstance(no_law.loop, str)
    assert "[controller]" in no_law.loop
    assert no_law.passed
    assert not isinstance(no_law.amplifier, str)
    assert not no_law.amplifier.from_steps
    assert empty.passed is None
    assert "could not be tested" in empty.answer()


def test_data_for_fitting_judge_only_for_want_of_others_and_it_is_said(records: list[Record]) -> None:
    model = model_of(BALL)
    fit = replace(records[1], use="fit", name="fitted")

    fit_result = validate_records([fit], model)
    both = validate_records([fit, records[1]], model)

    assert fit_result.flown == ("fitted",)
    assert any("may have been fitted" in note for note in fit_result.notes)
    assert both.flown == (records[1].name,)
    assert not any("may have been fitted" in note for note in both.notes)


def test_a_stated_noise_that_is_wrong_is_seen(records: list[Record]) -> None:
    model = model_of(BALL)
    quiet = replace(model, noise=replace(model.noise, sigma_x_m=model.noise.sigma_x_m / math.sqrt(2.0)))

    result = validate_records(records, quiet)

    assert not isinstance(result.channels, str)
    assert not result.channels[1].size_right


@pytest.mark.sample
def test_settling_interval_and_verdict_hold_over_many_flights() -> None:
    """20 flights under a right model: 95 % intervals miss 0 in more than 4 of them with a probability of 0.3 %."""
    missed, refused = 0, 0
    for seed in range(20):
        flight = replace(BALL.closed_loop(steps(300 + seed), TICKS, seed=400 + seed), use="judge")
        result = validate_records([flight], model_of(BALL))
        assert not isinstance(result.loop, str)
        settling = next(row for row in result.loop.steps if row.name == "settling_s")
        assert settling.ci95 is not None
        missed += not settling.ci95[0] <= 0.0 <= settling.ci95[1]
        refused += not result.passed
    assert missed <= 4
    # Six tests at 0.1 %, four floors with a margin of 5 %: 1 % of flights at most, two of 20 with a probability of 2 %.
    assert refused <= 1


def test_one_wrong_gain_of_the_law_is_not_blamed_on_the_model(records: list[Record]) -> None:
    right = controller_of(BALL)
    gains = (right.gains[0], right.gains[1] * 0.95, right.gains[2], right.gains[3])

    result = validate_records(records, model_of(BALL), replace(right, gains=gains))

    assert isinstance(result.loop, str)
    assert "follows gains of about [0.49, 2000, 18, " in result.loop
    assert result.passed


def test_single_wild_readings_are_left_out_and_counted(records: list[Record]) -> None:
    step, flight = records
    rng = np.random.default_rng(9)
    x, i = flight.x.copy(), flight.i_c.copy()
    places = rng.choice(np.arange(100, TICKS - 100, 20), 20, replace=False)
    x[places[:10]] = rng.uniform(0.5e-3, 5e-3, 10)
    i[places[10:]] = rng.uniform(1.0, 1.5, 10)

    result = validate_records([step, replace(flight, x=x, i_c=i)], model_of(BALL))

    assert result.passed, result.failures()
    message = next(note for note in result.notes if "outlying readings were left out" in note)
    # A drawn x may lie near the true one; a wild one draws the estimate with it, and the sample behind it looks wild.
    assert 18 <= int(message.split(" ")[0]) <= 30
    assert not isinstance(result.loop, str)
    rise = next(row for row in result.loop.steps if row.name == "rise_s")
    assert rise.count == rise.steps
    assert rise.ci95 is not None
    # 1.85 half widths of 95 % are the 99.9 % interval of t with 20 degrees.
    assert abs(rise.difference) <= 1.85 * (rise.ci95[1] - rise.ci95[0]) / 2
    assert rise.ci95[1] - rise.ci95[0] < 8e-3  # four ticks: no step is spoilt


def test_steps_of_the_amplifier_are_measured_against_equation_1(records: list[Record], right: Validation) -> None:
    slow = validate_records(records[:1], model_of(BALL, T_A=1.5))

    assert not isinstance(right.amplifier, str)
    assert not isinstance(slow.amplifier, str)
    rise = {row.name: row for row in right.amplifier.steps}["rise_s"]
    # ln 9 T_A, read off noisy samples: 0.2 % of the step is a thousandth of T_A at 90 %, and 40 us at most between two.
    assert rise.rig == pytest.approx(math.log(9.0) * BALL.T_A, abs=40e-6)
    assert abs(rise.difference) < 40e-6
    delay = {row.name: row for row in slow.amplifier.steps}["rise_s"]
    assert delay.difference == pytest.approx(-0.5 * math.log(9.0) * BALL.T_A, rel=0.1)


def test_what_the_model_does_not_know_is_said(records: list[Record]) -> None:
    model = model_of(BALL)
    unsure = replace(model.parameters["b"], verdict="not-identifiable", method="placeholder")

    result = validate_records(records, replace(model, parameters={**model.parameters, "b": unsure}))

    assert any("is not identified: placeholder" in note for note in result.notes)


def test_a_delay_of_the_models_own_recordings_is_corrected_and_a_longer_one_is_not(records: list[Record]) -> None:
    model = model_of(BALL)
    usage = {"name": "flight", "kind": "closed-loop", "input_delay": 1}
    aware = replace(model, provenance={"recordings": [usage]})
    flight = records[1]
    early = [replace(flight, u_c=np.append(flight.u_c[n:], flight.u_c[-n:])) for n in (1, 2)]

    same, longer = (validate_records([records[0], record], aware) for record in early)

    assert same.passed, same.failures()
    assert any("corrected here as there" in note for note in same.notes)
    assert longer.passed is False
    assert any("1 sample(s) still later" in note for note in longer.notes)
