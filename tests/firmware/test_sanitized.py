"""The firmware under the compiler's watch: no access outside an array, no overflow, nothing undefined, whatever comes.

A process of its own, as the address sanitizer has to be loaded before everything else.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from gateway.emulator.native.build import compile_to, compiler
from gateway.emulator.native.flags import flags
from protocol.errors import ServiceError
from tests.harness.gateway.board_host import skip_without_compiler

pytestmark = pytest.mark.slow

OPTIONS = flags("SANITIZE_FLAGS")
REPOSITORY = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def sanitized(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The library, and what has to be preloaded for it."""
    skip_without_compiler()
    path: Path = tmp_path_factory.mktemp("sanitized") / "firmware.so"
    try:
        compile_to(path, options=OPTIONS)
    except ServiceError as error:
        pytest.skip(f"the compiler has no sanitizers: {error.problem}")
    command = [str(compiler()), "-print-file-name=libasan.so"]
    runtime = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    if not Path(runtime).is_absolute():
        pytest.skip("the compiler has no address sanitizer that can be preloaded")
    return path, runtime


def run_watched(sanitized: tuple[Path, str], *arguments: str) -> subprocess.CompletedProcess[str]:
    path, runtime = sanitized
    environment = os.environ | {
        "LD_PRELOAD": runtime,
        "ASAN_OPTIONS": "detect_leaks=0",  # Python's own, at its end
        "UBSAN_OPTIONS": "print_stacktrace=1",
        "PYTHONMALLOC": "malloc",  # so that the memory of a board has an end that is watched
    }
    command = [sys.executable, "-m", arguments[0], str(path), *arguments[1:]]
    return subprocess.run(command, cwd=REPOSITORY, env=environment, capture_output=True, text=True, check=False)


def test_a_minute_of_anything_is_defined(sanitized: tuple[Path, str]) -> None:
    process = run_watched(sanitized, "tests.harness.firmware.random_host", "15000", "21", "22", "23")

    assert process.returncode == 0, process.stderr
    assert process.stdout.count("ticks=15000") == 3


def test_a_fuzzed_parser_reads_nothing_beyond_its_buffer(sanitized: tuple[Path, str]) -> None:
    process = run_watched(sanitized, "tests.harness.firmware.fuzz", "60000", "1", "2")

    assert process.returncode == 0, process.stderr
    assert process.stdout.count("frames=60000") == 2


def test_the_watch_would_tell(sanitized: tuple[Path, str], tmp_path: Path) -> None:
    """A library with an access beyond an array, compiled the same way, does end the process."""
    path = tmp_path / "broken.so"
    source = tmp_path / "broken.c"
    source.write_text("static int a[4];\nint broken(int n) { return a[n]; }\n", encoding="utf-8")
    subprocess.run([str(compiler()), "-fPIC", "-shared", *OPTIONS, str(source), "-o", str(path)], check=True)
    script = f"import ctypes; ctypes.CDLL({str(path)!r}).broken(4)"

    process = subprocess.run(
        [sys.executable, "-c", script],
        env=os.environ | {"LD_PRELOAD": sanitized[1], "ASAN_OPTIONS": "detect_leaks=0"},
        capture_output=True,
        text=True,
        check=False,
    )

    assert process.returncode != 0
    assert "out of bounds" in process.stderr
