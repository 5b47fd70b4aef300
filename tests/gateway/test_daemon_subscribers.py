"""The daemon beside a subscriber that hangs and a router that goes and comes back."""

from __future__ import annotations

import logging
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
import zenoh

from gateway.config import GatewayConfig, ZenohConfig
from gateway.emulator.serve import Emulator
from protocol.bus import board51_pb2 as pb
from protocol.bus.endpoint import zenoh_config
from protocol.log.reader import read
from tests.harness.gateway.gateway_peers import (
    Bus,
    ScriptedBoard,
    client,
    gapless,
    gateway_and_client,
    gateway_config,
    running,
    wait_for,
)
from tests.harness.ports import free_port
from tests.patience import HANG_S

STALLED = """
import sys, time, zenoh
with zenoh.open(zenoh.Config.from_json5(sys.argv[1])) as session:
    session.declare_subscriber("board51/**", lambda sample: None)
    print("ready", flush=True)
    time.sleep(60)
"""


def test_a_stopped_subscriber_costs_neither_others_nor_the_log_a_sample(tmp_path: Path) -> None:
    with Emulator(boards=2) as emulator:
        config = gateway_config(*emulator.urls, log=tmp_path)
        with gateway_and_client(config) as bus:
            text = zenoh_config("client", connect=config.zenoh.listen)
            stopped = subprocess.Popen([sys.executable, "-c", STALLED, text], stdout=subprocess.PIPE)
            assert stopped.stdout is not None
            stopped.stdout.readline()
            stopped.send_signal(signal.SIGSTOP)
            try:
                states = bus.await_states(1500, "rig0")
            finally:
                stopped.kill()
                stopped.wait()
                stopped.stdout.close()
            bus.await_states(200, "rig0")

    assert gapless(states)
    for name in ("rig0", "rig1"):
        logged = [r.message for r in read(next(tmp_path.glob("*.mcap")), topics=["state"], boards=[name])]
        assert len(logged) > 1500
        assert gapless([m for m in logged if isinstance(m, pb.State)])


@contextmanager
def router_process(endpoint: str) -> Iterator[subprocess.Popen[str]]:
    words = [sys.executable, "-m", "board51", "router", "--listen", endpoint]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert process.stdout is not None
    try:
        process.stdout.readline()
        yield process
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def test_a_router_may_go_and_come_back() -> None:
    port = free_port()
    endpoint = f"tcp/127.0.0.1:{port}"
    router = zenoh_config("router", listen=[endpoint])
    with Emulator() as emulator:
        config = gateway_config(*emulator.urls)
        config = GatewayConfig(
            boards=config.boards, zenoh=ZenohConfig(mode="client", connect=(endpoint,)), log=config.log
        )
        with running(config):
            with zenoh.open(zenoh.Config.from_json5(router)), client(endpoint) as bus:
                before = bus.await_states(50)[-1]
            with zenoh.open(zenoh.Config.from_json5(router)), client(endpoint) as bus:
                after = bus.await_states(50)[-1]
                assert bus.command("p", ping=pb.Ping()).accepted

    assert after.session == before.session
    assert after.tick > before.tick


@pytest.mark.slow
@pytest.mark.parametrize("queue", [8192, 64], ids=["all wait", "most are dropped"])
def test_what_subscribers_miss_while_the_router_is_away_is_counted(
    queue: int, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "gateway")
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with ExitStack() as stack:
        routers = [stack.enter_context(router_process(endpoint))]
        board = stack.enter_context(ScriptedBoard())
        config = gateway_config(board.url, stale_s=HANG_S)
        config = replace(config, zenoh=ZenohConfig(mode="client", connect=(endpoint,), queue=queue))
        stack.enter_context(running(config))
        bus = stack.enter_context(client(endpoint))
        bus.await_states(50)
        # What zenoh and the system hold when a router is killed is not known to have arrived: here they hold nothing.
        board.streaming = False
        wait_for(lambda: bus.states()[-1].sequence == board.tick & 0xFFFF, "the last sample")
        before = wait_for(lambda: bus.messages["rig/status"], "status")[-1]

        routers[0].kill()
        routers[0].wait()
        wait_for(lambda: [r for r in caplog.records if "No router" in r.message], "the gateway's notice")
        last_tick = bus.states()[-1].tick
        board.streaming = True
        start_tick = board.tick
        wait_for(lambda: board.tick > start_tick + 500, "samples during the outage")
        # The new router subscribes itself: a client of it may come back after the gateway, which it cannot know.
        router = zenoh.Config.from_json5(zenoh_config("router", listen=[endpoint]))
        new_bus = Bus(stack.enter_context(zenoh.open(router)))
        back = new_bus.await_event("bus-back")
        new_bus.await_states(50)
        after = wait_for(
            lambda: [s for s in new_bus.messages["rig/status"] if s.host_time_ns > back.host_time_ns], "status"
        )[-1]

    ticks = [s.tick for s in new_bus.states()]
    lost_on_the_line = sum(last_tick < tick <= ticks[-1] for tick in board.dropped_ticks)
    missing = ticks[-1] - last_tick - len(ticks) - lost_on_the_line
    counted = after.publish_dropped - before.publish_dropped
    assert ticks == sorted(ticks)
    assert (counted > 400) == (queue == 64)
    assert str(counted) in back.text or not counted
    assert missing == counted
