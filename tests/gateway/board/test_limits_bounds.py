"""Tests of the end of each limit of the gate, to the last value that passes. A refusal says value, bound and unit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from gateway.board.limits import (
    MAX_ALARM,
    MAX_ID,
    MAX_PAYLOAD,
    MAX_STOP,
    MAX_TEXT,
    MAX_WHO,
    BoardView,
    Gate,
    bumpless,
    read_command,
)
from gateway.board.scaling import Refusal, WireCommand, to_wire
from gateway.config import LimitsConfig
from protocol.bus import board51_pb2 as pb
from protocol.wire.messages import Flag, Mode
from tests.gateway.board.test_limits import SCALING, VIEW, excite, reference

SCALED_VIEW = replace(VIEW, scaling=SCALING)
OPEN, IDLE = replace(SCALED_VIEW, mode=Mode.OPEN_LOOP), replace(SCALED_VIEW, mode=Mode.IDLE)


def answer(limits: LimitsConfig, view: BoardView, **what: Any) -> Refusal | None:
    command = pb.Command(id="a", **what)
    wire = to_wire(command, SCALING)
    assert isinstance(wire, WireCommand)
    return Gate(limits).check(command, wire, view, 0.0)


def form(**fields: Any) -> str:
    _, refused = read_command(pb.Command(**{"id": "a", **fields}).SerializeToString())
    return "" if refused is None else f"{refused.reason}: {refused.text}"


@pytest.mark.parametrize(
    ("max_length", "field", "reason"),
    [
        (MAX_ID, lambda text: {"id": text, "ping": pb.Ping()}, "bad-id"),
        (MAX_WHO, lambda text: {"who": text, "ping": pb.Ping()}, "bad-who"),
        (MAX_TEXT, lambda text: {"mark": pb.Mark(text=text)}, "oversize: The remark"),
        (MAX_TEXT, lambda text: {"acknowledge": pb.Acknowledge(alarm="a", comment=text)}, "oversize: The comment"),
        (MAX_ALARM, lambda text: {"acknowledge": pb.Acknowledge(alarm=text)}, "malformed"),
    ],
)
def test_a_text_may_be_as_long_as_its_bound_and_no_longer(max_length: int, field: Any, reason: str) -> None:
    assert form(**field("x")) == ""
    assert form(**field("x" * max_length)) == ""
    refused = form(**field("x" * (max_length + 1)))

    assert refused.startswith(reason)
    assert f" {max_length}" in refused
    assert f" {max_length + 1}" in refused


def test_an_alarm_without_a_name_is_malformed() -> None:
    assert form(acknowledge=pb.Acknowledge()).startswith("malformed: An alarm's name")


def test_a_payload_may_be_as_long_as_its_bound_and_no_longer() -> None:
    tail = b"\xa2\x06"  # field 100, unknown here, with a length and so many bytes
    head = pb.Command(id="a", ping=pb.Ping()).SerializeToString()
    fits = head + tail + _varint(MAX_PAYLOAD - len(head) - 4) + bytes(MAX_PAYLOAD - len(head) - 4)

    assert len(fits) == MAX_PAYLOAD
    assert read_command(fits)[1] is None
    _, refused = read_command(fits + bytes(1))

    assert refused is not None
    assert refused.reason == "oversize"
    assert refused.text == f"The payload has {MAX_PAYLOAD + 1} bytes; a command has at most {MAX_PAYLOAD}."


def test_a_stop_is_looked_for_in_so_many_bytes_and_keeps_its_record() -> None:
    head = pb.Command(id="i", who="w", issued_ns=5, stop=pb.Stop()).SerializeToString()
    size = MAX_STOP - len(head) - 5
    payload = head + b"\xa2\x06" + _varint(size) + bytes(size)

    assert len(payload) == MAX_STOP
    assert read_command(payload) == (pb.Command(id="i", who="w", issued_ns=5, stop=pb.Stop()), None)
    longer = head + b"\xa2\x06" + _varint(size + 1) + bytes(size + 1)
    _, refused = read_command(longer)

    assert refused is not None
    assert refused.reason == "oversize"


def _varint(value: int) -> bytes:
    out = b""
    while value > 0x7F:
        out, value = out + bytes([value & 0x7F | 0x80]), value >> 7
    return out + bytes([value])


@pytest.mark.parametrize(
    ("what", "field"),
    [
        ({"set_reference": pb.SetReference(x_ref_m=float("nan"))}, "set_reference.x_ref_m"),
        ({"excite": pb.Excite(duration_s=float("inf"))}, "excite.duration_s"),
    ],
)
def test_a_number_that_is_none_is_told_with_its_field(what: dict[str, Any], field: str) -> None:
    assert form(**what) == f"not-finite: {field} is not a finite number."


@pytest.mark.parametrize(
    ("view", "limits", "what"),
    [
        (VIEW, {"x_ref_min_m": 2e-3}, reference(2e-3)),
        (VIEW, {"x_ref_max_m": 3e-3}, reference(3e-3)),
        (VIEW, {"x_ref_step_m": 0.5e-3}, reference(3e-3)),
        (VIEW, {"x_ref_step_m": 0.1}, reference(0.3e-3)),  # 200 counts, the board's lowest
        (VIEW, {"x_ref_step_m": 0.1}, reference(4.5e-3)),  # 3000 counts, its highest
        (VIEW, {"gain_max": 5.0}, {"set_gains": pb.SetGains(gains=[5.0, -5.0, 0.0, 0.0])}),
        (OPEN, {"u_max_v": 2.0}, excite(offset=1.0, amplitude=1.0)),
        (OPEN, {"u_max_v": 9.0}, excite(offset=2.25, amplitude=2.25)),  # 0 .. 3600 counts
        (IDLE, {"u_max_v": 2.0}, {"capture": pb.Capture(u_from_v=2.0, u_to_v=2.0, duration_s=0.01)}),
    ],
)
def test_what_lies_on_a_bound_passes(view: BoardView, limits: dict[str, float], what: dict[str, Any]) -> None:
    assert answer(LimitsConfig(**limits), view, **what) is None


CONFIGURED, OF_BOARD = "is outside the gateway's limits,", "is outside the board's limits,"


@pytest.mark.parametrize(
    ("view", "limits", "what", "expected"),
    [
        (VIEW, {"gain_max": 5.0}, {"set_gains": pb.SetGains(gains=[0, 6, 0, 0])}, "Gain 2 = 6 is above gain_max 5."),
        (
            VIEW,
            {"x_ref_step_m": 1e-3, "x_ref_slew_m_s": 0.02},
            reference(4e-3),
            "The jump of 1.5 mm from 2.5 mm is larger than the 1 mm allowed now; the allowance refills at 20 mm/s up"
            " to 1 mm.",
        ),
        (
            SCALED_VIEW,
            {"x_ref_min_m": 1e-3, "x_ref_max_m": 4e-3},
            excite(on_reference=True, offset=1.1e-3, amplitude=0.6e-3),
            f"the lowest x_ref = 0.5 mm {CONFIGURED} 1 mm .. 4 mm.",
        ),
        (
            SCALED_VIEW,
            {"x_ref_min_m": 1e-3, "x_ref_max_m": 4e-3},
            excite(on_reference=True, offset=3.9e-3, amplitude=-0.6e-3),
            f"the highest x_ref = 4.5 mm {CONFIGURED} 1 mm .. 4 mm.",
        ),
        (
            SCALED_VIEW,
            {"x_ref_max_m": 9e-3},
            excite(on_reference=True, offset=4.2e-3, amplitude=0.6e-3),
            f"offset -+ amplitude = 4.8 mm {OF_BOARD} 0.3 mm .. 4.5 mm.",
        ),
        (OPEN, {"u_max_v": 2.0}, excite(offset=2.0, amplitude=1.0), f"the highest u_c = 3 V {CONFIGURED} at most 2 V."),
        (
            OPEN,
            {"u_max_v": 9.0},
            excite(offset=4.0, amplitude=1.0),
            f"offset -+ amplitude = 5 V {OF_BOARD} 0 V .. 4.5 V.",
        ),
        (
            IDLE,
            {"u_max_v": 2.0},
            {"capture": pb.Capture(u_from_v=1.0, u_to_v=3.0, duration_s=0.01)},
            f"u_to = 3 V {CONFIGURED} at most 2 V.",
        ),
        (
            IDLE,
            {"u_max_v": 9.0},
            {"capture": pb.Capture(u_from_v=4.75, u_to_v=3.0, duration_s=0.01)},
            f"u_from = 4.75 V {OF_BOARD} 0 V .. 4.5 V.",
        ),
        (
            OPEN,
            {"excitation_max_s": 60.0},
            excite(offset=1.0, duration_s=61.0),
            "A duration of 61 s is outside the gateway's limit, up to 60 s.",
        ),
        (
            OPEN,
            {"excitation_max_s": 60.0},
            excite(offset=1.0, duration_s=0.0),
            "A duration of 0 s, endless, is outside the gateway's limit, up to 60 s.",
        ),
        (
            replace(VIEW, mode=Mode.CLOSED_LOOP),
            {},
            {"capture": pb.Capture(u_from_v=1.0, u_to_v=2.0, duration_s=0.01)},
            "This needs mode idle or open loop; the board is in closed loop.",
        ),
    ],
)
def test_a_refusal_says_value_bound_and_unit(
    view: BoardView, limits: dict[str, float], what: dict[str, Any], expected: str
) -> None:
    refusal = answer(LimitsConfig(**limits), view, **what)

    assert refusal is not None
    assert refusal.text == expected


def test_a_fault_and_an_unknown_level_are_told_with_what_to_do() -> None:
    faulty = answer(LimitsConfig(), replace(IDLE, flags=int(Flag.FAULT)), **excite(offset=1.0))
    unknown = bumpless(pb.Command(excite=pb.Excite(shape=pb.SHAPE_NONE)), replace(VIEW, mode=None))

    assert faulty is not None
    assert "set a mode first" in faulty.text
    assert isinstance(unknown, Refusal)
    assert "end it with a reference or a mode" in unknown.text


def test_only_a_reference_uses_up_the_allowance_for_jumps() -> None:
    gate = Gate(LimitsConfig(x_ref_step_m=1e-3, x_ref_slew_m_s=1e-6))
    far, command = replace(VIEW, x_ref_m=9e-3), pb.Command(id="a", **reference(3.4e-3))
    wire = to_wire(command, SCALING)
    assert isinstance(wire, WireCommand)

    gate.passed(pb.Command(id="a", ping=pb.Ping()), far, 0.0)

    assert gate.check(command, wire, VIEW, 0.0) is None


def test_one_command_a_second_at_least_passes_and_the_next_waits() -> None:
    gate, ping = Gate(LimitsConfig(commands_per_s=1.0)), pb.Command(id="p", ping=pb.Ping())

    assert gate.admit(ping, 0.0) is None
    refused = gate.admit(ping, 0.5)
    assert refused is not None
    assert "1 commands per second" in refused.text
    assert gate.admit(ping, 1.0) is None
