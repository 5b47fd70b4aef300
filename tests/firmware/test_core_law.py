"""The law in C against the one in Python: equal in u, in the limit and in the integral, tick by tick."""

from __future__ import annotations

import random
from itertools import product

import pytest

from gateway.emulator.firmware_model.flash import GAINS, K_PID, OPERATING_POINT, gains_in_counts
from gateway.emulator.firmware_model.law import ControlLaw, Gains
from protocol.wire.messages import Law, Shape
from tests.harness.firmware.core import Core, CSignal
from twin.control import rounded

FLOWN = (GAINS, gains_in_counts(Law.PID, K_PID, OPERATING_POINT))
ENDS = (-32767, -1, 0, 1, 32767)


def any_gains(chance: random.Random) -> Gains:
    """Gains from the whole range of SET_GAINS, its ends often among them."""

    def mantissa() -> int:
        return chance.choice(ENDS) if chance.random() < 0.2 else chance.randint(-32767, 32767)

    return Gains(
        law=chance.randrange(2),
        mantissas=(mantissa(), mantissa(), mantissa(), mantissa()),
        shifts=(chance.randint(0, 30), chance.randint(0, 30), chance.randint(0, 30), chance.randint(0, 30)),
        i_0=chance.randrange(4096),
        x_0=chance.randrange(4096),
        u_0=chance.randrange(4096),
    )


def fly_both(core: Core, seed: int, ticks: int) -> tuple[int, int]:
    """Compare tick by tick, with new gains every 500; return how many ticks were limited, and how many saturated."""
    chance = random.Random(seed)
    limited_ticks = saturated = 0
    for n in range(ticks):
        if n % 500 == 0:
            law = ControlLaw(FLOWN[n // 500 % 2] if n % 2000 == 0 else any_gains(chance))
            core.load(law.gains)
            if chance.random() < 0.5:
                law.sum = core.law.sum = chance.choice((-(1 << 23), (1 << 23) - 1, chance.randint(-(1 << 23), 1 << 22)))
        i, x, x_ref = chance.randrange(4096), chance.randrange(4096), chance.randrange(4096)
        u, limited = law.run(i, x, x_ref)
        assert core.run(i, x, x_ref) == (u, limited), (seed, n, law.gains, i, x, x_ref)
        assert core.law.sum == law.sum, (seed, n, law.gains, i, x, x_ref)
        limited_ticks += limited
        saturated += abs(law.sum) >= (1 << 23) - 1
    return limited_ticks, saturated


def test_the_law_is_that_of_python_over_random_ticks(core: Core) -> None:
    limited, saturated = fly_both(core, 20240611, 30_000)

    assert 3_000 < limited < 27_000  # both branches of the anti-windup
    assert saturated > 100


@pytest.mark.slow
def test_the_law_is_that_of_python_over_a_million_random_ticks(core: Core) -> None:
    limited, _ = fly_both(core, 20240612, 1_000_000)

    assert 100_000 < limited < 900_000


@pytest.mark.parametrize(("x_ref", "end"), [(0, -(1 << 23)), (4095, (1 << 23) - 1)], ids=["down", "up"])
def test_the_integral_saturates_at_both_ends(core: Core, x_ref: int, end: int) -> None:
    core.load(Gains(law=0, mantissas=(0, 0, 0, 0), shifts=(0, 0, 0, 0), i_0=0, x_0=0, u_0=0))

    for _ in range(2500):
        core.run(0, 4095 - x_ref, x_ref)

    assert core.law.sum == end


def test_before_rounding_the_accumulator_is_that_of_python(core: Core) -> None:
    chance = random.Random(7)
    for _ in range(5_000):
        law = ControlLaw(any_gains(chance))
        core.load(law.gains)
        law.sum = core.law.sum = chance.randint(-(1 << 23), (1 << 23) - 1)
        i, x, x_ref = chance.randrange(4096), chance.randrange(4096), chance.randrange(4096)

        assert core.c.b51_law_accumulate(i, x, x_ref) == law.accumulate(i, x, x_ref), (law.gains, i, x, x_ref)


def test_the_twin_rounds_half_a_count_as_the_board_does(core: Core) -> None:
    core.load(Gains(law=0, mantissas=(-256, 0, 0, 0), shifts=(9, 0, 0, 0), i_0=0, x_0=0, u_0=100))  # u = 100 + i/2

    assert [core.run(i, 0, 0)[0] for i in range(8)] == [rounded(100.0 + 0.5 * i, 1.0) for i in range(8)]


@pytest.mark.parametrize("law", Law)
@pytest.mark.parametrize("integral", [-1, 0, 1])
def test_at_its_limits_and_a_count_beside_them_the_integral_is_that_of_python(
    core: Core, law: Law, integral: int
) -> None:
    """Where u, the error or the integral's gain is at or beside the number that decides; chance rarely meets it."""
    of_integral = (1, 3)[law is Law.LQI]
    mantissas = tuple(256 if n == 0 else integral if n == of_integral else 0 for n in range(4))  # a count for a count
    for u_0, total, more, error in product((0, 4095), (-256, 0, 256), (-1, 0, 1), (-1, 0, 1)):
        python = ControlLaw(Gains(law=law, mantissas=mantissas, shifts=(8, 8, 8, 8), i_0=2000, x_0=2000, u_0=u_0))
        core.load(python.gains)
        python.sum = core.law.sum = total

        expected = python.run(2000 + more, 2000, 2000 + error)

        assert core.run(2000 + more, 2000, 2000 + error) == expected, (u_0, total, more, error)
        assert core.law.sum == python.sum, (u_0, total, more, error)


def test_within_two_counts_of_its_ends_the_integral_is_that_of_python(core: Core) -> None:
    python = ControlLaw(Gains(law=0, mantissas=(0, 0, 0, 0), shifts=(0, 0, 0, 0), i_0=0, x_0=0, u_0=0))
    core.load(python.gains)
    for end, offset, error in product((-(1 << 23), (1 << 23) - 1), range(-2, 3), range(-2, 3)):
        total = min(max(end + offset, -(1 << 23)), (1 << 23) - 1)
        python.sum = core.law.sum = total

        assert core.run(0, 2000, 2000 + error) == python.run(0, 2000, 2000 + error)
        assert core.law.sum == python.sum, (total, error)


def test_the_next_value_of_a_signal_is_computed_ahead(core: Core) -> None:
    """Else the tick would compute it, and u_c would be out later with a signal than without."""
    core.c.b51_excitation_start(CSignal(shape=Shape.STEP, amplitude=1, offset=10, period=1, duration=1))

    assert not core.c.b51_excitation_done()
    core.c.b51_loop_play_ahead()
    assert core.c.b51_excitation_done()
