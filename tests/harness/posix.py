"""The tests that need Linux or macOS open a pty, send signals, read /proc or the mode of a file, or compile.

Found by words of their source and of the helpers that they import.  So a new test is on the right side by itself, and
none is left out by hand.
"""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
_WORDS = re.compile(
    r"^\s*(import|from) (fcntl|grp|pty|pwd|resource|termios|tty)\b|--pty|tcp=False|/proc/|symlink_to|\bsh\b|\bbash\b"
    r"|\bos\.(chown|fork|geteuid|kill|mkfifo|nice|openpty|sched_\w+|set_blocking|O_\w+)\b|chmod|S_IMODE|0o[0-7]{3}"
    r"|send_signal|signal\.SIG(ALRM|HUP|KILL|STOP|USR)|pass_fds|select\.(select|poll)|NativeFirmware|chromium|which\(",
    re.MULTILINE,
)
_HELPERS = re.compile(r"^\s*from (tests\.[\w.]+) import", re.MULTILINE)
_EVERYWHERE = Path("system/test_windows.py")  # plays Windows elsewhere
_FOLDERS = ("firmware", "notebooks", "bench", "system")  # compilers, make, whole lines of processes with signals


@cache
def needs_posix(path: Path) -> bool:
    """Return whether a test module needs a POSIX system."""
    relative_path = path.relative_to(ROOT / "tests")
    if relative_path == _EVERYWHERE or relative_path.parts[0] in _FOLDERS:
        return relative_path != _EVERYWHERE
    # A file and the helpers below it, each once: helpers import each other.
    visited, ahead = set(), [path]
    while ahead:
        file = ahead.pop()
        if file in visited or not file.exists():
            continue
        visited.add(file)
        has_match, helpers = _search(file)
        if has_match:
            return True
        ahead += helpers
    return False


@cache
def _search(file: Path) -> tuple[bool, tuple[Path, ...]]:
    """Return whether one of the words stands in a file, and the helpers that it imports."""
    text = file.read_text(encoding="utf-8")
    helpers = (ROOT.joinpath(*name.split(".")).with_suffix(".py") for name in _HELPERS.findall(text))
    return _WORDS.search(text) is not None, tuple(helpers)
