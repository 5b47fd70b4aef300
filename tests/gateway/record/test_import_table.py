"""Tables into logs and back: values to the bit, gaps seen, bad cells named."""

from __future__ import annotations

import csv
import gzip
import json
import random
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
from scipy.io import loadmat, savemat

import board51
from gateway.record.tables.export import Format, export
from gateway.record.tables.table_import import ImportReport, import_recording
from gateway.record.writer import LogWriter
from protocol.bus import board51_pb2 as pb
from protocol.campaign import CHANNELS, Column, Kind, Recording
from protocol.errors import DataError
from protocol.log.reader import read

FORMATS: tuple[Format, ...] = ("csv", "mat", "parquet")


def bring(
    folder: Path, text: str | bytes, *, name: str = "a.csv", kind: Kind = "free", **columns: str | Column
) -> tuple[ImportReport, list[pb.State]]:
    source, log = folder / name, folder / "a.mcap"
    source.write_bytes(text if isinstance(text, bytes) else text.encode())
    named = {
        channel: Column(column=column) if isinstance(column, str) else column
        for channel in CHANNELS
        if (column := columns.get(channel)) is not None
    }
    report = import_recording(source, log, Recording(file=name, kind=kind, use="fit", columns=named), board="rig")
    return report, states(log)


def states(log: Path) -> list[pb.State]:
    return [record.message for record in read(log, topics=["state"]) if isinstance(record.message, pb.State)]


def test_a_table_becomes_samples(tmp_path: Path) -> None:
    report, samples = bring(tmp_path, "t,x,comment\n0,0.001,hot\n0.002,0.002,-\n0.004,0.003,nan\n")

    assert [(s.tick, s.sequence, s.t_s, s.x_m, s.host_time_ns, s.session, s.lost_before) for s in samples] == [
        (0, 0, 0.0, 0.001, 0, 1, 0),
        (1, 1, 0.002, 0.002, 2_000_000, 1, 0),
        (2, 2, 0.004, 0.003, 4_000_000, 1, 0),
    ]
    assert not any(s.HasField("i_c_a") or s.HasField("u_c_v") or s.HasField("x_ref_m") for s in samples)
    assert report.sample_time_s == 0.002
    parameters = next(read(tmp_path / "a.mcap", topics=["parameters"])).message
    assert isinstance(parameters, pb.Parameters)
    assert parameters.sample_time_s == 0.002


def test_scale_offset_and_look_up_table(tmp_path: Path) -> None:
    column = Column(column="duty", scale=2.0, offset=-1.0, table=((0.0, 0.0), (0.1, 1.0), (0.3, 2.0)))

    report, samples = bring(tmp_path, "t,duty\n0,0\n1,0.05\n2,0.2\n3,0.5\n", u_c=column)

    # table, then scale, then offset; beyond the last point the last slope goes on: 2 + 0.2 * 1 / 0.2 = 3
    assert [s.u_c_v for s in samples] == pytest.approx([-1.0, 0.0, 2.0, 5.0])
    assert report.beyond_table == {"u_c": 1}


def test_gaps_and_irregular_steps_are_seen(tmp_path: Path) -> None:
    times = [0.0, 0.002, 0.004, 0.010, 0.012, 0.0144, 0.0164]  # two samples missing, then one late by 0.4 ms

    report, samples = bring(tmp_path, "t,x\n" + "".join(f"{t},0\n" for t in times))

    assert [s.tick for s in samples] == [0, 1, 2, 5, 6, 7, 8]
    assert [s.lost_before for s in samples] == [0, 0, 0, 2, 0, 0, 0]
    assert [s.t_s for s in samples] == times
    assert (report.gaps, report.samples_missing, report.irregular_steps) == (1, 2, 1)
    assert report.worst_step_s == pytest.approx(0.0024)


def test_time_may_begin_below_zero(tmp_path: Path) -> None:
    _, samples = bring(tmp_path, "t,x\n-0.002,1\n0,2\n")

    assert [(s.t_s, s.host_time_ns) for s in samples] == [(-0.002, 0), (0.0, 2_000_000)]


def test_equilibria_have_no_time(tmp_path: Path) -> None:
    report, samples = bring(tmp_path, "i_c,x\n0.5,0.001\n0.6,0.002\n", kind="equilibria")

    assert report.sample_time_s == 0.0
    assert [(s.session, s.i_c_a, s.x_m) for s in samples] == [(1, 0.5, 0.001), (2, 0.6, 0.002)]


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("compressed", [False, True])
def test_kinds_of_csv(tmp_path: Path, separator: str, compressed: bool) -> None:
    text = "\ufeff# made by a logger\r\nt,x\r\n0,1e-3\r\n\r\n1, 2e-3\r\n".replace(",", separator).encode()

    _, samples = bring(
        tmp_path, gzip.compress(text) if compressed else text, name="a.csv.gz" if compressed else "a.csv"
    )

    assert [s.x_m for s in samples] == [1e-3, 2e-3]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is empty"),
        ("t,x\n", "no rows"),
        ("0,1\n1,2\n", "line 1 holds numbers where the names"),
        ("t,x,x\n0,1,2\n", "line 1: column 'x' is there twice"),
        ("time,x\n0,1\n1,2\n", "no column 't'.*its columns are: time, x"),
        ("t,gap\n0,1\n1,2\n", "none of the channels.*its columns are: t, gap"),
        ("t,x\n0,1\n,1\n", "line 3: t is empty"),
        ("t,x\n0,1\nnan,1\n", "line 3: t = 'nan' is not a finite number"),
        ("t,x\n0,inf\n1,inf\n", "line 2: x = 'inf' is not a finite number"),
        ("t,x\n0,far\n1,far\n", "line 2: x = 'far' is not a finite number"),
        ("t,x\n0,1\n1,1e308\n", r"line 3: x = '1e308' gives 1e\+308 m for x, which cannot be a measurement"),
        ("t,x\n0,1\n1e308,1\n", "line 3: t = '1e308' gives"),
        ("t,x\n0,1\n1,1\n2,1\n9e9,1\n", "line 5: t jumps by 9e"),
        ("t,x\n0,-999999999\n1,1\n", "line 2: x = '-999999999'"),
        ("# c\nt;x\n0;1,5\n1;2,5\n", "line 3: x = '1,5'.*decimals with a point"),
        ("t,x\n0,1\n1,2,3\n", "line 3 has 3 cells, the first line 2"),
        ("t,x\n0,1\n1\n", "line 3 has 1 cells"),
        ("t,x\n0,1\n2,1\n1,1\n", "line 4: t = 1 does not come after 2"),
        ("t,x\n0,1\n0,1\n", "line 3: t = 0 does not come after 0"),
        ("t,x\n0,1\n", "one row"),
    ],
)
def test_bad_tables_are_told_with_line_and_column(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(DataError, match=says):
        bring(tmp_path, text)

    assert not (tmp_path / "a.mcap").exists()


@pytest.mark.parametrize("cell", ["", "nan", "inf", "overflow"])
def test_a_cell_that_is_no_number_is_a_missing_reading(tmp_path: Path, cell: str) -> None:
    report, samples = bring(tmp_path, f"t,x,i_c\n0,0.001,0.5\n0.002,{cell},0.6\n0.004,0.003,0.7\n")

    assert [s.x_m if s.HasField("x_m") else None for s in samples] == [0.001, None, 0.003]
    assert [s.i_c_a for s in samples] == [0.5, 0.6, 0.7]
    assert report.warnings == ("1 cells of x are not numbers and were left out, the first in line 3",)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"t,x\n0,1\n", "named .gz but is not compressed"),
        (gzip.compress(b"t,x\n0,1\n1,2\n" * 50)[:-9], "damaged or cut off"),
        (gzip.compress(b"\xff\xfe\x00"), "is not text"),
    ],
    ids=["plain", "cut", "binary"],
)
def test_bad_compression_is_told(tmp_path: Path, data: bytes, says: str) -> None:
    with pytest.raises(DataError, match=says):
        bring(tmp_path, data, name="a.csv.gz")


def test_matlab_vectors_and_structs(tmp_path: Path) -> None:
    time_s, position_m = np.arange(5) * 0.001, np.linspace(0.0, 1e-3, 5)
    savemat(tmp_path / "a.mat", {"t": time_s, "run": {"x": position_m}, "T_s": 0.001})

    _, samples = bring(tmp_path, (tmp_path / "a.mat").read_bytes(), name="a.mat", x="run.x")

    assert [s.x_m for s in samples] == position_m.tolist()


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ({"t": np.arange(5.0), "x": np.arange(4.0)}, "differ in length: t 5, x 4"),
        ({"t": np.array([0.0, np.nan, 1.0]), "x": np.arange(3.0)}, "sample 2: t = nan"),
        ({"note": "hello"}, "no numeric vectors"),
        (None, "not a MATLAB file"),
    ],
)
def test_bad_matlab_files_are_told(tmp_path: Path, content: dict[str, object] | None, says: str) -> None:
    if content is None:
        data = b"not matlab at all" * 20
    else:
        savemat(tmp_path / "b.mat", content)
        data = (tmp_path / "b.mat").read_bytes()

    with pytest.raises(DataError, match=says):
        bring(tmp_path, data, name="a.mat")


def test_what_a_rig_does_not_do_is_said_with_the_scale_that_would_mend_it(tmp_path: Path) -> None:
    rows = "".join(f"{2 * n},{5.7 * n / 50},{600 + n},{2500}\n" for n in range(50))

    report, samples = bring(tmp_path, "t,x,i_c,u_c\n" + rows)

    assert len(samples) == 50, "it is the user's to decide"
    warning_of_channel = {line.split(" ")[0]: line for line in report.warnings}
    assert warning_of_channel.keys() == {"t", "x", "i_c", "u_c"}
    for channel, words in (
        ("t", "its samples are 2 s apart, more than the 0.2 s"),
        ("x", "reaches 5.5"),
        ("i_c", "more than the 30 A"),
        ("u_c", "it reaches 2.5e+03 V"),
    ):
        assert words in warning_of_channel[channel]
        assert "scale = 0.001 would make it plausible" in warning_of_channel[channel]


def test_a_plausible_recording_is_imported_without_a_word(tmp_path: Path) -> None:
    report, _ = bring(tmp_path, "t,x,i_c,u_c\n" + "".join(f"{n * 2e-3},0.0057,0.6,2.1\n" for n in range(50)))

    assert report.warnings == ()


def test_a_unit_in_the_name_of_a_column_wants_a_scale(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.csv").write_text("t_ms,x_mm\n0,1.5\n2,1.6\n")
    words = ["import", str(tmp_path / "a.csv"), "-o", str(tmp_path / "a.mcap"), "--map", "t=t_ms,scale=1e-3", "--map"]

    assert board51.main([*words, "x=x_mm"]) == 2
    assert "x = 'x_mm' is in mm by its name, x is in m. Give it scale = 0.001" in capsys.readouterr().err
    assert board51.main([*words, "x=x_mm,scale=1e-3"]) == 0
    assert [s.x_m for s in states(tmp_path / "a.mcap")] == pytest.approx([0.0015, 0.0016])


def test_variables_of_a_matlab_file_that_are_no_columns_are_named_with_the_reason(tmp_path: Path) -> None:
    content = {
        "t": np.arange(5) * 0.002,
        "x": np.full(5, 1e-3),
        "pos": np.zeros((5, 3)),
        "z": np.zeros(5, complex),
        "note": "hello",
        "parts": np.array([np.zeros(5), "a"], dtype=object),
        "T_s": 0.002,
    }
    savemat(tmp_path / "b.mat", content)

    report, _ = bring(tmp_path, (tmp_path / "b.mat").read_bytes(), name="a.mat")

    warning_text = "\n".join(report.warnings)
    assert len(report.warnings) == 4
    for words in (
        "'pos' cannot be used: it is a matrix of 5 x 3",
        "'z' cannot be used: it is complex",
        "'note'",
        "'parts'",
    ):
        assert words in warning_text
    with pytest.raises(DataError, match="has no column 'pos': it is a matrix of 5 x 3"):
        bring(tmp_path, (tmp_path / "b.mat").read_bytes(), name="c.mat", x="pos")


def test_import_and_export_return_every_bit(tmp_path: Path) -> None:
    rng = random.Random(51)
    rows = [[k * 0.002, *(rng.uniform(-1.0, 1.0) * 10.0 ** rng.randint(-12, 3) for _ in range(4))] for k in range(300)]
    text = "t,u_c,i_c,x,x_ref\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows)
    bring(tmp_path, text)
    expected = dict(zip(("t_s", "u_c_v", "i_c_a", "x_m", "x_ref_m"), zip(*rows, strict=True), strict=True))

    for form in FORMATS:
        export(tmp_path / "a.mcap", tmp_path / f"out.{form}", form=form)

    with (tmp_path / "out.csv").open() as file:
        lines = list(csv.DictReader(file))
    mat = loadmat(tmp_path / "out.mat")
    parquet = pyarrow.parquet.read_table(tmp_path / "out.parquet").to_pydict()
    for name, values in expected.items():
        assert [float(line[name]) for line in lines] == list(values)
        assert mat[name].ravel().tolist() == list(values)
        assert parquet[name] == list(values)
    assert [int(line["tick"]) for line in lines] == list(range(300))


def test_absent_channels_stay_absent_in_every_format(tmp_path: Path) -> None:
    bring(tmp_path, "t,x\n0,1\n1,2\n")

    for form in FORMATS:
        export(tmp_path / "a.mcap", tmp_path / f"out.{form}", form=form)

    with (tmp_path / "out.csv").open() as file:
        assert [line["i_c_a"] for line in csv.DictReader(file)] == ["", ""]
    assert np.isnan(loadmat(tmp_path / "out.mat")["i_c_a"]).all()
    assert pyarrow.parquet.read_table(tmp_path / "out.parquet").to_pydict()["i_c_a"] == [None, None]


def test_every_logged_topic_can_be_exported(tmp_path: Path) -> None:
    log = tmp_path / "a.mcap"
    writer = LogWriter(log)
    divergence = pb.Divergence(tick=3, t_s=0.006, sync="in-step", x_m=pb.SignalDivergence(error=1e-5))
    command = pb.CommandRecord(command=pb.Command(id="7", set_mode=pb.SetMode(mode=pb.MODE_OPEN_LOOP)))
    capture = pb.CaptureRecord(tick=9, sample_time_s=4e-5, u_from_v=1.0, u_to_v=2.0, step_index=1, i_c_a=[0.1, 0.2])
    for topic, message in (
        ("twin/divergence", divergence),
        ("command/record", command),
        ("capture", capture),
        ("status", pb.Status(bad_frames={"crc": 2, "cobs": 1})),
        ("raw", pb.RawBytes(data=b"\x00\x01")),
    ):
        writer.write(f"board51/rig/{topic}", message.SerializeToString(), 5)
    writer.close()

    def rows(topic: str) -> list[dict[str, str]]:
        out = tmp_path / (topic.replace("/", "-") + ".csv")
        export(log, out, form="csv", topic=topic)
        with out.open() as file:
            return list(csv.DictReader(file))

    assert rows("twin/divergence")[0].items() >= {"t_s": "0.006", "x_m_error": "1e-05", "i_c_a_error": ""}.items()
    assert (
        rows("command/record")[0].items()
        >= {
            "command_id": "7",
            "command_set_mode": '{"mode": "MODE_OPEN_LOOP"}',
            "command_stop": "",
        }.items()
    )
    assert [(r["t_s"], r["i_c_a"], r["u_c_v"]) for r in rows("capture")] == [
        ("-4e-05", "0.1", "1.0"),
        ("0.0", "0.2", "2.0"),
    ]
    assert rows("status")[0]["bad_frames"] == "cobs=1 crc=2"
    assert rows("raw")[0]["data"] == "0001"


def test_export_refuses_what_it_cannot_do(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bring(tmp_path, "t,x\n0,1\n1,2\n")
    log, out = str(tmp_path / "a.mcap"), str(tmp_path / "out.csv")

    assert board51.main(["export", log, "-o", out]) == 0
    assert board51.main(["export", log, "-o", out]) == 1
    assert board51.main(["export", log, "-o", str(tmp_path / "out.xlsx")]) == 2
    assert board51.main(["export", log, "-o", str(tmp_path / "b.csv"), "--topic", "twin/state"]) == 2

    assert [line.split(": ")[0] for line in capsys.readouterr().err.splitlines()] == ["board51 export"] * 3
    assert not (tmp_path / "b.csv").exists()


def test_the_command_maps_columns(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.csv").write_text("time,gap,duty\n0,0.02,0\n0.001,0.018,0.05\n")
    arguments = ["import", str(tmp_path / "a.csv"), "-o", str(tmp_path / "a.mcap"), "--board", "lab", "--json"]
    arguments += ["--map", "t=time", "--map", "x=gap,scale=-1,offset=0.02", "--map", "u_c=duty,table=0:0;0.1:1"]

    assert board51.main(arguments) == 0

    assert json.loads(capsys.readouterr().out)[0]["channels"] == ["u_c", "x"]
    assert [s.x_m for s in states(tmp_path / "a.mcap")] == pytest.approx([0.0, 0.002], abs=1e-15)
    assert [s.u_c_v for s in states(tmp_path / "a.mcap")] == [0.0, 0.5]
    assert board51.main([*arguments, "--map", "y=gap"]) == 2
    assert "'y' is not one of t, u_c, i_c, x, x_ref" in capsys.readouterr().err
