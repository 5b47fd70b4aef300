"""Wrongly stated data are recognised, named with their remedy, and never fitted into a wrong number."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from gateway.emulator.firmware_model.flash import POSITION
from gateway.emulator.plant.constants import CE152
from protocol.campaign import Campaign, parse
from protocol.errors import DataError
from protocol.wire.messages import Shape
from tests.harness.twin.emulated_campaign import Lab, campaign_of, random_rig, run_campaign
from twin.estimation.record import Record
from twin.identification.pipeline import identify_records
from twin.identification.result import table

RIG = random_rig(np.random.default_rng(30))


@pytest.fixture(scope="module")
def records() -> list[Record]:
    return run_campaign(RIG, seed=30, flight_s=5.0)


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    return campaign_of(RIG)


WRONG: dict[str, tuple[Callable[[Record], Record], str, str]] = {
    "position in mm": (lambda r: replace(r, x=r.x * 1e3, x_ref=r.x_ref * 1e3), "millimetres", "scale = 0.001"),
    "position in um": (lambda r: replace(r, x=r.x * 1e6, x_ref=r.x_ref * 1e6), "micrometres", "scale = 1e-06"),
    "position downwards": (
        lambda r: replace(r, x=RIG.travel_m - r.x, x_ref=RIG.travel_m - r.x_ref),
        "downwards",
        "scale = -1.0",
    ),
    "position negative": (lambda r: replace(r, x=r.x - RIG.travel_m), "downwards", "offset"),
    "position off by far": (lambda r: replace(r, x=r.x + 0.012), "the travel is", "offset"),
    "current in mA": (lambda r: replace(r, i_c=r.i_c * 1e3), "milliamperes", "scale = 1e-3"),
    "current reversed": (lambda r: replace(r, i_c=-r.i_c), "opposite signs", "scale = -1.0"),
    "current and position swapped": (lambda r: replace(r, i_c=r.x, x=r.i_c), "swapped", "Exchange"),
    "input and current swapped": (lambda r: replace(r, i_c=r.u_c, u_c=r.i_c), "swapped", "Exchange"),
    "position and reference swapped": (
        lambda r: replace(r, x=np.round(r.x_ref, 3), x_ref=r.x),
        "swapped",
        "x_ref",
    ),
    "time in ms": (lambda r: replace(r, t=r.t * 1e3), "milliseconds", "scale = 1e-3"),
    "time stands still": (lambda r: replace(r, t=r.t * 0.0), "never rises", "seconds"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_channel_is_recognised_with_its_remedy(name: str, records: list[Record], campaign: Campaign) -> None:
    change, problem, remedy = WRONG[name]
    flight = change(records[2])

    with pytest.raises(DataError) as caught:
        identify_records(campaign, [flight])

    assert problem in str(caught.value)
    assert remedy in caught.value.remedy
    assert flight.name in str(caught.value)
    assert "\n" not in str(caught.value)


def test_right_recordings_raise_nothing_and_warn_of_nothing(records: list[Record], campaign: Campaign) -> None:
    result = identify_records(campaign, records)

    assert result.usable
    assert not result.warnings


def test_a_plant_that_nobody_stated_is_marked_at_what_rests_on_it(records: list[Record], campaign: Campaign) -> None:
    result = identify_records(replace(campaign, plant=replace(campaign.plant, assumed=True)), records)

    marked = [name for name, entry in result.model.parameters.items() if "for an assumed ball of" in entry.method]
    assert marked == ["K_c", "b"]
    assert result.model.plant.assumed
    assert "! K_c and b are for an assumed ball of" in table(result)


def test_a_sawtooth_measured_downwards_is_recognised(records: list[Record], campaign: Campaign) -> None:
    with pytest.raises(DataError, match="downwards"):
        identify_records(campaign, [replace(records[1], x=RIG.travel_m - records[1].x)])


def test_a_missing_experiment_names_the_one_that_would_help(records: list[Record], campaign: Campaign) -> None:
    result = identify_records(campaign, records[:1])

    assert not result.usable
    assert result.model.parameters["K_A"].verdict == "identified"
    for name, help_ in (("K_c", "sawtooth"), ("b", "closed loop")):
        assert result.model.parameters[name].verdict == "not-identifiable"
        assert any(name in warning and help_ in warning for warning in result.warnings)


def test_a_ball_that_never_moves_is_said(records: list[Record], campaign: Campaign) -> None:
    rest = records[2].x * 0.0 + np.random.default_rng(1).normal(0.0, 5e-6, len(records[2].x))

    result = identify_records(campaign, [replace(records[2], x=rest)])

    assert any("never leaves its stops" in warning for warning in result.warnings)
    assert result.model.parameters["K_c"].verdict == "not-identifiable"
    assert not result.usable


def test_constant_channels_are_said(records: list[Record], campaign: Campaign) -> None:
    flight = records[2]
    n = len(flight.t)

    result = identify_records(campaign, [replace(flight, u_c=np.full(n, 2.0), i_c=np.full(n, 0.5), x=np.full(n, 3e-3))])

    assert not result.usable
    assert {w.split(": ")[1].split(" ")[0] for w in result.warnings if "throughout" in w} == {"u_c", "i_c", "x"}


def test_a_controller_section_that_contradicts_the_recording_is_said(records: list[Record]) -> None:
    text = (
        '[controller]\nkind = "lqi"\ngains = [0.49, 400.0, 5.0, -2000.0]\n'
        "operating_point = { i_c_a = 0.6, x_m = 2.85e-3, u_c_v = 2.1 }\n"
    )
    campaign = campaign_of(RIG, text)

    result = identify_records(campaign, records)

    assert any("[controller]" in warning and "gains of about" in warning for warning in result.warnings)
    assert result.usable


def test_noise_in_place_of_data_gives_a_statement_and_no_traceback(campaign: Campaign) -> None:
    rng = np.random.default_rng(3)
    n = 3000
    junk = Record(
        name="junk",
        kind="closed-loop",
        use="fit",
        t=2e-3 * np.arange(n, dtype=np.float64),
        u_c=rng.uniform(0, 5, n),
        i_c=rng.uniform(0, 1.5, n),
        x=rng.uniform(1e-3, 5e-3, n),
        x_ref=np.full(n, 3e-3),
    )

    result = identify_records(campaign, [junk])

    assert not result.usable
    assert result.warnings


def test_an_empty_campaign_is_refused() -> None:
    campaign = parse(
        '[plant]\nmass_kg = 8.28e-3\ntravel_m = 5.7e-3\n[[recording]]\nfile = "a.csv"\nkind = "free"\nuse = "judge"\n',
        where="campaign.toml",
    )
    from twin.identification.pipeline import identify

    with pytest.raises(DataError, match="use"):
        identify(campaign)


def test_a_second_pair_of_channels_mixed_up_is_recognised(records: list[Record], campaign: Campaign) -> None:
    flight = records[2]
    wrong = {
        "u_c stays below": replace(flight, x=flight.u_c, u_c=flight.x),
        "x changes": replace(flight, x=flight.x_ref, x_ref=flight.x),
        "millivolts": replace(flight, u_c=flight.u_c * 1e3),
        "does not rise": replace(flight, t=np.repeat(flight.t[::2], 2)[: len(flight.t)]),
    }
    for problem, record in wrong.items():
        with pytest.raises(DataError, match=problem):
            identify_records(campaign, [record])


@pytest.mark.slow
def test_a_constant_channel_does_not_move_the_others(records: list[Record], campaign: Campaign) -> None:
    n = len(records[2].t)
    whole = identify_records(campaign, records[:2] + records[3:])
    for dead in (
        replace(records[2], x=np.full(n, 3e-3)),
        replace(records[2], i_c=np.full(n, 0.6)),
        replace(records[2], u_c=np.full(n, 2.0)),
    ):
        result = identify_records(campaign, [*records[:2], dead, *records[3:]])

        assert any("a constant channel has no information" in warning for warning in result.warnings)
        for name, parameter in result.model.parameters.items():
            other = whole.model.parameters[name]
            assert other.std is not None
            # The same recordings, but for the good channels of the dead one.
            assert abs(parameter.value - other.value) < 4.0 * other.std
            assert parameter.verdict == "identified"


def test_a_ball_that_is_held_off_its_stops_is_not_fitted(records: list[Record], campaign: Campaign) -> None:
    held = replace(records[2], x=3e-3 + np.random.default_rng(1).normal(0.0, 5e-6, len(records[2].x)))

    result = identify_records(campaign, [records[0], held])

    assert any("x is only noise" in warning for warning in result.warnings)
    assert result.model.parameters["K_c"].verdict == "not-identifiable"
    assert not result.usable


def test_a_ball_at_rest_under_control_is_used(campaign: Campaign) -> None:
    lab = Lab(RIG, seed=31)
    lab.fly()
    lab.run(200)
    hover = lab.record("hover", "closed-loop", 3000)

    result = identify_records(campaign, [hover])

    assert not any("noise alone" in warning for warning in result.warnings)
    K_c = result.model.parameters["K_c"]
    assert K_c.std is not None
    assert abs(K_c.value - RIG.force_constant_n_m2_a2) < 4.0 * K_c.std


def test_a_record_of_the_noise_warns_of_nothing(records: list[Record], campaign: Campaign) -> None:
    lab = Lab(RIG, seed=32)
    rest = lab.record("rest", "free", 1000)

    assert not identify_records(campaign, [*records, rest]).warnings


@pytest.mark.parametrize(("gain", "share"), [("1700.0", 0), ("1870.0", 1)])
def test_a_single_wrong_gain_is_seen(gain: str, share: int) -> None:
    rig = replace(RIG, force_constant_n_m2_a2=CE152.force_constant_n_m2_a2, amplifier_gain_a_v=0.297)
    lab = Lab(rig, seed=33)
    lab.fly()
    lab.run(200)
    lab.excite(Shape.PRBS, on_reference=True, amplitude=300, offset=POSITION.to_count(2.85e-3), period=40, seed=3)
    flight = lab.record("prbs", "closed-loop", 3000)
    text = (
        f'[controller]\nkind = "lqi"\ngains = [0.49, {gain}, 17.7, -17600.0]\n'
        "operating_point = { i_c_a = 0.6, x_m = 2.85e-3, u_c_v = 2.1 }\n"
    )

    result = identify_records(campaign_of(rig, text), [flight])

    assert sum("[controller]" in warning for warning in result.warnings) == share


def test_a_travel_beyond_x_max_is_refused(records: list[Record], campaign: Campaign) -> None:
    wide = replace(campaign, plant=replace(campaign.plant, travel_m=1.1 * campaign.plant.x_max_m))

    with pytest.raises(DataError, match="within the travel"):
        identify_records(wide, records[:1])


def test_lift_off_and_flight_that_disagree_leave_no_identified_force_constant(records: list[Record]) -> None:
    campaign = campaign_of(replace(RIG, coil_plane_above_stop_m=1e-4))

    result = identify_records(campaign, records)

    assert result.model.parameters["K_c"].verdict == "weak"
    assert any("no single K_c explains both" in warning for warning in result.warnings)


def test_a_sampling_time_that_varies_is_said_and_used(records: list[Record], campaign: Campaign) -> None:
    """Time stamps off by up to 50 us: at 20 mm/s that is 1 um, less than the noise of the sensor."""
    rng = np.random.default_rng(2)
    jittered = replace(records[2], t=records[2].t + rng.uniform(-5e-5, 5e-5, len(records[2].t)))

    result = identify_records(campaign, [*records[:2], jittered])

    assert any("the sampling interval varies" in warning for warning in result.warnings)
    K_c = result.model.parameters["K_c"]
    assert abs(K_c.value / RIG.force_constant_n_m2_a2 - 1.0) < 2e-3


def amplifier_step(second_order_s: float = 0.0, digits: int = 17) -> Record:
    """Plateaus of u_c and the exact answer of (1), K_A 0.297 A/V, T_A 20 ms; behind a second lag; rounded."""
    n, dt, K_A, T_A = 1500, 2e-3, 0.297, 0.02
    u = np.array([0.5, 1.5, 2.5, 1.0, 3.0])[(np.arange(n) // 100) % 5]
    i, lagged = np.zeros(n), np.zeros(n)
    for k in range(n - 1):
        i[k + 1] = K_A * u[k] + (i[k] - K_A * u[k]) * np.exp(-dt / T_A)
        share = np.exp(-dt / second_order_s) if second_order_s else 0.0
        lagged[k + 1] = i[k + 1] + (lagged[k] - i[k + 1]) * share
    absent = np.full(n, np.nan)
    return Record(
        name="step",
        kind="amplifier-step",
        use="fit",
        t=dt * np.arange(n, dtype=np.float64),
        u_c=u,
        i_c=np.round(lagged, digits),
        x=absent,
        x_ref=absent,
    )


@pytest.mark.parametrize("digits", [17, 3])
def test_a_current_without_noise_is_identified_no_surer_than_it_is_resolved(campaign: Campaign, digits: int) -> None:
    result = identify_records(campaign, [amplifier_step(digits=digits)])

    assert not any("not first order" in warning for warning in result.warnings)
    for name, truth in (("K_A", 0.297), ("T_A", 0.02)):
        parameter = result.model.parameters[name]
        assert parameter.std is not None
        assert parameter.std >= (1.0 - 1e-9) * 1e-6 * parameter.value  # but for rounding
        assert parameter.value == pytest.approx(truth, abs=5.0 * parameter.std)


def test_a_misfit_is_told_in_amperes_where_there_is_no_noise_to_compare_it_with(campaign: Campaign) -> None:
    result = identify_records(campaign, [amplifier_step(second_order_s=5e-3)])

    (message,) = [warning for warning in result.warnings if "not first order" in warning]
    assert "mA rms, far beyond the" in message
    assert not any(len(word.strip("()x.")) > 6 for word in message.split() if word[0].isdigit())
    T_A = result.model.parameters["T_A"]
    assert T_A.std is not None
    assert T_A.std > 1e-3 * T_A.value, "an answer of another shape has no time constant to five digits"
