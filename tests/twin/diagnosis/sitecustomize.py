"""Writes down every file that a Python process opens, lists or executes, and every connection it makes.

Python imports a module of this name at its start if PYTHONPATH has its folder, in child processes too.
"""

from __future__ import annotations

import os
import sys

_LOG = os.environ.get("BOARD51_WATCH_LOG")
_WATCHED = {"open", "os.listdir", "os.scandir", "subprocess.Popen", "os.exec", "socket.connect", "glob.glob"}

if _LOG:
    _FILE = os.open(_LOG, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)

    def _write_down(event: str, args: tuple[object, ...]) -> None:
        if event not in _WATCHED:
            return
        what = args[1] if event == "socket.connect" else args[0]
        if isinstance(what, int) or what is None:
            return  # a descriptor opened before, or the current folder
        writes = event == "open" and isinstance(args[2], int) and bool(args[2] & (os.O_WRONLY | os.O_RDWR))
        text = os.fsdecode(what) if isinstance(what, str | bytes | os.PathLike) else repr(what)
        if event in ("open", "os.listdir", "os.scandir"):
            text = os.path.realpath(text)
        os.write(_FILE, f"{event}\t{'w' if writes else 'r'}\t{text}\n".encode())

    sys.addaudithook(_write_down)
