"""Completion: the script in a real shell."""

from __future__ import annotations

import contextlib
import io
import shlex
import shutil
import subprocess

import pytest

import board51

BASH = shutil.which("bash")
pytestmark = pytest.mark.skipif(BASH is None, reason="no bash here")


@pytest.fixture(scope="module")
def script() -> str:
    """Provide the script that the command prints."""
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        assert board51.main(["completion", "bash"]) == 0
    return printed.getvalue()


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("board51 ident", {"identify"}),
        ("board51 --", {"--help", "--version"}),
        ("board51 send rig1 re", {"reference"}),
        ("board51 send rig1 mode ", {"idle", "open-loop", "closed-loop"}),
        ("board51 send rig1 excite --on", {"--on-reference"}),
        ("board51 watch --topic twin/al", {"twin/alarm", "twin/alarms"}),
        ("board51 design --law ", {"lqi", "pid"}),
        ("board51 completion ", {"bash", "zsh"}),
        ("board51 identify ", set()),  # files
    ],
)
def test_the_shell_offers_what_may_follow(script: str, line: str, offered: set[str]) -> None:
    words = line.split(" ")
    variables = f"COMP_WORDS=({shlex.join(words)}) COMP_CWORD={len(words) - 1}"

    process = subprocess.run(
        [str(BASH), "-c", f'{script}\n{variables}\n_board51\necho "${{COMPREPLY[@]}}"'],
        capture_output=True,
        text=True,
        check=True,
    )

    assert set(process.stdout.split()) == offered
