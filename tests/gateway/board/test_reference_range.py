"""The reference has one range: a view shows the range that gateway and board let through."""

from __future__ import annotations

import math
from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.board.limits import Gate
from gateway.board.reference import reference_range, reference_range_mm
from gateway.board.scaling import Scaling, WireCommand, to_wire
from gateway.config import LimitsConfig
from protocol.bus import board51_pb2 as pb


def scaling(x_lsb_m: float) -> Scaling:
    return Scaling(
        i_offset_a=0.0, i_lsb_a=5e-4, x_offset_m=0.0, x_lsb_m=x_lsb_m, u_offset_v=0.0, u_lsb_v=1.25e-3,
        sample_time_s=2e-3, capture_time_s=4e-5, capture_size=2000,
    )  # fmt: skip


@pytest.mark.parametrize("mm", [f"{n / 10:.1f}" for n in range(3, 53)])
def test_a_limit_is_reached_however_a_sender_converts_millimetres(mm: str) -> None:
    limit_m = float(Decimal(mm) / 1000)
    gate = Gate(LimitsConfig(x_ref_min_m=limit_m, x_ref_max_m=limit_m + 1e-4))
    other = Gate(LimitsConfig(x_ref_min_m=limit_m - 1e-4, x_ref_max_m=limit_m))

    for x_ref_m in (float(mm) * 1e-3, float(mm) / 1e3, float(mm) * 0.001):
        command = pb.Command(set_reference=pb.SetReference(x_ref_m=x_ref_m))
        assert gate.check_configured_range(command) is None
        assert other.check_configured_range(command) is None


@given(
    x_lsb_m=st.floats(1e-6, 5e-6),
    counts=st.tuples(st.integers(0, 1500), st.integers(1600, 4095)),
    gateway=st.tuples(st.floats(0.0, 1e-3), st.floats(7e-3, 9e-3)),
    swapped=st.booleans(),
)
def test_both_ends_of_what_is_shown_are_let_through(
    x_lsb_m: float, counts: tuple[int, int], gateway: tuple[float, float], swapped: bool
) -> None:
    s = scaling(x_lsb_m)
    low_m, high_m = (s.x_m(count) for count in counts)
    bounds = pb.Parameters(
        x_ref_min_m=high_m if swapped else low_m, x_ref_max_m=low_m if swapped else high_m,
        gateway_x_ref_min_m=gateway[0], gateway_x_ref_max_m=gateway[1],
    )  # fmt: skip
    gate = Gate(LimitsConfig(x_ref_min_m=gateway[0], x_ref_max_m=gateway[1]))

    low, high = reference_range(bounds)
    for mm in reference_range_mm(bounds):
        assert low - 1e-9 <= mm / 1e3 <= high + 1e-9
        if low < high - 2e-6:
            command = pb.Command(set_reference=pb.SetReference(x_ref_m=mm / 1e3))
            wire = to_wire(command, s)
            assert isinstance(wire, WireCommand)
            assert gate.check_configured_range(command) is None
            assert counts[0] <= int(wire.values["x_ref"]) <= counts[1]


def test_without_the_gateway_s_limits_the_board_s_count() -> None:
    parameters = pb.Parameters(x_ref_min_m=0.30001e-3, x_ref_max_m=5.19999e-3)

    assert reference_range(parameters) == (0.30001e-3, 5.19999e-3)
    assert reference_range_mm(parameters) == (0.301, 5.199)
    assert math.isclose(reference_range_mm(pb.Parameters(x_ref_max_m=5.2e-3))[1], 5.2)
