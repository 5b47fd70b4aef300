"""The firmware is compiled where somebody asks for it, once, and without a compiler they are told what is missing."""

from __future__ import annotations

import os
import stat
from importlib.metadata import version
from pathlib import Path

import pytest

import board51
from gateway.emulator.native import build
from gateway.emulator.native.board import NativeFirmware
from protocol.errors import InstallError, ServiceError
from tests.firmware.conftest import WARNINGS
from tests.harness.gateway.board_host import Bench, skip_without_compiler


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "board51"


def no_compiler(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))


def test_the_sources_compile_without_a_warning(tmp_path: Path) -> None:
    skip_without_compiler()

    build.compile_to(tmp_path / "firmware.so", options=WARNINGS)

    assert (tmp_path / "firmware.so").stat().st_size > 10_000


def test_it_is_compiled_once_and_then_taken_from_the_cache(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    skip_without_compiler()
    path = build.library()

    no_compiler(monkeypatch, tmp_path)  # an installation that moved to a machine without one has its cache
    again = build.library()

    assert again == path
    assert list(cache.iterdir()) == [path]


def test_without_a_compiler_one_line_says_what_to_install(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    no_compiler(monkeypatch, tmp_path)

    status = board51.main(["emulate", "--firmware", "c", "--tcp", "127.0.0.1:0", "--duration", "0.1"])

    error = capsys.readouterr().err
    assert status == 2
    assert error.count("\n") == 1
    assert "neither cc, gcc nor clang is found" in error
    assert "apt-get install gcc" in error
    assert list(cache.iterdir()) == []


def test_a_compiler_that_is_named_and_not_there_is_named(
    cache: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("CC", "no-such-cc")

    with pytest.raises(InstallError, match="CC=no-such-cc is not found"):
        build.library()


def test_a_compiler_that_fails_is_quoted_and_leaves_nothing(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = tmp_path / "brokencc"
    broken.write_text("#!/bin/sh\necho 'core.h:11: fatal error: stdint.h: No such file or directory' >&2\nexit 1\n")
    broken.chmod(broken.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("CC", str(broken))

    with pytest.raises(ServiceError, match=r"stdint\.h: No such file"):
        build.library()

    assert list(cache.iterdir()) == []


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes everywhere")
def test_a_cache_that_cannot_be_written_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    skip_without_compiler()
    tmp_path.chmod(0o500)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))

    with pytest.raises(ServiceError, match="cannot be kept in"):
        build.library()


def test_a_cache_that_is_a_file_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    skip_without_compiler()
    (tmp_path / "cache").write_bytes(b"")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))

    with pytest.raises(ServiceError, match="cannot be kept in"):
        build.library()


def test_boards_of_one_process_do_not_see_each_other() -> None:
    skip_without_compiler()
    boards = [NativeFirmware(Bench(), board_id=n) for n in (1, 2, 3)]

    for _ in range(5):
        boards[0].tick()
    boards[1].tick()
    del boards[2]
    boards[1].tick()

    assert [board.next_tick for board in boards] == [5, 2]


def test_an_image_says_of_which_commit_or_release_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    git_output = {"ls-files": "core/core.h", "rev-parse": "0123456789abcdef", "status": ""}
    monkeypatch.setattr(build, "_git", lambda *words: git_output[words[0]])

    def build_now() -> bytes:
        build.build_of_sources.cache_clear()
        return build.build_of_sources()

    clean = build_now()
    git_output["status"] = " M core/core.h"
    changed = build_now()
    git_output["ls-files"] = ""
    installed = build_now()
    monkeypatch.undo()
    build.build_of_sources.cache_clear()

    assert clean == b"01234567"
    assert changed == b"0123456+"
    assert installed == version("board51").encode().ljust(8)[:8]
