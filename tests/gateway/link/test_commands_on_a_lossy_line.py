"""Commands over a line that loses a fifth of all frames each way: none acts twice, and no answer is untrue."""

from __future__ import annotations

import pytest

from tests.harness.gateway.board_host import FIRMWARES, skip_without_compiler
from tests.harness.gateway.lossy_line import Account, LossyRig, send_all

LOSS = 0.2
STALL = 1e-3  # per tick: every 2 s on average the line stands, for up to 1.5 s, and then gives all at once


@pytest.mark.parametrize(
    ("firmware", "count", "stall"),
    [
        pytest.param("python", 2_000, STALL, marks=pytest.mark.slow),
        ("c", 2_000, STALL),
        pytest.param("python", 100_000, 0.0, marks=pytest.mark.sample),  # 75 minutes of the board's time
        pytest.param("c", 20_000, STALL, marks=pytest.mark.slow),
        pytest.param("c", 100_000, STALL, marks=pytest.mark.sample),
    ],
)
def test_no_command_acts_twice_and_no_answer_is_untrue(firmware: str, count: int, stall: float) -> None:
    if firmware == "c":
        skip_without_compiler()
    rig = LossyRig(FIRMWARES[firmware], seed=1, loss=LOSS, stall=stall)

    account = send_all(rig, count, seed=2)

    assert account.outcomes.total() == count
    assert untrue(account) == [], account
    for wire in (rig.to_board, rig.from_board):
        assert wire.lost / wire.carried == pytest.approx(LOSS, abs=0.02)
    # Of five attempts all fail with a probability of (1 - 0.8^2)^5 = 0.6 %; a STOP gives up what is under way.
    assert account.outcomes["acknowledged"] > 0.8 * count
    assert account.outcomes["link: timed-out, unknown"] > 0


def untrue(account: Account) -> list[int]:
    return account.twice + account.false_acks + account.false_refusals + account.wrong_ticks + account.contradictions
