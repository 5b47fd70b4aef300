"""Counts to SI units and back, with the scalings of the board."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.board.scaling import Refusal, Scaling, StateEncoder, WireCommand, parameters_message, to_wire
from protocol.bus import board51_pb2 as pb
from protocol.wire.codec import encode_body
from protocol.wire.decoder import State
from protocol.wire.events import Sample
from protocol.wire.mantissa import to_mantissa
from protocol.wire.messages import Message

SCALING = Scaling(
    i_offset_a=-0.1, i_lsb_a=5e-4, x_offset_m=-5e-5, x_lsb_m=1.5e-6, u_offset_v=0.2, u_lsb_v=1.25e-3,
    sample_time_s=0.002, capture_time_s=4e-5, capture_size=2000,
)  # fmt: skip


def wire(**what: Any) -> WireCommand:
    converted = to_wire(pb.Command(id="a", **what), SCALING)
    assert isinstance(converted, WireCommand), converted
    encode_body(converted.name, id=1, **converted.values)  # every value fits its field
    return converted


def refusal(**what: Any) -> Refusal:
    converted = to_wire(pb.Command(id="a", **what), SCALING)
    assert isinstance(converted, Refusal)
    return converted


def test_a_state_is_offset_plus_lsb_times_count() -> None:
    sample = Sample(70_000, 3, 2, State(70_000 & 0xFFFF, 1000, 2000, 300, 4095, 0x84 | 2), 0.0)

    state = pb.State.FromString(StateEncoder(SCALING, 3).encode(sample, 123))

    assert state.i_c_a == pytest.approx(-0.1 + 0.5, abs=1e-15)
    assert state.x_m == pytest.approx(-5e-5 + 3e-3, abs=1e-15)
    assert state.u_c_v == pytest.approx(0.2 + 0.375, abs=1e-15)
    assert state.x_ref_m == pytest.approx(-5e-5 + 4095 * 1.5e-6, abs=1e-15)
    assert (state.tick, state.sequence, state.session, state.lost_before) == (70_000, 70_000 & 0xFFFF, 3, 2)
    assert (state.mode, state.flags, state.host_time_ns, state.t_s) == (pb.MODE_CLOSED_LOOP, 0x84, 123, 140.0)


def test_a_zero_is_present_in_the_message() -> None:
    scaling = Scaling(
        i_offset_a=0.0, i_lsb_a=1e-3, x_offset_m=0.0, x_lsb_m=1e-6, u_offset_v=0.0, u_lsb_v=1e-3,
        sample_time_s=0.002, capture_time_s=4e-5, capture_size=2000,
    )  # fmt: skip

    state = pb.State.FromString(StateEncoder(scaling, 1).encode(Sample(0, 1, 0, State(0, 0, 0, 0, 0, 0), 0.0), 1))

    assert all(state.HasField(name) for name in ("i_c_a", "x_m", "u_c_v", "x_ref_m"))


@given(count=st.integers(0, 4095))
def test_a_reference_goes_to_the_count_it_came_from(count: int) -> None:
    command = wire(set_reference=pb.SetReference(x_ref_m=SCALING.x_m(count)))

    assert command.values == {"x_ref": count}


@given(gain=st.floats(-32767, 32767).filter(lambda g: abs(g) > 2**-14))
def test_a_gain_keeps_fifteen_bits(gain: float) -> None:
    mantissa, shift = to_mantissa(gain)

    assert abs(mantissa) <= 32767
    assert 0 <= shift <= 30
    assert abs(mantissa * 2.0**-shift - gain) <= abs(gain) * 2**-15


def test_gains_follow_rule_14_and_come_back_in_the_parameters() -> None:
    gains = [0.49, 1700.0, 17.7, -17600.0]
    command = wire(set_gains=pb.SetGains(law=pb.LAW_LQI, gains=gains, i_0_a=0.6, x_0_m=2.85e-3, u_0_v=2.1))

    k = [int(command.values[f"k{n}_mantissa"]) * 2.0 ** -int(command.values[f"k{n}_shift"]) for n in range(1, 5)]
    i, x, u, t_s = 5e-4, 1.5e-6, 1.25e-3, 0.002
    expected = [0.49 * i / u, 1700 * x / u, 17.7 * x / (t_s * u), -17600 * x * t_s / u]
    # 15 bits of mantissa while the shift of 30 suffices: half a unit in the last place is 2^-15
    assert k == pytest.approx(expected, rel=2**-15)
    assert "Rounding" in command.note

    board: dict[str, Any] = {
        "x_ref_min": 0,
        "x_ref_max": 4095,
        "x_ref_step": 1,
        "x_ref_slew": 1,
        "u_max": 4095,
        "divider": 1,
    }
    values: dict[str, Any] = {**command.values, **board, "id": 1, "policy": 1, "timeout": 500, "tick": 99}
    identity: dict[str, Any] = {
        "board_id": 5, "version": 1, "firmware_major": 1, "firmware_minor": 4, "build": b"abc     ",
    }  # fmt: skip
    parameters = parameters_message(
        Message("PARAMETERS", values), Message("IDENTITY", identity), SCALING, session=3, host_time_ns=1
    )
    assert list(parameters.gains) == pytest.approx(gains, rel=2**-15)
    assert parameters.i_0_a == pytest.approx(0.6, abs=i / 2)
    assert parameters.x_0_m == pytest.approx(2.85e-3, abs=x / 2)
    assert (parameters.firmware, parameters.from_tick, parameters.law) == ("1.4 abc", 99, pb.LAW_LQI)
    assert parameters.capture_s == pytest.approx(min(SCALING.capture_size, 2000) * SCALING.capture_time_s)


def test_pid_gains_are_position_integral_speed() -> None:
    command = wire(set_gains=pb.SetGains(law=pb.LAW_PID, gains=[1000.0, 5000.0, 10.0, 0.0], u_0_v=1.0))

    k = [int(command.values[f"k{n}_mantissa"]) * 2.0 ** -int(command.values[f"k{n}_shift"]) for n in range(1, 5)]
    per_x = 1.5e-6 / 1.25e-3
    assert k == pytest.approx([1000 * per_x, 5000 * per_x * 0.002, 10 * per_x / 0.002, 0], rel=2**-15)


def test_an_excitation_becomes_ticks_and_counts() -> None:
    excite = pb.Excite(
        shape=pb.SHAPE_CHIRP,
        on_reference=True,
        amplitude=3e-4,
        offset=3e-3,
        period_s=1.0,
        period_end_s=0.1,
        duration_s=20,
    )

    assert wire(excite=excite).values == {
        "shape": 6, "target": 1, "amplitude": 200, "offset": 2033, "period": 500, "period_end": 50, "seed": 1,
        "duration": 10_000,
    }  # fmt: skip


def test_a_capture_becomes_samples() -> None:
    capture = pb.Capture(u_from_v=0.2, u_to_v=2.7, duration_s=0.04, pre_s=0.004)

    assert wire(capture=capture).values == {"u_from": 0, "u_to": 2000, "pre": 100, "count": 1000}


@pytest.mark.parametrize(
    "what",
    [
        {"set_reference": pb.SetReference(x_ref_m=1.0)},
        {"set_mode": pb.SetMode(mode=7)},  # type: ignore[arg-type]  # unknown on purpose
        {"set_gains": pb.SetGains(gains=[1.0, 2.0])},
        {"set_gains": pb.SetGains(gains=[1e12, 0, 0, 0], u_0_v=1.0)},
        {"set_gains": pb.SetGains(gains=[1, 0, 0, 0], u_0_v=1e9)},
        {"excite": pb.Excite(shape=pb.SHAPE_PRBS, offset=1.0, period_s=0.0)},
        {"excite": pb.Excite(shape=pb.SHAPE_PRBS, offset=1.0, period_s=1e9)},
        {"excite": pb.Excite(shape=pb.SHAPE_CHIRP, offset=1.0, period_s=1.0, period_end_s=0.1)},
        {"excite": pb.Excite(shape=pb.SHAPE_STEP, offset=1.0, amplitude=1e9)},
        {"excite": pb.Excite(shape=pb.SHAPE_STEP, offset=1.0, duration_s=-1.0)},
        {"excite": pb.Excite(shape=pb.SHAPE_STEP, offset=1.0, seed=70_000)},
        {"excite": pb.Excite(shape=99, offset=1.0)},  # type: ignore[arg-type]  # unknown on purpose
        {"capture": pb.Capture(u_from_v=1.0, u_to_v=2.0, duration_s=1.0)},
        {"capture": pb.Capture(u_from_v=1.0, u_to_v=2.0, duration_s=0.01, pre_s=0.02)},
        {"set_stream": pb.SetStream(divider=1001)},
        {"set_host_loss": pb.SetHostLoss(policy=3, timeout_s=1.0)},
        {"set_host_loss": pb.SetHostLoss(policy=1, timeout_s=0.01)},
    ],
    ids=lambda what: next(iter(what)),
)
def test_what_does_not_fit_its_field_is_refused_with_the_bound(what: dict[str, Any]) -> None:
    refused = refusal(**what)

    assert refused.reason == "out-of-range"
    assert refused.text.endswith(".")


FINITE = st.floats(allow_nan=False, allow_infinity=False)


@given(x_ref_m=FINITE)
def test_any_finite_reference_is_converted_or_refused(x_ref_m: float) -> None:
    converted = to_wire(pb.Command(set_reference=pb.SetReference(x_ref_m=x_ref_m)), SCALING)

    assert isinstance(converted, WireCommand) or converted.reason == "out-of-range"


@pytest.mark.parametrize("gain", [5e-324, -5e-324, 1e-300, 2.0**-31 / 0.0012 * 0.9])
def test_a_gain_that_would_become_zero_is_refused(gain: float) -> None:
    refused = refusal(set_gains=pb.SetGains(gains=[1.0, gain, 0.0, 0.0], u_0_v=1.0))

    assert refused.reason == "out-of-range"
    assert "becomes 0" in refused.text
    assert "gain 2" in refused.text


def test_the_smallest_gain_that_is_named_is_taken() -> None:
    smallest = 2.0**-30 / (1.5e-6 / 1.25e-3)

    command = wire(set_gains=pb.SetGains(gains=[1.0, smallest, 0.0, 0.0], u_0_v=1.0))

    assert (command.values["k2_mantissa"], command.values["k2_shift"]) == (1, 30)


@given(gain=FINITE)
def test_the_mantissa_is_right_to_half_a_step_or_the_gain_too_large(gain: float) -> None:
    try:
        mantissa, shift = to_mantissa(gain)
    except OverflowError:
        assert abs(gain) >= 32767.5
        return
    assert abs(mantissa) <= 32767
    assert abs(mantissa * 2.0**-shift - gain) <= 0.5 * 2.0**-shift
    assert gain == 0 or shift == 30 or abs(gain * 2.0 ** (shift + 1)) >= 32767.5  # no finer one would do


@pytest.mark.parametrize("duration_s", [1e-300, 1e-4, 0.0009])
def test_a_duration_of_less_than_a_tick_is_not_endless(duration_s: float) -> None:
    refused = refusal(excite=pb.Excite(shape=pb.SHAPE_STEP, offset=1.0, duration_s=duration_s))

    assert refused.reason == "out-of-range"


def test_shape_none_carries_nothing_but_its_level() -> None:
    excite = pb.Excite(shape=pb.SHAPE_NONE, offset=2.7, amplitude=1e308, period_s=-1.0, seed=70_000, duration_s=1e308)

    command = wire(excite=excite)

    assert command.values == {
        "shape": 0, "target": 0, "amplitude": 0, "offset": 2000, "period": 1, "period_end": 1, "seed": 1, "duration": 0,
    }  # fmt: skip
    assert command.note == "u_c stays at 2.7 V."
