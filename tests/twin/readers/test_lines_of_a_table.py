"""The lines of a CSV file, by any of the three line ends, and numbers of any size."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from protocol.campaign import Channel, Column, Recording
from twin.readers.campaign import read_recording

ROWS = ["t_s,x_m,i_c_a,u_c_v", *(f"{0.002 * n:.3f},{1e-3 + 1e-5 * n:.6f},0.{n},2.0" for n in range(9))]
COLUMNS: dict[Channel, Column] = {
    "t": Column(column="t_s"),
    "x": Column(column="x_m"),
    "i_c": Column(column="i_c_a"),
    "u_c": Column(column="u_c_v"),
}


@pytest.mark.parametrize("ends", [["\n"], ["\r\n"], ["\n", "\r", "\r\n"]], ids=["unix", "windows", "mixed"])
def test_each_line_is_a_row(tmp_path: Path, ends: list[str]) -> None:
    text = "".join(row + ends[n % len(ends)] for n, row in enumerate(ROWS))
    (tmp_path / "a.csv").write_bytes(text.encode())

    record = read_recording(tmp_path / "a.csv", Recording(file="a.csv", kind="closed-loop", use="fit", columns=COLUMNS))

    assert record.t == pytest.approx(0.002 * np.arange(9))
    assert record.x == pytest.approx(1e-3 + 1e-5 * np.arange(9))


def test_times_in_nanoseconds_since_1970_are_read(tmp_path: Path) -> None:
    """They are integers above 2^53, which not every double holds."""
    now_ns = 1_790_000_000_000_000_001
    lines = ["t_ns,x_m,i_c_a,u_c_v", *(f"{now_ns + 2_000_000 * n},0.001,0.5,2" for n in range(9))]
    (tmp_path / "a.csv").write_text("\n".join(lines), encoding="utf-8")
    columns = COLUMNS | {"t": Column(column="t_ns", scale=1e-9)}

    record = read_recording(tmp_path / "a.csv", Recording(file="a.csv", kind="closed-loop", use="fit", columns=columns))

    assert np.diff(record.t) == pytest.approx(0.002, abs=1e-6)
