"""Builds the image of an ADuC841 by sdcc, and the chip's simulator by this machine's compiler; each once, as native/.

An image is one file: its code, and where the program keeps what `board.py` shows (`symbols` of the linker's map).
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Final

from gateway.emulator.native.build import build_option, cached, compile_to
from gateway.emulator.native.flags import SOURCES, flags
from protocol.errors import InstallError, ServiceError, UsageError

CLOCK_HZ: Final = 20_000_000  # firmware/mcs51/part.h

_FOLDER = Path(__file__).resolve().parent
_SIMULATOR = (_FOLDER / "cpu.c", _FOLDER / "chip.c")
_REMEDY = "Install it (Debian: apt-get install gcc libc6-dev sdcc), or fly --firmware python or c"
_BAUD_ERROR = 0.02


def image_sources() -> list[Path]:
    """Return the C files of the image, the one with the interrupts first, as the linker wants it."""
    return [SOURCES / "mcs51" / "mcs51.c", *sorted(SOURCES.glob("core/*.c"))]


def build_image(target: Path, *, baud: int = 115200, options: Sequence[str] = ()) -> None:
    """Compile and link the image.

    Args:
        target: The file to write.
        baud: Of the line, bits per second.
        options: For the compiler, behind those that are always given: another clock or configuration.

    Raises:
        InstallError: there is no sdcc.
        ServiceError: it fails, or finds anything to warn of.
    """
    if shutil.which("sdcc") is None:
        raise InstallError("The firmware of the 8051 needs sdcc, and it is not found", remedy=_REMEDY)
    chosen = [build_option(), f"-DB51_BAUD=UINT32_C({baud})", *options]
    with tempfile.TemporaryDirectory() as scratch:
        # By the words of the Makefile, in a copy: the registers that sdcc chooses depend on the length of its paths.
        for part in ("core", "mcs51"):
            shutil.copytree(SOURCES / part, Path(scratch) / part)
        files = [source.relative_to(SOURCES).as_posix() for source in image_sources()]
        for file in files:
            command = ["sdcc", *flags("MCS51_FLAGS", "MCS51_WARNINGS", "MCS51_CONFIG"), *chosen, "-c", file]
            _run(command, Path(scratch))
        objects = [f"{Path(file).stem}.rel" for file in files]
        _run(["sdcc", *flags("MCS51_FLAGS", "MCS51_LINK"), *objects, "-o", "image.ihx"], Path(scratch))
        linked = Path(scratch) / "image.ihx"
        image = {
            "code": code_of(linked.read_text(encoding="ascii")).hex(),
            "symbols": _symbols(linked.with_suffix(".map").read_text(encoding="utf-8")),
            "sizes": _sizes(linked.with_suffix(".mem").read_text(encoding="utf-8")),
        }
    target.write_text(json.dumps(image), encoding="utf-8")


def image(baud: int = 115200) -> Path:
    """Return the image; build it if it is not in the cache.

    Raises:
        InstallError: there is no sdcc.
        UsageError: the part does not give this baud rate.
        ServiceError: sdcc fails, or the cache cannot be written.
    """
    if abs(actual_baud(baud) / baud - 1) > _BAUD_ERROR:
        raise UsageError(
            f"The 8051 at {CLOCK_HZ / 1e6:g} MHz does not give {baud} baud",
            remedy="Give --baud 57600, 115200 or 230400",
        )
    made_of = [*image_sources(), *SOURCES.glob("core/*.h"), *SOURCES.glob("mcs51/*.h")]
    make = partial(build_image, baud=baud)
    return cached(
        "mcs51.json", made_of, (flags("MCS51_FLAGS", "MCS51_LINK", "MCS51_CONFIG"), build_option(), baud), make
    )


def actual_baud(baud: int) -> float:
    """Return what timer 3 makes of a baud rate: the arithmetic of firmware/mcs51/part.h, as the data sheet has it."""
    divider = min(max((CLOCK_HZ // 16 // max(baud, 1)).bit_length() - 1, 1), 7)
    fraction = round(2 * CLOCK_HZ / (1 << divider - 1) / max(baud, 1)) - 64
    return 2 * CLOCK_HZ / (1 << divider - 1) / (min(max(fraction, 0), 255) + 64)


def simulator() -> Path:
    """Return the compiled simulator; compile it if it is not in the cache.

    Raises:
        InstallError: there is no C compiler.
        ServiceError: the compiler fails, or the cache cannot be written.
    """
    made_of = [*_SIMULATOR, *_FOLDER.glob("*.h")]
    return cached("mcs51.so", made_of, "simulator", partial(compile_to, files=_SIMULATOR))


def code_of(hex_file: str) -> bytes:
    """Return the program memory that a file in Intel's hexadecimal format fills, from 0 on; gaps are 0xFF."""
    code = bytearray()
    for line in hex_file.split():
        record = bytes.fromhex(line[1:])
        size, address, kind = record[0], int.from_bytes(record[1:3], "big"), record[3]
        if kind == 0:
            code += b"\xff" * (address + size - len(code))
            code[address : address + size] = record[4 : 4 + size]
    return bytes(code)


def _symbols(map_file: str) -> dict[str, int]:
    """Return the addresses of the program's functions and variables, as C names them."""
    return {name: int(at, 16) for at, name in re.findall(r"\s([0-9A-F]{8})\s+_(\w+)", map_file)}


def _sizes(mem_file: str) -> dict[str, int]:
    """Return the linker's account: bytes of code and external RAM, and where the stack begins."""
    external, code = (
        int(re.findall(rf"{name}\s+0x\w+\s+0x\w+\s+(\d+)", mem_file)[0]) for name in ("EXTERNAL RAM", "ROM/EPROM/FLASH")
    )
    (stack,) = re.findall(r"sp set to 0x([0-9a-f]+)", mem_file)
    return {"code": code, "external_ram": external, "stack_from": int(stack, 16) + 1}


def _run(command: list[str], folder: Path) -> None:
    process = subprocess.run(command, cwd=folder, capture_output=True, text=True, errors="replace", check=False)
    if process.returncode != 0:
        message = next((line for line in process.stderr.splitlines() if "rror" in line), process.stderr.strip())
        raise ServiceError(f"{command[0]} fails: {message}", remedy=_REMEDY)
