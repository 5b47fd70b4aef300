"""The minutes come from the gateway's log and its earlier parts, or from the bus; an error says if neither has any."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import zenoh

from protocol.bus import board51_pb2 as pb
from protocol.campaign import load
from protocol.errors import ServiceError, UsageError
from tests.harness.ports import free_endpoint
from tests.harness.repeated import repeated
from tests.harness.twin.twin_bus import router
from twin.live.folder import changes_of, controller_of, plant_of, write
from twin.live.pieces import cut
from twin.live.source import LiveData, find_board, from_bus, from_log
from twin.mirror.bus.client import open_client
from twin.model.parameters import Model
from twin.readers.log import TwinLog

T_NS = 2_000_000
GAINS = (0.49, 1700.0, 17.7, -17600.0)


def state(tick: int, *, session: int = 7) -> pb.State:
    x_ref = 1e-3 if tick // 1000 % 2 else 3e-3
    return pb.State(
        session=session, tick=tick, t_s=tick * 2e-3, host_time_ns=10**18 + tick * T_NS, mode=pb.MODE_CLOSED_LOOP,
        x_m=x_ref, x_ref_m=x_ref, i_c_a=0.6, u_c_v=2.0,
    )  # fmt: skip


def parameters(*, session: int = 7, gains: tuple[float, ...] = GAINS, from_tick: int = 0) -> pb.Parameters:
    return pb.Parameters(session=session, gains=gains, i_0_a=0.6, x_0_m=2.85e-3, u_0_v=2.1, from_tick=from_tick)


def write_part(path: Path, ticks: range, *, board: str = "rig") -> None:
    with TwinLog(path) as log:
        log.write(f"lab/{board}/parameters", parameters(), message_type=pb.Parameters, log_time_ns=10**18)
        for tick in ticks:
            log.write(f"lab/{board}/state", state(tick), message_type=pb.State, log_time_ns=10**18 + tick * T_NS)


def test_the_span_is_taken_from_as_many_parts_as_it_needs(tmp_path: Path) -> None:
    (tmp_path / "log-000.mcap").write_bytes(b"not read: the span does not reach so far")
    write_part(tmp_path / "log-001.mcap", range(0, 5000))
    write_part(tmp_path / "log-002.mcap", range(5000, 9000))
    status = pb.Status(session=7, log_file="log-002.mcap")

    short = from_log(status, tmp_path, "lab", "rig", 4.0)
    long = from_log(status, tmp_path, "lab", "rig", 16.0)

    assert short is not None
    assert long is not None
    assert [state.tick for state in short.states] == list(range(8999 - 2000, 9000))
    assert [state.tick for state in long.states] == list(range(8999 - 8000, 9000))
    assert len(long.parameters) == 1, "what repeats the same values is no change"


def test_a_log_of_another_machine_is_not_taken_for_ours(tmp_path: Path) -> None:
    write_part(tmp_path / "log-000.mcap", range(100))

    assert from_log(pb.Status(session=8, log_file="log-000.mcap"), tmp_path, "lab", "rig", 60.0) is None
    assert from_log(pb.Status(session=7, log_file="log-000.mcap"), tmp_path, "lab", "other", 60.0) is None
    assert from_log(pb.Status(session=7, log_file="log-001.mcap"), tmp_path, "lab", "rig", 60.0) is None
    assert from_log(pb.Status(session=7, log_file=""), tmp_path, "lab", "rig", 60.0) is None


def test_the_folder_is_a_campaign_that_reads_back(tmp_path: Path) -> None:
    write_part(tmp_path / "log-000.mcap", range(8000))
    live_data = from_log(pb.Status(session=7, log_file="log-000.mcap"), tmp_path, "lab", "rig", 60.0)
    assert live_data is not None
    pieces = cut(list(live_data.states), live_data.captures, changes_of(live_data.parameters))

    campaign = load(write(live_data, pieces, plant_of(live_data), tmp_path / "out", site="lab", board="rig"))

    assert [(item.kind, item.use) for item in campaign.recordings] == [("closed-loop", "fit"), ("closed-loop", "judge")]
    assert all(campaign.path_of(item).is_file() for item in campaign.recordings)
    assert campaign.controller is not None
    assert campaign.controller.gains == GAINS
    assert campaign.plant.mass_kg == Model.load("ce152").plant.mass_kg


def test_a_change_of_gains_is_where_recordings_end_and_leaves_no_single_law() -> None:
    live_data = LiveData()
    for message in (parameters(), parameters(), parameters(gains=(1.0, 2.0, 3.0, 4.0), from_tick=500)):
        live_data.take("parameters", message.SerializeToString())

    assert changes_of(live_data.parameters) == [(7, 500)]
    assert controller_of(live_data.parameters) is None


@contextmanager
def gateway(session: zenoh.Session, *boards: str) -> Iterator[None]:
    """Publishes a status and a sample of each board, over and over."""
    ticks = itertools.count()

    def publish() -> None:
        tick = next(ticks)
        for board in boards:
            session.put(f"lab/{board}/status", pb.Status(session=7).SerializeToString())
            session.put(f"lab/{board}/state", state(tick).SerializeToString())

    with repeated(publish, 0.01):
        yield


@pytest.mark.slow
def test_without_a_log_here_the_bus_is_listened_to() -> None:
    endpoint, messages = free_endpoint(), list[str]()
    with router(endpoint) as router_session, gateway(router_session, "rig"), open_client((endpoint,)) as session:
        board, status = find_board(session, "lab", None)
        live_data = from_bus(session, "lab", board, 0.5, messages.append)

    assert (board, status.session) == ("rig", 7)
    ticks = [state.tick for state in live_data.states]
    assert ticks == list(range(ticks[0], ticks[0] + len(ticks)))
    assert len(ticks) > 5
    assert "not on this machine" in messages[0]


def test_several_boards_must_be_told_apart_and_none_is_an_error() -> None:
    endpoint = free_endpoint()
    with router(endpoint) as router_session, open_client((endpoint,)) as session:
        with pytest.raises(ServiceError, match=r"No gateway reports lab/\*.*Start `board51 gateway`"):
            find_board(session, "lab", None)
        with gateway(router_session, "one", "two"):
            with pytest.raises(UsageError, match=r"report: one, two\. Choose one with --board"):
                find_board(session, "lab", None)
            assert find_board(session, "lab", "two")[0] == "two"


@pytest.mark.slow
def test_a_router_that_is_not_there_is_said() -> None:
    with pytest.raises(ServiceError, match="No router answers"):
        open_client((free_endpoint(),))
