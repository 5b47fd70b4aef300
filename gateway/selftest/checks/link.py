"""The line: the answer to the first call, PINGs, the stream of STATEs, and the board's clock."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from statistics import median

from gateway.selftest.bench import Bench
from gateway.selftest.connection import BOOT_S
from gateway.selftest.estimates import clock_error
from gateway.selftest.verdict import Verdict, fault, judge, passed, skipped
from protocol.wire.messages import VERSION

_WIRES = "look at TX, RX, ground and the plug; shorten the cable"
_CRYSTAL = "look at the board's crystal and at the divider of its tick"


def link(bench: Bench) -> Iterator[Verdict]:
    """Judge the line."""
    begin = bench.begin
    yield judge(
        "answer", "first answer after the port was opened", begin.answer_s, "s",
        good=(0.0, 4.0), possible=(0.0, BOOT_S), remedy="the boot loader is slow, or the line lost the first calls",
    )  # fmt: skip
    if begin.boot_s is None:
        yield fault("boot", "answer after RESET", "none", bound=f"within {BOOT_S:g} s", remedy="look at its supply")
        return
    yield judge("boot", "answer after RESET", begin.boot_s, "s", good=(0.0, 3.0), remedy="look at its start")
    yield from _pings(bench)
    yield from _stream(bench)


def no_answer(bench: Bench) -> Verdict:
    """Return the fault of a board that has not answered the first call."""
    line = bench.line
    if line.version_refused is not None:
        return fault(
            "protocol-version", "version of the protocol", str(line.version_refused), bound=str(VERSION),
            remedy="flash firmware of this version",
        )  # fmt: skip
    if line.session.counters.valid_frames:
        return fault(
            "deaf-board", "answer to HELLO", "none, but states come",
            remedy="the line to the board is open: look at its RX and the adapter's TX",
        )  # fmt: skip
    if line.bytes_received:
        return fault(
            "garbage", "valid frames", f"none in {line.bytes_received} bytes",
            remedy="the baud rate or the crystal is wrong, or this is another device",
        )  # fmt: skip
    return fault(
        "silence", "bytes from the board", f"none in {BOOT_S:g} s",
        remedy="look at the supply, at the board's TX, at the ground, and whether firmware is in it",
    )  # fmt: skip


def _pings(bench: Bench) -> Iterator[Verdict]:
    line, count = bench.line, 100 if bench.quick else 1000
    bad_before = line.order("PING").int("bad_frames")
    trips_s: list[float] = []
    lost = 0
    for n in range(count):
        bench.progress(f"{count} PINGs", n / count)
        sent_s = line.wire.now_s()
        answer = line.send("PING")
        lost += answer.attempts - 1
        if answer.attempts == 1:
            trips_s.append(line.wire.now_s() - sent_s)
    bad = line.order("PING").int("bad_frames") - bad_before
    yield judge(
        "ping-loss", f"PINGs without an answer, of {count}:", lost, "", good=(0, 0), possible=(0, count // 200),
        remedy=_WIRES,
    )  # fmt: skip
    if trips_s:
        yield judge(
            "round-trip", "round trip of a PING, median", 1e3 * median(trips_s), "ms",
            good=(0.0, 20.0), possible=(0.0, 50.0), remedy="set the adapter's latency timer to 1 ms; take another hub",
        )  # fmt: skip
        yield judge(
            "round-trip-longest", "round trip of a PING, longest", 1e3 * max(trips_s), "ms",
            good=(0.0, 100.0), possible=(0.0, 300.0), remedy="this computer is busy, or the board is",
        )  # fmt: skip
    yield judge("bad-to-board", "damaged frames to the board", bad, "", good=(0, 0), possible=(0, 2), remedy=_WIRES)


def _stream(bench: Bench) -> Iterator[Verdict]:
    line, duration_s = bench.line, 2.0 if bench.quick else 30.0
    line.order("SET_STREAM", divider=1)
    bad_before = sum(line.session.counters.bad_frames.values())
    first = len(line.samples)
    for n in range(10):
        bench.progress(f"{duration_s:g} s of states", n / 10)
        line.run(duration_s / 10)
    samples = line.samples[first:]
    bad = sum(line.session.counters.bad_frames.values()) - bad_before
    tick_s = bench.scaling.sample_time_s
    due = round(duration_s / tick_s)
    if len(samples) < due // 2:
        yield fault("no-states", "states", f"{len(samples)} of {due}", remedy=_WIRES)
        return
    lost = sum(sample.lost_before for sample in samples[1:])
    some = max(1, due // 1000)
    yield judge("lost-states", f"states lost, of {due}:", lost, "", good=(0, 0), possible=(0, some), remedy=_WIRES)
    yield judge("bad-frames", "damaged frames from the board", bad, "", good=(0, 0), possible=(0, some), remedy=_WIRES)
    arrivals_s = [*(sample.arrived_s for sample in samples), line.wire.now_s()]
    longest_s = max(b - a for a, b in pairwise(arrivals_s))
    yield judge(
        "jitter", "longest time between two states", 1e3 * longest_s, "ms", good=(0.0, 50.0), possible=(0.0, 300.0),
        remedy="this computer is busy, or the adapter collects bytes",
    )  # fmt: skip
    if samples[0].session != samples[-1].session:
        yield skipped("crystal", "the board's clock", "the board restarted meanwhile")
        return
    ppm, interval = clock_error([s.tick for s in samples], [s.arrived_s for s in samples], tick_s)
    verdict = judge(
        "crystal", "the board's clock against this computer's", ppm, "ppm",
        good=(-5000, 5000), possible=(-10000, 10000), remedy=_CRYSTAL,
    )  # fmt: skip
    yield replace(verdict, value=f"{round(ppm):+d} ± {interval:.0f} ppm")
    yield passed("tick", "T_s", f"{1e3 * tick_s:g} ms")
