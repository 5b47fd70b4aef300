"""The bus holds together whoever starts first, and daemons that share a router hear each other."""

from __future__ import annotations

import queue
import time
from pathlib import Path

import pytest
import zenoh

from protocol.bus.endpoint import check_endpoint, zenoh_config
from protocol.errors import ConfigError
from tests.harness.gateway.stopped_subscriber import STALL_S, longest_round_s
from tests.harness.ports import free_endpoint


def _open(text: str) -> zenoh.Session:
    return zenoh.open(zenoh.Config.from_json5(text))


def _reaches(publisher: zenoh.Session, subscriber: zenoh.Session, limit_s: float = 15.0, data: bytes = b"1") -> bool:
    """Return whether a put of `data` arrives at the other; repeated, because routes spread in their own time."""
    got: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    with subscriber.declare_subscriber("t/x", lambda sample: got.put(sample.payload.to_bytes())):
        end = time.monotonic() + limit_s
        while time.monotonic() < end:
            publisher.put("t/x", data)
            try:
                return got.get(timeout=0.05) == data
            except queue.Empty:
                continue
    return False


def test_daemons_that_started_before_their_router_hear_each_other_through_it() -> None:
    endpoint = free_endpoint()
    daemon = zenoh_config("client", connect=[endpoint], wait_for_router=False)
    with _open(daemon) as first, _open(daemon) as other:
        with _open(zenoh_config("router", listen=[endpoint])):
            assert _reaches(first, other)
            with _open(zenoh_config("client", connect=[endpoint])) as command:
                assert _reaches(first, command)
                assert _reaches(command, other)

        with _open(zenoh_config("router", listen=[endpoint])):  # gone and back
            assert _reaches(first, other)


def test_a_command_without_a_router_fails_instead_of_waiting_for_ever() -> None:
    with pytest.raises(zenoh.ZError):
        _open(zenoh_config("client", connect=[free_endpoint()]))


@pytest.mark.skipif(not Path("/proc/self/maps").is_file(), reason="the memory of a process is read in /proc")
def test_a_large_message_maps_no_shared_memory() -> None:
    endpoint = free_endpoint()
    with (
        _open(zenoh_config("router", listen=[endpoint])) as router,
        _open(zenoh_config("client", connect=[endpoint])) as client,
    ):
        assert _reaches(client, router, data=b"x" * 1_000_000)
        assert ".zenoh" not in Path("/proc/self/maps").read_text(encoding="ascii")


@pytest.mark.parametrize("separate", [False, True], ids=["the gateway is the router", "router apart"])
def test_a_subscriber_that_does_not_read_stalls_nobody_else(separate: bool) -> None:
    endpoint = free_endpoint()
    client = zenoh_config("client", connect=[endpoint])
    with _open(zenoh_config("router", listen=[endpoint])) as router, _open(client) as healthy:
        if not separate:
            assert longest_round_s(router, healthy, client) < STALL_S
            return
        with _open(zenoh_config("client", connect=[endpoint], wait_for_router=False)) as gateway:
            assert _reaches(gateway, healthy)
            assert longest_round_s(gateway, healthy, client) < STALL_S


def test_the_shipped_router_file_hands_on_as_ours_does() -> None:
    shipped = zenoh.Config.from_file(str(Path(__file__).parents[2] / "gateway" / "router.json5"))
    generated = zenoh.Config.from_json5(zenoh_config("router", listen=["tcp/127.0.0.1:7447"]))

    for part in ("transport", "qos"):
        assert shipped.get_json(part) == generated.get_json(part)


@pytest.mark.parametrize("endpoint", ["", "7447", "tcp/", "tcp/a b:1", "http://x:1"])
def test_what_is_no_endpoint_is_named(endpoint: str) -> None:
    with pytest.raises(ConfigError, match="--connect"):
        check_endpoint(endpoint, where="--connect")
