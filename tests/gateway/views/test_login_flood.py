"""Six threads that try passwords as fast as they can, against the running web server; and who must get in meanwhile."""

from __future__ import annotations

import contextlib
import threading
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from tests.harness.gateway.bus_peers import played_gateway
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.gateway.hmi_peers import Page, hmi, users_file

pytestmark = pytest.mark.xdist_group("hmi-access")
THREADS = 6


@pytest.fixture
def port(tmp_path: Path) -> Iterator[int]:
    """A fresh server: nobody has come in yet."""
    with (
        played_gateway() as gateway,
        hmi(tmp_path, gateway.endpoint, "--users", str(users_file(tmp_path))) as (port, _),
    ):
        yield port


def visitor(port: int, address: str) -> Page:
    """Return a visitor that comes from `address`: all of 127.0.0.0/8 is this machine."""
    page = Page(port)
    no_leftovers = httpx.Limits(max_keepalive_connections=0)
    transport = httpx.HTTPTransport(local_address=address, verify=False, limits=no_leftovers)
    page.http = httpx.Client(base_url=page.base, timeout=60.0, transport=transport)
    return page


@contextlib.contextmanager
def flood(port: int, address: str, name: str, *, threads: int = THREADS) -> Iterator[Counter[int]]:
    """Wrong passwords without a pause; the answers by status."""
    answers: Counter[int] = Counter()
    over = threading.Event()

    def try_on() -> None:
        page = visitor(port, address)
        while not over.is_set():
            answers[page.log_in(name, "guess").status_code] += 1
        page.http.close()

    workers = [threading.Thread(target=try_on) for _ in range(threads)]
    for worker in workers:
        worker.start()
    try:
        wait_for(lambda: sum(answers.values()) >= threads, "the flood")
        yield answers
    finally:
        over.set()
        for worker in workers:
            worker.join()


@pytest.mark.slow
def test_a_flood_does_not_keep_the_right_password_out_wherever_it_comes_from(port: int) -> None:
    with flood(port, "127.0.0.66", "ben") as answers:
        from_elsewhere = visitor(port, "127.0.0.7").log_in("ben")
        from_the_same_address = visitor(port, "127.0.0.66").log_in("ben")

    assert from_elsewhere.status_code == 303
    assert from_the_same_address.status_code == 303
    assert set(answers) <= {401, 429}


@pytest.mark.slow
def test_a_larger_flood_does_not_keep_out_the_browser_that_was_in(port: int) -> None:
    browser = visitor(port, "127.0.0.66")
    assert browser.log_in("ben").status_code == 303

    with flood(port, "127.0.0.66", "ben", threads=24) as answers:
        wait_for(lambda: answers[429] > 50, "a flood that is refused")
        again = browser.log_in("ben")
        stop = browser.post("/api/rig/stop")

    assert again.status_code == 303
    assert stop.json()["reason"] != "session-over"
