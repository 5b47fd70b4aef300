"""The metrics: names as Prometheus wants them, values that are known; and the files for Prometheus and Grafana."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.metrics_core import Metric
from prometheus_client.parser import text_string_to_metric_families

from gateway.views.feed import Feed
from gateway.views.hmi.metrics import Rigs
from protocol.bus import board51_pb2 as pb
from protocol.wire.decoder import CAUSES
from tests.harness.gateway.bus_peers import PlayedGateway, feed_of, played_gateway
from tests.harness.gateway.gateway_peers import wait_for

MONITORING = Path(__file__).parents[3] / "docs" / "monitoring"
UNITS = ("_meters", "_amperes", "_volts", "_seconds", "_bytes", "_ratio", "_total", "_info")
COUNTS_AND_STATES = {"board51_link_live", "board51_twin_in_step", "board51_log_writing", "board51_mode",
                     "board51_alarms", "board51_alarm_active"}  # fmt: skip


@pytest.fixture(scope="module")
def bus() -> Iterator[tuple[PlayedGateway, Feed]]:
    with played_gateway() as gateway, feed_of(gateway) as feed:
        yield gateway, feed


def scraped(feed: Feed) -> dict[str, Metric]:
    registry = CollectorRegistry()
    registry.register(Rigs(feed, "1.2.3"))
    return {family.name: family for family in text_string_to_metric_families(generate_latest(registry).decode("utf-8"))}


def names(families: dict[str, Metric]) -> set[str]:
    """The names that a query may use."""
    suffix = {"counter": "_total", "info": "_info"}
    return {name if name.endswith("_info") else name + suffix.get(f.type, "") for name, f in families.items()}


def value(families: dict[str, Metric], name: str, **labels: str) -> float | None:
    samples = [s for f in families.values() for s in f.samples if s.name == name and labels.items() <= s.labels.items()]
    return samples[0].value if samples else None


def test_a_name_ends_with_its_unit(bus: tuple[PlayedGateway, Feed]) -> None:
    families = scraped(bus[1])

    assert len(families) > 25
    for name in names(families):
        assert name in COUNTS_AND_STATES or name.endswith(UNITS), name
        assert re.fullmatch(r"board51_[a-z0-9_]+", name)
    assert all(family.documentation.endswith(".") for family in families.values())


def test_what_the_bus_says_is_what_is_scraped(bus: tuple[PlayedGateway, Feed]) -> None:
    gateway, feed = bus
    status = pb.Status(
        link="streaming", host_time_ns=time.time_ns(), log_state="writing", samples=500, samples_lost=3,
        commands_accepted=4, commands_refused=2, commands_timed_out=1, reconnects=7, latency_p99_ms=0.5,
        line_load=0.25, bad_frames={"crc": 9, "nonsense": 1},
    )  # fmt: skip
    error = pb.SignalDivergence(error=2e-6, normalised=0.5)
    divergence = pb.Divergence(sync="in-step", x_m=error, nis_mean=2.1, innovation_valid=True)
    alarm = pb.Alarm(name='say "x"\n', active=True, text="?", host_time_ns=time.time_ns())

    def collect_metrics() -> dict[str, Metric] | None:
        """The metrics once all of it has arrived, and before it is old."""
        gateway.state(i_c_a=0.7, x_m=3.1e-3)
        for topic, message in (("status", status), ("twin/divergence", divergence), ("twin/alarm", alarm)):
            gateway.send(topic, message)
        families = scraped(feed)
        required = ("alarm_active", "position_meters", "divergence_position_meters", "samples_received_total")
        return families if all(value(families, f"board51_{name}", rig="rig") for name in required) else None

    families = wait_for(collect_metrics, "all of it")

    def of(name: str, **labels: str) -> float | None:
        return value(families, f"board51_{name}", rig="rig", **labels)

    assert (of("current_amperes"), of("position_meters"), of("link_live")) == (0.7, 3.1e-3, 1.0)
    assert (of("samples_received_total"), of("samples_lost_total")) == (500, 3)
    assert [of(f"commands_{what}_total") for what in ("executed", "refused", "unanswered")] == [4, 2, 1]
    assert (of("reconnections_total"), of("line_load_ratio"), of("publish_latency_p99_seconds")) == (7, 0.25, 5e-4)
    assert (of("divergence_position_meters"), of("innovation_ratio"), of("twin_in_step")) == (2e-6, 2.1, 1.0)
    assert (of("mode", mode="closed-loop"), of("mode", mode="idle")) == (1.0, 0.0)
    assert of("alarm_active", alarm='say "x"\n', severity="warning") == 1.0
    assert of("link_errors_total", cause="crc") == 9
    assert {sample.labels["cause"] for sample in families["board51_link_errors"].samples} == set(CAUSES)
    assert value(families, "board51_build_info", version="1.2.3") == 1.0


def test_what_is_not_known_is_left_out(bus: tuple[PlayedGateway, Feed]) -> None:
    gateway, feed = bus
    gateway.send("state", pb.State(tick=1, session=1), "bare")
    wait_for(lambda: feed.board("bare"), "the board")

    families = scraped(feed)

    for name in ("position_meters", "current_amperes", "samples_received_total", "twin_in_step", "innovation_ratio"):
        assert value(families, f"board51_{name}", rig="bare") is None
    assert value(families, "board51_link_live", rig="bare") is not None


def test_the_dashboard_and_the_alerts_ask_for_metrics_that_exist(bus: tuple[PlayedGateway, Feed]) -> None:
    exist = names(scraped(bus[1]))
    dashboard = json.loads((MONITORING / "grafana" / "board51.json").read_text(encoding="utf-8"))
    queries = [target["expr"] for panel in dashboard["panels"] for target in panel["targets"]]
    variables = [variable["query"] for variable in dashboard["templating"]["list"]]
    alerts = (MONITORING / "alerts.yml").read_text(encoding="utf-8")

    queried = set(re.findall(r"\bboard51_\w+", " ".join([*queries, *variables, alerts])))

    assert queried - exist == set()
    assert len(queried) > 20
    assert len({panel["id"] for panel in dashboard["panels"]}) == len(dashboard["panels"])
    for counter in re.findall(r"board51_\w+_total", " ".join(queries)):
        assert all(f"rate({counter}" in query for query in queries if counter in query)


def test_the_how_to_names_every_metric_and_no_other(bus: tuple[PlayedGateway, Feed]) -> None:
    page = (MONITORING.parent / "howto" / "monitoring.md").read_text(encoding="utf-8")

    documented = {f"board51{rest}" for rest in re.findall(r"`(?:board51)?(_[a-z0-9_]+)`", page)}

    assert documented == names(scraped(bus[1]))
