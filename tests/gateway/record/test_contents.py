"""The contents of a part are the same, however it grew, and bytes from another site are bounded."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st

from gateway.record.blocks import EVERY_TICK, MAX_IDS, BlockId, decompress, locate, pack, unpack
from gateway.record.contents import Contents
from protocol.bus import board51_pb2 as pb
from protocol.bus.topics import TOPIC_OF_NAME
from protocol.errors import DataError
from tests.harness.sites.logs import flight, write


@pytest.mark.parametrize("seed", range(4))
def test_a_part_that_is_read_while_it_grows_has_the_contents_of_the_whole(tmp_path: Path, seed: int) -> None:
    whole, path, draw = tmp_path / "whole.mcap", tmp_path / "part.mcap", random.Random(seed)
    write(whole, flight(3_000, first=16_000, seed=seed))
    data = whole.read_bytes()
    cuts = sorted(draw.sample(range(100, len(data)), 12))
    path.write_bytes(data[: cuts[0]])
    growing, at_once = Contents(path), Contents(whole)

    for begin, end in zip(cuts, [*cuts[1:], len(data)], strict=True):
        growing.refresh()
        with path.open("ab") as file:
            file.write(data[begin:end])
    while not growing.refresh(0.0):  # a chunk at a time
        list(growing.records(next(iter(growing.blocks))))  # what is asked in between changes nothing
    at_once.refresh()

    assert {b: (e.digest, e.count, e.end_byte) for b, e in growing.blocks.items()} == {
        b: (e.digest, e.count, e.end_byte) for b, e in at_once.blocks.items()
    }
    assert growing.damage == ""


def test_topics_of_every_tick_are_told_apart_by_tick() -> None:
    assert {"state", "twin/state", "twin/divergence"} == EVERY_TICK
    assert all({"tick", "session"} <= set(TOPIC_OF_NAME[t].message.DESCRIPTOR.fields_by_name) for t in EVERY_TICK)


def test_records_without_a_time_of_their_own_get_that_of_their_board(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap", flight(1_000))
    contents = Contents(tmp_path / "a.mcap")
    contents.refresh()

    states = dict(contents.records(BlockId("board51/rig1/state", 7, 0)))
    twins = dict(contents.records(BlockId("board51/rig1/twin/state", 7, 0)))

    assert {tick: record.time_ns for tick, record in twins.items()} == {t: r.time_ns for t, r in states.items()}


@given(ids=st.sets(st.integers(0, (1 << 64) - 1), max_size=50), more=st.integers(0, (1 << 64) - 1))
def test_ids_come_back_and_another_set_has_another_digest(ids: set[int], more: int) -> None:
    packed, digest = pack(ids)

    assert unpack(packed) == ids
    assert (pack(ids | {more})[1] == digest) == (more in ids)


def test_what_unpacks_to_more_than_it_may_is_refused() -> None:
    bomb = zstandard.ZstdCompressor().compress(bytes(8 * MAX_IDS + 8))

    with pytest.raises(DataError, match="more than"):
        unpack(bomb)
    with pytest.raises(DataError, match="do not unpack"):
        decompress(b"nothing packed", 100)
    with pytest.raises(DataError, match="malformed"):
        unpack(zstandard.ZstdCompressor().compress(b"123"))


@pytest.mark.parametrize("key", ["board51/rig/command/as/engineer/ana", "board51/rig/none", "board51/", ""])
def test_a_record_of_another_site_that_no_log_has_belongs_nowhere(key: str) -> None:
    assert locate(pb.LogRecord(key=key, data=b"")) is None
