"""The parts of a folder become one log: ordered, each record once, and what cannot be read is said."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

import board51
from gateway.record.merge import merge
from protocol.bus import board51_pb2 as pb
from protocol.log.reader import LogReader
from tests.harness.sites.logs import flight, held, write


def test_parts_in_any_order_and_twice_become_one_log_in_order(tmp_path: Path) -> None:
    records, draw = flight(4_000), random.Random(3)
    later = flight(500, session=3, first=50_000)  # a session of a smaller number
    pieces = [records[n : n + 700] for n in range(0, len(records), 700)]
    draw.shuffle(pieces)
    write(tmp_path / "a" / "0.mcap", [record for piece in pieces[:6] for record in piece])
    write(tmp_path / "a" / "1.mcap", [record for piece in pieces[4:] for record in piece])
    write(tmp_path / "a" / "2.mcap", later, finish=False)

    merged = merge(tmp_path / "a", tmp_path / "whole.mcap")

    reader = LogReader(tmp_path / "whole.mcap")
    states = [pb.State.FromString(record.data) for record in reader.raw(topics_=["state"])]
    assert [(s.session, s.tick) for s in states] == [
        *((7, tick) for tick in range(1_000, 5_000)),
        *((3, tick) for tick in range(50_000, 50_500)),
    ]
    assert merged.twice == sum(n - 1 for n in held(tmp_path / "a").values())
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "whole.mcap"]  # nothing of the work is left


def test_a_part_that_cannot_be_read_is_named_and_the_others_are_merged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / "a" / "0.mcap", flight(100))
    (tmp_path / "a" / "1.mcap").write_bytes(b"no log")
    out = tmp_path / "whole.mcap"

    assert board51.main(["merge", str(tmp_path / "a"), "-o", str(out)]) == 1
    assert "1.mcap is not an MCAP file" in capsys.readouterr().err
    assert held(tmp_path) == held(tmp_path / "a", parts="0.mcap")
    assert board51.main(["merge", str(tmp_path / "a"), "-o", str(out)]) == 1
    assert "exists already" in capsys.readouterr().err
    assert out.exists()


def test_a_folder_without_logs_is_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert board51.main(["merge", str(tmp_path), "-o", str(tmp_path / "out.mcap")]) == 2
    assert "has no logs" in capsys.readouterr().err
