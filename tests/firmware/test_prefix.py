"""Every name that a program around the firmware can meet begins with b51_ or B51_, so that none meets a vendor's."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from gateway.emulator.native.flags import SOURCES, flags

HEADERS = sorted(path for part in ("core", "avr", "mcs51", "posix") for path in SOURCES.glob(f"{part}/*.h"))
PREFIX = re.compile(r"b51_|B51_|_")  # what begins with _ belongs to the compiler
EXTERNAL_NAMES = {"main", "F_CPU"}  # by the language and avr-libc
TARGETS = {
    "posix": ("gcc", "nm", ("POSIX_FLAGS",)),
    "avr": ("avr-gcc", "avr-nm", ("AVR_FLAGS", "AVR_CONFIG")),
    "mcs51": ("sdcc", "", ("MCS51_FLAGS", "MCS51_CONFIG")),
}


@pytest.mark.parametrize("target", TARGETS)
def test_the_symbols_of_the_objects(target: str, tmp_path: Path) -> None:
    compiler, reader, names = TARGETS[target]
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    symbols: set[str] = set()
    for source in [*SOURCES.glob("core/*.c"), *SOURCES.glob(f"{target}/*.c")]:
        out = tmp_path / f"{source.stem}.rel"
        command = [compiler, *flags(*names), "-c", str(source), "-o", str(out)]
        subprocess.run([word for word in command if word != "-shared"], check=True, cwd=tmp_path)
        symbols |= _global_symbols(out, reader)

    assert {"b51_board", "b51_board_poll", "b51_hal_send"} <= symbols
    assert {name for name in symbols if not PREFIX.match(name)} <= EXTERNAL_NAMES


def _global_symbols(out: Path, reader: str) -> set[str]:
    if not reader:  # sdcc: `S _name Def...`, with a bit's and a register's address behind it, too
        text = out.read_text(encoding="ascii")
        registers = {f"_{name}" for name in re.findall(r"\b(\w+)\b", _register_names())}
        return {name[1:] for name in re.findall(r"^S (_\w+) Def", text, re.M) if name not in registers}
    process = subprocess.run([reader, "-g", "--defined-only", str(out)], check=True, capture_output=True, text=True)
    return {line.split()[2] for line in process.stdout.splitlines()}


def _register_names() -> str:
    """The header of the part's registers, which sdcc makes symbols of every program that includes it."""
    command = ["sdcc", "-mmcs51", "-E", str(SOURCES / "mcs51" / "mcs51.c")]
    text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return "\n".join(line for line in text.splitlines() if "__sfr" in line or "__sbit" in line)


@pytest.mark.parametrize("path", HEADERS, ids=lambda path: path.name)
def test_the_names_in_a_header(path: Path) -> None:
    code = re.sub(r"/\*.*?\*/", "", path.read_text(encoding="utf-8"), flags=re.S)
    names = set(re.findall(r"^#\s*(?:define|ifndef|ifdef)\s+(\w+)", code, re.M))
    names |= set(re.findall(r"\b(?:struct|union|enum)\s+(\w+)\s*\{", code))
    for body in re.findall(r"\benum\s*\w*\s*\{([^}]*)\}", code):
        names |= {item.split("=")[0].strip() for item in body.split(",")} - {""}

    assert names
    assert {name for name in names if not PREFIX.match(name)} <= EXTERNAL_NAMES
