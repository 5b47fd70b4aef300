"""A place in a bucket of an S3 server: what lies there, put, get.  Each refusal is one error that says what to do.

The library takes region, session token and all else from the standard variables AWS_*.  It repeats what fails by the
network or the server; an object is whole or absent at any time.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import timedelta
from html import unescape
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, NamedTuple

from protocol.errors import Board51Error, ServiceError, UsageError, require

if TYPE_CHECKING:
    from obstore.store import ClientConfig

KEYS = ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY")
_ADDRESS = re.compile(r"s3://([A-Za-z0-9][A-Za-z0-9._-]{1,254})/?(.*)")
_ENDPOINT = re.compile(r"https?://[^\s/?#@]+/?")
_REFUSAL = re.compile(r"<Code>(\w+)</Code>(?:.*?<Message>([^<]*))?", re.DOTALL)
_STATUS = re.compile(r"status code: (\d+) ([\w ]+)")  # an answer to a HEAD says no more
_CAUSE = re.compile(r'(?:message|error): "([^"]+)"')
_RIGHTS = f"Give the user of {KEYS[0]} the right to list, read and write there"
_ADDRESSES = "board51 logs query shows the addresses in the column archived"
_REMEDIES = {
    "403": _RIGHTS,
    "404": _ADDRESSES,
    "NoSuchBucket": "Create the bucket, or correct the address",
    "NoSuchKey": _ADDRESSES,
    "InvalidAccessKeyId": f"Correct {KEYS[0]}",
    "SignatureDoesNotMatch": f"Correct {KEYS[1]} or {KEYS[0]}",
    "AccessDenied": _RIGHTS,
    "RequestTimeTooSkewed": "Set the clock of this machine, or that of the server",
    "AuthorizationHeaderMalformed": "Set AWS_REGION to the region of the bucket",
    "PermanentRedirect": "Set AWS_REGION to the region of the bucket",
}
# Two pieces on their way at a time, and ten minutes for each, so that a line of 250 kbit/s suffices.
_PIECE, _PIECES, _LIMIT = 8 << 20, 2, timedelta(minutes=10)


class Stored(NamedTuple):
    """An object as a list of the bucket shows it."""

    size: int
    e_tag: str | None


class Bucket:
    """The objects below an address such as s3://plant/logs, by their names below it.

    Args:
        address: `s3://BUCKET` or `s3://BUCKET/PREFIX`.
        endpoint: address of the server, https or http; AWS_ENDPOINT_URL or Amazon's own without it.

    Raises:
        UsageError: the address, the endpoint or the environment is not usable.
        InstallError: the extra is not installed.
    """

    def __init__(self, address: str, endpoint: str | None) -> None:
        require("s3", "obstore")
        from obstore.store import S3Store

        endpoint = endpoint or os.environ.get("AWS_ENDPOINT_URL")
        parts = _ADDRESS.fullmatch(address)
        if parts is None:
            raise UsageError(f"{address} is not the address of a bucket", remedy="Write s3://BUCKET/PREFIX")
        if endpoint is not None and not _ENDPOINT.fullmatch(endpoint):
            raise UsageError(f"{endpoint} is not an endpoint", remedy="Write it as in https://storage.plant:9000")
        if missing := [key for key in KEYS if not os.environ.get(key)]:
            raise UsageError(f"{' and '.join(missing)} not set", remedy="Set them to the keys of a user of the bucket")
        options: ClientConfig = {"allow_http": True, "timeout": _LIMIT}
        if bundle := os.environ.get("AWS_CA_BUNDLE"):
            try:
                options["root_certificate"] = Path(bundle).read_bytes()
            except OSError as error:
                problem = f"AWS_CA_BUNDLE={bundle} cannot be read: {error.strerror}"
                raise UsageError(problem, remedy="Name a file of certificates in PEM") from None
        self.address = address.rstrip("/")
        with self._reworded():
            self._store = S3Store(
                parts[1],
                prefix=parts[2].strip("/") or None,
                config={"endpoint": endpoint.rstrip("/")} if endpoint else {},
                client_options=options,
                retry_config={"max_retries": 4, "backoff": {"init_backoff": timedelta(seconds=0.3)}},
            )

    def listing(self) -> dict[str, Stored]:
        """Return all objects by name."""
        with self._reworded():
            return {item["path"]: Stored(item["size"], item["e_tag"]) for items in self._store.list() for item in items}

    def attributes(self, name: str) -> Mapping[str, str]:
        """Return the attributes that were stored with an object."""
        with self._reworded(name):
            return self._store.get(name, options={"head": True}).attributes

    def put(self, name: str, content: bytes | BinaryIO, attributes: Mapping[str, str]) -> None:
        """Write an object, in place of one that is there."""
        with self._reworded(name):
            self._store.put(name, content, attributes=dict(attributes), chunk_size=_PIECE, max_concurrency=_PIECES)

    def get(self, name: str) -> tuple[Mapping[str, str], Iterator[bytes]]:
        """Return the attributes of an object, and its content in pieces."""
        with self._reworded(name):
            result = self._store.get(name)

        def pieces() -> Iterator[bytes]:
            with self._reworded(name):
                yield from map(bytes, result.stream(min_chunk_size=_PIECE))

        return result.attributes, pieces()

    @contextmanager
    def _reworded(self, name: str = "") -> Iterator[None]:
        """Raise the errors of the library in one line: what, where, what to do."""
        from obstore.exceptions import BaseError

        where = f"{self.address}/{name}" if name else self.address
        try:
            yield
        except (BaseError, FileNotFoundError, ValueError) as error:
            raise _translate(where, str(error)) from None


def _translate(where: str, text: str) -> Board51Error:
    first, _, details = text.partition("\n")
    if refusal := _REFUSAL.search(text) or _STATUS.search(first):
        text = unescape(refusal[2] or "").strip().rstrip(".")
        problem = f"{where}: the server refuses with {refusal[1]}: {text}"
        return ServiceError(problem, remedy=_REMEDIES.get(refusal[1], "Look into the log of the server"))
    if "HTTP error" not in first:
        problem = f"{where}: {first.rstrip('.')}"
        return ServiceError(problem, remedy="Look at the address, --endpoint, AWS_CA_BUNDLE and the server")
    cause = _CAUSE.search(details)
    return ServiceError(
        f"{where}: no answer from the server{f' ({cause[1]})' if cause else ''}",
        remedy="Look at --endpoint (https or http), the network and the server; AWS_CA_BUNDLE names a private CA",
    )
