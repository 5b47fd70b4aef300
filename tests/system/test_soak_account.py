"""The account of a soak, by histories made by hand: what a fault explains, and what it does not."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import pytest

from gateway.emulator.firmware_model.flash import CURRENT, POSITION
from tests.harness.soak.account import (
    IGNORED_UNCOUNTED,
    IGNORED_UNSEEN,
    LOGGED,
    NOWHERE,
    PUBLISHED,
    account_of,
)
from tests.harness.soak.faults import Occurrence
from tests.harness.soak.logged import Logged
from tests.harness.soak.numbered_board import Fate, Ledger
from tests.harness.soak.stage import GATEWAYS

MS = 1_000_000


def test_what_no_fault_explains_and_what_comes_twice_is_seen() -> None:
    ledger, other = Ledger(), Ledger()
    for at_s in range(1, 7):
        ledger.sense()
        ledger.came(at_s, Fate.RECEIVED if at_s < 6 else Fate.SENT)
        ledger.at_ns[at_s] = at_s * 1_000_000_000
    logged = Logged(samples=[(CURRENT.to_si(n), POSITION.to_si(0)) for n in (1, 2, 3, 3, 9)])
    published = np.array([(0, 1, 0), (0, 4, 0)], np.int64)
    ledger.closed_ns.append(5_000_000_000)

    account = account_of([ledger, other], published, {0: logged}, [], GATEWAYS)

    assert [(location, number) for location, _, number, _ in account.unexplained] == [
        (LOGGED, 2), (LOGGED, 3), (PUBLISHED, 4),
    ]  # fmt: skip
    assert (account.twice, account.invented) == ([(0, 3)], [(0, 9)])
    assert account.lines[NOWHERE, "in the cable when it was unplugged"] == 1
    assert account.lines.total() == account.sensed == 6


def test_a_second_hole_beside_a_killed_router_is_seen() -> None:
    ledger = Ledger()
    for number in range(1, 9):
        ledger.sense()
        ledger.came(number, Fate.RECEIVED)
        ledger.at_ns[number] = number * 100_000_000
    logged = Logged(samples=[(CURRENT.to_si(n), POSITION.to_si(0)) for n in range(1, 9)])
    published = np.array([(0, n, 0) for n in (1, 2, 5, 6, 8)], np.int64)  # 3 was on its way, 4 did not fit the queue
    killed = Occurrence("router killed", 0, 340_000_000, 350_000_000, 500_000_000)

    account = account_of([ledger], published, {0: logged}, [killed], GATEWAYS)

    assert [(location, number) for location, _, number, _ in account.unexplained] == [(LOGGED, 7)]
    assert account.lines[LOGGED, "no router, or on its way to one that was killed"] == 2


@pytest.mark.parametrize(
    ("early", "logged", "lost", "unexplained"),
    [
        pytest.param({7, 8}, {1, 2, 3, 4, 5, 6}, set(), [], id="ignored and not counted"),
        pytest.param({7, 8}, {1, 2, 3, 4, 5, 6}, {9}, [9], id="after the handshake"),
        pytest.param({5, 6, 7, 8}, {1, 2, 3, 4}, set(), [5, 6], id="more than 250 ms before the kill"),
        pytest.param({7}, {1, 2, 3, 4, 5, 6, 8}, set(), [7], id="before a sample that has reached the log"),
        pytest.param({7, 8}, {1, 2, 3, 4, 5, 6}, {6}, [6], id="before the reset"),
    ],
)
def test_a_kill_explains_what_was_ignored_and_not_yet_logged_and_nothing_beside_it(
    early: Collection[int], logged: Collection[int], lost: Collection[int], unexplained: list[int]
) -> None:
    ledger = board_that_was_reset(early, 11, every_ns=50 * MS)
    published = np.array([(0, n, 0) for n in range(1, 11) if n not in {*early, *lost}], np.int64)
    samples = [(CURRENT.to_si(n), POSITION.to_si(0)) for n in logged if n not in lost]
    read = [n for n in logged if n not in lost]
    killed = Occurrence("gateway killed", 0, 555 * MS, 560 * MS, 900 * MS)  # 11 was in the cable

    account = account_of([ledger], published, {0: Logged(samples, read)}, [killed], GATEWAYS)

    assert [(location, number) for location, _, number, _ in account.unexplained] == [(NOWHERE, n) for n in unexplained]
    assert account.lines[NOWHERE, IGNORED_UNCOUNTED] == len({*early} - {*unexplained})
    assert account.too_early == []
    assert account.lines.total() == account.sensed == 11


def test_a_full_disk_explains_what_was_ignored_and_not_what_was_lost() -> None:
    ledger = board_that_was_reset({4, 5}, 8, every_ns=50 * MS)
    published = np.array([(0, n, 0) for n in (1, 2, 3, 6, 8)], np.int64)
    full = Occurrence("disk full", 0, 0, 0, 400 * MS)

    account = account_of([ledger], published, {0: Logged()}, [full], GATEWAYS)

    assert [(location, number) for location, _, number, _ in account.unexplained] == [(NOWHERE, 7)]
    assert account.lines[NOWHERE, IGNORED_UNSEEN] == account.read_but_no_sample[0] == 2


def test_a_sample_before_the_end_of_a_handshake_is_too_early() -> None:
    ledger = board_that_was_reset({2}, 3, every_ns=50 * MS)
    logged = Logged([(CURRENT.to_si(n), POSITION.to_si(0)) for n in (1, 2, 3)], [1, 2, 3])

    account = account_of([ledger], np.array([(0, n, 0) for n in (1, 2, 3)]), {0: logged}, [], GATEWAYS)

    assert account.too_early == [(0, 2)]


def test_a_handshake_ends_with_the_answer_to_its_own_hello() -> None:
    ledger = Ledger()
    steps = ((ledger.note_hello, 3), (ledger.answered, 2), (ledger.answered, 3), (ledger.note_hello, 3))
    for step, hello in steps:  # the last HELLO is a repetition whose answer has come
        step(hello)
        ledger.came(ledger.sense(), Fate.RECEIVED)

    assert list(ledger.early) == [False, True, True, False, False]


def board_that_was_reset(early: Collection[int], count: int, *, every_ns: int) -> Ledger:
    """The ledger of a board that was reset before the first of these samples and answered HELLO after the last."""
    ledger = Ledger()
    ledger.note_hello(1)
    ledger.answered(1)
    for n in range(1, count + 1):
        if n == min(early):
            ledger.reset()
            ledger.note_hello(2)
        ledger.came(ledger.sense(), Fate.RECEIVED)
        if n == max(early):
            ledger.answered(2)
    for n in range(count + 1):
        ledger.at_ns[n] = n * every_ns
    return ledger
