"""Compile the firmware for a board, write it into its flash memory with avrdude, and ask the board what it does.

For an Arduino Uno with a MagnetoShield, through the Uno's boot loader.  firmware/magnetoshield.md has the ten steps.
--dry-run compiles, touches no port, and prints the command; the image stays in the cache.
"""

from __future__ import annotations

import argparse
import json
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from gateway.link.port import PortProblem, open_port
from protocol.errors import InstallError, ServiceError, UsageError, single_line
from protocol.files import writing

if TYPE_CHECKING:
    from gateway.emulator.firmware_model.magnetoshield import MagnetoShieldProfile

BOARDS = ("magnetoshield",)
_HANG_S = 120.0  # writing and reading back 32 kB takes 10 s
_BOOT_LOADER_BAUD = 115200  # of an Uno's Optiboot
_FLASH_BYTES = 32256  # what the boot loader leaves
_AGAIN = "Unplug the Uno and plug it in again, end what uses the port, and repeat: the boot loader is untouched"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.epilog = (
        "examples:\n"
        "  board51 flash --board magnetoshield --dry-run\n"
        "  board51 flash --board magnetoshield --port /dev/ttyACM0\n\n"
        "needs avr-gcc with avr-libc, and avrdude (Debian: apt-get install gcc-avr avr-libc avrdude);\n"
        "--out writes the image for another programmer, without avrdude and port\n\n"
        "fuses stay as they are, as no boot loader can write them; the image needs those of an Uno (low 0xFF:\n"
        "crystal, clock not divided), and a brown-out detector at 4.3 V is better\n"
        "than the Uno's 2.7 V: see firmware/README.md"
    )
    parser.add_argument("--board", choices=BOARDS, required=True, help="board of the firmware")
    parser.add_argument("--port", metavar="DEVICE", help="serial device of the Uno: /dev/ttyACM0")
    parser.add_argument("--baud", type=int, default=115200, help="speed of the firmware's UART (default: %(default)s)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the image (Intel HEX) there and stop")
    parser.add_argument("--dry-run", action="store_true", help="compile, print the command of avrdude, touch no port")
    parser.add_argument("--json", action="store_true", help="print the command and the size as JSON")


def run(args: argparse.Namespace) -> int:
    """Compile, check, and let avrdude write and verify."""
    from gateway.commands.flashed import query_board
    from gateway.emulator.firmware_model.magnetoshield import magnetoshield
    from gateway.emulator.native.build import build_of_sources

    if args.out is None and args.port is None and not args.dry_run:
        raise UsageError("No port is given", remedy="Give --port /dev/ttyACM0, --dry-run, or --out FILE")
    if not 300 <= args.baud <= 4_000_000:
        raise UsageError(f"--baud {args.baud} is out of range", remedy="Give 57600, 115200 or 250000")
    if not args.dry_run and args.out is None:
        _check_avrdude()
        _check_port(args.port)
    image = _image(magnetoshield(), args.baud)
    size = _size(image)
    if size > _FLASH_BYTES:
        raise ServiceError(f"The image has {size} bytes, the chip {_FLASH_BYTES}", remedy="Report it")
    if args.out is not None:
        with writing(args.out):
            args.out.write_bytes(image.read_bytes())
        _print_result(args, size, None)
        return 0
    command = _command(args.port, image)
    _print_result(args, size, command)
    if args.dry_run:
        return 0
    _write(command)
    print(query_board(args.port, args.baud, build_of_sources()), file=sys.stderr if args.json else sys.stdout)
    return 0


def _image(profile: MagnetoShieldProfile, baud: int) -> Path:
    """Return the image for these numbers; compile it if it is not in the cache."""
    from firmware.sim.avr.build import hex_of, image_inputs
    from gateway.emulator.firmware_model.magnetoshield import header
    from gateway.emulator.native.build import cached

    numbers = header(profile)

    def make(target: Path) -> None:
        with tempfile.TemporaryDirectory(prefix="board51-") as scratch:
            chosen = Path(scratch) / "profile.h"
            chosen.write_text(numbers, encoding="ascii")
            hex_of(target, baud=baud, profile=str(chosen))

    files, options = image_inputs()
    return cached("magnetoshield.hex", files, (*options, baud, numbers), make)


def _size(image: Path) -> int:
    """Return how many bytes a file in Intel's hexadecimal format has: the sum of its records' first bytes."""
    records = (line for line in image.read_text(encoding="ascii").splitlines() if line[7:9] == "00")
    return sum(int(line[1:3], 16) for line in records)


def _command(port: str | None, image: Path) -> list[str]:
    """Return the command that writes and verifies the flash memory; fuses, boot loader and EEPROM stay as they are."""
    options = ["-q", "-p", "atmega328p", "-c", "arduino", "-b", str(_BOOT_LOADER_BAUD), "-P", port or "PORT", "-D"]
    return ["avrdude", *options, "-U", f"flash:w:{image}:i"]


def _check_port(port: str) -> None:
    """Open it once, as a gateway would: absent, no serial device, no permission, in use."""
    if "://" in port:
        raise UsageError(f"{port} is not a device of this computer", remedy="Give the Uno's, for example /dev/ttyACM0")
    opened = open_port(port, _BOOT_LOADER_BAUD)
    if isinstance(opened, PortProblem):
        raise UsageError(opened.text.rstrip(".?"), remedy="Give the Uno's device; see ls /dev/ttyACM* /dev/ttyUSB*")
    opened.close()


def _check_avrdude() -> None:
    if shutil.which("avrdude") is None:
        raise InstallError(
            "avrdude, which writes the flash memory, is not found",
            remedy="Install it (Debian: apt-get install avrdude), or write the image with --out FILE",
        )


def _print_result(args: argparse.Namespace, size: int, command: list[str] | None) -> None:
    outcome = shlex.join(command) if command is not None else f"written to {args.out}"
    if args.json:
        print(json.dumps({"board": args.board, "bytes": size, "of": _FLASH_BYTES, "command": command}))
    else:
        print(f"{args.board}: {size} of {_FLASH_BYTES} bytes; {outcome}")
    sys.stdout.flush()


def _write(command: list[str]) -> None:
    try:
        process = subprocess.run(
            command, check=False, timeout=_HANG_S, capture_output=True, text=True, errors="replace"
        )
    except subprocess.TimeoutExpired:
        raise ServiceError(f"avrdude has not ended after {_HANG_S:g} s", remedy=_AGAIN) from None
    if process.returncode == 0:
        return
    lines = [line.strip() for line in process.stderr.splitlines() if line.strip()]
    message = next(
        (line for line in lines if "not in sync" in line or "error" in line.lower()), lines[-1] if lines else ""
    )
    raise ServiceError(f"avrdude fails ({process.returncode}): {single_line(message, 200)}", remedy=_AGAIN)
