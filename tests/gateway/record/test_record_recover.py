"""Reading and recovering logs that are cut, damaged or foreign: everything intact comes out, nothing else does."""

from __future__ import annotations

import json
import os
import random
import struct
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import Writer

import board51
from gateway.record.recover import recover
from gateway.record.summary import as_json, summarise
from gateway.record.writer import Compression, LogError, LogWriter
from protocol.bus import board51_pb2 as pb
from protocol.bus.encoding import CHUNK_BYTES
from protocol.errors import DataError
from protocol.log.reader import LogReader, LogRecord, read
from tests.examples import costly

START_NS = 1_700_000_000_000_000_000
TICKS = 400
COMPRESSIONS: tuple[Compression, ...] = ("lz4", "zstd", "none")


def state(tick: int, *, session: int = 1) -> pb.State:
    return pb.State(
        sequence=tick & 0xFFFF,
        tick=tick,
        session=session,
        host_time_ns=START_NS + tick * 2_000_000,
        x_m=(tick * 104729 % 4096) * 1.4e-6,
        t_s=tick * 0.002,
    )


def write_log(path: Path, *, compression: Compression = "lz4", finish: bool = True) -> list[tuple[str, bytes, int]]:
    """A log of two boards with a flush every 20 ticks; what was written."""
    writer = LogWriter(path, compression=compression, metadata={"config": {"rig": "ce152"}})
    written = []
    for tick in range(TICKS):
        for board in ("a", "b"):
            message = state(tick)
            written.append((f"board51/{board}/state", message.SerializeToString(), message.host_time_ns))
            writer.write(*written[-1])
        if tick % 20 == 19:
            writer.flush()
    if finish:
        writer.close()
    else:
        writer.abandon()
    return written


@pytest.fixture(scope="module", params=COMPRESSIONS)
def intact(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, list[object]]:
    path = tmp_path_factory.mktemp("log") / "intact.mcap"
    written = write_log(path, compression=request.param)
    return path.read_bytes(), list(written)


def save(data: bytes, folder: Path) -> tuple[list[object], Path] | None:
    """Return the records and the log that recover saves of `data`, or None where it says that nothing can be saved."""
    broken, clean = folder / "broken.mcap", folder / "clean.mcap"
    broken.write_bytes(data)
    clean.unlink(missing_ok=True)
    try:
        recover(broken, clean)
    except DataError:
        assert not clean.exists()
        return None
    reader = LogReader(clean)
    assert reader.scans[0].indexed
    return [(r.key, r.data, r.time_ns) for r in reader.raw()], clean


@settings(
    max_examples=costly(50),
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(data=st.data())
def test_a_log_cut_anywhere_gives_its_beginning(
    intact: tuple[bytes, list[object]], tmp_path: Path, data: st.DataObject
) -> None:
    whole, written = intact
    cut = data.draw(st.integers(0, len(whole)))

    saved = save(whole[:cut], tmp_path)

    if saved is not None:
        assert saved[0] == written[: len(saved[0])]
        # A cut costs the chunk it is in, not more: 40 messages lie between two flushes.
        assert len(saved[0]) >= min(len(written), len(written) * cut // len(whole) - 80)
    else:
        assert cut < len(whole) / 5


@settings(
    max_examples=costly(50),
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(ppm=st.integers(0, 999_999), noise=st.binary(min_size=1, max_size=64))
def test_damaged_bytes_cost_their_chunk_and_never_give_wrong_data(
    intact: tuple[bytes, list[object]], tmp_path: Path, ppm: int, noise: bytes
) -> None:
    whole, written = intact
    at = 8 + (len(whole) - 8) * ppm // 1_000_000

    saved = save(whole[:at] + noise + whole[at + len(noise) :], tmp_path)

    if saved is None:
        pytest.fail("one damaged place cannot cost everything")
    remaining = iter(written)
    assert all(message in remaining for message in saved[0])  # a subsequence: right data in the right order
    if written[0] in saved[0][:1]:  # else the description of the channels may have been hit with the first chunk
        assert len(saved[0]) >= len(written) - 80


RECORDING = [state(tick) for tick in range(5000)]  # 10 s, as a campaign or an import writes it: nobody flushes


@pytest.fixture(scope="module", params=["zstd, finished", "lz4, killed"])
def recording(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("recording") / "intact.mcap"
    writer = LogWriter(path, compression="zstd" if "zstd" in request.param else "lz4")
    for message in RECORDING:
        writer.write("board51/a/state", message.SerializeToString(), message.host_time_ns)
    if "killed" in request.param:
        writer.flush()
        writer.abandon()
    else:
        writer.close()
    return path.read_bytes()


def test_one_damaged_spot_costs_the_chunks_it_touches(recording: bytes, tmp_path: Path) -> None:
    draw = random.Random(20240611)
    # One place, of two chunks at most: a chunk has CHUNK_BYTES of messages, and takes more than 4 kB of the file.
    in_chunk = CHUNK_BYTES // len(RECORDING[1].SerializeToString()) + 2
    begins = [8, 80, 12_000, len(recording) - 4096, *(draw.randrange(8, len(recording) - 4096) for _ in range(16))]
    for begin in begins:
        size = draw.randint(1, 4096)

        saved = save(recording[:begin] + draw.randbytes(size) + recording[begin + size :], tmp_path)

        assert saved is not None, begin
        retained = {row[1] for row in saved[0] if isinstance(row, tuple)}
        lost = [m.tick for m in RECORDING if m.SerializeToString() not in retained]
        assert len(retained) == len(saved[0])
        assert len(lost) <= 2 * in_chunk, begin
        assert not lost or lost[-1] - lost[0] == len(lost) - 1


@pytest.mark.slow
def test_every_kind_of_record_may_be_cut(tmp_path: Path) -> None:
    log = tmp_path / "intact.mcap"
    written = write_log(log)
    whole = log.read_bytes()
    kinds: dict[int, list[tuple[int, int]]] = {}
    at = 8
    while at < len(whole) - 8:
        opcode, length = struct.unpack_from("<BQ", whole, at)
        kinds.setdefault(opcode, []).append((at, length))
        at += 9 + length
    assert kinds.keys() >= {1, 2, 3, 4, 6, 7, 8, 0x0B, 0x0C, 0x0D, 0x0E, 0x0F}

    for at, length in [record for records in kinds.values() for record in (records[0], records[-1])]:
        for offset in (0, 1, 5, 9, 9 + length // 2, 8 + length):
            saved = save(whole[: at + offset], tmp_path)
            assert saved is None or saved[0] == written[: len(saved[0])]


def test_a_log_without_its_end_reads_whole_and_silently(tmp_path: Path) -> None:
    written = write_log(tmp_path / "a.mcap", finish=False)

    assert len(list(read(tmp_path / "a.mcap"))) == len(written)


def test_a_cut_log_gives_everything_and_then_says_how_far(tmp_path: Path) -> None:
    log = tmp_path / "a.mcap"
    write_log(log)
    log.write_bytes(log.read_bytes()[: log.stat().st_size // 2])
    records: list[LogRecord] = []

    with pytest.raises(DataError, match=r"damaged at byte \d+ of \d+.*readable to 0\.\d+ s.*board51 recover"):
        records.extend(read(log))

    assert len(records) > 200


def test_recover_tells_what_was_lost(tmp_path: Path) -> None:
    log = tmp_path / "a.mcap"
    write_log(log)
    whole = bytearray(log.read_bytes())
    chunks = [at for at in range(len(whole)) if whole[at + 37 : at + 44] == b"\x03\0\0\0lz4" and whole[at] == 6]
    whole[chunks[5] + 60] ^= 0xFF  # chunk 5: ticks 100 to 119
    log.write_bytes(whole)

    result = recover(log, tmp_path / "clean.mcap")

    assert [damage.offset for damage in result.damages] == [chunks[5]]
    assert result.bytes_lost > 0
    assert result.was_finished
    assert [(gap.board, gap.after_tick, gap.missing) for gap in result.gaps] == [("a", 99, 20), ("b", 99, 20)]
    assert result.last_good_s == pytest.approx((TICKS - 1) * 0.002, abs=1e-9)
    assert LogReader(tmp_path / "clean.mcap").metadata == {}  # known after a pass
    again = summarise(tmp_path / "clean.mcap")
    assert again.metadata["config"] == {"rig": "ce152"}
    assert again.metadata["recovered"] == {"from": "a.mcap"}


def test_recover_does_not_touch_an_existing_file(tmp_path: Path) -> None:
    write_log(tmp_path / "a.mcap")
    (tmp_path / "b.mcap").write_bytes(b"precious")

    with pytest.raises(LogError, match="exists already"):
        recover(tmp_path / "a.mcap", tmp_path / "b.mcap")

    assert (tmp_path / "b.mcap").read_bytes() == b"precious"


def foreign(path: Path, *, schema: str, topic: str) -> None:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema_id = writer.register_schema(schema, "protobuf", b"")
        channel_id = writer.register_channel(topic, "protobuf", schema_id)
        writer.add_message(channel_id, 5, b"\x08\x01", 5)
        writer.finish()


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (None, "No such file"),
        (b"", "is empty"),
        (b"t,x\n0,1\n", "not an MCAP file"),
        (b"\x89MCA", "not an MCAP file.*cut off"),
        (b"\x89MCAP0\r\n", "no channels at all"),
    ],
    ids=["absent", "empty", "csv", "half-a-magic", "magic-only"],
)
def test_what_is_not_a_log_is_told(tmp_path: Path, content: bytes | None, says: str) -> None:
    log = tmp_path / "a.mcap"
    if content is not None:
        log.write_bytes(content)

    with pytest.raises(DataError, match=says):
        list(read(log))
    with pytest.raises(DataError):
        recover(log, tmp_path / "b.mcap")
    with pytest.raises(DataError):
        summarise(log)


@pytest.mark.parametrize(
    ("schema", "topic"),
    [("sensor_msgs/Imu", "/imu"), ("other.v1.State", "board51/rig/state"), ("board51.v1.State", "/board51/rig/state")],
)
def test_a_log_of_others_is_told(tmp_path: Path, schema: str, topic: str) -> None:
    foreign(tmp_path / "a.mcap", schema=schema, topic=topic)

    with pytest.raises(DataError, match=f"no Board51 messages: only {topic}"):
        list(read(tmp_path / "a.mcap"))


def test_messages_of_others_are_skipped_and_counted(tmp_path: Path) -> None:
    log = tmp_path / "a.mcap"
    with log.open("wb") as file:
        writer = Writer(file)
        writer.start()
        for schema, topic, data in (
            ("sensor_msgs/Imu", "/imu", b"?"),
            ("board51.v1.State", "board51/rig/state", state(3).SerializeToString()),
            ("board51.v1.State", "board51/bad/state", b"\xff\xff"),
        ):
            channel = writer.register_channel(topic, "protobuf", writer.register_schema(schema, "protobuf", b""))
            writer.add_message(channel, 5, data, 5)
        writer.finish()
    reader = LogReader(log)

    records = list(reader.records())

    assert [record.message for record in records] == [state(3)]
    assert reader.foreign == {"/imu": 1}
    assert reader.unparsable == {"board51/bad/state": 1}


def test_topics_boards_and_time_choose(tmp_path: Path) -> None:
    for finish, log in ((True, tmp_path / "a.mcap"), (False, tmp_path / "b.mcap")):
        write_log(log, finish=finish)

        chosen = list(read(log, topics=["state"], boards=["b"], start_s=0.100, end_s=0.200))

        assert [record.board for record in chosen] == ["b"] * 50
        assert [record.message for record in chosen] == [state(tick) for tick in range(50, 100)]
        assert list(read(log, topics=["status"])) == []


def test_info_shows_gaps_ranges_sessions_and_rates(tmp_path: Path) -> None:
    log = tmp_path / "a.mcap"
    writer = LogWriter(log)
    for tick in [*range(0, 100), *range(110, 200)]:
        writer.write("board51/rig/state", state(tick).SerializeToString(), state(tick).host_time_ns)
    reset = pb.Event(source="board", name="reset-watchdog", severity="fault", host_time_ns=START_NS + 400_000_000)
    writer.write("board51/rig/event", reset.SerializeToString(), reset.host_time_ns)
    for tick in range(10):
        message = state(tick, session=2)
        message.host_time_ns += 400_000_000
        writer.write("board51/rig/state", message.SerializeToString(), message.host_time_ns)
    writer.close()

    board = json.loads(json.dumps(as_json(summarise(log))))["boards"]["board51/rig"]

    assert board["sessions"] == 2
    assert board["resets"] == 1
    assert board["gaps"]["samples_missing"] == 10
    assert board["gaps"]["list"] == [{"board": "rig", "session": 1, "after_tick": 99, "missing": 10, "at_s": 0.198}]
    assert board["topics"]["state"]["count"] == 200
    assert board["topics"]["state"]["rate_hz"] == pytest.approx(199 / 0.418)
    values = [state(tick).x_m for tick in [*range(0, 100), *range(110, 200), *range(10)]]
    assert board["ranges"]["x_m"]["low"] == min(values)
    assert board["ranges"]["x_m"]["high"] == max(values)
    assert "i_c_a" not in board["ranges"]  # never measured


def test_the_commands_answer_with_codes_and_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, clean = tmp_path / "a.mcap", tmp_path / "clean.mcap"
    write_log(log)
    assert board51.main(["info", str(log)]) == 0
    assert "gaps" in capsys.readouterr().out
    os.truncate(log, log.stat().st_size - 2000)

    assert board51.main(["info", str(log)]) == 1
    assert "DAMAGED" in capsys.readouterr().out
    assert board51.main(["recover", str(log), "-o", str(clean)]) == 0
    assert "lost" in capsys.readouterr().out
    assert board51.main(["info", str(clean), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["damages"] == []
    assert board51.main(["info", str(tmp_path / "absent.mcap")]) == 2
    error_output = capsys.readouterr().err
    assert error_output.count("\n") == 1
    assert "No such file" in error_output
