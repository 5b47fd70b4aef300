"""T_A of eq. (1) from captures, and how late the input acts in the loop.

A capture counts its time from its own step: the area above it is T_A.  In the loop the share r of a step that i_c shows
one tick later has both, as r = 1 - exp(-(T_s - d) / T_A) with the delay d from the sample of i_c to the input.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from statistics import fmean

from gateway.selftest.bench import Bench
from gateway.selftest.verdict import Verdict, fault, judge, passed, skipped
from protocol.wire.messages import EventCode, Shape

_CAPTURE_S = 0.012
_PERIOD_S = 0.04
_SIGMAS = 6.0


def latency(bench: Bench) -> Iterator[Verdict]:
    """Judge T_A and the delay of the loop."""
    u_v = 0.7 * bench.rig.rest_input_v
    bench.open_loop()
    time_constant_s = None
    if bench.scaling.capture_size * bench.scaling.capture_time_s < _CAPTURE_S / 2:
        yield skipped("time-constant", "T_A", "the board holds no capture long enough")
    else:
        curves = [_capture(bench, u_v) for _ in range(2 if bench.quick else 6)]
        missing = [fmean(column) for column in zip(*curves, strict=True)]
        time_constant_s, lag_s = first_order(missing, bench.scaling.capture_time_s)
        good, possible = bench.rig.T_A_max_s
        yield judge(
            "time-constant", f"T_A after a delay of {1e3 * lag_s:.2f} ms,", 1e3 * time_constant_s, "ms",
            good=(0.02, 1e3 * good), possible=(-0.05, 1e3 * possible),
            remedy="coil, free-wheeling diode or driver are not those of this rig, or the slew rate is limited",
        )  # fmt: skip
    edges = _edges(bench, u_v)
    bench.idle()
    yield _delay(bench, edges, time_constant_s)


def _capture(bench: Bench, u_v: float) -> list[float]:
    """Return what a step of i_c still misses at each sample from the step on, as a share of it."""
    line, scaling = bench.line, bench.scaling
    count = min(round(_CAPTURE_S / scaling.capture_time_s), scaling.capture_size, 2000)
    pre = count // 4
    first = len(line.events)
    line.order("CAPTURE", u_from=0, u_to=bench.input_count(u_v), pre=pre, count=count)
    line.until(
        lambda: any(event.code == EventCode.CAPTURE_DONE for event in line.events[first:]),
        0.3 + count * scaling.capture_time_s,
    )
    i_a = [scaling.i_a(code) for code in line.read_capture()]
    before, after = fmean(i_a[:pre]), fmean(i_a[-(count // 3) :])
    if after - before < 0.1 * bench.rig.K_A * u_v:
        raise bench.no_current()
    return [1.0 - (i - before) / (after - before) for i in i_a[pre:]]


def first_order(missing: Sequence[float], step_s: float) -> tuple[float, float]:
    """Return time constant and delay of a step response, s, from the share that is missing at each sample.

    Their sum is the area below `missing`.  How it is divided is where the squares of the errors are least, in 50 steps.
    """
    area_s = (sum(missing) - 0.5 * missing[0]) * step_s

    def error(delay_s: float) -> float:
        rate = 1.0 / max(area_s - delay_s, 1e-6)
        model = (math.exp(-max(n * step_s - delay_s, 0.0) * rate) for n in range(len(missing)))
        return sum((a - b) ** 2 for a, b in zip(missing, model, strict=True))

    delay_s = min((area_s * n / 50 for n in range(50)), key=error) if area_s > 0.0 else 0.0
    return area_s - delay_s, delay_s


def _edges(bench: Bench, u_v: float) -> list[list[float]]:
    """Return the steps up of a rectangle as seen in the states: shares of the step at 0, 1, 2, ... ticks after it."""
    periods = 10 if bench.quick else 40
    samples = bench.play(Shape.RECTANGLE, u_v, period_s=_PERIOD_S, duration_s=periods * _PERIOD_S)
    half = round(_PERIOD_S / bench.scaling.sample_time_s / 2)
    u, i_a = [sample.state.u_c for sample in samples], bench.currents(samples)
    starts = [n for n in range(half, len(samples) - half) if u[n] > u[n - 1] and u[n + half - 1] == u[n]]
    steps = []
    for start in starts:
        before, after = fmean(i_a[start - half // 2 : start + 1]), fmean(i_a[start + half // 2 : start + half])
        if after - before > 0.1 * bench.rig.K_A * u_v:
            steps.append([(i - before) / (after - before) for i in i_a[start : start + half]])
    return steps


def _delay(bench: Bench, edges: Sequence[Sequence[float]], time_constant_s: float | None) -> Verdict:
    """Judge the delay from the share that is there after one tick."""
    if len(edges) < 3:
        return skipped("delay", "delay of the loop", "no steps of i_c are seen: see staircase")
    tick_s, time_constant_s = bench.scaling.sample_time_s, time_constant_s or 5e-4
    shares = [fmean(edge[n] for edge in edges) for n in range(5)]
    noise = max(bench.rest().i_deviation_a / (bench.rig.K_A * bench.rig.rest_input_v), 1e-3) / math.sqrt(len(edges))
    ticks = next((n for n in range(1, 5) if shares[n] > 0.5), 5)
    if ticks > 1:
        return fault(
            "delay", "delay of the loop", f"{ticks - 1} ticks at least", bound=f"below {1e3 * tick_s:g} ms",
            remedy="the input is written a tick late: look at the order within a tick (rule 4)",
        )  # fmt: skip
    missing = 1.0 - shares[1]
    if missing < _SIGMAS * noise:
        limit_s = max(tick_s + time_constant_s * math.log(_SIGMAS * noise), 0.0)
        return passed("delay", "delay of the loop", f"below {1e3 * limit_s:.2f} ms", f"below {0.5e3 * tick_s:g} ms")
    return judge(
        "delay", "delay of the loop", 1e3 * max(tick_s + time_constant_s * math.log(missing), 0.0), "ms",
        good=(0.0, 0.5e3 * tick_s), possible=(0.0, 0.9e3 * tick_s),
        remedy="the law or the input converter takes long: the twin's model needs this delay (actuation-delay)",
    )  # fmt: skip
