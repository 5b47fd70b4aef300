"""The daemon on a line that fails: boards that go and come back, noise, a stall, a port in use."""

from __future__ import annotations

from pathlib import Path

import pytest

from gateway.emulator.serve import Emulator
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.gateway_peers import (
    client,
    consistent,
    gapless,
    gateway_and_client,
    gateway_config,
    running,
    wait_for,
)


@pytest.mark.parametrize("tcp", [True, False])
def test_an_unplugged_board_comes_back_as_a_new_session(tcp: bool) -> None:
    with Emulator(tcp=tcp) as emulator, gateway_and_client(gateway_config(*emulator.urls)) as bus:
        before = bus.await_states(50)[-1].session
        emulator.disconnect()
        bus.await_event("port-lost")
        down = bus.command("x", ping=pb.Ping())
        emulator.reconnect()
        wait_for(lambda: bus.states()[-1].session != before, "new session")
        again = bus.command("x", ping=pb.Ping())

    assert (down.refused_by, down.reason) == ("link", "link-down")
    assert again.accepted
    assert consistent(bus.states())


def test_an_adapter_may_come_back_under_another_name(tmp_path: Path) -> None:
    with Emulator(tcp=False, pty=tmp_path / "usb") as emulator:
        with gateway_and_client(gateway_config(str(tmp_path / "usb*"))) as bus:
            before = bus.await_states(50)[-1].session
            emulator.disconnect()
            bus.await_event("port-lost")
            emulator.reconnect(renamed=True)

            wait_for(lambda: bus.states()[-1].session != before, "new session")
            status = wait_for(
                lambda: next((s for s in bus.messages["rig/status"] if s.reconnects == 1), None), "status"
            )

    assert status.port == str(tmp_path / "usb-renamed")


def test_a_reset_of_the_board_is_a_new_session_and_not_a_loss() -> None:
    with Emulator() as emulator, gateway_and_client(gateway_config(*emulator.urls)) as bus:
        before = bus.await_states(300)[-1]
        emulator.reset_board()
        new = wait_for(lambda: [s for s in bus.states() if s.session != before.session], "new session")
        bus.await_event("reset-power-on")
        bus.await_states(100)

    assert new[0].tick < before.tick
    assert consistent(bus.states())
    assert len({s.session for s in bus.states()}) == 2


def test_noise_costs_frames_and_every_one_is_counted() -> None:
    with Emulator(faults=("flip=2e-3", "lost=1e-3", "duplicate=1e-3", "insert=1e-3"), seed=3) as emulator:
        with gateway_and_client(gateway_config(*emulator.urls)) as bus:
            replies = [bus.command(f"p{n}", ping=pb.Ping()) for n in range(20)]
            states = bus.await_states(1000)
            status = wait_for(
                lambda: next((s for s in bus.messages["rig/status"] if sum(s.bad_frames.values()) > 10), None), "status"
            )

    assert consistent(states)
    assert sum(s.lost_before for s in states) > 0
    assert len({s.session for s in states}) == 1
    assert sum(r.accepted for r in replies) >= 19  # a try fails with 2-5 %, five tries all together once in 10^6
    assert status.samples_lost > 0


def test_a_stall_of_the_line_loses_nothing_it_kept() -> None:
    with Emulator(tcp=True) as emulator, gateway_and_client(gateway_config(*emulator.urls)) as bus:
        emulator.inject("stall=0.5")
        states = bus.await_states(700)

    assert consistent(states)
    assert len({s.session for s in states}) == 1


def test_two_gateways_on_one_tty_do_not_share_it() -> None:
    with Emulator(tcp=False) as emulator, gateway_and_client(gateway_config(*emulator.urls)) as bus:
        second = gateway_config(*emulator.urls)
        with running(second), client(second.zenoh.listen[0]) as other:
            status = wait_for(lambda: other.messages["rig/status"], "status")[0]
            reply = other.command("p", ping=pb.Ping())
        states = bus.await_states(100)

    assert status.link == "absent"
    assert "in use" in reply.text
    assert gapless(states)
