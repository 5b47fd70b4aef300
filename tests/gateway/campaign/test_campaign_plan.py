"""The menu of a campaign, and that nothing it plans leaves the limits of any rig."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.campaign.plan import (
    CommandLimits,
    GoTo,
    Scale,
    Send,
    Shoot,
    actions_of,
    guessed_lift_off_v,
    limits_of,
    raised,
)
from gateway.campaign.selection import chosen
from protocol.bus import board51_pb2 as pb
from protocol.campaign import Plant
from protocol.errors import UsageError
from protocol.experiments import EXPERIMENT_OF_NAME, MENU, Experiment

CE152 = CommandLimits(
    u_min_v=0.0, u_max_v=4.99878, x_min_m=0.3e-3, x_max_m=5.2e-3, step_m=2.5e-3, slew_m_s=20e-3,
    u_lsb_v=5 / 4096, x_lsb_m=1.4e-6,
)  # fmt: skip
SCALE = Scale(limits=CE152, travel_m=5.7e-3, lift_off_v=3.3)

limits = st.builds(
    lambda u, low, span, step, slew: replace(
        CE152, u_max_v=u, x_min_m=low, x_max_m=low + span, step_m=step, slew_m_s=slew
    ),
    st.floats(0.5, 24.0), st.floats(0.0, 5e-3), st.floats(1e-4, 2e-2), st.floats(1e-4, 1e-2), st.floats(1e-3, 1.0),
)  # fmt: skip
scales = st.builds(
    Scale, limits=limits, travel_m=st.floats(2e-3, 2e-2), lift_off_v=st.floats(0.2, 24.0), seed=st.integers(0, 600),
    u_factor=st.sampled_from((1.0, 1.25, 0.7, math.inf)), x_factor=st.sampled_from((1.0, 0.7)),
)  # fmt: skip


def parameters(*, u_0_v: float = 2.143) -> pb.Parameters:
    return pb.Parameters(
        sample_time_s=2e-3,
        u_0_v=u_0_v,
        x_0_m=2.85e-3,
        x_ref_min_m=0.3e-3,
        x_ref_max_m=5.2e-3,
        x_ref_step_max_m=2.5e-3,
        x_ref_slew_m_s=20e-3,
        u_max_v=5.0,
        u_lsb_v=1.22e-3,
        x_lsb_m=1.4e-6,
    )


@given(scale=scales, experiment=st.sampled_from(MENU))
def test_no_rig_is_driven_beyond_its_limits(scale: Scale, experiment: Experiment) -> None:
    plan = actions_of(experiment, scale)

    if isinstance(plan, str):
        assert plan
        return
    bounds = scale.limits
    for action in plan:
        match action:
            case GoTo():
                assert bounds.x_min_m <= action.x_ref_m <= bounds.x_max_m
            case Shoot():
                assert bounds.u_min_v <= min(action.u_from_v, action.u_to_v)
                assert max(action.u_from_v, action.u_to_v) <= bounds.u_max_v
            case Send() if action.command.WhichOneof("what") == "excite":
                e = action.command.excite
                low, high = (bounds.x_min_m, bounds.x_max_m) if e.on_reference else (bounds.u_min_v, bounds.u_max_v)
                lsb = bounds.x_lsb_m if e.on_reference else bounds.u_lsb_v
                # In counts, as the gateway rounds them; the bounds are whole counts on a board.
                offset, amplitude = round(e.offset / lsb), round(e.amplitude / lsb)
                assert offset - amplitude >= math.floor(low / lsb)
                assert offset + amplitude <= math.ceil(high / lsb)


def test_jumps_of_the_reference_stay_within_the_step_and_waves_within_the_slew() -> None:
    tight = replace(SCALE, limits=replace(CE152, step_m=1.5e-3, slew_m_s=10e-3))

    wide, multisine = (
        actions_of(EXPERIMENT_OF_NAME["wide-steps"], tight),
        actions_of(EXPERIMENT_OF_NAME["multisine"], tight),
    )

    assert not isinstance(wide, str)
    assert not isinstance(multisine, str)
    assert isinstance(wide[-1], Send)
    assert isinstance(multisine[-1], Send)
    assert wide[-1].command.excite.amplitude == pytest.approx(0.75e-3, abs=2e-6)
    amplitude, period_s = multisine[-1].command.excite.amplitude, 2.0
    assert amplitude * 2 * math.pi / period_s * 6.5 <= 10e-3


def test_a_narrow_range_makes_wide_steps_impossible_and_says_the_numbers() -> None:
    narrow = replace(SCALE, limits=replace(CE152, x_min_m=2.6e-3, x_max_m=3.0e-3))

    plan = actions_of(EXPERIMENT_OF_NAME["wide-steps"], narrow)

    assert isinstance(plan, str)
    assert "2.6 .. 3 mm" in plan


def test_what_judges_is_never_what_was_fitted() -> None:
    for e in MENU:
        if e.use == "judge" and not e.name.startswith("bode-"):  # of which there is none for fitting
            fitted = EXPERIMENT_OF_NAME[e.name.removesuffix("-judge")]
            assert fitted.use == "fit"
            assert actions_of(fitted, SCALE) != actions_of(e, SCALE)


def test_the_default_run_has_about_90_s_and_the_quick_one_25_s_with_a_judge() -> None:
    assert 80 <= sum(e.duration_s for e in chosen()) <= 100
    quick = chosen(quick=True)
    assert 20 <= sum(e.duration_s for e in quick) <= 30
    assert sum(e.use == "judge" for e in quick) >= 1
    assert {e.kind for e in quick} == {e.kind for e in chosen()}


def test_every_experiment_of_the_menu_is_possible_on_a_ce152() -> None:
    assert [e.name for e in MENU if isinstance(actions_of(e, SCALE), str)] == []
    assert [e.name for e in chosen(("holds", "chirp"))] == ["chirp", "holds"]


def test_another_seed_is_another_random_signal() -> None:
    first = actions_of(EXPERIMENT_OF_NAME["prbs-reference"], SCALE)
    other = actions_of(EXPERIMENT_OF_NAME["prbs-reference"], replace(SCALE, seed=2))

    assert first != other


def test_the_first_ramp_is_guessed_from_the_operating_point() -> None:
    plant = Plant(name="", mass_kg=8.28e-3, travel_m=5.7e-3, x_max_m=8.138e-3, gravity_m_s2=9.81)

    # By (8) the carrying current grows with the distance from x_max: 2.143 V * 8.138 / (8.138 - 2.85).
    assert guessed_lift_off_v(parameters(), plant, CE152) == pytest.approx(3.298, abs=1e-3)
    assert guessed_lift_off_v(parameters(u_0_v=0.0), plant, CE152) == pytest.approx(CE152.u_max_v / 1.1)


def test_a_ramp_that_did_not_lift_the_ball_is_raised_to_the_limit_at_last() -> None:
    ramp = EXPERIMENT_OF_NAME["lift-off"]
    scale = replace(SCALE, lift_off_v=2.0)
    tops = []
    for attempt in (1, 2, 3):
        plan = actions_of(ramp, scale)
        assert not isinstance(plan, str)
        assert isinstance(plan[0], Send)
        excite = plan[0].command.excite
        tops.append(excite.offset + excite.amplitude)
        scale = raised(scale, attempt=attempt)

    assert tops == pytest.approx([2.2, 2.75, CE152.u_max_v], abs=2 * CE152.u_lsb_v)


def test_wishes_only_tighten() -> None:
    tightened = limits_of(parameters(), u_max_v=4.0, x_min_m=1e-3, x_max_m=4e-3)

    assert (tightened.u_max_v, tightened.x_min_m, tightened.x_max_m) == (4.0, 1e-3, 4e-3)
    with pytest.raises(UsageError, match=r"--u-max 6 V is outside the board's limits, 0 \.\. 5 V"):
        limits_of(parameters(), u_max_v=6.0, x_min_m=None, x_max_m=None)
    with pytest.raises(UsageError, match=r"--x-max 6 mm is outside"):
        limits_of(parameters(), u_max_v=None, x_min_m=None, x_max_m=6e-3)
    with pytest.raises(UsageError, match="No range is left"):
        limits_of(parameters(), u_max_v=None, x_min_m=4e-3, x_max_m=3e-3)
