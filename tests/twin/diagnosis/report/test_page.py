from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from tests.harness.diagnose.known_diagnosis import diagnosis
from tests.harness.diagnose.simulated_rig import controller
from twin.diagnosis.report.figures import (
    ahead_figure,
    curve_figure,
    error_figure,
    piece_figure,
    regime_figure,
    short_label,
)
from twin.diagnosis.report.page import to_html
from twin.diagnosis.report.quantities import measured, quantity
from twin.diagnosis.report.sentences import cause_sentence, finding_sentence, summary_sentence
from twin.diagnosis.residuals.step_response import Steps
from twin.diagnosis.residuals.summary import Summary, summarise
from twin.diagnosis.result import Diagnosis, Member, MinorEffect, Proposal, to_json
from twin.estimation.step_figures import together
from twin.model.causes.catalogue import BY_NAME, CATALOGUE
from twin.model.causes.cause import Cause
from twin.model.parameters import Parameter

pytestmark = pytest.mark.xdist_group("diagnosis-page")  # the pages that several tests look at are made once
PICTURE = "data:image/svg+xml;base64,"


def page(result: Diagnosis) -> str:
    summary = summarise(result, controller(), quick=result.quick)
    return to_html(result, summary, campaign=Path("runs/monday"), out=Path("diagnosis"))


@cache
def gap_diagnosis() -> Diagnosis:
    return diagnosis("air-gap-offset", 5e-4)


@cache
def gap_page() -> str:
    return page(gap_diagnosis())


@cache
def unknown() -> Diagnosis:
    return diagnosis("air-gap-offset", 5e-4, extended=False, quick=True)


@cache
def quick_gap_page() -> str:
    return quick_page(gap_diagnosis())


def quick_page(result: Diagnosis) -> str:
    """Return the page with few of the figures."""
    return page(replace(result, quick=True))


def words_of(result: Diagnosis) -> str:
    """The words of its page, made without the figures of its errors."""
    return summary_words(result, summarise(result, controller(), quick=True))


def summary_words(result: Diagnosis, summary: Summary) -> str:
    bare = replace(summary, ahead=summary.ahead[:1], piece=None, spectrum=None, regimes=(), force=(), current=())
    return text_of(to_html(replace(result, quick=True), bare, campaign=Path("runs/monday"), out=Path("diagnosis")))


def text_of(html: str) -> str:
    """Return the words of a page, however its lines are broken."""
    return " ".join(re.sub(r"<[^>]+>", " ", re.sub(r"(?s)<style>.*?</style>|src=\"[^\"]*\"", "", html)).split())


@pytest.mark.slow
def test_the_sentence_comes_first_then_pictures_of_before_and_after() -> None:
    html = gap_page()

    assert html.index("The coil sits 0.50") < html.index(PICTURE) < html.index("Which cause")
    assert "by a factor of" in html


def test_the_page_needs_nothing_else_and_is_small() -> None:
    html = gap_page()

    assert not re.findall(r"(?:src|href)=\"(?!data:)", html)
    assert "http" not in re.sub(r"src=\"[^\"]*\"", "", html)
    assert len(html) < 3_000_000


def test_every_part_of_the_argument_is_there() -> None:
    text = text_of(gap_page())

    for part in (
        "Before and after",
        "Where the simulation is wrong",
        "Is the rig slower than the simulation?",
        "force",
        "Which cause",
        "How to confirm it by hand",
        "What to do about it",
        "cannot tell",
        "position-sensor-gain",
        "Next experiment: Raise u_c slowly",
        "board51 campaign run FOLDER --experiment lift-off",
        "What is left",
        "The model's numbers",
        "coulomb-friction",
        "F_f is at most 3 µN",
        "Not testable",
        "How the campaign was used",
        "board51 predict",
    ):
        assert part in text, part
    assert gap_page().count(PICTURE) >= 15


def test_what_is_too_small_to_be_named_is_listed_with_its_size_and_where_it_shows() -> None:
    result = gap_diagnosis()
    parameters = {
        "c_n_s2_m2": Parameter(value=0.2, unit="N s^2/m^2", ci95=(0.15, 0.25)),
        "power": Parameter(value=2.0, unit=""),
    }
    small = MinorEffect(name="quadratic-drag", parameters=parameters, loglik_gain=31.4)

    text = words_of(replace(result, minor_effects=(small,)))
    listed = text[text.index("too small to be named") : text.index("Larger effects than the stated size are ruled out")]

    for part in ("quadratic-drag", "c = 0.20 N s^2/m^2", "31", *BY_NAME["quadratic-drag"].shows_in):
        assert part in listed, part
    assert "too small to be named" not in text_of(gap_page())


def test_a_pair_that_no_experiment_separates_has_no_command() -> None:
    result = gap_diagnosis()
    why = "air-gap-offset and position-sensor-gain: no experiment on this rig separates them; a shim would"
    (cause,) = result.causes
    result = replace(result, causes=(replace(cause, next_experiment=Proposal(what=why, separation_z=0.3)),))

    text = words_of(result)

    assert "a shim would" in text
    assert "Next experiment" not in text


def test_a_stated_value_is_listed_with_its_size_and_how_to_check_it() -> None:
    result = gap_diagnosis()
    (cause,) = result.causes
    error = {"error": Parameter(value=0.0199, unit="", ci95=(0.0185, 0.0213))}
    sentence = cause_sentence("stated-clock", error)
    clock = Member(name="stated-clock", parameters=error, sentence=sentence)
    result = replace(result, causes=(replace(cause, indistinguishable_from=(clock,), next_experiment=None),))

    text = words_of(result).replace("&#39;", "'")
    (alternative,) = to_json(result)["causes"][0]["alternatives"]

    assert sentence == "the board's clock is 1.99 % slow"
    assert "would explain this instead of air-gap-offset: the board's clock is 1.99 % slow." in summary_sentence(result)
    assert "The board's clock is 1.99 % slow. Compare ten minutes of the board's ticks" in text
    assert "No other cause of the catalogue explains these recordings as well" in text
    assert alternative["stated"]
    assert alternative["sentence"] == sentence
    assert alternative["confirm"] == BY_NAME["stated-clock"].confirm
    better = replace(clock, lead=20.0)
    result = replace(result, causes=(replace(cause, indistinguishable_from=(better,)),))
    assert "would explain this, and better than air-gap-offset" in summary_sentence(result)


def test_an_unknown_cause_says_how_much_is_left_and_where() -> None:
    text = text_of(page(unknown()))

    assert "none of the known causes explains it" in text
    assert "of the log-likelihood that the model lacks on the recordings for fitting is left" in text
    assert "position x:" in text


def test_names_beside_an_unknown_cause_are_said_to_be_confounders() -> None:
    result = replace(
        gap_diagnosis(), verdict="unknown-cause", unexplained_where="at rest: the model needs a stop elsewhere"
    )

    text = summary_sentence(result)

    assert text.startswith("The model is wrong, and the known causes do not explain all of it.")
    assert "may only imitate an unknown cause: the coil sits" in text
    assert "The remaining error is largest at rest: the model needs a stop elsewhere." in text


def test_an_adequate_model_says_so_and_shows_one_model() -> None:
    result = unknown()
    result = replace(result, verdict="model-adequate", account=replace(result.account, unexplained=0.0))
    result = replace(result, sentence=summary_sentence(result))

    html = page(result)

    assert "The model is adequate" in html
    assert "These errors got larger" not in html
    assert "The causes, and what to do" not in html
    assert "as a curve" not in html


@cache
def summary_of_gap() -> Summary:
    return summarise(gap_diagnosis(), controller())


def with_chances(**chances: float) -> str:
    """The page of the gap with these p values of the extended model's step figures."""
    summary = summary_of_gap()
    assert isinstance(summary.steps, Steps)
    rows = [replace(row, chance=chances.get(row.name, 0.9), ci95=(1e-4, 2e-3)) for _, row in summary.steps.figures]
    figures = tuple(zip([first for first, _ in summary.steps.figures], together(rows), strict=True))
    return summary_words(gap_diagnosis(), replace(summary, steps=replace(summary.steps, figures=figures)))


def test_a_step_figure_that_just_misses_is_no_contradiction_of_nothing_left() -> None:
    """One of five figures at 4 %: a right model has such a one on every fifth page."""
    text = with_chances(rise_s=0.04)

    assert "Nothing measurable is left: the rest is white" in text
    assert "does not explain all of it" not in text


def test_a_step_figure_that_surely_differs_is_said_where_what_is_left_is_told() -> None:
    text = with_chances(rise_s=1e-5)

    assert "The rig is as fast as the baseline simulation" in text
    assert "The extended model is off by" in text
    assert "Nothing that can be measured" not in text
    assert "the extended model differs from the rig in rise time 10-90 %" in text


def test_a_chart_of_one_point_is_a_sentence() -> None:
    summary = summary_of_gap()
    first, *rest = summary.force
    summary = replace(summary, force=(replace(first, points=first.points[:1]), *rest), ahead=summary.ahead[:1])

    html = to_html(gap_diagnosis(), summary, campaign=Path("runs/monday"), out=Path("diagnosis"))

    assert html.count(PICTURE) == gap_page().count(PICTURE) - 2
    assert f"over {first.title}: one group alone" in text_of(html)


def test_a_legend_lies_above_its_data() -> None:
    summary = summary_of_gap()

    assert summary.piece is not None
    for figure in (
        ahead_figure(summary.ahead),
        piece_figure(summary.piece),
        error_figure(summary.piece, summary.floor_m),
        regime_figure(summary.regimes[0], summary.floor_m),
        curve_figure(summary.force[0]),
    ):
        FigureCanvasAgg(figure).draw()  # type: ignore[no-untyped-call]  # matplotlib's stub
        (ax,) = figure.axes
        legend = ax.get_legend()
        assert legend is not None
        box = legend.get_window_extent()
        assert box.y0 >= ax.get_window_extent().y1 - 1.0
        assert box.y1 <= figure.bbox.y1
        assert box.x1 <= figure.bbox.x1


def test_quick_says_that_it_is_not_calibrated_and_draws_less() -> None:
    html = quick_gap_page()

    assert "not calibrated" in html
    assert html.count(PICTURE) < gap_page().count(PICTURE)


def test_without_judge_recordings_the_page_says_that_errors_flatter() -> None:
    assert "they are too small" in words_of(diagnosis("air-gap-offset", 5e-4, has_judges=False, quick=True))


def test_the_same_diagnosis_gives_the_same_bytes() -> None:
    assert quick_page(gap_diagnosis()) == quick_gap_page()


@pytest.mark.parametrize(
    ("label", "drawn"),
    [
        ("slower than 1 mm/s", "slower than 1 mm/s"),
        ("later than 500 ms", "later than 500 ms"),
        ("runs/closed_loop_5.csv.gz", "closed_loop_5"),
        ("runs/monday.mcap", "monday"),
        ("rig/cl_sinusoidal_fast__LQR_tracking_KF.csv.gz", "cl_sinusoid…_tracking_KF"),
    ],
)
def test_a_group_of_errors_is_drawn_with_its_name(label: str, drawn: str) -> None:
    assert short_label(label) == drawn


def test_names_of_files_cannot_break_the_page() -> None:
    result = gap_diagnosis()
    record = replace(result.fit_evidence.records[0], name="<script>x</script>")
    usages = result.fit_evidence.usages
    usages[0].name = record.name
    evidence = replace(result.fit_evidence, records=(record,))

    html = quick_page(replace(result, fit_evidence=evidence, warnings=("<b>",)))

    usages[0].name = "steps_1"
    assert "<script>" not in html
    assert "<li>&lt;b&gt;</li>" in html


@pytest.mark.parametrize("cause", CATALOGUE, ids=lambda cause: cause.name)
def test_every_cause_has_a_sentence_with_its_size(cause: Cause) -> None:
    assert cause.sentence
    for side in ("above", "below"):
        values = {}
        for entry in cause.parameters:
            value = entry.probes[0]
            if entry is cause.strength and entry.neutral not in (float("inf"),):
                value = 2.0 * entry.neutral - value if side == "below" else value
            values[entry.name] = Parameter(value=value, unit=entry.unit)
        sentence = finding_sentence(cause.name, values)

        assert "{" not in sentence
        assert re.search(r"\d", sentence)
        assert not sentence.endswith(".")


def test_a_sign_changes_the_words_and_not_the_number() -> None:
    def offset(value: float) -> str:
        ci95 = (value - 1e-6, value + 1e-6)
        return finding_sentence("position-sensor-offset", {"offset_m": Parameter(value=value, unit="m", ci95=ci95)})

    assert offset(1.2e-4).startswith("x reads 0.1200 mm too high (offset = 0.1190 to 0.1210 mm")
    assert offset(-1.2e-4).startswith("x reads 0.1200 mm too low (offset = -0.1210 to -0.1190 mm")


def test_a_sentence_says_how_far_an_offset_wanders() -> None:
    offset = Parameter(value=0.017, unit="A", std=0.013, ci95=(-0.009, 0.043))
    wander = Parameter(value=0.039, unit="A", std=0.003, ci95=(0.033, 0.045))

    assert "wanders by 39 mA in a minute" in finding_sentence(
        "current-sensor-offset", {"offset_a": offset, "wander_a": wander}
    )
    steady = replace(wander, value=0.001)
    assert "wanders" not in finding_sentence("current-sensor-offset", {"offset_a": offset, "wander_a": steady})


def test_a_sentence_says_how_far_a_delay_varies() -> None:
    delay = Parameter(value=1.45e-3, unit="s", std=5e-6, ci95=(1.44e-3, 1.46e-3))
    jitter = Parameter(value=1.1e-4, unit="s", std=5e-6, ci95=(1e-4, 1.2e-4))

    sentence = finding_sentence("actuation-delay", {"delay_s": delay, "jitter_s": jitter})
    assert "delay = 1.440 to 1.460 ms, 95 %; varies by 0.110 ms from tick to tick" in sentence
    steady = replace(jitter, value=5e-6)
    assert "varies" not in finding_sentence("actuation-delay", {"delay_s": delay, "jitter_s": steady})


def test_numbers_have_the_digits_that_their_interval_leaves() -> None:
    assert measured(2.4003e-3, (2.21e-3, 2.59e-3), "m") == ("2.40 mm", "2.21 to 2.59 mm")
    assert measured(99.98, (99.9, 100.06), "A/s") == ("99.98 A/s", "99.90 to 100.06 A/s")
    assert measured(0.5, None, "N") == ("0.5 N", "")
    assert quantity(2e-5, "m/A") == "20 µm/A"


def test_rounds_are_numbered_without_those_that_scored_nothing() -> None:
    """The second name of a pair has a round without scores, and no figure."""
    result = gap_diagnosis()
    (first,) = result.selection.rounds
    rounds = (first, replace(first, scores=()), first)

    html = quick_page(replace(result, selection=replace(result.selection, rounds=rounds)))

    assert set(re.findall(r"Round (\d+):", html)) == {"1", "2"}
