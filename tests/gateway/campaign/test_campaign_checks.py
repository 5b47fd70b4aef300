"""Tests of the faults that make a recording of a campaign unusable: each by itself, on an otherwise good recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from gateway.campaign.checks import CheckedRig, Problem, check, lift_off_v, rest_level_m
from gateway.campaign.plan import CommandLimits
from gateway.client.commands import Mode
from gateway.client.values import Sample, Samples
from protocol.bus import board51_pb2 as pb
from protocol.experiments import EXPERIMENT_OF_NAME, Burst
from protocol.wire.messages import Flag

T_S = 2e-3
TRAVEL = 5.7e-3
REST = 0.2e-3  # a sensor that is not zero at the ball's rest
LIMITS = CommandLimits(
    u_min_v=0.0, u_max_v=5.0, x_min_m=0.3e-3, x_max_m=5.2e-3, step_m=2.5e-3, slew_m_s=20e-3, u_lsb_v=1.2e-3
)
RIG = CheckedRig(limits=LIMITS, travel_m=TRAVEL, rest_m=REST, sample_time_s=T_S)
Change = Callable[[Samples], Samples]


def series(u_v: np.ndarray, x_m: np.ndarray, x_ref_m: np.ndarray | None = None, mode: Mode = Mode.OPEN_LOOP) -> Samples:
    n, rng = len(u_v), np.random.default_rng(1)
    return Samples(
        tick=np.arange(100, 100 + n),
        session=np.ones(n, dtype=np.int64),
        t_s=np.arange(n) * np.float64(T_S),
        u_c_v=u_v,
        i_c_a=0.3 * u_v + 2e-3 * rng.standard_normal(n),
        x_m=x_m + 5e-6 * rng.standard_normal(n),
        x_ref_m=np.full(n, 2.85e-3) if x_ref_m is None else x_ref_m,
        mode=np.full(n, mode),
        flags=np.zeros(n, dtype=np.int64),
        lost_before=np.zeros(n, dtype=np.int64),
    )


def at_rest() -> Samples:
    return series(np.repeat([0.0, 1.0, 2.0], 700), np.full(2100, REST))


def sawtooth(*, lifts_at_v: float = 3.3) -> Samples:
    u_v = np.tile(np.linspace(0.0, 3.6, 1500), 3)
    return series(u_v, np.where(u_v > lifts_at_v, TRAVEL, REST))


def bouncing() -> Samples:
    high = np.tile(np.repeat([1.0, 0.0], 50), 20)
    return series(4.0 * high, REST + 0.95 * (TRAVEL - REST) * high)


def flying() -> Samples:
    x_ref = np.tile(np.repeat([2.4e-3, 3.3e-3], 350), 5)
    lag = np.convolve(x_ref, np.ones(60) / 60, mode="full")[: len(x_ref)]
    x = np.where(np.arange(len(x_ref)) < 60, x_ref, lag)
    return series(2.1 + 100 * (x - 2.85e-3), x, x_ref, mode=Mode.CLOSED_LOOP)


GOOD: dict[str, Callable[[], Samples]] = {
    "rest": at_rest, "lift-off": sawtooth, "prbs-open-loop": bouncing, "steps": flying, "blocked-ball": at_rest,
}  # fmt: skip


def capture(u_from_v: float, u_to_v: float, *, count: int = 1000, gain: float = 0.3) -> pb.CaptureRecord:
    u = np.where(np.arange(count) <= 100, u_from_v, u_to_v)
    i = gain * u + 2e-3 * np.random.default_rng(2).standard_normal(count)
    return pb.CaptureRecord(u_from_v=u_from_v, u_to_v=u_to_v, step_index=100, i_c_a=i.tolist())


def captures(name: str) -> list[pb.CaptureRecord]:
    return [capture(3.3 * s.u_from, 3.3 * s.u_to) for s in EXPERIMENT_OF_NAME[name].steps if isinstance(s, Burst)]


def problems(
    name: str, samples: Samples, *, events: Sequence[pb.Event] = (), shots: list[pb.CaptureRecord] | None = None
) -> tuple[Problem, ...]:
    return check(EXPERIMENT_OF_NAME[name], samples, captures(name) if shots is None else shots, events, RIG)


def cut(part: slice) -> Change:
    """Return a change that removes the samples of `part`."""

    def change(s: Samples) -> Samples:
        keep = np.ones(len(s), dtype=bool)
        keep[part] = False
        return Samples(**{name: getattr(s, name)[keep] for name in Samples.__dataclass_fields__})

    return change


def with_(channel: str, change: Callable[[np.ndarray], np.ndarray]) -> Change:
    return lambda s: replace(s, **{channel: change(getattr(s, channel).copy())})


def put(part: slice, value: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(values: np.ndarray) -> np.ndarray:
        values[part] = value
        return values

    return change


@pytest.mark.parametrize("name", GOOD)
def test_a_good_recording_has_no_problem(name: str) -> None:
    assert problems(name, GOOD[name]()) == ()


@pytest.mark.parametrize(
    ("name", "spoil", "code", "cure"),
    [
        ("steps", cut(slice(1000, 1026)), "samples-lost", "again"),  # 52 ms in one place
        ("rest", cut(slice(0, 2000, 6)), "samples-lost", "again"),  # every sixth
        ("rest", with_("session", put(slice(900, None), 2)), "board-reset", "again"),
        ("steps", with_("flags", put(slice(10, 12), Flag.FAULT)), "fault", "again"),
        ("rest", with_("flags", put(slice(0, 90), Flag.CURRENT_RANGE)), "clipped-i_c", "lower"),
        ("steps", with_("flags", put(slice(0, 90), Flag.POSITION_RANGE)), "clipped-x", "none"),
        ("rest", with_("i_c_a", put(slice(None), 0.1)), "nothing-moves", "none"),
        ("rest", with_("i_c_a", lambda i: i[::-1]), "no-response", "none"),
        ("rest", with_("x_m", put(slice(500, None), 3e-3)), "ball-moves", "lower"),
        ("blocked-ball", with_("x_m", put(slice(500, None), 0.4e-3)), "ball-moves", "none"),
        ("lift-off", with_("x_m", put(slice(None), REST)), "nothing-moves", "none"),
        ("lift-off", with_("x_m", lambda x: np.minimum(x, REST + 1e-5)), "never-lifted", "raise"),
        ("lift-off", with_("x_m", put(slice(1200, None), TRAVEL)), "few-lift-offs", "again"),
        ("prbs-open-loop", with_("x_m", lambda x: np.minimum(x, REST + 1e-5)), "never-lifted", "raise"),
        ("prbs-open-loop", with_("x_m", lambda x: np.maximum(x, x.max() - 1e-5)), "hardly-flies", "again"),
        ("steps", with_("mode", put(slice(2000, None), 0)), "mode-changed", "again"),
        ("steps", with_("x_m", put(slice(2000, 2060), REST)), "ball-fell", "lower"),
        ("steps", with_("x_m", lambda x: x + 0.5e-3), "reference-not-reached", "lower"),
        ("steps", with_("x_m", lambda x: 2.85e-3 + 1e-3 * (x - x.mean())), "nothing-moves", "again"),
        ("steps", with_("u_c_v", put(slice(0, 1000), 5.0)), "clipped-u_c", "lower"),
    ],
)
def test_what_spoils_a_recording_is_named(name: str, spoil: Change, code: str, cure: str) -> None:
    detected = problems(name, spoil(GOOD[name]()))

    assert [(problem.code, problem.cure) for problem in detected] == [(code, cure)], detected
    assert detected[0].text


def test_single_lost_samples_are_no_problem() -> None:
    assert problems("steps", cut(slice(0, 2000, 10))(flying())) == ()


def test_a_sensor_at_its_end_at_the_stop_is_no_problem_where_the_ball_bounces() -> None:
    at_the_end = with_("flags", put(slice(0, 400), Flag.POSITION_RANGE))

    assert problems("prbs-open-loop", at_the_end(bouncing())) == ()


def test_a_ramp_that_ended_at_the_limit_is_not_raised_any_more() -> None:
    stuck = sawtooth(lifts_at_v=99.0)
    at_the_limit = replace(stuck, u_c_v=stuck.u_c_v * 5.0 / 3.6)

    assert [p.cure for p in problems("lift-off", stuck)] == ["raise"]
    assert [p.cure for p in problems("lift-off", at_the_limit)] == ["none"]


def test_a_missing_or_dead_capture_is_named() -> None:
    rest, shots = at_rest(), captures("amplifier-steps")
    dead = [capture(c.u_from_v, c.u_to_v, gain=0.0) for c in shots]
    swallowed = [capture(0.0, 0.33, gain=0.0), *shots[1:]]  # by a dead zone

    assert problems("amplifier-steps", rest, shots=shots) == ()
    assert problems("amplifier-steps", rest, shots=swallowed) == ()
    assert [p.code for p in problems("amplifier-steps", rest, shots=shots[:-1])] == ["captures-missing"]
    assert [p.code for p in problems("amplifier-steps", rest, shots=dead)] == ["no-response"]


def test_a_reset_is_told_in_the_boards_words() -> None:
    reset = pb.Event(source="board", severity="warning", name="reset-watchdog", text="The board restarted.")
    spoiled = with_("session", put(slice(900, None), 2))(at_rest())

    (problem,) = problems("rest", spoiled, events=[reset])

    assert "The board restarted" in problem.text


def test_the_lift_off_input_is_read_off_the_ramps() -> None:
    ramp_v_per_sample = 3.6 / 1500

    assert lift_off_v(sawtooth(), RIG) == pytest.approx(3.3, abs=2 * ramp_v_per_sample)
    assert lift_off_v(at_rest(), RIG) is None


def test_an_absent_channel_is_not_zero() -> None:
    states = [pb.State(tick=tick, session=1, u_c_v=1.0, mode=pb.MODE_IDLE) for tick in (1, 2)]
    samples = Samples.of(map(Sample.of, states))

    assert np.isnan(samples.x_m).all()
    assert [p.code for p in problems("rest", samples)] == ["nothing-moves", "no-i_c", "no-x"]
    assert np.isnan(rest_level_m([]))
