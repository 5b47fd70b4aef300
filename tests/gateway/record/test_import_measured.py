"""Recordings of a measured rig, imported with every value."""

from __future__ import annotations

import csv
import gzip
import json
import os
from pathlib import Path

import pytest

import board51
from gateway.record.tables.table_import import import_recording
from protocol.bus import board51_pb2 as pb
from protocol.campaign import Channel, Column, Recording
from protocol.log.reader import LogReader, read

REPO = Path(__file__).parents[3]
DATA = Path(os.environ.get("BOARD51_DATA", REPO.parent / "shared" / "data"))
INTECO = DATA / "inteco-mls2em"


def test_measured_recordings_import_by_their_campaign(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if not INTECO.is_dir():
        pytest.skip(f"no recordings at {INTECO}")
    campaign = REPO / "twin" / "campaigns" / "inteco.toml"
    logs = tmp_path / "logs"

    files = ["--only", "cl_step__LQI_KF.csv.gz"]
    code = board51.main(["import", "--campaign", str(campaign), "--data", str(DATA), "-o", str(logs), *files, "--json"])

    report = json.loads(capsys.readouterr().out)[0]
    assert code == 0
    assert report["rows"] == 15001
    assert report["sample_time_s"] == 0.001
    assert report["gaps"] == report["irregular_steps"] == 0
    log = logs / "cl_step__LQI_KF.mcap"
    with gzip.open(INTECO / "cl_step__LQI_KF.csv.gz", "rt") as file:
        rows = list(csv.DictReader(file))
    states = [r.message for r in read(log, topics=["state"]) if isinstance(r.message, pb.State)]
    assert [s.i_c_a for s in states] == [float(row["i1_A"]) for row in rows]
    assert [s.x_m for s in states] == pytest.approx([0.02 - float(row["gap_meas_m"]) for row in rows], abs=1e-12)
    assert all(s.mode == pb.MODE_CLOSED_LOOP for s in states)
    reader = LogReader(log)
    assert sum(1 for _ in reader.raw()) == 15002
    assert reader.metadata["import"]["file"] == "cl_step__LQI_KF.csv.gz"
    assert len(reader.metadata["import"]["sha256"]) == 64


def test_every_measured_recording_can_be_read(tmp_path: Path) -> None:
    if not INTECO.is_dir():
        pytest.skip(f"no recordings at {INTECO}")
    gap = Column(column="gap_m", scale=-1.0, offset=0.02)
    columns: dict[Channel, Column] = {"t": Column(column="t_s"), "i_c": Column(column="i1_A"), "x": gap}
    for source in sorted(INTECO.glob("[fi]*_*0[1-3].csv.gz")):
        recording = Recording(file=source.name, kind="free", use="fit", columns=columns)

        report = import_recording(source, tmp_path / f"{source.name}.mcap", recording, board="rig")

        assert report.sample_time_s == 0.005
        assert report.gaps == 0
