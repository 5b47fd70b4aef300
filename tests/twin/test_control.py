"""The law against numbers computed by hand from rule 9, and the linear models against the nonlinear one."""

from __future__ import annotations

import math

import numpy as np
import pytest

from protocol.bus import board51_pb2 as pb
from tests.harness.twin.one_tick import tick
from twin.control import LawNumbers, integral_behind, law, law_numbers, linearise
from twin.model.equilibrium import equilibrium
from twin.model.linear import c2d
from twin.model.parameters import Model
from twin.model.simulate import plant_numbers

T_S = 2e-3


def board(**changes: object) -> pb.Parameters:
    p = pb.Parameters(
        session=1,
        sample_time_s=T_S,
        law=pb.LAW_LQI,
        gains=(0.5, 1000.0, 10.0, -20000.0),
        i_0_a=0.6,
        x_0_m=3e-3,
        u_0_v=2.0,
        u_min_v=0.0,
        u_max_v=5.0,
        x_lsb_m=1e-6,
    )
    for name, value in changes.items():
        if name == "gains":
            del p.gains[:]
            p.gains.extend(value)  # type: ignore[arg-type]  # a list here, by its name
        else:
            setattr(p, name, value)
    return p


def numbers(**changes: object) -> LawNumbers:
    result = law_numbers(board(**changes))
    assert result is not None
    return result


def test_lqi_by_hand() -> None:
    """U = 2 - (0.5*0.1 + 1000*1e-4 + 10*2e-5/2e-3 - 20000*1e-5) = 2 - (0.05 + 0.1 + 0.1 - 0.2) = 1.95 V."""
    u, s = law(numbers(), 0.7, 3.1e-3, 3.08e-3, 1e-5, 3.3e-3)

    assert u == pytest.approx(1.95, abs=1e-12)
    assert s == pytest.approx(1e-5 + 2e-4 * T_S, rel=1e-12)  # advanced after u was computed


def test_pid_by_hand() -> None:
    """U = 2 + 1000*2e-4 + 20000*1e-5 - 10*2e-5/2e-3 = 2 + 0.2 + 0.2 - 0.1 = 2.3 V."""
    u, _ = law(numbers(law=pb.LAW_PID, gains=(1000.0, 20000.0, 10.0, 7.0)), 0.7, 3.1e-3, 3.08e-3, 1e-5, 3.3e-3)

    assert u == pytest.approx(2.3, abs=1e-12)


@pytest.mark.parametrize(
    ("x", "x_ref", "limit", "advances"),
    [
        (0.0, 4e-3, 5.0, False),  # far below: u at its top, the error pushes it higher
        (0.0, -1e-3, 5.0, True),  # at its top, the error pulls it back
        (5.7e-3, 1e-3, 0.0, False),
        (5.7e-3, 5.8e-3, 0.0, True),
    ],
)
def test_anti_windup_stops_the_sum_only_where_the_error_drives_u_further(
    x: float, x_ref: float, limit: float, advances: bool
) -> None:
    u, s = law(numbers(), 0.6, x, x, 0.0, x_ref)

    # without a limit: u = 2 - 1000 (x - 3e-3) = 5.0 or -0.7; make sure the upper one is really above
    assert u == pytest.approx(limit, abs=1e-9) or x == 0.0
    u, s = law(numbers(u_max_v=4.9), 0.6, x, x, 0.0, x_ref)
    assert u == (4.9 if limit else 0.0)
    assert (s != 0.0) is advances


def test_the_sum_saturates_as_a_24_bit_integer_does() -> None:
    c = numbers(gains=(0.0, 0.0, 0.0, -1e-6))
    s_max = 8388607 * 1e-6 * T_S

    _, s = law(c, 0.6, 1e-3, 1e-3, s_max, 4e-3)

    assert c.s_max == pytest.approx(s_max, rel=1e-12)
    assert s == c.s_max


def test_the_integral_is_found_from_the_input_that_it_gave() -> None:
    c = numbers()
    u, _ = law(c, 0.62, 3.1e-3, 3.09e-3, 2.5e-5, 3.2e-3)

    integral = integral_behind(c, i=0.62, x=3.1e-3, x_prev=3.09e-3, x_ref=3.2e-3, u=u)

    assert integral == pytest.approx(2.5e-5, rel=1e-9)


def test_a_limited_input_tells_nothing_about_the_integral() -> None:
    assert integral_behind(numbers(), i=0.6, x=0.0, x_prev=0.0, x_ref=3e-3, u=5.0) is None


@pytest.mark.parametrize(
    "changes", [{"gains": ()}, {"gains": (1.0, math.nan, 0.0, 0.0)}, {"sample_time_s": 0.0}, {"u_max_v": 0.0}]
)
def test_parameters_without_a_law_give_none(changes: dict[str, object]) -> None:
    assert law_numbers(board(**changes)) is None


@pytest.mark.parametrize("x", [1e-3, 2.85e-3, 4.5e-3])
def test_linearisation_and_discretisation_agree_with_the_nonlinear_tick(x: float) -> None:
    model = Model.load("ce152")
    i, u = equilibrium(model, x)
    p = plant_numbers(model, T_S)
    Phi, Gamma = c2d(*linearise(model, x), T_S)  # noqa: N806 - the textbook's letters
    at_rest = np.array(tick(p, i, x, 0.0, u))
    steps = (1e-5, 1e-9, 1e-7, 1e-5)  # A, m, m/s, V

    assert np.allclose(at_rest, [i, x, 0.0], atol=1e-12)
    for column, d in enumerate(steps):
        z = [i, x, 0.0, u]
        z[column] += d
        moved = (np.array(tick(p, *z)) - at_rest) / d

        expected = Phi[:, column] if column < 3 else Gamma[:, 0]
        # What the second derivative leaves of a one-sided difference: d / gap, d / i.  What a jump of current or input
        # does to the ball within the tick is integrated to 0.3 %.
        assert np.allclose(moved, expected, rtol=4e-3 if column in (0, 3) else 1e-4, atol=1e-7)


def test_the_unstable_pole_is_where_the_gap_puts_it() -> None:
    """At rest x'' = 2 g / gap * dx: poles near +-sqrt(2 g / gap), drag aside."""
    A, _ = linearise(Model.load("ce152"), 2.85e-3)

    assert max(np.linalg.eigvals(A).real) == pytest.approx(math.sqrt(2 * 9.81 / 2.85e-3), rel=0.02)
