"""The end of a process: at once while it has begun nothing, and of a session whose peer does not read."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
import zenoh

from protocol.bus.closing import CLOSE_S, close
from protocol.bus.endpoint import has_subscriber, zenoh_config
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.gateway.hmi_peers import Process
from tests.harness.ports import free_port
from tests.patience import HANG_S

COMPILING = """
from protocol.ending import end_at_once
end_at_once()
print("ready", flush=True)
sum(range(10**13))  # C that looks at no signal, as a compiler
"""


WAITING = """
import os, signal, threading
from protocol.ending import on_end_signal
ordered = threading.Event()
on_end_signal(ordered.set)

def order() -> None:
    for _ in range(40):
        os.kill(os.getpid(), signal.SIGTERM)
        while not ordered.is_set():
            pass
        ordered.clear()
    os._exit(0)

threading.Thread(target=order, daemon=True).start()
while True:
    ordered.wait(0.0)  # nearly always about to wait, with the lock of the event
"""


@pytest.mark.posix
def test_a_signal_may_come_while_its_event_is_about_to_be_waited_for() -> None:
    with subprocess.Popen([sys.executable, "-c", WAITING]) as process:
        try:
            assert process.wait(HANG_S) == 0
        finally:
            process.kill()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_what_has_begun_nothing_ends_at_once(number: signal.Signals) -> None:
    with subprocess.Popen([sys.executable, "-c", COMPILING], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"

        process.send_signal(number)

        assert process.wait(HANG_S) == -number


def test_a_session_whose_router_does_not_read_is_closed_in_its_time(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    config = zenoh.Config.from_json5(zenoh_config("client", connect=[endpoint]))
    with Process(tmp_path, "router", "--listen", endpoint) as router:
        router.wait_for_words("listens on")
        session, subscribed = zenoh.open(config), zenoh.open(config)
        subscribed.declare_subscriber("a", lambda _: None)
        publisher = session.declare_publisher("a", congestion_control=zenoh.CongestionControl.BLOCK)
        wait_for(lambda: has_subscriber(publisher), "the subscriber")
        put: list[int] = []

        def publish() -> None:
            while not session.is_closed():
                publisher.put(bytes(60_000))
                put.append(1)

        router.signal(signal.SIGSTOP)
        try:
            threading.Thread(target=publish, daemon=True).start()
            counts: list[int] = []
            wait_for(lambda: counts.append(len(put)) or counts[-20:] == 20 * counts[-1:], "a full queue")  # type: ignore[func-returns-value]
            began_s = time.monotonic()
            close(session)
            took_s = time.monotonic() - began_s
        finally:
            router.signal(signal.SIGCONT)
        subscribed.close()

    assert took_s < CLOSE_S + 4.0  # zenoh's own limit is 10 s
