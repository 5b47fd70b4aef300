"""The gate in front of the wire."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from gateway.board.limits import BoardView, Gate, TokenBucket, bumpless, read_command
from gateway.board.scaling import Refusal, Scaling, WireCommand, to_wire
from gateway.config import LimitsConfig
from protocol.bus import board51_pb2 as pb
from protocol.wire.messages import Flag, Message, Mode

SCALING = Scaling(
    i_offset_a=0.0, i_lsb_a=5e-4, x_offset_m=0.0, x_lsb_m=1.5e-6, u_offset_v=0.0, u_lsb_v=1.25e-3,
    sample_time_s=0.002, capture_time_s=4e-5, capture_size=2000,
)  # fmt: skip
BOARD = Message("PARAMETERS", {"x_ref_min": 200, "x_ref_max": 3000, "u_max": 3600, "divider": 1})
VIEW = BoardView(mode=Mode.CLOSED_LOOP, flags=0, x_ref_m=2.5e-3, u_c_v=1.5, parameters=BOARD)


def verdict(gate: Gate, view: BoardView = VIEW, now_s: float = 0.0, **what: Any) -> str:
    command = pb.Command(id="a", **what)
    wire = to_wire(command, SCALING)
    assert isinstance(wire, WireCommand)
    refusal = gate.check(command, wire, view, now_s)
    if refusal is None:
        gate.passed(command, view, now_s)
        return ""
    assert refusal.text.endswith(".")
    return refusal.reason


def reference(x_ref_m: float) -> dict[str, Any]:
    return {"set_reference": pb.SetReference(x_ref_m=x_ref_m)}


def excite(**fields: Any) -> dict[str, Any]:
    return {"excite": pb.Excite(**{"shape": pb.SHAPE_STEP, "duration_s": 1.0, **fields})}


@pytest.mark.parametrize(
    ("payload", "reason"),
    [
        (b"\xff\xff\xff", "malformed"),
        (b"", "bad-id"),
        (b"\x00" * 5000, "oversize"),
        (pb.Command(id="x" * 129, ping=pb.Ping()).SerializeToString(), "bad-id"),
        (pb.Command(id="x", who="y" * 129, ping=pb.Ping()).SerializeToString(), "bad-who"),
        (pb.Command(id="x").SerializeToString(), "empty-command"),
        (pb.Command(id="x").SerializeToString() + b"\xa2\x06\x00", "empty-command"),  # field 100: from the future
        (pb.Command(id="x", set_reference=pb.SetReference(x_ref_m=math.nan)).SerializeToString(), "not-finite"),
        (pb.Command(id="x", set_gains=pb.SetGains(gains=[1, math.inf, 0, 0])).SerializeToString(), "not-finite"),
        (pb.Command(id="x", excite=pb.Excite(duration_s=-math.inf)).SerializeToString(), "not-finite"),
    ],
)
def test_what_is_not_a_command_is_refused(payload: bytes, reason: str) -> None:
    _, refused = read_command(payload)

    assert refused is not None
    assert refused.reason == reason
    assert refused.text.endswith(".")


@pytest.mark.parametrize(
    "payload",
    [
        pb.Command(stop=pb.Stop()).SerializeToString(),
        pb.Command(id="x" * 129, stop=pb.Stop()).SerializeToString(),
        pb.Command(id="x", who="y" * 129, valid_s=math.nan, stop=pb.Stop()).SerializeToString(),
        pb.Command(id="x" * 60_000, stop=pb.Stop()).SerializeToString(),
        pb.Command(id="x", stop=pb.Stop()).SerializeToString() + b"\xa2\x06\x00",  # field 100: from the future
    ],
    ids=["no id", "long id", "long who", "oversize", "unknown field"],
)
def test_whatever_can_be_read_as_a_stop_is_one(payload: bytes) -> None:
    command, refused = read_command(payload)

    assert refused is None
    assert command.WhichOneof("what") == "stop"
    assert command.ByteSize() < 300  # what goes into the log


def test_the_reference_stays_within_configuration_and_board() -> None:
    gate = Gate(LimitsConfig(x_ref_min_m=1e-3, x_ref_max_m=5.2e-3, x_ref_step_m=0.1))

    assert verdict(gate, **reference(0.9e-3)) == "out-of-range"  # configuration
    assert verdict(gate, **reference(4.6e-3)) == "out-of-range"  # board: 3000 counts are 4.5 mm
    assert verdict(gate, **reference(4.4e-3)) == ""


@pytest.mark.parametrize(
    ("limits", "x_ref_m", "expected"),
    [
        ({}, 9e-3, "x_ref = 9 mm is outside the gateway's limits, 0.3 mm .. 5.2 mm."),
        ({"x_ref_step_m": 0.1}, 4.6e-3, "x_ref = 4.6005 mm is outside the board's limits, 0.3 mm .. 4.5 mm."),
        ({"x_ref_step_m": 1e-3}, 4e-3, "The jump of 1.5 mm from 2.5 mm is larger than the 1 mm allowed now;"),
    ],
)
def test_a_refused_reference_is_told_in_mm_and_in_the_range_that_holds(
    limits: dict[str, float], x_ref_m: float, expected: str
) -> None:
    gate, view = Gate(LimitsConfig(**limits)), replace(VIEW, scaling=SCALING)
    command = pb.Command(id="a", **reference(x_ref_m))
    wire = to_wire(command, SCALING)

    refusal = gate.check_configured_range(command)  # before counts: the converter ends elsewhere
    if refusal is None:
        assert isinstance(wire, WireCommand)
        refusal = gate.check(command, wire, view, 0.0)

    assert refusal is not None
    assert expected in refusal.text


def test_the_allowance_for_jumps_refills_with_time() -> None:
    gate = Gate(LimitsConfig(x_ref_step_m=1e-3, x_ref_slew_m_s=10e-3))

    assert verdict(gate, **reference(3.4e-3)) == ""  # 0.9 of 1.0 mm
    assert verdict(gate, **reference(2.3e-3)) == "slew"  # 0.2 mm wanted, 0.1 left
    assert verdict(gate, now_s=0.011, **reference(2.3e-3)) == ""  # 0.11 mm more


def test_a_refused_jump_uses_nothing_up() -> None:
    gate = Gate(LimitsConfig(x_ref_step_m=1e-3, x_ref_slew_m_s=1e-6))

    for _ in range(5):
        assert verdict(gate, **reference(4.0e-3)) == "slew"

    assert verdict(gate, **reference(3.4e-3)) == ""


@pytest.mark.parametrize(
    ("mode", "on_reference", "reason"),
    [
        (Mode.IDLE, False, "wrong-mode"),
        (Mode.IDLE, True, "wrong-mode"),
        (Mode.OPEN_LOOP, False, ""),
        (Mode.OPEN_LOOP, True, "wrong-mode"),
        (Mode.CLOSED_LOOP, False, "wrong-mode"),
        (Mode.CLOSED_LOOP, True, ""),
        (None, False, ""),  # not known: the board decides
    ],
)
def test_an_excitation_needs_the_mode_of_its_target(mode: Mode | None, on_reference: bool, reason: str) -> None:
    view = replace(VIEW, mode=mode)
    offset = 2e-3 if on_reference else 1.0

    assert verdict(Gate(LimitsConfig()), view, **excite(on_reference=on_reference, offset=offset)) == reason


def test_an_excitation_stays_within_the_bounds_at_both_peaks() -> None:
    gate, open_loop = Gate(LimitsConfig(u_max_v=4.0)), replace(VIEW, mode=Mode.OPEN_LOOP)

    assert verdict(gate, open_loop, **excite(offset=2.0, amplitude=1.9)) == ""
    assert verdict(gate, open_loop, **excite(offset=3.0, amplitude=-1.1)) == "out-of-range"
    assert verdict(gate, open_loop, **excite(offset=1.0, amplitude=1.1)) == "out-of-range"  # below 0 counts
    assert verdict(gate, **excite(on_reference=True, offset=4.4e-3, amplitude=0.2e-3)) == "out-of-range"


@pytest.mark.parametrize(
    ("longest_s", "duration_s", "reason"),
    [(600.0, 600.0, ""), (600.0, 601.0, "out-of-range"), (600.0, 0.0, "out-of-range"), (0.0, 0.0, ""), (0.0, 1e6, "")],
)
def test_an_excitation_ends_within_the_bound_where_there_is_one(
    longest_s: float, duration_s: float, reason: str
) -> None:
    gate, open_loop = Gate(LimitsConfig(excitation_max_s=longest_s)), replace(VIEW, mode=Mode.OPEN_LOOP)

    assert verdict(gate, open_loop, **excite(offset=1.0, duration_s=duration_s)) == reason


ENDING: dict[str, Any] = {"excite": pb.Excite(shape=pb.SHAPE_NONE)}


@pytest.mark.parametrize(
    ("mode", "on_reference", "offset"), [(Mode.CLOSED_LOOP, True, 2.5e-3), (Mode.OPEN_LOOP, False, 1.5)]
)
@pytest.mark.parametrize(
    "excite",
    [
        pb.Excite(shape=pb.SHAPE_NONE),
        pb.Excite(shape=pb.SHAPE_NONE, on_reference=True),
        pb.Excite(shape=pb.SHAPE_NONE, on_reference=True, offset=0.0, amplitude=1.0),  # all that OPC UA can say
    ],
)
def test_ending_an_excitation_leaves_the_signal_where_it_is(
    mode: Mode, on_reference: bool, offset: float, excite: pb.Excite
) -> None:
    command = bumpless(pb.Command(excite=excite), replace(VIEW, mode=mode))

    assert isinstance(command, pb.Command)
    assert (command.excite.shape, command.excite.on_reference) == (pb.SHAPE_NONE, on_reference)
    assert command.excite.offset == offset


def test_ending_an_excitation_needs_no_bounds_but_a_mode_in_which_one_plays() -> None:
    narrow = Gate(LimitsConfig(x_ref_min_m=3e-3, x_ref_max_m=3.1e-3, u_max_v=0.1))

    assert verdict(narrow, **ENDING) == ""
    assert verdict(narrow, excite=pb.Excite(shape=pb.SHAPE_NONE, on_reference=True, amplitude=1.0)) == ""
    assert verdict(narrow, replace(VIEW, mode=Mode.OPEN_LOOP), **ENDING) == ""
    assert verdict(narrow, replace(VIEW, mode=Mode.IDLE), **ENDING) == "wrong-mode"


def test_an_excitation_is_not_ended_at_a_level_that_nobody_knows() -> None:
    for view in (replace(VIEW, mode=None), replace(VIEW, x_ref_m=None)):
        refused = bumpless(pb.Command(**ENDING), view)

        assert isinstance(refused, Refusal)
        assert refused.reason == "not-available"


def test_shape_none_with_an_offset_is_a_level_of_the_input_within_the_limits() -> None:
    gate, open_loop = Gate(LimitsConfig(u_max_v=4.0)), replace(VIEW, mode=Mode.OPEN_LOOP)
    command = pb.Command(excite=pb.Excite(shape=pb.SHAPE_NONE, offset=0.0))

    assert bumpless(command, open_loop) is command
    assert verdict(gate, open_loop, excite=pb.Excite(shape=pb.SHAPE_NONE, offset=0.0)) == ""
    assert verdict(gate, open_loop, excite=pb.Excite(shape=pb.SHAPE_NONE, offset=4.1)) == "out-of-range"
    assert verdict(gate, excite=pb.Excite(shape=pb.SHAPE_NONE, offset=1.0)) == "wrong-mode"  # closed loop


def test_a_capture_needs_idle_or_open_loop_and_bounded_inputs() -> None:
    gate = Gate(LimitsConfig())
    capture: dict[str, Any] = {"capture": pb.Capture(u_from_v=1.0, u_to_v=2.0, duration_s=0.01)}
    high: dict[str, Any] = {"capture": pb.Capture(u_from_v=1.0, u_to_v=4.8, duration_s=0.01)}

    assert verdict(gate, **capture) == "wrong-mode"
    assert verdict(gate, replace(VIEW, mode=Mode.IDLE), **capture) == ""
    assert verdict(gate, replace(VIEW, mode=Mode.IDLE), **high) == "out-of-range"  # the board's u_max is 4.5 V


def test_a_fault_leaves_only_what_clears_it() -> None:
    gate, faulty = Gate(LimitsConfig()), replace(VIEW, mode=Mode.IDLE, flags=int(Flag.FAULT))

    assert verdict(gate, faulty, **excite(offset=1.0)) == "fault-active"
    assert verdict(gate, faulty, set_mode=pb.SetMode(mode=pb.MODE_CLOSED_LOOP)) == ""
    assert verdict(gate, faulty, stop=pb.Stop()) == ""


def test_a_gain_has_a_largest_magnitude() -> None:
    gate = Gate(LimitsConfig(gain_max=2000.0))

    assert verdict(gate, set_gains=pb.SetGains(gains=[0.5, -1999, 1, 1])) == ""
    assert verdict(gate, set_gains=pb.SetGains(gains=[0.5, -2001, 1, 1])) == "out-of-range"


def test_a_flood_is_refused_but_never_stop() -> None:
    gate = Gate(LimitsConfig(commands_per_s=10.0))
    ping, stop = pb.Command(id="p", ping=pb.Ping()), pb.Command(id="s", stop=pb.Stop())

    admitted = [gate.admit(ping, 0.001 * n) for n in range(100)]

    assert sum(refusal is None for refusal in admitted) == 10
    assert {refusal.reason for refusal in admitted if refusal} == {"flood"}
    assert all(gate.admit(stop, 0.1) is None for _ in range(1000))
    assert gate.admit(ping, 0.1 + 0.1) is None


def test_a_bucket_never_holds_more_than_its_size() -> None:
    bucket = TokenBucket(2.0, 1.0)

    bucket.take(2.0, 0.0)

    assert bucket.level(1.5) == pytest.approx(1.5)
    assert bucket.level(100.0) == 2.0


@pytest.mark.parametrize(
    ("minimum_s", "timeout_s", "reason"), [(1.0, 0.05, "out-of-range"), (1.0, 1.0, ""), (0.05, 0.05, "")]
)
def test_a_host_loss_time_out_that_this_computer_cannot_hold_is_refused_with_both_numbers(
    minimum_s: float, timeout_s: float, reason: str
) -> None:
    gate = Gate(LimitsConfig(host_loss_min_s=minimum_s))
    command = pb.Command(id="a", set_host_loss=pb.SetHostLoss(policy=1, timeout_s=timeout_s))
    wire = to_wire(command, SCALING)
    assert isinstance(wire, WireCommand)

    refusal = gate.check(command, wire, VIEW, 0.0)

    assert (refusal.reason if refusal else "") == reason
    assert refusal is None or all(f"{value:g} s" in refusal.text for value in (minimum_s, timeout_s))
