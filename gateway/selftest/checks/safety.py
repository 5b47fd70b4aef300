"""Whatever should switch the coil off does so, by the measured current: STOP, the loss of the host, RESET."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from gateway.selftest.bench import CUT, HOST_LOSS_MS, Bench
from gateway.selftest.verdict import Verdict, fault, judge, passed, skipped
from protocol.wire.events import Sample
from protocol.wire.messages import COUNTS_MAX, EventCode, Flag

_INPUT = 0.5  # of the highest input at which the ball rests
_LOSS_MS = 100
_OFF = 0.1  # of the current before: below it the coil is off


def safety(bench: Bench) -> Iterator[Verdict]:
    """Judge what ends the current."""
    yield _stop(bench)
    yield from _host_loss(bench)
    yield _reset(bench)
    top_a = bench.rig.K_A * bench.rig.top_input_v
    full_a = bench.scaling.i_a(COUNTS_MAX)
    reason = f"cannot be provoked from the host: {top_a:.3g} A at the top of the input, {full_a:.3g} A at that of i_c"
    yield skipped("over-current", "fault OVER_CURRENT", reason)
    yield skipped("watchdog", "reset by the watchdog", "cannot be provoked from the host")
    yield skipped(
        "sensor-fault",
        "fault SENSOR_FAULT",
        "cannot be provoked from the host: pull the sensor's plug, and --only converters must find it",
    )


def _energize(bench: Bench) -> float:
    """Let half the current of lift-off flow; return it above that at rest, A."""
    rest = bench.rest()
    bench.open_loop()
    samples = bench.level(_INPUT * bench.rig.rest_input_v, 0.1)
    current_a = max(bench.currents(samples), default=0.0) - rest.i_a
    if current_a < 0.3 * bench.rig.K_A * _INPUT * bench.rig.rest_input_v:
        bench.line.stop()
        raise bench.no_current()
    return current_a


def _off_after(bench: Bench, samples: Sequence[Sample], limit_a: float) -> Sample | None:
    """Return the first sample from which u_c is 0 and i_c stays below the limit; None: never."""
    rest_a = bench.rest().i_a
    flowing = [n for n, sample in enumerate(samples) if _flows(bench, sample, limit_a + rest_a)]
    first = flowing[-1] + 1 if flowing else 0
    return samples[first] if first < len(samples) else None


def _flows(bench: Bench, sample: Sample, limit_a: float) -> bool:
    return sample.state.u_c > 0 or bench.scaling.i_a(sample.state.i_c) > limit_a


def _limit(bench: Bench, current_a: float) -> float:
    return max(_OFF * current_a, 6 * bench.rest().i_deviation_a)


def _stop(bench: Bench) -> Verdict:
    current_a = _energize(bench)
    first = len(bench.line.samples)
    ordered_s = bench.line.wire.now_s()
    ack = bench.line.stop()
    bench.line.run(0.1)
    after = [s for s in bench.line.samples[first:] if ack is None or s.tick >= ack.int("tick") + 1]
    off = _off_after(bench, after, _limit(bench, current_a))
    if off is None:
        return fault("stop", "i_c after STOP", _last(bench), bound="off", remedy=CUT)
    if ack is None:
        return fault("stop", "STOP", "without an ACK", remedy="the line to the board loses frames: see link")
    return judge(
        "stop", f"STOP: from {current_a:.3g} A to none in", 1e3 * (off.arrived_s - ordered_s), "ms",
        good=(0.0, 50.0), possible=(0.0, 300.0), remedy="the line is slow: see link",
    )  # fmt: skip


def _host_loss(bench: Bench) -> Iterator[Verdict]:
    line, scaling = bench.line, bench.scaling
    current_a = _energize(bench)
    bench.set_host_loss(_LOSS_MS)
    bench.expected_host_losses += 1
    called_s = line.wire.now_s()
    first, first_event = len(line.samples), len(line.events)
    line.run(2.5e-3 * _LOSS_MS + 0.1, silent=True)
    samples = line.samples[first:]
    off = _off_after(bench, samples, _limit(bench, current_a))
    flagged = any(sample.state.flags & Flag.HOST_LOST for sample in samples)
    line.order("PING")
    line.run(0.05)
    codes = {event.code for event in line.events[first_event:]}
    line.stop()
    bench.set_host_loss(HOST_LOSS_MS)
    if off is None:
        yield fault("host-loss", "i_c without a host", _last(bench), bound=f"off after {_LOSS_MS} ms", remedy=CUT)
        return
    yield judge(
        "host-loss", f"no host for {_LOSS_MS} ms: coil off after", 1e3 * (off.arrived_s - called_s), "ms",
        good=(_LOSS_MS - 1e4 * scaling.sample_time_s, _LOSS_MS + 60.0), possible=(0.0, 3.0 * _LOSS_MS),
        remedy="the time-out does not count ticks (rule 10), or the line is slow",
    )  # fmt: skip
    if flagged and EventCode.HOST_BACK in codes:
        yield passed("host-back", "flag HOST_LOST and event HOST_BACK", "seen")
    else:
        yield fault(
            "host-back", "flag HOST_LOST and event HOST_BACK", "flag missing" if not flagged else "event missing",
            remedy="the coil is off, but the firmware does not say so (rule 10)",
        )  # fmt: skip


def _reset(bench: Bench) -> Verdict:
    current_a = _energize(bench)
    handshakes, first = len(bench.line.identities), len(bench.line.samples)
    boot_s = bench.restart()
    if boot_s is None:
        return fault("reset", "answer after RESET with current", "none", remedy=CUT)
    bench.line.run(0.2)
    bench.set_host_loss(HOST_LOSS_MS)
    session = bench.line.session.number
    after = [sample for sample in bench.line.samples[first:] if sample.session == session]
    limit_a = _limit(bench, current_a) + bench.rest().i_a
    if len(bench.line.identities) == handshakes or not after:
        return fault("reset", "states after RESET", "none", remedy="look at its start")
    if any(_flows(bench, sample, limit_a) for sample in after):
        return fault("reset", "i_c after RESET", _last(bench), bound="off", remedy=CUT)
    return passed("reset", "RESET with current: coil", f"off, answers after {1e3 * boot_s:.0f} ms")


def _last(bench: Bench) -> str:
    sample = bench.line.samples[-1]
    i_a, u_v = bench.scaling.i_a(sample.state.i_c), bench.scaling.u_v(sample.state.u_c)
    return f"{i_a:.3g} A at u_c {u_v:.2f} V"
