"""x at both stops: the numbers that correct the position sensor, as the line to flash."""

from __future__ import annotations

from collections.abc import Iterator
from statistics import fmean

from gateway.selftest.bench import Bench, NotReadyError
from gateway.selftest.verdict import Result, Verdict, fault, judge, passed

_HOLD_S = 0.5
_CLOSE_M = 0.1e-3


def calibration(bench: Bench) -> Iterator[Verdict]:
    """Lift the ball to the ceiling for half a second, and compare x with the travel."""
    rest, rig, scaling = bench.rest(), bench.rig, bench.scaling
    if bench.faults & {"position-polarity", "position-frozen", "no-lift"}:
        raise NotReadyError("x does not follow the ball: see polarity")
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
        yield fault(
            "ceiling",
            "x at the ceiling",
            f"{1e3 * top_m:.3f} mm",
            bound=f"{1e3 * rig.travel_m:g} mm",
            remedy="the ball does not reach the ceiling: see polarity; its way must be free",
        )
        return
    verdict = judge(
        "travel",
        "x at the ceiling",
        1e3 * top_m,
        "mm",
        good=(1e3 * (rig.travel_m - _CLOSE_M), 1e3 * (rig.travel_m + _CLOSE_M)),
        possible=(1e3 * (rig.travel_m - 0.6e-3), 1e3 * (rig.travel_m + 0.6e-3)),
        remedy="the position sensor has another slope: flash the line below",
    )
    yield verdict
    if verdict.result == Result.OK and abs(rest.x_m) <= _CLOSE_M:
        yield passed("calibration", "calibration of x", f"{1e3 * rest.x_m:.3f} and {1e3 * top_m:.3f} mm: nothing to do")
    else:
        yield Verdict(
            name="calibration",
            result=Result.WARNING,
            what="calibration of x",
            value=f"{1e3 * rest.x_m:.3f} and {1e3 * top_m:.3f} mm",
            bound=f"0 and {1e3 * rig.travel_m:g} mm within {1e3 * _CLOSE_M:g} mm",
            remedy=_correction(bench, rest.x_m, top_m),
        )


def _correction(bench: Bench, ground_m: float, ceiling_m: float) -> str:
    """Return what to flash, so that the two stops read 0 and the travel."""
    rig, scaling = bench.rig, bench.scaling
    if rig.flash_board:
        port = bench.port if "://" not in bench.port else "PORT"
        return (
            f"if this image has no calibration yet: board51 flash --board {rig.flash_board} --port {port}"
            f" --x-ground {ground_m:.6f} --x-ceiling {ceiling_m:.6f}"
        )
    lsb = scaling.x_lsb_m * rig.travel_m / (ceiling_m - ground_m)
    offset = -(ground_m - scaling.x_offset_m) / scaling.x_lsb_m * lsb
    return f"write x_offset = {offset:.6e} m, x_lsb = {lsb:.6e} m/count into the board's identity"
