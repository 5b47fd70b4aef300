"""Logins under a flood; the clock is the test's."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from gateway.access.logins import PATIENCE_S, Logins, TooMany
from gateway.access.roles import Role
from gateway.access.tries import BURST, PACE_S
from gateway.access.users import User, Users, set_user

ANA = User(name="ana", role=Role.OPERATOR)
RIGHT = "correct horse"


class Clock:
    """Time that passes when somebody sleeps."""

    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s

    async def sleep(self, duration_s: float) -> None:
        until_s = self.now_s + duration_s
        await asyncio.sleep(0)
        self.now_s = max(self.now_s, until_s)


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def logins(tmp_path: Path, clock: Clock) -> Logins:
    file = tmp_path / "users.toml"
    set_user(file, ANA, RIGHT)
    return Logins(Users(file), clock=clock, sleep=clock.sleep)


def test_the_right_password_waits_its_turn_behind_a_flood_from_its_own_address(logins: Logins, clock: Clock) -> None:
    async def scene() -> tuple[list[User | TooMany | None], User | TooMany | None]:
        flood = [asyncio.create_task(logins.login("ana", "guess", "10.0.0.7")) for _ in range(BURST + 6)]
        await asyncio.sleep(0)
        right = await logins.login("ana", RIGHT, "10.0.0.7")
        return await asyncio.gather(*flood), right

    begun_s = clock.now_s
    wrong, right = asyncio.run(scene())

    assert right == ANA
    assert wrong == [None] * (BURST + 6)
    assert clock.now_s - begun_s == pytest.approx(7 * PACE_S)


def test_a_longer_flood_is_refused_at_once_with_the_time_and_others_are_not(logins: Logins) -> None:
    async def scene() -> tuple[list[User | TooMany | None], User | TooMany | None]:
        flood = [asyncio.create_task(logins.login("ana", "guess", "10.0.0.66")) for _ in range(100)]
        await asyncio.sleep(0)
        other = await logins.login("ana", RIGHT, "10.0.0.7")
        return await asyncio.gather(*flood), other

    wrong, other = asyncio.run(scene())

    refused = [answer for answer in wrong if isinstance(answer, TooMany)]
    assert other == ANA
    assert len(refused) == 100 - BURST - PATIENCE_S / PACE_S
    assert all(answer.wait_s > PATIENCE_S for answer in refused)


def test_a_caller_that_cannot_wait_is_refused_until_the_next_turn(logins: Logins, clock: Clock) -> None:
    for _ in range(BURST):
        assert logins.at_once("ana", "guess", "10.0.0.66") is None

    assert logins.at_once("ana", RIGHT, "10.0.0.66") == TooMany(PACE_S)
    assert logins.at_once("ana", RIGHT, "10.0.0.7") == ANA
    clock.now_s += PACE_S
    assert logins.at_once("ana", RIGHT, "10.0.0.66") == ANA
