"""A log as a download, also while it is being written.

Rule: as many bytes are sent as there were at the beginning.  starlette's FileResponse sends what was written meanwhile,
too, beyond the length that it has promised: the server then cuts the connection.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

from starlette.responses import Response, StreamingResponse

from gateway.views.hmi.library import LibraryFile

MEDIA_TYPE = "application/octet-stream"
_PIECE = 1 << 18  # bytes


def download(entry: LibraryFile) -> Response:
    """Return the response that sends a file of a library."""
    headers = {
        "content-length": str(entry.bytes),
        "content-disposition": f"attachment; filename*=utf-8''{quote(entry.path.name)}",
    }
    return StreamingResponse(_pieces(entry.path, entry.bytes), media_type=MEDIA_TYPE, headers=headers)


def _pieces(path: Path, left: int) -> Iterator[bytes]:
    with path.open("rb") as stream:
        while data := stream.read(min(left, _PIECE)):
            left -= len(data)
            yield data
