"""Two twins for one board: the second one ends and says who serves it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
import zenoh

from tests.harness.ports import free_endpoint
from tests.harness.repeated import repeated
from tests.harness.twin.rig import Rig
from tests.harness.twin.twin_bus import Subscriber, introduce, publish, router, wait
from tests.patience import HANG_S
from twin.mirror.bus.service import TwinService
from twin.model.parameters import Model

HELD = 2.85e-3


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


def twin_of(endpoint: str, board: str | None = None, site: str = "lab") -> TwinService:
    return TwinService(Model.load("ce152"), site=site, board=board, endpoints=(endpoint,))


def ended(session: zenoh.Session, service: TwinService) -> str:
    """Return the failure of the service, once the next message of the board has reached it."""
    parameters = Rig(seed=2).parameters().SerializeToString()

    def failed() -> bool:
        session.put("lab/rig/parameters", parameters)
        return service.failure is not None

    wait(failed, "the refusal")
    wait(lambda: not service.running, "the end of the worker")
    return str(service.failure)


@pytest.mark.parametrize(("first", "second"), [(None, None), ("rig", "rig"), (None, "rig"), ("rig", None)])
def test_the_second_twin_of_a_board_ends_and_says_who_serves_it(
    endpoint: str, first: str | None, second: str | None
) -> None:
    rig = Rig(seed=2)
    rig.hold(HELD)
    with router(endpoint) as session:
        subscriber = Subscriber(session, "lab")
        with twin_of(endpoint, first) as first_twin:
            introduce(session, first_twin, rig)
            publish(session, list(rig.run(50, HELD)))
            wait(lambda: len(subscriber.payloads["lab/rig/twin/divergence"]) == 50, "divergence")
            with twin_of(endpoint, second) as second_twin:
                message = ended(session, second_twin)
            publish(session, list(rig.run(50, HELD)))
            wait(lambda: len(subscriber.payloads["lab/rig/twin/divergence"]) == 100, "divergence of one twin")

            assert f"process {os.getpid()} on " in message
            assert ("every board" if first is None else "board rig") in message
            assert first_twin.failure is None
            assert second_twin.boards == {}


def test_a_token_with_a_name_that_no_twin_has_is_named(endpoint: str) -> None:
    with router(endpoint) as session, session.liveliness().declare_token("lab/rig/twin/alive/0"):
        with twin_of(endpoint) as service:
            message = ended(session, service)

    assert "board rig of site lab: one that calls itself '0'" in message


def test_twins_of_other_boards_and_sites_do_not_meet(endpoint: str) -> None:
    first, second, third = twin_of(endpoint, "rig"), twin_of(endpoint, "other"), twin_of(endpoint, site="elsewhere")
    with router(endpoint) as session, first, second, third:
        introduce(session, first, Rig(seed=2))
        introduce(session, second, Rig(seed=3), board="other")

        assert [service.failure for service in (first, second, third)] == [None] * 3


def test_of_two_that_wait_for_the_router_one_serves(endpoint: str) -> None:
    with twin_of(endpoint) as first, twin_of(endpoint) as second, router(endpoint) as session:
        parameters = Rig(seed=2).parameters().SerializeToString()

        def decided() -> bool:
            session.put("lab/rig/parameters", parameters)
            served = [service for service in (first, second) if service.failure is None and service.boards]
            return len(served) == 1 and any(service.failure for service in (first, second))

        wait(decided, "one twin")


def test_a_twin_that_was_stopped_frees_its_board(endpoint: str) -> None:
    with router(endpoint) as session:
        for seed in (2, 3):
            with twin_of(endpoint) as service:
                introduce(session, service, Rig(seed=seed))
                assert service.failure is None


@pytest.mark.slow
def test_the_command_ends_with_one_line_and_starts_again_after_the_other_was_killed(endpoint: str) -> None:
    words = [sys.executable, "-m", "board51", "twin", "--site", "lab", "--connect", endpoint]
    with router(endpoint) as session, speaking(session) as twins, running(words) as first:
        wait(twins, "the first twin")

        second = subprocess.run([*words, "--duration", str(HANG_S)], capture_output=True, text=True, check=False)

        assert second.returncode == 1
        refusal = f"A twin already serves every board of site lab: process {first.pid} on "
        # Lines of a panic may follow, while zenoh closes (protocol/ending.py).
        assert sum(refusal in line for line in second.stderr.splitlines()) == 1

        first.kill()
        first.wait()
        with running(words):
            wait(twins, "the twin that took over")


@contextmanager
def running(words: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait()


@contextmanager
def speaking(session: zenoh.Session) -> Iterator[Callable[[], bool]]:
    """A board that repeats itself; yields whether a twin has answered since the last call."""
    rig, subscriber = Rig(seed=2), Subscriber(session, "lab")
    rig.hold(HELD)

    def speak() -> None:
        session.put("lab/rig/parameters", rig.parameters().SerializeToString())
        publish(session, list(rig.run(1, HELD)))

    def answered() -> bool:
        return bool(subscriber.payloads.pop("lab/rig/twin/divergence", []))

    with repeated(speak, 0.02):
        yield answered
