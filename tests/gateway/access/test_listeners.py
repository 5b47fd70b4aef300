"""The rules for the listeners that may be opened."""

from __future__ import annotations

import pytest

from gateway.access.listeners import check_bus_listeners, check_listener, is_loopback, nearest, to_reach
from protocol.errors import ConfigError


@pytest.mark.parametrize(
    "host", ["127.0.0.1", "127.8.8.8", "::1", "[::1]", "localhost", "LocalHost", "::ffff:127.0.0.1"]
)
def test_only_this_machine_reaches_loopback(host: str) -> None:
    assert is_loopback(host)


@pytest.mark.parametrize(
    "host", ["0.0.0.0", "::", "10.0.0.5", "rig.local", "localhost.evil.org", "", "127.0.0.1.evil.org"]
)
def test_everything_else_may_be_reached_by_others(host: str) -> None:
    assert not is_loopback(host)


@pytest.mark.parametrize(
    ("endpoint", "guarded"),
    [
        ("tcp/127.0.0.1:7447", False),
        ("tcp/localhost:7447", False),
        ("tcp/[::1]:7447", False),
        ("unixsock-stream//tmp/bus", False),
        ("tcp/127.0.0.1:7447", True),
        ("tls/0.0.0.0:7447", True),
        ("tls/[::]:7447", True),
    ],
)
def test_what_is_safe_is_opened(endpoint: str, guarded: bool) -> None:
    check_bus_listeners([endpoint], guarded=guarded, insecure=False)


@pytest.mark.parametrize(
    ("endpoint", "guarded", "remedy"),
    [
        ("tcp/0.0.0.0:7447", False, "security init"),
        ("tcp/[::]:7447", False, "security init"),
        ("tls/0.0.0.0:7447", False, "security init"),
        ("udp/10.0.0.5:7447", False, "security init"),
        ("tcp/0.0.0.0:7447", True, "Write tls/0.0.0.0:7447"),
        ("ws/rig.local:7447", True, "Write tls/rig.local:7447"),
    ],
)
def test_what_is_open_to_the_network_is_refused_with_a_remedy(endpoint: str, guarded: bool, remedy: str) -> None:
    with pytest.raises(ConfigError, match=f"without protection.*{remedy.replace('.', '[.]')}.*--insecure"):
        check_bus_listeners(["tcp/127.0.0.1:1", endpoint], guarded=guarded, insecure=False)


def test_insecure_opens_it_and_says_so(caplog: pytest.LogCaptureFixture) -> None:
    check_bus_listeners(["tcp/0.0.0.0:7447"], guarded=False, insecure=True)

    assert "WITHOUT PROTECTION" in caplog.text


def test_a_protected_view_may_be_open() -> None:
    check_listener("0.0.0.0", protected=True, insecure=False, what="The web page", remedy="Give --security DIR")
    with pytest.raises(ConfigError, match=r"The web page would be open.*Give --security DIR, or listen on 127.0.0.1"):
        check_listener("0.0.0.0", protected=False, insecure=False, what="The web page", remedy="Give --security DIR")


def test_a_neighbour_takes_the_listener_that_others_cannot_disturb() -> None:
    assert nearest(["tls/0.0.0.0:7448", "tcp/127.0.0.1:7447"]) == "tcp/127.0.0.1:7447"
    assert nearest(["tls/0.0.0.0:7448"]) == "tls/127.0.0.1:7448"


def test_an_endpoint_for_everybody_is_reached_on_this_machine() -> None:
    assert to_reach("tls/0.0.0.0:7447") == "tls/127.0.0.1:7447"
    assert to_reach("tls/[::]:7447") == "tls/[::1]:7447"
    assert to_reach("tls/10.0.0.5:7447") == "tls/10.0.0.5:7447"
