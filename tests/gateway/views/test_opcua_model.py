"""Tests of the address space without a server: units, descriptions, status codes, stamps, history, commands."""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta
from itertools import pairwise

import pytest
from asyncua import ua
from asyncua.server.internal_server import InternalServer
from hypothesis import given
from hypothesis import strategies as st

from gateway.views.board_feed import Link
from gateway.views.opcua.address_space import quality
from gateway.views.opcua.address_space.history import RingHistory, Track
from gateway.views.opcua.address_space.model import TOPICS, Method, leaves, methods
from gateway.views.opcua.address_space.values import StampClock, data_value, datetime_of
from gateway.views.opcua.operations import called, code_of, written
from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.wire.messages import Flag

S = ua.StatusCodes
NODE = ua.NodeId("rig/state/x_m", 2)


def test_every_field_of_the_topics_is_a_variable() -> None:
    paths = {leaf.path for leaf in leaves()}

    for topic in TOPICS:
        for field in topics.TOPIC_OF_NAME[topic].message.DESCRIPTOR.fields:
            assert any(path.startswith(f"{topic}/{field.name}") for path in paths), (topic, field.name)
    assert {"state/x_m", "state/x_m/min", "state/x_m/max", "twin/divergence/x_m.error/max"} <= paths
    assert "status/latency_p99_ms/max" not in paths


def test_every_kind_of_command_is_a_method() -> None:
    lookup = {method.act: method for method in methods()}

    assert set(lookup) | {"set_plant"} == {field.name for field in pb.Command.DESCRIPTOR.oneofs_by_name["what"].fields}
    assert lookup["set_reference"].name == "SetReference"
    assert [a.name for a in lookup["set_gains"].arguments] == ["law", "gains", "i_0_a", "x_0_m", "u_0_v"]
    assert lookup["stop"].arguments == ()


@pytest.mark.parametrize(
    ("state", "code"),
    [
        ("live", S.Good),
        ("silent", S.UncertainLastUsableValue),
        ("handshake", S.UncertainLastUsableValue),
        ("absent", S.BadNoCommunication),
        ("no-gateway", S.BadNoCommunication),
    ],
)
def test_the_link_decides_the_status(state: str, code: int) -> None:
    assert quality.of_board(Link(state=state, reason="", age_s=1.0)) == code


def test_a_twin_is_good_in_step_only() -> None:
    codes = [quality.of_twin(0.1, "in-step"), quality.of_twin(0.1, "settling"), quality.of_twin(0.1, "out-of-step"),
             quality.of_twin(1.0, "in-step"), quality.of_twin(60.0, "in-step")]  # fmt: skip

    assert codes == [S.Good, S.UncertainSubNormal, S.UncertainSubNormal, S.UncertainLastUsableValue,
                     S.BadNoCommunication]  # fmt: skip


def test_a_signal_is_no_better_than_its_sensor() -> None:
    x, i_c = (next(leaf for leaf in leaves() if leaf.path == f"state/{name}") for name in ("x_m", "i_c_a"))

    assert quality.of_signal(S.Good, x, 0, fault="sensor-fault") == S.BadSensorFailure
    assert quality.of_signal(S.Good, i_c, 0, fault="sensor-fault") == S.Good
    assert quality.of_signal(S.Good, x, Flag.POSITION_RANGE, fault="") == S.UncertainSensorNotAccurate
    assert quality.of_signal(S.Good, i_c, Flag.CURRENT_RANGE, fault="") == S.UncertainSensorNotAccurate
    assert quality.of_signal(S.BadNoCommunication, x, 0, fault="sensor-fault") == S.BadNoCommunication
    assert quality.of_extreme(S.Good, "high", 3) == S.UncertainSubNormal
    assert quality.of_extreme(S.Good, "last", 3) == S.Good


def test_stamps_are_the_boards_ticks_without_the_jitter_of_the_link() -> None:
    clock, start_ns = StampClock(), 1_700_000_000_000_000_000

    stamps = [
        clock.stamp(session=1, t_s=n * 0.02, host_time_ns=start_ns + n * 20_000_000 + (n * 7 % 5) * 300_000)
        for n in range(500)
    ]

    steps = [b - a for a, b in pairwise(stamps)]
    assert max(abs(step - 20_000_000) for step in steps[10:]) < 20_000  # arrivals jitter by 1.2 ms


@given(st.lists(st.tuples(st.integers(1, 3), st.floats() | st.floats(0, 1e6), st.integers(0, 2**64 - 1)), max_size=50))
def test_stamps_always_rise_and_are_times(samples: list[tuple[int, float, int]]) -> None:
    clock = StampClock()

    stamps = [clock.stamp(session=s, t_s=t, host_time_ns=h) for s, t, h in samples]

    assert all(a < b for a, b in pairwise(stamps))
    assert all(datetime_of(stamp).year < 2200 for stamp in stamps)
    assert clock.time_ns(math.nan) == clock.time_ns(math.inf) == clock.time_ns(0.0)


@pytest.mark.parametrize(("value", "variant"), [(math.nan, ua.VariantType.Double), (-1, ua.VariantType.UInt32)])
def test_a_number_that_a_client_cannot_take_is_unavailable(value: float, variant: ua.VariantType) -> None:
    result = data_value(value, variant, quality.GOOD, 1)

    assert (result.Value.Value, result.StatusCode.value) == (None, quality.UNAVAILABLE)


def history_of(rows: int, retained: int) -> RingHistory:
    track, history = Track(1, retained), RingHistory(InternalServer())
    history.add(NODE, track, 0)
    for n in range(rows):
        track.append(n * 1_000_000_000, [float(n)], [S.Good if n % 10 else S.BadNoCommunication])
    return history


def at(second: float) -> datetime:
    return datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=second)


def read(history: RingHistory, start: float | None, end: float | None, count: int = 0) -> list[float | None]:
    values, _ = history.read(NODE, None if start is None else at(start), None if end is None else at(end), count)
    return [value.Value.Value for value in values]


def test_history_is_the_newest_rows_between_two_times() -> None:
    history = history_of(25, 8)

    assert read(history, 19, 22) == [19.0, None, 21.0, 22.0]  # 20: no communication, and it says so
    assert read(history, 1, 60) == [17.0, 18.0, 19.0, None, 21.0, 22.0, 23.0, 24.0]
    assert read(history, 23, 21) == [23.0, 22.0, 21.0]
    assert read(history, None, None, 3) == [24.0, 23.0, 22.0]
    assert read(history, 100, 200) == []


def test_a_long_history_is_read_in_pages() -> None:
    history = history_of(30, 30)

    values, more = history.read(NODE, at(1), at(29), 5)
    assert more is not None
    rest, end = history.read(NODE, more, at(29), 0)

    assert len(values) + len(rest) == 29
    assert end is None


@pytest.mark.parametrize(
    ("reason", "code"),
    [
        ("out-of-range", S.BadOutOfRange),
        ("slew", S.BadOutOfRange),
        ("wrong-mode", S.BadInvalidState),
        ("fault-active", S.BadInvalidState),
        ("not-allowed", S.BadUserAccessDenied),
        ("flood", S.BadTooManyOperations),
        ("link-down", S.BadNoCommunication),
        ("not-delivered", S.BadNoCommunication),
        ("timed-out", S.BadTimeout),
        ("a reason of a later gateway", S.BadRequestNotAllowed),
    ],
)
def test_every_refusal_has_its_status(reason: str, code: int) -> None:
    assert code_of(pb.CommandReply(accepted=False, reason=reason)) == code
    assert code_of(pb.CommandReply(accepted=True)) == S.Good


def double(value: object) -> ua.DataValue:
    return ua.DataValue(ua.Variant(value))


def word(value: int) -> ua.DataValue:
    return ua.DataValue(ua.Variant(value, ua.VariantType.UInt32))


def test_a_written_value_becomes_a_command_or_says_why_not() -> None:
    assert written("x_ref_m", double(3e-3)) == (
        "set_reference",
        pb.Command(set_reference=pb.SetReference(x_ref_m=3e-3)),
    )
    assert written("mode", word(2)) == ("set_mode", pb.Command(set_mode=pb.SetMode(mode=pb.MODE_CLOSED_LOOP)))
    assert written("mode", word(7)) == S.BadOutOfRange
    assert written("x_ref_m", double("high")) == S.BadTypeMismatch
    assert written("x_ref_m", double(True)) == S.BadTypeMismatch
    assert written("x_ref_m", double(math.nan)) == S.BadOutOfRange


def test_a_call_becomes_a_command_or_says_which_argument_is_wrong() -> None:
    lookup = {method.act: method for method in methods()}
    gains = [
        ua.Variant(0, ua.VariantType.UInt32),
        ua.Variant([0.5, 1700.0, 17.7, -17600.0]),
        ua.Variant(0.6),
        ua.Variant(2.85e-3),
    ]

    good = called(lookup["set_gains"], [*gains, ua.Variant(2.1)])
    incomplete = called(lookup["set_gains"], gains)
    wrong = called(lookup["set_stream"], [ua.Variant("every")])
    negative = called(lookup["set_stream"], [ua.Variant(-1, ua.VariantType.UInt32)])

    assert isinstance(good, pb.Command)
    assert list(good.set_gains.gains) == [0.5, 1700.0, 17.7, -17600.0]
    assert incomplete == (S.BadArgumentsMissing, [])
    assert wrong == (S.BadInvalidArgument, [S.BadTypeMismatch])
    assert negative == (S.BadInvalidArgument, [S.BadOutOfRange])


@pytest.mark.parametrize("method", methods(), ids=lambda method: method.name)
def test_every_method_takes_arguments_of_the_types_that_it_declares(method: Method) -> None:
    v = ua.VariantType
    examples = {v.Double: 0.5, v.Boolean: True, v.UInt32: 1, v.Int32: 1, v.String: "text"}
    inputs = [
        ua.Variant([examples[a.variant]] if a.is_array else examples[a.variant], a.variant) for a in method.arguments
    ]

    command = called(method, inputs)

    assert isinstance(command, pb.Command)
    assert command.WhichOneof("what") == method.act
    assert len(getattr(command, method.act).ListFields()) == len(method.arguments)
