"""Files that somebody else wrote: bounds of what is opened, parsed and repeated."""

from __future__ import annotations

import errno
import gzip
import tracemalloc
from pathlib import Path

import pytest

from protocol.errors import ConfigError, DataError, UsageError, single_line
from protocol.files import LARGEST_SMALL, open_regular, parse_json, parse_toml, read_small, writing
from protocol.table_file import LONGEST_LINE, read_csv_bytes, read_header


def test_a_small_file_is_read_up_to_its_bound(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_bytes(b"x" * LARGEST_SMALL)
    assert len(read_small(file, remedy="-")) == LARGEST_SMALL

    file.write_bytes(b"x" * (LARGEST_SMALL + 1))
    with pytest.raises(DataError, match=f"more than {LARGEST_SMALL} bytes"):
        read_small(file, remedy="-")


@pytest.mark.parametrize(("number", "says"), [(errno.ENOSPC, "Free space there"), (errno.EACCES, "you may write to")])
def test_what_cannot_be_written_is_said_with_a_remedy(number: int, says: str) -> None:
    with pytest.raises(UsageError, match=f"^folder cannot be written: .*{says}"), writing(Path("folder")):
        raise OSError(number, "-")


def test_integers_are_those_of_64_bits() -> None:
    assert parse_toml("a = 9223372036854775807\nb = -9223372036854775808", where="f") == {"a": 2**63 - 1, "b": -(2**63)}
    for text in (
        "a = 9223372036854775808",
        f"a = 0x{'f' * 9000}",
        f"a = {'9' * 9000}",
        "a = [[{b = 0xfffffffffffffffff}]]",
    ):
        with pytest.raises(ConfigError, match="an integer has more than 64 bits"):
            parse_toml(text, where="f")
    assert parse_json('{"a": 1000000000000000000000, "b": 7}', where="f") == {"a": 1e21, "b": 7}
    assert parse_json("9" * 9000, where="f") == float("inf")


@pytest.mark.parametrize("text", ["a = " + "[" * 60 + "]" * 60, "a" + ".b" * 60 + " = 1", "a = " + "[" * 9000])
def test_toml_nests_within_bounds(text: str) -> None:
    with pytest.raises(ConfigError, match="nested too deeply"):
        parse_toml(text, where="f")


def test_a_key_of_many_parts_is_refused_before_it_takes_memory() -> None:
    for key in ("a" + ".b" * 20_000, ' . "a b"' * 20_000, "[" + "a." * 20_000 + "a]"):
        tracemalloc.start()
        with pytest.raises(ConfigError, match="nested too deeply"):
            parse_toml(f"x{key} = 1\n", where="f")
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 10_000_000
    version = ".".join(["1"] * 30)
    assert parse_toml(f'a.b = "{version}"\nc = [{"0.1," * 1000}]', where="f")["a"] == {"b": version}


def test_equal_rows_are_no_recording(tmp_path: Path) -> None:
    file = tmp_path / "table.csv.gz"
    file.write_bytes(gzip.compress(b"t,x\n" + b"0,0.001\n" * 600_000))
    with pytest.raises(DataError, match="more than 100 times its size"):
        read_csv_bytes(file)

    rows = b"".join(b"%d,0.001\n" % n for n in range(600_000))
    file.write_bytes(gzip.compress(b"t,x\n" + rows))
    assert read_csv_bytes(file).endswith(rows)


def test_what_the_kernel_shows_as_a_file_is_empty() -> None:
    for name in ("/proc/self/mem", "/proc/kmsg"):  # the first cannot be read at 0, the second blocks
        if Path(name).exists():
            with open_regular(Path(name), remedy="-") as file:
                assert file.read() == b""


@pytest.mark.parametrize("text", ["[" * 60 + "]" * 60, '{"a":' * 60 + "1" + "}" * 60, "[" * 200_000])
def test_json_nests_within_bounds(text: str) -> None:
    with pytest.raises(DataError, match="nested too deeply"):
        parse_json(text, where="f")


@pytest.mark.parametrize("packed", [False, True])
def test_a_line_of_a_table_has_a_bound_wherever_it_begins(tmp_path: Path, packed: bool) -> None:
    file = tmp_path / ("table.csv.gz" if packed else "table.csv")
    pack = gzip.compress if packed else bytes
    line = b"1" * LONGEST_LINE
    for before in (b"t,x\n", b"t,x\n" * 40_000):
        file.write_bytes(pack(before + line + b"\n" + line))
        assert read_csv_bytes(file).endswith(line)

        file.write_bytes(pack(before + line + b"1\n"))
        with pytest.raises(DataError, match=f"line {before.count(10) + 1} is longer than {LONGEST_LINE} bytes"):
            read_csv_bytes(file)


@pytest.mark.parametrize(
    ("head", "row"),
    [(["root:$6$salt$hash:19000"], ["bin:*:19000"]), (["user", "password"], ["ana", "secret"]), (["a", "b"], [])],
)
def test_what_is_no_recording_is_refused_without_a_word_of_it(head: list[str], row: list[str]) -> None:
    with pytest.raises(DataError) as error:
        read_header(Path("file"), ",".join(head), ",".join(row))

    assert not any(cell in str(error.value) for cell in (*head, *row) if len(cell) > 1)


def test_an_error_is_one_line_that_a_terminal_can_show() -> None:
    error = DataError("a = '\x1b]0;title\x07\n\u202e\udcff'" + "x" * 9000, remedy="b\nc")

    assert str(error).isprintable()
    assert len(str(error)) < 1100
    assert r"\x1b]0;title\x07\n\u202e\udcff" in str(error)
    assert single_line("K_A = 0.297 A/V, x 5 \u00b5m") == "K_A = 0.297 A/V, x 5 \u00b5m"
