"""The records that a recording has missed are filled in from the lab's log: all, once, whatever happens in between."""

from __future__ import annotations

import os
import random
from collections.abc import Callable
from pathlib import Path

import pytest
import zenoh

import board51
from gateway.client.connection import BusBoard, open_bus
from gateway.record.merge import merge
from gateway.record.writer import LogError
from gateway.sites.filler import Filler, Tally
from gateway.sites.server import LogServer
from protocol.bus import board51_pb2 as pb
from protocol.bus.endpoint import zenoh_config
from protocol.log.reader import LogReader
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.ports import free_endpoint
from tests.harness.sites.logs import account, flight, missing, served, without, write
from tests.harness.soak.processes import Service
from tests.harness.soak.stage import Disk


def fill(endpoint: str, folder: Path, report: Callable[[str], None] = lambda line: None) -> Tally:
    with open_bus(endpoint) as session:
        return Filler(BusBoard(session, "board51", "*"), folder, settle_s=1.0, days=1e5, report=report).fill()


@pytest.fixture
def sites(tmp_path: Path) -> tuple[Path, Path]:
    """Folders of a lab and a plant."""
    lab, plant = tmp_path / "lab", tmp_path / "plant"
    lab.mkdir()
    plant.mkdir()
    return lab, plant


def test_what_a_recording_has_missed_is_filled_in_once_and_in_order(sites: tuple[Path, Path], tmp_path: Path) -> None:
    lab, plant = sites
    first = flight(6_000, first=15_000)  # of two blocks
    second = flight(2_000, board="rig2", session=9, seed=2)
    write(lab / "a-000.mcap", first[: len(first) // 3])
    write(lab / "a-001.mcap", first[len(first) // 3 :])
    write(lab / "b-000.mcap", second)
    write(plant / "bus-000.mcap", without(first, (0.2, 0.6), (0.7, 0.7001), (0.95, 1.1)))

    with served(lab) as endpoint:
        tally, again = fill(endpoint, plant), fill(endpoint, plant)
    merged = merge(plant, tmp_path / "whole.mcap")

    assert account(lab, plant) == (0, 0)
    assert (tally.refused, tally.settling, again.records) == (0, 0, 0)
    assert merged.twice == 0
    for board, ticks in (("rig1", range(15_000, 21_000)), ("rig2", range(1_000, 3_000))):
        states = [
            pb.State.FromString(r.data)
            for r in LogReader(tmp_path / "whole.mcap").raw(topics_=["state"], boards=[board])
        ]
        assert [state.tick for state in states] == list(ticks)


def test_what_an_older_twin_sent_without_a_time_is_left_out_and_stays(sites: tuple[Path, Path]) -> None:
    lab, plant = sites
    records = flight(3_000)
    timeless = [r for r in records if r[0].endswith("/twin/model") and not pb.TwinModel.FromString(r[1]).host_time_ns]
    write(lab / "a-000.mcap", records)
    write(plant / "bus-000.mcap", timeless[:2])

    with served(lab) as endpoint:
        tally, again = fill(endpoint, plant), fill(endpoint, plant)

    assert (tally.records, tally.refused, again.records) == (len(records) - len(timeless), 0, 0)
    models = [r.data for path in plant.glob("*.mcap") for r in LogReader(path).raw(topics_=["twin/model"])]
    assert sorted(models) == sorted(r[1] for r in records if r[0].endswith("/twin/model") and r not in timeless[2:])


def test_the_part_that_is_being_written_is_served_and_filled(sites: tuple[Path, Path]) -> None:
    lab, plant = sites
    records = flight(6_000)
    lab_writer = write(lab / "a-000.mcap", records[:8_000], finish=False)
    plant_writer = write(plant / "bus-000.mcap", without(records[:6_000], (0.5, 0.8)), finish=False)

    with served(lab) as endpoint, open_bus(endpoint) as session:
        filler = Filler(BusBoard(session, "board51", "*"), plant, settle_s=1.0, days=1e5)
        filler.fill()
        first = account(lab, plant)
        for record in records[8_000:]:
            lab_writer.write(*record)
            lab_writer.flush()
        again = filler.fill()
    lab_writer.close()
    plant_writer.close()

    assert first == (0, 0)
    assert again.compared < 6  # what is new, and not all of it once more
    assert account(lab, plant) == (0, 0)


def test_what_is_young_is_left_to_the_recorder(sites: tuple[Path, Path]) -> None:
    lab, plant = sites
    write(lab / "a-000.mcap", flight(3_000, began_ns=LogServer(lab, "board51").answer(b"").now_ns))

    with served(lab) as endpoint, open_bus(endpoint) as session:
        tally = Filler(BusBoard(session, "board51", "*"), plant, settle_s=3600.0).fill()

    assert (tally.records, tally.settling) == (0, 1)
    assert list(plant.iterdir()) == []


@pytest.mark.slow
def test_a_killed_fill_goes_on_where_it_was(sites: tuple[Path, Path], tmp_path: Path) -> None:
    lab, plant = sites
    records = flight(20_000)
    write(lab / "a-000.mcap", records)
    write(plant / "bus-000.mcap", without(records, (0.1, 1.1)))

    endpoint = free_endpoint()
    with zenoh.open(zenoh.Config.from_json5(zenoh_config("router", listen=[endpoint]))):
        bus = ("--connect", endpoint)
        server = Service("server", tmp_path, "-m", "board51", "serve-log", str(lab), *bus, ready="serving")
        server.start()
        words = ("-m", "board51", "fill", str(plant), *bus, "--settle", "1", "--days", "99999")
        killed = Service("fill", tmp_path, *words)
        killed.start()
        wait_for(lambda: sum(p.stat().st_size for p in plant.glob("fill-*.mcap")) > 20_000, "a part that grows")
        code = killed.kill()
        missing, twice = account(lab, plant)
        fill(endpoint, plant)
        ended = server.end()

    assert (code, ended) == (-9, 0)
    assert missing > 0
    assert twice == 0
    assert account(lab, plant) == (0, 0)


def test_a_full_disk_ends_a_round_and_the_next_one_goes_on(sites: tuple[Path, Path], tmp_path: Path) -> None:
    lab, _ = sites
    disk = Disk(tmp_path / "disk")
    if not disk.mounted:
        pytest.skip("no right to mount a small disk")
    write(lab / "a-000.mcap", flight(6_000, first=15_000))
    try:
        with served(lab) as endpoint, open_bus(endpoint) as session:
            filler = Filler(BusBoard(session, "board51", "*"), disk.folder, settle_s=1.0, days=1e5)
            disk.fill()
            with pytest.raises(LogError, match="disk full"):
                filler.fill()
            lacked = missing(lab, disk.folder)
            disk.free()
            filler.fill()
        result = account(lab, disk.folder)
    finally:
        disk.close()

    assert lacked > 0
    assert result == (0, 0)


def test_of_a_damaged_part_everything_intact_is_filled_in(sites: tuple[Path, Path]) -> None:
    lab, plant = sites
    path = lab / "a-000.mcap"
    write(path, flight(5_000))
    data = bytearray(path.read_bytes())
    at = random.Random(5).randrange(len(data) // 3, len(data) // 2)
    data[at : at + 20_000] = bytes(20_000)  # a chunk at least
    path.write_bytes(data)
    messages: list[str] = []

    with served(lab) as endpoint:
        tally = fill(endpoint, plant, messages.append)

    assert account(lab, plant) == (0, 0)
    assert 5_000 < tally.records < 9_900
    assert "is damaged at byte" in messages[0]


def test_a_bad_request_gets_a_reply_that_says_why(sites: tuple[Path, Path]) -> None:
    lab, plant = sites
    write(lab / "a-000.mcap", flight(100))
    write(plant / "secret.mcap", flight(100))
    block = pb.LogBlock(stream="board51/rig1/state", session=7, number=0)
    other = pb.LogBlock(stream="board51/rig1/state", session=8, number=0)
    server = LogServer(lab, "board51")

    assert "malformed" in server.answer(b"\xff\xff").problem
    assert (
        "has no part ../plant/secret.mcap"
        in server.answer(pb.LogRequest(part="../plant/secret.mcap").SerializeToString()).problem
    )
    assert "has no block" in server.answer(pb.LogRequest(part="a-000.mcap", block=other).SerializeToString()).problem
    bad = pb.LogRequest(part="a-000.mcap", block=block, have=b"no list")
    assert "do not unpack" in server.answer(bad.SerializeToString()).problem
    assert not server.answer(pb.LogRequest(part="a-000.mcap", from_byte=1 << 40).SerializeToString()).blocks
    assert len(server.answer(pb.LogRequest(part="a-000.mcap", block=block).SerializeToString()).records) == 100
    assert LogServer(lab, "elsewhere").answer(pb.LogRequest(part="a-000.mcap", block=block).SerializeToString()).problem


def test_a_server_that_sends_something_else_fills_in_nothing(sites: tuple[Path, Path], tmp_path: Path) -> None:
    lab, plant = sites
    write(lab / "a-000.mcap", flight(500))

    class Liar(LogServer):
        def answer(self, payload: bytes) -> pb.LogReply:
            reply = super().answer(payload)
            for record in reply.records:
                record.key = "board51/rig2/state"
            reply.more = True
            return reply

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tests.harness.sites.logs.LogServer", Liar)
        with served(lab) as endpoint:
            tally = fill(endpoint, plant)

    assert tally.records == 0
    assert tally.refused >= 500
    assert list(plant.iterdir()) == []


def test_without_a_server_the_error_says_what_to_start(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "plant").mkdir()
    with served(tmp_path, site="elsewhere") as endpoint:
        code = board51.main(["fill", str(tmp_path / "plant"), "--connect", endpoint])
    assert code == 1
    assert "No log server of board51 answers. Start `board51 serve-log`" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--settle -1", "-1 is no age; give seconds, 0 or more"),
        ("--settle inf", "inf is no age"),
        ("--days 0", "0 is no number of days; give one above 0"),
        ("--board Rig9", "--board 'Rig9' is not a name"),
    ],
)
def test_a_bad_option_is_named_with_what_to_give(
    words: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        code = board51.main(["fill", str(tmp_path), *words.split()])
    except SystemExit as ended:  # of the parser
        code = int(ended.code or 0)
    assert code == 2
    assert message in capsys.readouterr().err


def test_a_folder_is_filled_by_one_process_at_a_time(
    sites: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    fcntl = pytest.importorskip("fcntl")
    lab, plant = sites
    handle = os.open(plant, os.O_RDONLY)
    fcntl.flock(handle, fcntl.LOCK_EX)
    with served(lab) as endpoint:
        assert board51.main(["fill", str(plant), "--connect", endpoint]) == 2
    os.close(handle)
    assert "is being filled by another process" in capsys.readouterr().err
