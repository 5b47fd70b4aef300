"""Every option that names a file or folder, given everything that is none: exit code 2, one line, no wait.

The test's own time limit is the guard against waiting for ever: a pipe that nobody writes to, a device that never ends.
"""

from __future__ import annotations

import contextlib
import gzip
import os
import socket
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest

import board51

pytestmark = pytest.mark.xdist_group("file-arguments")  # they share what is slow to make and to import
DIGITS = "1" * 5000


def _pipe(path: Path) -> None:
    os.mkfifo(path)


def _socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made, contextlib.chdir(path.parent):  # a socket's path is short
        made.bind(path.name)


def _mat(path: Path) -> None:
    """A matrix of 600 MB of zeros in 600 kB."""
    packed = zlib.compressobj(9)
    data = packed.compress(struct.pack("<II", 14, 600_000_000))
    data += b"".join(packed.compress(bytes(1_000_000)) for _ in range(600)) + packed.flush()
    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM"
    path.write_bytes(head + struct.pack("<II", 15, len(data)) + data)


def _huge_cell(path: Path) -> None:
    """A table whose one cell has 50 MB."""
    with gzip.open(path, "wb", compresslevel=1) as file:
        file.write(b"t,x\n0.0,")
        for _ in range(50):
            file.write(b"1" * 1_000_000)


def _equal_rows(path: Path) -> None:
    """A table of a million and a half equal rows in 20 kB."""
    with gzip.open(path, "wb") as file:
        file.write(b"t,x\n")
        for _ in range(15):
            file.write(b"0,0.001\n" * 100_000)


BAD: dict[str, Callable[[Path], object]] = {
    "absent": lambda path: None,
    "folder": Path.mkdir,
    "pipe": _pipe,
    "socket": _socket,
    "endless": lambda path: path.symlink_to("/dev/zero"),
    "memory": lambda path: path.symlink_to("/proc/self/mem"),
    "random": lambda path: path.symlink_to("/dev/urandom"),
    "terminal": lambda path: path.symlink_to("/dev/tty"),
    "loop": lambda path: path.symlink_to(path),
    "empty": lambda path: path.write_bytes(b""),
    "binary": lambda path: path.write_bytes(bytes(range(256)) * 64),
    "nested JSON": lambda path: path.write_text("[" * 200_000),
    "nested object": lambda path: path.write_text('{"plant":' * 200_000),
    "nested TOML": lambda path: path.write_text("plant = " + "[" * 200_000),
    "nested keys": lambda path: path.write_text("plant" + ".a" * 3_000 + " = 1\n"),
    "sixty thousand keys": lambda path: path.write_text("plant" + ".a" * 60_000 + " = 1\n"),
    "digits": lambda path: path.write_text(f"[plant]\nmass_kg = {DIGITS}\n"),
    "hexadecimal digits": lambda path: path.write_text(f"[plant]\nmass_kg = 0x{'f' * 5000}\n"),
    "digits in JSON": lambda path: path.write_text(f'{{"plant": {DIGITS}}}'),
    "another table": lambda path: path.write_text('[a]\nb = "c"\n'),
    "another object": lambda path: path.write_text('{"a": [1, 2]}'),
    "control characters": lambda path: path.write_bytes(b"\x1b]0;title\x07,\x1b[2J\n1,2\n"),
    "one cell": _huge_cell,
    "equal rows": _equal_rows,
    "matrix": _mat,
    "large": lambda path: path.write_text('# "'.ljust(100) * 60_000),
}
NOBODY_MAY: dict[str, Callable[[Path], object]] = {"not readable": lambda path: path.touch(0o000)}

GOOD_TABLE = "t,u_c,i_c,x\n" + "".join(f"{n * 2e-3:.3f},1.0,0.3,0.0\n" for n in range(20))
CAMPAIGN = '[plant]\nmass_kg = 8.28e-3\ntravel_m = 5.7e-3\n[[recording]]\nfile = "{file}"\nkind = "free"\nuse = "fit"\n'

# BAD is the file that is none, GOOD a table that is one, CAMPAIGN one of GOOD, OUT what may be written.
INPUTS: tuple[str, ...] = (
    "campaign run OUT --plant BAD --board rig --connect tcp/127.0.0.1:1",
    "design BAD",
    "diagnose --live 5 --plant BAD --out OUT --connect tcp/127.0.0.1:1",
    "diagnose BAD --out OUT",
    "diagnose BAD-RECORDING --out OUT",
    "diagnose CAMPAIGN --model BAD --out OUT",
    "emulate --secret 7 --sealed BAD --pty OUT",
    "export BAD -o OUT.csv",
    "foxglove --identity BAD --connect tcp/127.0.0.1:1",
    "foxglove BAD -o OUT.mcap",
    "gateway --config BAD --no-log",
    "gateway --security BAD --no-log --board rig=/dev/null",
    "hmi --identity BAD --connect tcp/127.0.0.1:1",
    "hmi --security BAD --connect tcp/127.0.0.1:1",
    "hmi --users BAD --connect tcp/127.0.0.1:1",
    "identify BAD",
    "identify BAD-RECORDING",
    "import --campaign BAD -o OUT",
    "import --campaign BAD-RECORDING -o OUT",
    "import BAD -o OUT.mcap",
    "import BAD.mat -o OUT.mcap",
    "import BAD.parquet -o OUT.mcap",
    "info BAD",
    "opcua --security BAD --connect tcp/127.0.0.1:1",
    "plot BAD --out OUT.png",
    "predict BAD GOOD",
    "predict ce152 BAD",
    "predict ce152 BAD.mat",
    "predict ce152 GOOD --campaign BAD",
    "record --identity BAD -o OUT --connect tcp/127.0.0.1:1",
    "recover BAD -o OUT.mcap",
    "replay BAD --bytes --pty OUT",
    "replay BAD --connect tcp/127.0.0.1:1",
    "router --config BAD",
    "router --security BAD",
    "security add-user BAD ana:viewer",
    "security check BAD",
    "security remove-user BAD ana",
    "security renew BAD",
    "security zenoh-config BAD",
    "send rig stop --identity BAD --connect tcp/127.0.0.1:1",
    "twin --hand-over BAD --connect tcp/127.0.0.1:1",
    "twin --identity BAD --connect tcp/127.0.0.1:1",
    "twin --log BAD",
    "twin --model BAD --connect tcp/127.0.0.1:1",
    "validate BAD --model ce152 --out OUT",
    "validate CAMPAIGN --model BAD --out OUT",
    "watch --identity BAD --connect tcp/127.0.0.1:1",
)


# Written where nothing is: given nothing, they are right.
MAKES_IT = ("emulate --secret 7 --sealed BAD --pty OUT",)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`good`: a table and its campaign.  For each BAD a folder: it as `bad`, .mat and .parquet, and its campaign."""
    root = tmp_path_factory.mktemp("files")
    (root / "good").mkdir()
    (root / "good" / "good.csv").write_text(GOOD_TABLE)
    (root / "good" / "campaign.toml").write_text(CAMPAIGN.format(file="good.csv"))
    for kind, make in kinds().items():
        subfolder = root / kind / "recording"
        subfolder.mkdir(parents=True)
        make(root / kind / "bad")
        for copy in (root / kind / "bad.mat", root / kind / "bad.parquet", subfolder / "bad.csv"):
            if (root / kind / "bad").is_file() and not (root / kind / "bad").is_symlink():
                copy.hardlink_to(root / kind / "bad")
            else:
                make(copy)
        (subfolder / "campaign.toml").write_text(CAMPAIGN.format(file="bad.csv"))
    return root


def kinds() -> dict[str, Callable[[Path], object]]:
    return BAD if os.geteuid() == 0 else BAD | NOBODY_MAY


def find_problem(capsys: pytest.CaptureFixture[str], words: list[str]) -> str:
    """Return the fault of this command's answer to a bad argument; "" if there is none."""
    try:
        code = board51.main(words)
    except SystemExit as ended:
        code = int(ended.code or 0)
    err = capsys.readouterr().err
    good = code == 2 and len(err.splitlines()) == 1 and err.rstrip("\n").isprintable() and len(err) < 2500
    return "" if good else f"{' '.join(words)}: {code}, {err[:500]!r}"


@pytest.mark.parametrize("line", INPUTS)
def test_a_file_that_is_none_is_refused_in_one_line(
    line: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    faults = []
    for kind in kinds():
        if kind == "absent" and line in MAKES_IT:
            continue
        places = {
            "BAD-RECORDING": folder / kind / "recording",
            "BAD": folder / kind / "bad",
            "CAMPAIGN": folder / "good",
            "GOOD": folder / "good" / "good.csv",
            "OUT": tmp_path / "out",
        }
        words = []
        for word in line.split():
            for name, path in places.items():
                word = word.replace(name, str(path))
            words.append(word)
        if problem := find_problem(capsys, words):
            faults.append(f"{kind}: {problem}")

    assert faults == []


# IN-A-FILE lies in a file as if that were a folder; the rest is right.
OUTPUTS = (
    "demo --out IN-A-FILE",
    "design ce152 --out IN-A-FILE",
    "emulate --pty IN-A-FILE",
    "emulate --secret 7 --sealed IN-A-FILE --pty OUT",
    "export LOG -o IN-A-FILE --format csv",
    "foxglove LOG -o IN-A-FILE",
    "gateway --board rig=/dev/null --log-dir IN-A-FILE --listen tcp/127.0.0.1:0",
    "identify CAMPAIGN --out IN-A-FILE --quiet",
    "import --campaign CAMPAIGN -o IN-A-FILE",
    "import GOOD -o IN-A-FILE",
    "plot LOG --out IN-A-FILE.png",
    "predict ce152 GOOD --out IN-A-FILE",
    "record -o IN-A-FILE --connect tcp/127.0.0.1:1",
    "recover LOG -o IN-A-FILE",
    "security init IN-A-FILE",
    "security zenoh-config KEYS/identities/views --out IN-A-FILE",
    "twin --log LOG --out IN-A-FILE",
    "validate CAMPAIGN --model ce152 --out IN-A-FILE",
)


@pytest.fixture(scope="module")
def right(folder: Path) -> dict[str, Path]:
    """Provide the inputs that the commands need besides the path to write to."""
    good = folder / "good"
    assert board51.main(["import", str(good / "good.csv"), "-o", str(good / "good.mcap")]) == 0
    assert board51.main(["security", "init", str(good / "keys")]) == 0
    (folder / "file").write_text("x")
    names = {"CAMPAIGN": good, "GOOD": good / "good.csv", "LOG": good / "good.mcap", "KEYS": good / "keys"}
    return names | {"IN-A-FILE": folder / "file" / "out"}


@pytest.mark.parametrize("line", OUTPUTS)
def test_a_place_that_cannot_be_written_is_refused_in_one_line(
    line: str, right: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = line
    for name, path in (right | {"OUT": tmp_path / "out"}).items():
        words = words.replace(name, str(path))
    capsys.readouterr()

    try:
        code = board51.main(words.split())
    except SystemExit as ended:
        code = int(ended.code or 0)

    err = capsys.readouterr().err
    assert code in (1, 2), err  # 1: a log, which is written to a disk that says no
    assert len(err.splitlines()) == 1
    assert "file" in err
