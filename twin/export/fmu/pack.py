"""The FMU as a file: description, C sources, and a binary for the machine that exports.

Rule 1: the same model, controller and version give the same bytes, but for the binary, which depends on the compiler.
Rule 2: a missing C compiler is not an error: other machines compile the sources anyway.
"""

from __future__ import annotations

import io
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from dataclasses import dataclass
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path
from uuid import UUID

from protocol.errors import UsageError
from twin.control import LawNumbers
from twin.export.fmu.description import SOURCES, Description, build3, fmi2, fmi3
from twin.export.fmu.model_c import header, source
from twin.export.rig import rig
from twin.export.variables import title, variables
from twin.model.parameters import Model, model_text
from twin.model.simulate import left_out

INTERFACES = {"2.0": "fmi2.c", "3.0": "fmi3.c"}
COMPILERS = ("gcc", "cc", "clang")
# Contraction would give other last digits than the twin's own kernels.
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared", "-fvisibility=hidden")
_SUFFIX = {"linux": "so", "win32": "dll", "darwin": "dylib"}
_FIRST_DAY = (1980, 1, 1, 0, 0, 0)  # of zip


@dataclass(frozen=True, slots=True, kw_only=True)
class Fmu:
    """The content of an FMU."""

    content: bytes
    identifier: str
    platform: str | None  # folder of the binary; None: sources only


def fmu(model: Model, law: LawNumbers, *, fmi: str = "2.0", compiler: str | None = None) -> Fmu:
    """Export a model as a co-simulation FMU, whose T_s is that of the law; compiler and errors as in `export_model`."""
    T_s = law.sample_time_s
    program, listed = rig(model, T_s), variables(model, law)
    absent = tuple(left_out(model))
    # Of the content: a random one would make equal exports differ.
    token = str(UUID(bytes=sha256(repr((model_text(model), law, fmi, _tool())).encode()).digest()[:16]))
    description = Description(
        identifier=identifier(model.plant.name),
        title=title(model),
        text=". ".join((f"{title(model)}, {len(model.causes)} causes, T_s = {T_s:g} s", *absent)),
        token=f"{{{token}}}",
        sample_time_s=T_s,
        variables=tuple(listed),
        tool=_tool(),
    )
    sources = {
        "model.h": header(program, listed, T_s, description.token),
        "model.c": source(program, listed, description.title),
        **{name: _shipped(name) for name in ("slave.h", "slave.c", INTERFACES[fmi])},
    }
    content = {f"sources/{name}": text.encode() for name, text in sources.items()}
    content["modelDescription.xml"] = (fmi2 if fmi == "2.0" else fmi3)(description).encode()
    if fmi == "3.0":
        content["sources/buildDescription.xml"] = build3(description).encode()
    folder = None
    chosen = next(filter(None, map(shutil.which, COMPILERS)), None) if compiler is None else compiler
    if chosen and shutil.which(chosen) is None:
        raise UsageError(f"--compiler {chosen} is not found", remedy="Install it, or give '' for sources only")
    if chosen:
        folder, suffix = platform_folder(fmi)
        binary = f"binaries/{folder}/{description.identifier}.{suffix}"
        content[binary] = compiled(sources, [*SOURCES, INTERFACES[fmi]], chosen)
    return Fmu(content=_zipped(content), identifier=description.identifier, platform=folder)


def identifier(name: str) -> str:
    """Return the name of a rig as a name of C."""
    text = re.sub(r"\W", "_", name, flags=re.ASCII)
    return text if text[:1].isalpha() else f"rig_{text}"


def platform_folder(fmi: str) -> tuple[str, str]:
    """Return (folder of the binaries for this machine, suffix of the file)."""
    system = {"linux": "linux", "win32": "windows", "darwin": "darwin"}[sys.platform]
    if fmi == "2.0":
        return f"{system.removesuffix('dows')}{64 if sys.maxsize > 2**32 else 32}", _SUFFIX[sys.platform]
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(platform.machine().lower(), platform.machine().lower())
    return f"{machine}-{system}", _SUFFIX[sys.platform]


def compiled(sources: dict[str, str], units: list[str], compiler: str) -> bytes:
    """Compile the sources into a shared library.  Raises UsageError."""
    with tempfile.TemporaryDirectory() as folder:
        for name, text in sources.items():
            Path(folder, name).write_text(text, encoding="utf-8")
        compilation = subprocess.run(
            [compiler, *FLAGS, *units, "-o", "fmu.bin", "-lm"], cwd=folder, capture_output=True, text=True, check=False
        )
        if compilation.returncode:
            first = (compilation.stderr.strip() or f"exit code {compilation.returncode}").splitlines()[0]
            raise UsageError(
                f"{compiler} does not compile the FMU: {first}",
                remedy="Give --compiler '' for an FMU with sources only",
            )
        return Path(folder, "fmu.bin").read_bytes()


def _zipped(content: dict[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in sorted(content.items()):
            # A fixed day and mode, so that the bytes are the same (rule 1).
            entry = zipfile.ZipInfo(name, _FIRST_DAY)
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            archive.writestr(entry, data)
    return stream.getvalue()


def _shipped(name: str) -> str:
    return files("twin.export.fmu").joinpath("sources", name).read_text(encoding="utf-8")


def _tool() -> str:
    try:
        return f"board51 {version('board51')}"
    except PackageNotFoundError:
        return "board51"
