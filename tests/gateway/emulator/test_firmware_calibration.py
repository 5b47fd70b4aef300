"""The correction of the position sensor: rule 17 of protocol/README.md, on both firmwares."""

from __future__ import annotations

import struct

import pytest

from gateway.emulator.firmware_model.flash import BOOT_TICKS, POSITION
from protocol.wire.framing import encode_frame
from protocol.wire.messages import COUNTS_MAX, EventCode, Flag, Mode, Reason
from tests.harness.gateway.board_host import Bench, Host, refusal

pytestmark = pytest.mark.usefixtures("each_firmware")

POINTS = {"low_read": 40, "low_true": 100, "high_read": 3900, "high_true": 4000}
NONE = {"low_read": 0, "low_true": 0, "high_read": COUNTS_MAX, "high_true": COUNTS_MAX}


def in_force(host: Host) -> dict[str, int]:
    answer = host.request("GET_CALIBRATION")
    return {name: answer.int(name) for name in (*NONE, "kept")}


def x_read(host: Host, bench: Bench, count: int) -> int:
    """The x of STATE where the sensor's converter gives `count`."""
    bench.x_m = POSITION.to_si(count)
    host.run(2)
    return host.states[-1].x


def test_a_board_starts_without_a_calibration() -> None:
    bench = Bench()
    host = Host(bench)

    assert in_force(host) == NONE | {"kept": 0}
    assert [x_read(host, bench, count) for count in (0, 1, 2034, 4094, 4095)] == [0, 1, 2034, 4094, 4095]


@pytest.mark.parametrize(
    ("points", "readings"),
    [
        (NONE | {"high_read": 4000}, {1: 1, 2000: 2047, 3999: 4094, 4001: 4095}),
        (POINTS, {40: 100, 3900: 4000, 2000: 2080, 1: 61, 0: 0, 4095: 4095, 4094: 4095}),
        (
            {"low_read": 300, "low_true": 0, "high_read": 2348, "high_true": 2848},
            {1: 0, 301: 1, 1324: 1424, 4000: 4095},
        ),
        ({"low_read": 0, "low_true": 500, "high_read": 2048, "high_true": 1548}, {1: 501, 1024: 1024, 4094: 2595}),
    ],
)
def test_a_calibration_corrects_readings_and_leaves_the_ends(points: dict[str, int], readings: dict[int, int]) -> None:
    bench = Bench()
    host = Host(bench)

    assert host.request("SET_CALIBRATION", **points).name == "ACK"

    assert in_force(host) == points | {"kept": 1}
    assert {count: x_read(host, bench, count) for count in readings} == readings


def test_the_law_gets_the_corrected_position() -> None:
    bench, other = Bench(), Bench()
    host, corrected = Host(bench), Host(other)
    corrected.request("SET_CALIBRATION", **NONE | {"low_true": 200, "high_read": 3895})
    bench.x_m, other.x_m = POSITION.to_si(2200), POSITION.to_si(2000)
    for each in (host, corrected):
        each.request("SET_MODE", mode=int(Mode.CLOSED_LOOP))
        each.run(5)

    assert [state.u_c for state in host.states[-5:]] == [state.u_c for state in corrected.states[-5:]]
    assert corrected.states[-1].x == 2200


@pytest.mark.parametrize(
    ("points", "bound"),
    [
        ({"high_read": 2047}, 2048),
        ({"low_read": 2048, "low_true": 2048}, 4096),
        ({"low_read": 4095, "high_read": 0}, 4095 + 2048),
        ({"low_true": 501}, 500),
        ({"low_read": 600}, 500),
        ({"high_read": 3000, "high_true": 3600}, 500),
        ({"high_true": 3594}, 500),
        ({"high_true": 4096}, 4095),
        ({"low_read": 0xFFFF}, 4095),
    ],
)
def test_points_that_cannot_be_right_are_refused(points: dict[str, int], bound: int) -> None:
    host = Host()
    host.request("SET_CALIBRATION", **POINTS)

    body = bytes((0x0F, host.next_id())) + struct.pack("<4H", *(NONE | points).values())

    assert refusal(host.send(encode_frame(body))) == (Reason.OUT_OF_RANGE, bound)
    assert in_force(host) == POINTS | {"kept": 1}


@pytest.mark.parametrize("mode", [Mode.OPEN_LOOP, Mode.CLOSED_LOOP])
def test_while_the_coil_is_driven_it_is_refused(mode: Mode) -> None:
    host = Host()
    host.request("SET_MODE", mode=int(mode))

    assert refusal(host.request("SET_CALIBRATION", **POINTS)) == (Reason.WRONG_MODE, mode)
    assert in_force(host) == NONE | {"kept": 0}


def test_in_a_capture_and_in_a_fault_it_is_refused() -> None:
    bench = Bench()
    host = Host(bench)
    host.request("CAPTURE", u_from=300, u_to=1700, pre=50, count=2000)

    busy = host.request("SET_CALIBRATION", **POINTS)
    host.run(60)
    bench.i_a = 5.0
    host.run(60)

    assert refusal(busy) == (Reason.BUSY, 0)
    assert refusal(host.request("SET_CALIBRATION", **POINTS)) == (Reason.FAULT_ACTIVE, 0)


@pytest.mark.parametrize("cause", [EventCode.RESET_POWER_ON, EventCode.RESET_WATCHDOG])
def test_it_outlives_a_reset_and_can_be_taken_back(cause: EventCode) -> None:
    bench = Bench()
    host = Host(bench)
    host.request("SET_CALIBRATION", **POINTS)
    host.firmware.reset(cause)
    host.run(BOOT_TICKS + 1)
    host.hello(2)

    assert in_force(host) == POINTS | {"kept": 1}
    assert x_read(host, bench, 2000) == 2080
    assert host.request("SET_CALIBRATION", **NONE).name == "ACK"
    assert x_read(host, bench, 2000) == 2000


def test_a_corrected_position_at_the_end_is_flagged_as_one_at_the_end() -> None:
    bench = Bench()
    host = Host(bench)
    host.request("SET_CALIBRATION", **POINTS)

    x_read(host, bench, 4094)

    assert host.states[-1].flags & Flag.POSITION_RANGE
