"""Compiles the firmware's core for this machine, once for each version of its sources.

Rule 1: the library lies in the user's cache, under a name made of its sources and options.  A change of either compiles
        it again.  An installation needs no compiler until this firmware is used.
Rule 2: the file appears in the cache only when it is complete, so processes may compile it at the same time.
"""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from platformdirs import user_cache_path

from gateway.emulator.native.flags import SOURCES, flags
from protocol.errors import InstallError, ServiceError

_LINUX = ("POSIX_LINUX",) if sys.platform == "linux" else ()
_COMPILERS = ("cc", "gcc", "clang")


def sources() -> list[Path]:
    """Return the C files of the core and of its hardware on a computer."""
    return sorted([*SOURCES.glob("core/*.c"), *SOURCES.glob("posix/*.c")])


def compiler() -> str | None:
    """Return the path of a C compiler: $CC, or the first of cc, gcc, clang that is there; None without one."""
    named = os.environ.get("CC")
    return next(filter(None, map(shutil.which, [named] if named else _COMPILERS)), None)


def compile_to(target: Path, *, files: Sequence[Path] = (), options: Sequence[str] = ()) -> None:
    """Compile `files`, by default `sources()`, into a library, with `options` behind those that are always given.

    Raises:
        InstallError: there is no C compiler.
        ServiceError: it fails.
    """
    program = compiler()
    if program is None:
        configured = os.environ.get("CC")
        looked_for = f"CC={configured} is not" if configured else "neither cc, gcc nor clang is"
        raise InstallError(
            f"The firmware in C needs a C compiler, and {looked_for} found",
            remedy="Install one (Debian: apt-get install gcc libc6-dev), or fly the Python firmware, the default",
        )
    command = [program, *flags("POSIX_FLAGS"), *options, *map(str, files or sources())]
    command += [*flags(*_LINUX), "-o", str(target)]
    process = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    if process.returncode != 0:
        message = next((line for line in process.stderr.splitlines() if "error" in line), process.stderr.strip())
        raise ServiceError(
            f"{program} cannot compile the firmware: {message}",
            remedy="Install a complete C compiler (Debian: apt-get install gcc libc6-dev), or fly the Python firmware",
        )


@cache
def build_of_sources() -> bytes:
    """Return IDENTITY.build of an image, 8 ASCII characters: the commit or release of its sources.

    A commit has 8 digits, or 7 and a `+` if the sources differ from it.  Outside of a clone: the installed version.
    """
    if _git("ls-files", "core/core.h"):
        commit = _git("rev-parse", "HEAD")
        text = f"{commit[:7]}+" if _git("status", "--porcelain", ".") else commit[:8]
    else:
        try:
            text = version("board51")
        except PackageNotFoundError:
            text = ""
    return (text or "unknown").encode("ascii", "replace").ljust(8)[:8]


def build_option() -> str:
    """Return the compiler's option that sets IDENTITY.build."""
    return "-DB51_FIRMWARE_BUILD=" + ",".join(map(str, build_of_sources()))


def _git(*words: str) -> str:
    try:
        process = subprocess.run(["git", "-C", str(SOURCES), *words], capture_output=True, text=True, check=False)
    except OSError:  # no git
        return ""
    return process.stdout.strip() if process.returncode == 0 else ""


def library() -> Path:
    """Return the compiled library; compile it if it is not in the cache.

    Raises:
        InstallError: there is no C compiler.
        ServiceError: it fails, or the cache cannot be written.
    """
    return cached("firmware.so", [*sources(), *SOURCES.glob("*/*.h")], flags("POSIX_FLAGS", *_LINUX), compile_to)


def cached(name: str, inputs: Iterable[Path], options: object, make: Callable[[Path], object]) -> Path:
    """Return a file from the cache, by `name` with a key of inputs and options; if it is not there, `make` writes it.

    Raises:
        ServiceError: the cache cannot be written.
    """
    key = hashlib.sha256(repr((options, platform.machine())).encode())
    for path in sorted(inputs):
        key.update(path.name.encode() + b"\0" + path.read_bytes())
    folder = user_cache_path("board51", appauthor=False)
    stem, dot, ending = name.partition(".")
    target = folder / f"{stem}-{key.hexdigest()[:16]}{dot}{ending}"
    if target.exists():
        return target
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder) as scratch:
            make(Path(scratch) / target.name)
            os.replace(Path(scratch) / target.name, target)
    except OSError as error:
        raise ServiceError(
            f"The compiled firmware cannot be kept in {folder}: {error.strerror or error}",
            remedy="Make that folder writable (Linux: or set XDG_CACHE_HOME to another)",
        ) from None
    return target
