"""Sequence numbers to ticks: losses, duplicates, noise, wraps, resets."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.wire.decoder import State
from protocol.wire.events import Sample
from protocol.wire.unwrap import Jump, TickUnwrapper

T_S = 0.002


def state(tick: int) -> State:
    return State(tick & 0xFFFF, 1, 2, 3, 4, 0)


def started(tick: int = 0, *, divider: int = 1) -> TickUnwrapper:
    unwrapper = TickUnwrapper()
    unwrapper.restart(tick, tick * T_S, sample_time_s=T_S)
    unwrapper.divider = divider
    return unwrapper


def run(unwrapper: TickUnwrapper, ticks: list[int], *, at_s: float | None = None) -> list[Sample | Jump]:
    placed: list[Sample | Jump] = []
    for tick in ticks:
        now_s = tick * T_S if at_s is None else at_s
        placed += unwrapper.feed(state(tick), now_s)
        unwrapper.settle(now_s)
    return placed


def ticks_of(placed: list[Sample | Jump]) -> list[int]:
    return [p.tick for p in placed if isinstance(p, Sample)]


@given(
    start=st.integers(0, 200_000),
    steps=st.lists(st.integers(1, 400), min_size=1, max_size=60),
    delays_s=st.lists(st.floats(0, 0.05), min_size=1, max_size=10),
)
def test_every_loss_is_counted_and_no_tick_is_wrong(start: int, steps: list[int], delays_s: list[float]) -> None:
    unwrapper = started(start)
    ticks = [start]
    for step in steps:
        ticks.append(ticks[-1] + step)

    placed: list[Sample | Jump] = []
    for n, tick in enumerate(ticks):
        placed += unwrapper.feed(state(tick), tick * T_S + delays_s[n % len(delays_s)])

    following = ticks[-1] + 1
    placed += unwrapper.feed(state(following), following * T_S + 0.05)  # the witness of the last one

    assert ticks_of(placed) == [*ticks, following]
    assert unwrapper.lost == sum(step - 1 for step in steps)
    assert sum(p.lost_before for p in placed if isinstance(p, Sample)) == unwrapper.lost


def test_the_count_goes_on_over_the_wrap() -> None:
    placed = run(started(65_530), list(range(65_530, 65_545)))

    assert ticks_of(placed) == list(range(65_530, 65_545))


def test_losses_are_counted_in_frames_of_the_divider() -> None:
    unwrapper = started(1000, divider=10)

    run(unwrapper, [1000, 1010, 1040, 1050])

    assert unwrapper.lost == 2


def test_losses_are_counted_before_the_divider_is_known() -> None:
    unwrapper = started(1000)
    unwrapper.divider = None

    run(unwrapper, [1000, 1005, 1010, 1025, 1030])

    assert unwrapper.lost == 2


def test_what_a_stream_that_was_switched_off_did_not_send_is_not_lost() -> None:
    unwrapper = started()
    run(unwrapper, [0, 1, 2])

    unwrapper.stream(0)
    unwrapper.stream(5)
    placed = run(unwrapper, [5000, 5005])

    assert ticks_of(placed) == [5000, 5005]
    assert unwrapper.lost == 0


def test_a_doubled_frame_is_placed_once() -> None:
    unwrapper = started()

    placed = run(unwrapper, [0, 1, 2]) + unwrapper.feed(state(2), 2 * T_S) + unwrapper.feed(state(0), 2 * T_S)
    placed += run(unwrapper, [3, 4])

    assert ticks_of(placed) == [0, 1, 2, 3, 4]
    assert (unwrapper.duplicates, unwrapper.lost) == (2, 0)


@given(noise=st.integers(0, 0xFFFF))
def test_a_noise_frame_that_passed_the_crc_does_not_move_the_count(noise: int) -> None:
    unwrapper = started()
    before, after = list(range(1000)), list(range(1000, 1010))
    placed = run(unwrapper, before)

    placed += unwrapper.feed(state(noise), 999 * T_S)
    placed += run(unwrapper, after)

    # Noise that is just the next number cannot be told from the state that then looks like its double.
    assert ticks_of(placed) == before + after
    assert unwrapper.lost == 0
    assert unwrapper.duplicates + unwrapper.implausible == 1


def test_two_noise_frames_in_a_row_are_both_dropped() -> None:
    unwrapper = started()

    placed = run(unwrapper, [0, 1, 2])
    placed += unwrapper.feed(state(40_000), 2 * T_S) + unwrapper.feed(state(9_000), 2 * T_S)
    placed += run(unwrapper, [3, 4])

    assert ticks_of(placed) == [0, 1, 2, 3, 4]
    assert unwrapper.implausible == 2


def test_a_board_that_begins_again_at_zero_is_a_reset() -> None:
    unwrapper = started()
    run(unwrapper, list(range(5000)))

    jump = unwrapper.feed(state(0), 5005 * T_S) + unwrapper.feed(state(1), 5006 * T_S)

    assert jump == [Jump(board_reset=True)]


def test_a_backlog_read_at_once_is_continuous() -> None:
    unwrapper = started()
    run(unwrapper, list(range(100)))

    placed = run(unwrapper, list(range(100, 3000)), at_s=3000 * T_S)

    assert ticks_of(placed) == list(range(100, 3000))
    assert unwrapper.lost == 0


def test_a_silence_of_several_wraps_is_bridged_by_a_full_tick() -> None:
    unwrapper = started()
    run(unwrapper, list(range(10)))
    far = 3 * 65_536 + 77

    assert unwrapper.witness(far, far * T_S) is None
    placed = run(unwrapper, [far + 1, far + 2])

    assert ticks_of(placed) == [far + 1, far + 2]


def test_two_full_ticks_behind_the_count_are_a_reset() -> None:
    unwrapper = started()
    run(unwrapper, list(range(5000)))

    assert unwrapper.witness(3, 5100 * T_S) is None
    assert unwrapper.in_doubt
    assert unwrapper.witness(8, 5105 * T_S) == Jump(board_reset=True, doubtful=(0, 4999))


@settings(max_examples=30)
@given(wrong=st.integers(0, 2**32 - 1))
def test_one_wrong_full_tick_moves_nothing(wrong: int) -> None:
    unwrapper = started()
    run(unwrapper, list(range(5000)))

    assert unwrapper.witness(wrong, 5000 * T_S) is None
    placed = run(unwrapper, list(range(5000, 5050)))
    assert unwrapper.witness(5051, 5051 * T_S) is None
    placed += run(unwrapper, list(range(5050, 5100)))

    assert ticks_of(placed) == list(range(5000, 5100))
    assert (unwrapper.lost, unwrapper.in_doubt) == (0, False)


def test_a_jump_by_whole_wraps_ends_the_count_with_the_second_full_tick() -> None:
    unwrapper = started()
    run(unwrapper, list(range(1000)))
    assert unwrapper.witness(1000, 1000 * T_S) is None
    run(unwrapper, list(range(1000, 1060)))  # in truth 65 536 more: the low 16 bits do not show it

    assert unwrapper.witness(65_536 + 1060, 1060 * T_S) is None
    assert unwrapper.witness(65_536 + 1063, 1063 * T_S) == Jump(board_reset=False, doubtful=(1000, 1059))


def test_after_a_silence_that_may_hide_a_wrap_the_count_ends() -> None:
    unwrapper = started()
    run(unwrapper, list(range(1000)))

    jump = unwrapper.feed(state(1000 + 65_536), 1000 * T_S + 66.0)

    assert jump == [Jump(board_reset=False)]


def test_a_clock_of_the_host_that_stood_still_ends_the_count() -> None:
    """A computer that sleeps: the board goes on, CLOCK_MONOTONIC does not."""
    unwrapper = started()
    run(unwrapper, list(range(1000)))
    awake = 1000 + 150_000

    jump = unwrapper.feed(state(awake), 1000 * T_S) + unwrapper.feed(state(awake + 1), 1001 * T_S)

    assert jump == [Jump(board_reset=False)]


def test_the_count_goes_on_where_the_boards_tick_of_32_bits_begins_again() -> None:
    start = 2**32 - 30
    unwrapper = started(start)
    placed = run(unwrapper, list(range(start, 2**32 + 20)))

    assert unwrapper.witness(20, (2**32 + 20) * T_S) is None
    placed += run(unwrapper, list(range(2**32 + 20, 2**32 + 40)))

    assert ticks_of(placed) == list(range(start, 2**32 + 40))
    assert not unwrapper.in_doubt


def test_a_board_twenty_times_too_fast_keeps_its_count_over_losses() -> None:
    unwrapper = started()
    ticks = [*range(1000), *range(1200, 1400)]

    placed: list[Sample | Jump] = []
    for n, tick in enumerate(ticks):
        placed += unwrapper.feed(state(tick), tick * T_S / 20)
        if n % 10 == 0:
            unwrapper.settle(tick * T_S / 20)

    assert ticks_of(placed) == ticks
    assert unwrapper.lost == 200


class LongWay(TickUnwrapper):
    """Places each state by the full rules."""

    def following(self, sequence: int, now_s: float) -> int | None:
        return None


@given(
    steps=st.lists(st.one_of(st.just(1), st.integers(-3, 400)), min_size=1, max_size=60),
    divider=st.sampled_from([1, 2]),
    delays_s=st.lists(st.floats(0, 0.05), min_size=1, max_size=10),
)
def test_the_short_way_of_an_undisturbed_stream_gives_what_the_full_rules_give(
    steps: list[int], divider: int, delays_s: list[float]
) -> None:
    results = []
    for unwrapper in (TickUnwrapper(), LongWay()):
        unwrapper.restart(0, 0.0, sample_time_s=T_S)
        unwrapper.divider = divider
        tick, now_s, placed = 0, 0.0, list[Sample | Jump]()
        for n, step in enumerate(steps):
            tick = max(tick + step * divider, 0)
            now_s = max(now_s, tick * T_S + delays_s[n % len(delays_s)])
            placed += unwrapper.feed(state(tick), now_s)
        results.append((placed, unwrapper.lost, unwrapper.duplicates, unwrapper.implausible, unwrapper.unplaced))

    assert results[0] == results[1]
