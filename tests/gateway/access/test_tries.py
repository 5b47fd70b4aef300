"""The rules of how often passwords may be tried, and from where."""

from __future__ import annotations

import pytest

from gateway.access.tries import BURST, MAX_TRACKED, PACE_S, RIGHT_COST, TOGETHER_BURST, TOGETHER_PACE_S, Tries, network

PATIENCE_S = 10.0


def wait_s(tries: Tries, name: str = "ana", host: str = "10.0.0.7", now_s: float = 0.0, browser: str = "") -> float:
    turn = tries.turn(name, host, now_s, patience_s=PATIENCE_S, browser=browser)
    return turn.wait_s if turn.granted else float("inf")


def known(tries: Tries, name: str, host: str) -> None:
    tries.right(tries.turn(name, host, 0.0, patience_s=0.0), name, host)


def test_after_a_burst_tries_of_one_source_follow_in_the_order_they_came() -> None:
    tries = Tries()

    waits = [wait_s(tries, f"name{n}") for n in range(BURST + 3)]

    assert waits == [0.0] * BURST + [PACE_S, 2 * PACE_S, 3 * PACE_S]


def test_who_would_wait_too_long_is_refused_and_the_queue_is_not_longer_for_it() -> None:
    tries = Tries()
    granted = BURST + int(PATIENCE_S / PACE_S)

    waits = [wait_s(tries) for _ in range(granted + 100)]

    assert waits[:granted][-1] == PATIENCE_S
    assert set(waits[granted:]) == {float("inf")}
    assert wait_s(tries, now_s=PACE_S) == PATIENCE_S, "one has gone, one may come"


def test_the_lane_is_free_again_when_nobody_has_tried_for_a_while() -> None:
    tries = Tries()
    for _ in range(BURST):
        wait_s(tries)

    assert wait_s(tries, now_s=BURST * PACE_S) == 0.0


def test_a_flood_does_not_hold_up_another_source_under_the_same_name() -> None:
    tries = Tries()
    for _ in range(1000):
        wait_s(tries, "ana", "10.0.0.66")

    assert wait_s(tries, "ana", "10.0.0.7") <= TOGETHER_PACE_S


def test_a_flood_from_the_own_address_does_not_hold_up_who_came_in_from_there_before() -> None:
    tries = Tries()
    known(tries, "ana", "10.0.0.7")
    for n in range(1000):
        wait_s(tries, f"eve{n}")

    assert wait_s(tries, "ana") == 0.0


def test_a_flood_under_the_own_name_and_address_does_not_hold_up_the_browser_of_the_last_session() -> None:
    tries = Tries()
    known(tries, "ana", "10.0.0.7")
    for _ in range(1000):
        wait_s(tries, "ana")

    assert wait_s(tries, "ana", browser="token") == 0.0


def test_a_flood_from_many_addresses_is_held_up_as_a_whole_but_not_who_came_in_before() -> None:
    tries = Tries()
    known(tries, "ana", "10.0.0.7")
    strangers = [wait_s(tries, "ana", f"10.1.0.{n}") for n in range(1, TOGETHER_BURST + 3)]

    assert strangers[: TOGETHER_BURST - 1] == [0.0] * (TOGETHER_BURST - 1)
    assert strangers[-1] >= TOGETHER_PACE_S
    assert wait_s(tries, "ana") == 0.0


def test_right_passwords_cost_a_part_of_a_wrong_one() -> None:
    tries, granted = Tries(), 0
    while (turn := tries.turn("scada", "10.0.0.9", 0.0, patience_s=0.0)).granted:
        tries.right(turn, "scada", "10.0.0.9")
        granted += 1

    assert granted >= (BURST - 1) / RIGHT_COST


def test_invented_names_and_addresses_do_not_fill_the_memory() -> None:
    tries = Tries()

    for n in range(MAX_TRACKED + 50):
        wait_s(tries, f"eve{n}", f"10.{n // 250}.{n % 250}.1", now_s=float(n))

    assert len(tries._lanes) == MAX_TRACKED


@pytest.mark.parametrize(
    ("host", "source"),
    [
        ("10.0.0.7", "10.0.0.7"),
        ("::ffff:10.0.0.7", "10.0.0.7"),
        ("2001:db8::1:2:3", "2001:db8::/64"),
        ("2001:db8::ffff:2:3", "2001:db8::/64"),
        ("fe80::1%eth0", "fe80::/64"),
        ("testclient", "testclient"),
        ("", ""),
    ],
)
def test_a_source_is_what_one_machine_has_of_addresses(host: str, source: str) -> None:
    assert network(host) == source
