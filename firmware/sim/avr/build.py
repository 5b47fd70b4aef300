"""Compiles the firmware of the ATmega328P, and the simulator that runs it; both once for each version of their sources.

Needs avr-gcc with avr-libc, and libsimavr (Debian: gcc-avr avr-libc libsimavr-dev, and a C compiler).
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from gateway.emulator.native.build import build_option, cached, compiler
from gateway.emulator.native.flags import SOURCES, flags
from protocol.errors import InstallError, ServiceError, UsageError

_SHIM = Path(__file__).with_name("simavr.c")
_REMEDY = "Install them (Debian: apt-get install gcc gcc-avr avr-libc libsimavr-dev), or fly --firmware python or c"


@dataclass(frozen=True, slots=True)
class Image:
    """A program: the content of the flash memory, and the addresses of its symbols (RAM from 0x800000 on)."""

    code: bytes
    symbols: Mapping[str, int]

    def ram(self, name: str) -> int:
        """Return the address of a variable in RAM."""
        return self.symbols[name] & 0xFFFF


def sources() -> list[Path]:
    """Return the C files of the core and of the chip's hardware layer, and what the linker checks."""
    return [*sorted([*SOURCES.glob("core/*.c"), *SOURCES.glob("avr/*.c")]), SOURCES / "avr" / "stack.ld"]


def missing() -> str | None:
    """Return what is not installed, or None."""
    if shutil.which("avr-gcc") is None:
        return "avr-gcc"
    program = compiler()
    if program is None:
        return "a C compiler"
    command = [program, "-x", "c", "-E", "-", "-o", "/dev/null"]
    probe = subprocess.run(command, input=b"#include <simavr/sim_avr.h>\n", capture_output=True, check=False)
    return "libsimavr" if probe.returncode else None


def compile_image(target: Path, *, baud: int = 115200, profile: str = "", options: tuple[str, ...] = ()) -> None:
    """Compile the firmware into the ELF file `target`.

    Args:
        target: The file to write.
        baud: Of the UART.
        profile: Header with the numbers of the rig: a name in firmware/avr, or a path; none: the emulated CE 152's.
        options: For the compiler, behind those that are always given.

    Raises:
        InstallError: avr-gcc is missing.
        UsageError: the chip's clock does not give this baud rate.
        ServiceError: the compiler fails.
    """
    if shutil.which("avr-gcc") is None:
        raise InstallError("The firmware of the AVR needs avr-gcc, and it is not found", remedy=_REMEDY)
    chosen = [build_option(), f"-DB51_BAUD=UINT32_C({baud})", *([f'-DB51_PROFILE="{profile}"'] if profile else [])]
    _run(["avr-gcc", *_flags(), *chosen, *options, *map(str, sources()), "-o", str(target)])


def hex_of(target: Path, *, baud: int = 115200, profile: str = "") -> int:
    """Compile the firmware into the Intel HEX file `target`; return its size in the flash memory, bytes.

    Raises:
        InstallError, UsageError, ServiceError: as `compile_image`.
    """
    with tempfile.TemporaryDirectory() as scratch:
        elf, flat = Path(scratch) / "firmware.elf", Path(scratch) / "code"
        compile_image(elf, baud=baud, profile=profile)
        for form, file in (("ihex", target), ("binary", flat)):
            _run(["avr-objcopy", "-O", form, *flags("AVR_HEX_FLAGS"), str(elf), str(file)])
        return flat.stat().st_size


def image_inputs() -> tuple[list[Path], tuple[object, ...]]:
    """Return the files and options that an image is made of, whatever its baud rate and profile."""
    return [*sources(), *SOURCES.glob("*/*.h")], (_flags(), build_option())


@cache
def image(baud: int = 115200, profile: str = "") -> Image:
    """Return the firmware for this baud rate and profile; compile it if it is not in the cache.

    Raises:
        InstallError, UsageError, ServiceError: as `compile_image`, or the cache cannot be written.
    """
    files, options = image_inputs()
    elf = cached(
        "avr.elf",
        files,
        (*options, baud, profile),
        lambda target: compile_image(target, baud=baud, profile=profile),
    )
    return load(elf)


def load(elf: Path) -> Image:
    """Read a compiled program."""
    with tempfile.TemporaryDirectory() as scratch:
        flat = Path(scratch) / "code"
        _run(["avr-objcopy", "-O", "binary", str(elf), str(flat)])
        code = flat.read_bytes()
    rows = (line.split() for line in _run(["avr-nm", str(elf)]).splitlines())
    return Image(code, {row[2]: int(row[0], 16) for row in rows if len(row) == 3})


def simulator() -> Path:
    """Return the library that runs the chip; compile it if it is not in the cache.

    Raises:
        InstallError: a C compiler or libsimavr is missing.
        ServiceError: the compiler fails, or the cache cannot be written.
    """
    absent = missing()
    if absent is not None:
        raise InstallError(f"The simulated AVR needs avr-gcc and libsimavr, and {absent} is not found", remedy=_REMEDY)
    options = ["-O2", "-fPIC", "-shared"]
    command = [str(compiler()), *options, str(_SHIM), "-lsimavr", "-o"]
    return cached("simavr.so", [_SHIM], options, lambda target: _run([*command, str(target)]))


def _flags() -> tuple[str, ...]:
    return flags("AVR_FLAGS", "AVR_CONFIG")


def _run(command: list[str]) -> str:
    process = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    if process.returncode == 0:
        return process.stdout
    message = next((line for line in process.stderr.splitlines() if "error" in line), process.stderr.strip())
    if "#error BAUD" in message or '#error "BAUD' in message:
        raise UsageError(
            "The AVR at 16 MHz does not give this baud rate within 2.5 %", remedy="Give --baud 57600, 115200 or 250000"
        )
    raise ServiceError(f"{command[0]} fails: {message}", remedy=_REMEDY)
