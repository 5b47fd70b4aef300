"""The next step of an investigation: from what is known to one action, without a rig."""

from __future__ import annotations

from dataclasses import replace

from gateway.investigate.decide import COVERAGE, JUDGES, START, Diagnose, Finish, Known, Offer, Perform, next_action
from gateway.investigate.investigator import menu_of
from protocol.diagnosis import Cause, Diagnosis

MENU = menu_of(quick=False)
NEW = Known(
    recordings=frozenset(),
    refused=frozenset(),
    answer=None,
    diagnosed=frozenset(),
    thorough=False,
    left_s=300.0,
    quick=False,
)


def answered(verdict: str, *suspects: Cause, recordings: tuple[str, ...] = START, thorough: bool = False) -> Known:
    answer = Diagnosis(verdict=verdict, sentence="", causes=suspects)
    return replace(
        NEW, recordings=frozenset(recordings), diagnosed=frozenset(recordings), answer=answer, thorough=thorough
    )


def suspect(confounders: dict[str, float], experiments: dict[str, dict[str, float]] | None = None) -> Cause:
    return Cause(
        name="drag", confidence=0.97, confounders=confounders, experiments=experiments or {}, outside=("Weigh it.",)
    )


def test_it_begins_with_what_every_model_needs_then_asks() -> None:
    first = next_action(NEW, MENU)
    second = next_action(replace(NEW, recordings=frozenset(START)), MENU)

    assert isinstance(first, Perform)
    assert first.experiments == START
    assert isinstance(second, Diagnose)
    assert not second.thorough, "to choose, quick suffices"


def test_what_is_logged_is_looked_at_before_anything_is_recorded() -> None:
    logged = next_action(replace(NEW, recordings=frozenset({"steps"})), MENU)
    then = next_action(answered("model-adequate", recordings=("steps",)), MENU)

    assert isinstance(logged, Diagnose)
    assert isinstance(then, Perform)
    assert then.experiments == ("lift-off",), "adequate for one narrow flight says little"


def test_recordings_that_are_there_are_not_made_again() -> None:
    known = replace(NEW, recordings=frozenset({"lift-off", "rest", "amplifier-steps"}))

    action = next_action(known, MENU)

    assert isinstance(action, Perform)
    assert action.experiments == ("wide-steps",)


def test_the_experiment_that_tells_most_for_its_time_is_chosen_and_the_reason_given() -> None:
    class_ = suspect({"lag": 1.2}, {"holds": {"lag": 14.0}, "chirp": {"lag": 5.5}, "steps": {"lag": 2.0}})

    action = next_action(answered("causes-found", class_), MENU)

    # Both suffice, and chirp takes 17 s where holds takes 20: more than enough is worth no more time.
    assert isinstance(action, Perform)
    assert action.experiments == ("chirp",)
    assert "drag may be lag (1.2 apart)" in action.why
    assert "5.5 standard errors" in action.why
    assert "holds 14.0 in 20 s" in action.why
    assert "steps" not in action.why, "it would not separate them"


def test_an_experiment_that_splits_two_confounders_beats_one_that_splits_one() -> None:
    class_ = suspect(
        {"lag": 1.0, "friction": 1.0}, {"steps": {"lag": 4.0, "friction": 0.0}, "chirp": {"lag": 5.0, "friction": 5.0}}
    )
    menu = MENU | {"chirp": replace(MENU["chirp"], seconds=MENU["steps"].seconds)}

    action = next_action(answered("causes-found", class_), menu)

    assert isinstance(action, Perform)
    assert action.experiments == ("chirp",)


def test_what_was_made_or_refused_or_needs_a_hand_is_not_chosen() -> None:
    class_ = suspect({"lag": 1.0}, {name: {"lag": 9.0} for name in ("wide-steps", "chirp", "blocked-ball", "holds")})
    known = replace(answered("causes-found", class_), refused=frozenset({"chirp"}))

    action = next_action(known, MENU)

    assert isinstance(action, Perform)
    assert action.experiments == ("holds",)


def test_the_cheaper_experiment_is_taken_where_the_budget_does_not_allow_the_better() -> None:
    class_ = suspect({"lag": 1.0}, {"warm-run": {"lag": 50.0}, "prbs-reference": {"lag": 3.1}})
    menu = MENU | {"warm-run": Offer(purpose="", seconds=20.0)}

    rich = next_action(answered("causes-found", class_), menu)
    poor = next_action(replace(answered("causes-found", class_), left_s=15.0), menu)

    assert isinstance(rich, Perform)
    assert isinstance(poor, Perform)
    assert rich.experiments == ("warm-run",)
    assert poor.experiments == ("prbs-reference",)


def test_what_has_to_be_recorded_before_counts() -> None:
    class_ = suspect({"lag": 1.0}, {"prbs-open-loop": {"lag": 9.0}, "lift-off": {"lag": 9.0}})

    action = next_action(answered("causes-found", class_, recordings=("steps",)), MENU)
    scarce = next_action(replace(answered("causes-found", class_, recordings=("steps",)), left_s=12.0), MENU)

    # 9 s against 11 s; but its inputs are shares of the lift-off input, which is not known yet.
    assert MENU["prbs-open-loop"].seconds < MENU["lift-off"].seconds
    for decision in (action, scarce):
        assert isinstance(decision, Perform)
        assert decision.experiments == ("lift-off",)


def test_nothing_is_called_adequate_or_unknown_before_every_experiment_was_made() -> None:
    for verdict in ("model-adequate", "unknown-cause", "partly-explained"):
        recordings: tuple[str, ...] = START
        made: list[str] = []
        while isinstance(action := next_action(answered(verdict, recordings=recordings), MENU), Perform):
            made += action.experiments
            recordings += action.experiments

        assert made == [*COVERAGE[len(START) :], *JUDGES]
        assert isinstance(action, Diagnose)
        assert action.thorough
        end = next_action(answered(verdict, recordings=recordings, thorough=True), MENU)
        assert isinstance(end, Finish)
        assert end.stands is (verdict != "unknown-cause")


def test_one_name_is_judged_then_asked_thoroughly_then_stands() -> None:
    recorded = START + JUDGES
    first = next_action(answered("causes-found", suspect({})), MENU)
    second = next_action(replace(answered("causes-found", suspect({})), recordings=frozenset(recorded)), MENU)
    third = next_action(answered("causes-found", suspect({}), recordings=recorded, thorough=True), MENU)

    assert isinstance(first, Perform)
    assert first.experiments == JUDGES
    assert isinstance(second, Diagnose)
    assert second.thorough
    assert isinstance(third, Finish)
    assert third.stands
    assert "drag" in third.why
    assert "Weigh it." in third.why  # what no experiment shows


def test_a_class_that_opens_in_the_thorough_answer_is_split_after_all() -> None:
    class_ = suspect({"lag": 1.0}, {"chirp": {"lag": 9.0}})

    action = next_action(answered("causes-found", class_, recordings=START + JUDGES, thorough=True), MENU)

    assert isinstance(action, Perform)
    assert action.experiments == ("chirp",)


def test_a_class_that_nothing_splits_stands_with_what_to_measure_beside_the_board() -> None:
    class_ = suspect({"lag": 0.3}, {"blocked-ball": {"lag": 8.0}})

    end = next_action(answered("causes-found", class_, recordings=START + JUDGES, thorough=True), MENU)

    assert isinstance(end, Finish)
    assert end.stands
    assert "Weigh it." in end.why
    assert "Clamp the ball" in end.why


def test_a_weak_name_asks_for_more() -> None:
    weak = replace(suspect({}), confidence=0.6)

    quick = next_action(answered("causes-found", weak), MENU)
    thorough = next_action(answered("causes-found", weak, thorough=True), MENU)

    assert isinstance(quick, Perform)
    assert quick.experiments == JUDGES, "a quick one's confidence is not calibrated"
    assert isinstance(thorough, Perform)
    assert thorough.experiments == (COVERAGE[len(START)],)
    assert "0.60" in thorough.why


def test_a_spent_budget_ends_it_but_not_before_a_thorough_answer() -> None:
    poor = replace(answered("causes-found", suspect({})), left_s=3.0)

    first = next_action(poor, MENU)
    second = next_action(replace(poor, thorough=True), MENU)
    at_once = next_action(replace(NEW, left_s=5.0), MENU)

    assert isinstance(first, Diagnose)
    assert first.thorough, "it takes no time on the rig"
    assert isinstance(second, Finish)
    assert not second.stands
    assert "3 s are left" in second.why
    assert isinstance(at_once, Finish)
    assert not at_once.stands


def test_without_a_flight_another_is_tried_and_then_given_up() -> None:
    known = replace(NEW, recordings=frozenset(START[:3]), refused=frozenset({"wide-steps"}))

    action = next_action(known, MENU)
    end = next_action(replace(known, refused=frozenset({"wide-steps", "prbs-reference", "multisine", "steps"})), MENU)

    assert isinstance(action, Perform)
    assert action.experiments == ("prbs-reference",)
    assert isinstance(end, Finish)
    assert not end.stands


def test_quick_is_never_thorough() -> None:
    state = replace(answered("causes-found", suspect({}), recordings=START + JUDGES), quick=True)

    assert isinstance(next_action(state, MENU), Finish)
    again = next_action(replace(state, diagnosed=frozenset(START)), MENU)
    assert isinstance(again, Diagnose)
    assert not again.thorough
