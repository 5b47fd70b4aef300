"""Files that a page may show: logs, recordings and diagnosis reports, found by a scan of folders.

Rule 1: a name from a browser is looked up among the files of the scan, never joined to a path.  So `../`, absolute
        names, links out of the folder and hidden files do not exist for it.
Rule 2: looking never changes a file; a file that vanishes in between is absent.
Rule 3: of a log that is being written, as many bytes are sent as there were at the beginning.  starlette's FileResponse
        sends what was written meanwhile, too, beyond the length that it has promised: the server then cuts the
        connection.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain
from pathlib import Path
from urllib.parse import quote

from starlette.responses import Response, StreamingResponse

from gateway.record.timeline import Extent, extent

MAX_FILES = 500  # the newest are listed
_PIECE = 1 << 18  # bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class LibraryFile:
    """A file that a page may show."""

    name: str  # folder of the scan, slash, path within it
    path: Path
    bytes: int
    changed_s: float  # Unix time

    @property
    def changed(self) -> str:
        """Return the time of the last change, for people."""
        return time.strftime("%Y-%m-%d %H:%M", time.localtime(self.changed_s))

    @property
    def extent(self) -> Extent | None:
        """Return rigs and duration of a log; None where its index does not say so."""
        return _extent(self.path, self.bytes, self.changed_s)


@lru_cache(maxsize=2 * MAX_FILES)
def _extent(path: Path, _bytes: int, _changed_s: float) -> Extent | None:
    return extent(path)  # read again when the file has changed


class Library:
    """Files of some kinds below some folders.

    Args:
        roots: name -> folder; a folder that is absent holds nothing.
        patterns: of file names, e.g. *.mcap.
    """

    def __init__(self, roots: dict[str, Path], *patterns: str) -> None:
        self._roots = {name: path.resolve() for name, path in roots.items()}
        self._patterns = patterns

    @property
    def folders(self) -> list[Path]:
        """Return the folders that are searched."""
        return list(self._roots.values())

    def entries(self) -> list[LibraryFile]:
        """The newest first."""
        entries = {entry.name: entry for entry in self._scan()}
        return sorted(entries.values(), key=lambda e: -e.changed_s)[:MAX_FILES]

    def find(self, name: str) -> LibraryFile | None:
        """Return the file of that name, or None if there is none."""
        return next((entry for entry in self.entries() if entry.name == name), None)

    def _scan(self) -> Iterator[LibraryFile]:
        for root_name, root in self._roots.items():
            for path in chain.from_iterable(map(root.rglob, self._patterns)):
                relative = path.relative_to(root)
                if any(part.startswith(".") for part in relative.parts):
                    continue
                try:
                    real, stat = path.resolve(strict=True), path.stat()
                except OSError:
                    continue
                if path.is_file() and real.is_relative_to(root):
                    name = f"{root_name}/{relative.as_posix()}"
                    yield LibraryFile(name=name, path=real, bytes=stat.st_size, changed_s=stat.st_mtime)


def download(entry: LibraryFile) -> Response:
    """Return the response that sends a file of a library."""
    headers = {
        "content-length": str(entry.bytes),
        "content-disposition": f"attachment; filename*=utf-8''{quote(entry.path.name)}",
    }
    return StreamingResponse(_pieces(entry.path, entry.bytes), media_type="application/octet-stream", headers=headers)


def _pieces(path: Path, left: int) -> Iterator[bytes]:
    with path.open("rb") as stream:
        while data := stream.read(min(left, _PIECE)):
            left -= len(data)
            yield data
