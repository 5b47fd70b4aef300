"""The fit of identification: the likelihood of the diagnosis, in blocks, with b below 0 where the data say so."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from tests.harness.twin.independent_plant import Ball, wandering
from twin.estimation.prepare import BLOCK_SAMPLES, prepare
from twin.estimation.record import Record
from twin.identification.fit import Blocks, bare
from twin.inference.likelihood import Criterion
from twin.inference.theta import BASE, Theta, moved

BALL = Ball()
TICKS, COPIES = 3000, 15
THETA = Theta(
    K_A=1.001 * BALL.K_A,
    T_A=BALL.T_A,
    K_c=BALL.K_c,
    b=BALL.b,
    sigma_i_c_a=BALL.sigma_i,
    sigma_x_m=BALL.sigma_x,
    process_i_c_a=1e-4,
    process_a_m_s2=0.05,
    min_b=-math.inf,
    closed_form=True,
)


def repeated(record: Record, copies: int) -> Record:
    """The same flight again and again, each after a gap."""
    t = np.concatenate([record.t + n * (record.t[-1] + 0.5) for n in range(copies)])
    u_c, i_c, x, x_ref = (np.tile(row, copies) for row in (record.u_c, record.i_c, record.x, record.x_ref))
    return replace(record, t=t, u_c=u_c, i_c=i_c, x=x, x_ref=x_ref)


@pytest.fixture(scope="module")
def whole() -> Iterator[Criterion]:
    record = repeated(BALL.closed_loop(wandering(1, TICKS), TICKS, seed=2), COPIES)
    series, _ = prepare([record], BALL.campaign.plant)
    assert len(series) > 2 * BLOCK_SAMPLES
    with closing(Criterion(bare(series), BALL.campaign.plant, BALL.tick)) as criterion:
        yield criterion


def test_blocks_change_neither_the_likelihood_nor_its_derivatives(whole: Criterion) -> None:
    blocks = Blocks(whole)

    value, score, fisher = whole.slopes(THETA, BASE, *whole.derivatives(THETA, BASE, whole.run(THETA)))
    slopes = blocks.exact(THETA, None, BASE)

    assert blocks.visit(THETA)[0] == pytest.approx(value, rel=1e-12)
    unit = np.sqrt(np.diag(fisher))
    np.testing.assert_allclose(slopes.fisher / np.outer(unit, unit), fisher / np.outer(unit, unit), atol=1e-9)
    np.testing.assert_allclose(slopes.score / unit, score / unit, rtol=0.0, atol=1e-6)
    np.testing.assert_array_equal(blocks.white(THETA), whole.white(THETA)[1])


def test_b_moves_below_zero_only_where_it_may() -> None:
    plant = BALL.campaign.plant
    bounded = replace(THETA, b=0.0, min_b=0.0)

    assert moved(bounded, "b", -1.0, plant) == bounded
    assert moved(replace(bounded, min_b=-math.inf), "b", -1.0, plant).b == pytest.approx(-plant.mass_kg)
