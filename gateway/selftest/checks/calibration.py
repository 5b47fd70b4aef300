"""x at both stops, and with --calibrate the correction that the board keeps: rule 17 of protocol/README.md."""

from __future__ import annotations

from collections.abc import Iterator
from statistics import fmean

from gateway.selftest.bench import Bench, FaultFoundError, NotReadyError
from gateway.selftest.verdict import Verdict, judge, passed, warning
from protocol.wire.messages import COUNTS_MAX, Message

_HOLD_S = 0.5
_CLOSE_M = 0.1e-3
_SINCE = (1, 4)  # firmware


def calibration(bench: Bench) -> Iterator[Verdict]:
    """Compare x at both stops with the travel; correct it if the bench is to, and compare again."""
    if bench.faults & {"position-polarity", "position-frozen", "no-lift"}:
        raise NotReadyError("x does not follow the ball: see polarity")
    corrects = (bench.identity.int("firmware_major"), bench.identity.int("firmware_minor")) >= _SINCE
    if bench.calibrate and not corrects:
        raise NotReadyError("its firmware is older than 1.4 and takes no calibration: flash it again")
    ground_m, top_m = bench.rest().x_m, _ceiling_m(bench)
    if not bench.calibrate or _is_right(bench, ground_m, top_m):
        yield _travel(bench, top_m)
        yield _both(bench, ground_m, top_m, corrects=corrects)
        return
    is_stored, before = _correct(bench, ground_m, top_m), _pair(ground_m, top_m)
    bench.forget_rest()
    ground_m, top_m = bench.rest().x_m, _ceiling_m(bench)
    yield _travel(bench, top_m)
    yield _both(bench, ground_m, top_m, corrects=corrects)
    if is_stored:
        yield passed("calibration-kept", "the board corrects x for good, before that", before)
    else:
        yield warning(
            "calibration-kept", "the board corrects x until its next reset, before that", before,
            remedy="this chip keeps none: calibrate again after each reset",
        )  # fmt: skip


def corrected_points(in_force: Message, ground: float, top: float, truth: tuple[float, float]) -> dict[str, int]:
    """Return the fields of SET_CALIBRATION that turn two counts of x, as the board gives them now, into their truth."""
    number = in_force.int
    slope = (number("high_true") - number("low_true")) / (number("high_read") - number("low_read"))
    low, high = (number("low_read") + (x - number("low_true")) / slope for x in (ground, top))
    counts = (min(max(round(count), 0), COUNTS_MAX) for count in (low, truth[0], high, truth[1]))
    return dict(zip(("low_read", "low_true", "high_read", "high_true"), counts, strict=True))


def _correct(bench: Bench, ground_m: float, top_m: float) -> bool:
    """Write the calibration; return whether the board keeps it through a reset."""
    scaling, line = bench.scaling, bench.line
    ground, top, zero, travel = (
        (x_m - scaling.x_offset_m) / scaling.x_lsb_m for x_m in (ground_m, top_m, 0.0, bench.rig.travel_m)
    )
    points = corrected_points(line.order("GET_CALIBRATION"), ground, top, (zero, travel))
    answer = line.send("SET_CALIBRATION", **points).message
    if answer is None or answer.name == "NACK":
        raise FaultFoundError(
            "calibration-refused", "calibration of x", f"{_pair(ground_m, top_m)}: further off than the board corrects",
            remedy="look at the sensor, its place and its supply, and whether this is the right --rig",
        )  # fmt: skip
    for _ in range(10):
        line.run(0.05)
        if line.order("GET_CALIBRATION").int("kept"):
            return True
    return False


def _ceiling_m(bench: Bench) -> float:
    """Lift the ball to the ceiling for half a second; return x there, m."""
    rest, rig, scaling = bench.rest(), bench.rig, bench.scaling
    u_v = bench.lift_input_v or rig.lift_input_v
    ticks = round(_HOLD_S / scaling.sample_time_s)
    bench.open_loop()
    samples = bench.pulse(u_v, ticks, then_s=0.2)
    bench.idle()
    held = [sample for sample in samples if sample.state.u_c][-ticks // 4 :]
    if not held:
        raise NotReadyError("u_c does not follow: see staircase")
    top_m = fmean(bench.positions(held))
    if max(bench.currents(held)) - rest.i_a < 0.2 * rig.K_A * u_v and abs(top_m - rest.x_m) < _CLOSE_M:
        raise bench.no_current()
    if top_m - rest.x_m < 0.5 * rig.travel_m:
        raise FaultFoundError(
            "ceiling", "x at the ceiling", f"{1e3 * top_m:.3f} mm", bound=f"{1e3 * rig.travel_m:g} mm",
            remedy="the ball does not reach the ceiling: see polarity; its way must be free",
        )  # fmt: skip
    return top_m


def _pair(ground_m: float, top_m: float) -> str:
    return f"{1e3 * ground_m:.3f} and {1e3 * top_m:.3f} mm"


def _is_right(bench: Bench, ground_m: float, top_m: float) -> bool:
    return abs(ground_m) <= _CLOSE_M and abs(top_m - bench.rig.travel_m) <= _CLOSE_M


def _travel(bench: Bench, top_m: float) -> Verdict:
    travel_m = bench.rig.travel_m
    return judge(
        "travel", "x at the ceiling", 1e3 * top_m, "mm",
        good=(1e3 * (travel_m - _CLOSE_M), 1e3 * (travel_m + _CLOSE_M)),
        possible=(1e3 * (travel_m - 0.6e-3), 1e3 * (travel_m + 0.6e-3)),
        remedy="the position sensor has another slope: see the next line",
    )  # fmt: skip


def _both(bench: Bench, ground_m: float, top_m: float, *, corrects: bool) -> Verdict:
    value = _pair(ground_m, top_m)
    if _is_right(bench, ground_m, top_m):
        return passed("calibration", "calibration of x", f"{value}: nothing to do")
    repeat = "put the ball at the bottom and repeat with --only calibration --calibrate: the board then corrects x"
    return warning(
        "calibration", "calibration of x", value,
        bound=f"0 and {1e3 * bench.rig.travel_m:g} mm within {1e3 * _CLOSE_M:g} mm",
        remedy=repeat if corrects else "flash firmware 1.4 or newer, then repeat with --calibrate",
    )  # fmt: skip
