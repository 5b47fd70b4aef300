"""The records of a log in blocks, which two sites compare by digests before any record is sent.

Rule 1: a record has an id within its block: its tick, where its topic has one message for each tick; else a digest of
        it.  Equal records have equal ids at every site, and the records of a block are a set.
Rule 2: what bears neither tick nor time of its own belongs to no block: repetitions are equal, and each site's log has
        its own time for them.  So it is with twin/model and twin/alarms of older versions.  Neither do the raw bytes of
        the line, which do not travel.
"""

from __future__ import annotations

import hashlib
import operator
from array import array
from collections.abc import Iterable
from functools import lru_cache
from itertools import accumulate
from typing import Any, NamedTuple

import zstandard
from google.protobuf.message import Message

from protocol.bus import board51_pb2 as pb
from protocol.bus.encoding import parse, stamp_ns
from protocol.bus.topics import RECORDED, TOPIC_OF_NAME, split
from protocol.errors import DataError
from protocol.log.reader import RawLogRecord

TICKS_BITS = 14  # of a block: 33 s at 500 Hz
SECONDS = 64  # of a block of other topics
MAX_IDS = 1 << 20  # of a block; a longer list is not unpacked
LARGEST_REPLY = 16_000_000  # bytes, unpacked
EVERY_TICK = frozenset(name for name in RECORDED if TOPIC_OF_NAME[name].rate.startswith("every tick"))


class BlockId(NamedTuple):
    """A block."""

    stream: str  # <site>/<board>/<topic> of ticks, <site>/<board> of other topics
    session: int
    number: int


class Located(NamedTuple):
    """The block of a record, and its id there."""

    block: BlockId
    id: int
    stamp_ns: int | None  # its own time, of the gateway's clock


@lru_cache(maxsize=4096)
def _topic_of(key: str) -> tuple[str, str, type[Message]] | None:
    """Return board (<site>/<board>), topic and message class of a key; None for a key of another program."""
    parts = split(key)
    return None if parts is None else (f"{parts[0]}/{parts[1]}", parts[2], TOPIC_OF_NAME[parts[2]].message)


def locate(record: RawLogRecord | pb.LogRecord) -> Located | None:
    """Return the block of a record; None if it belongs to none."""
    known = _topic_of(record.key)
    if known is None:
        return None
    board, topic, kind = known
    message: Any = parse(kind, record.data)
    if message is None:
        return None
    stamp = stamp_ns(message)
    if topic in EVERY_TICK:
        return Located(BlockId(record.key, message.session, message.tick >> TICKS_BITS), message.tick, stamp)
    if stamp is None:
        return None
    digest = hashlib.blake2b(topic.encode() + b"\0" + record.data, digest_size=8).digest()
    return Located(BlockId(board, 0, stamp // 10**9 // SECONDS), int.from_bytes(digest, "little"), stamp)


def pack(ids: Iterable[int]) -> tuple[bytes, int]:
    """Return a set of ids in few bytes (differences, zstd: 40 of a whole block of ticks), and its digest."""
    ordered = sorted(set(ids))
    steps = array("Q", map(operator.sub, ordered, [0, *ordered])).tobytes()
    digest = int.from_bytes(hashlib.blake2b(steps, digest_size=8).digest(), "little")
    return zstandard.ZstdCompressor().compress(steps), digest


def unpack(packed: bytes) -> set[int]:
    """Return the ids that `pack` has packed; raises DataError for other bytes."""
    steps = array("Q")
    try:
        steps.frombytes(decompress(packed, 8 * MAX_IDS))
    except ValueError:  # not whole numbers
        raise DataError("A list of ids is malformed", remedy="Install the same version at both sites") from None
    return set(accumulate(steps))


def decompress(packed: bytes, largest: int) -> bytes:
    """Return the content of bytes from another site, which may claim to unpack to any size; raises DataError."""
    if not packed:
        return b""
    try:
        plain = zstandard.ZstdDecompressor(max_window_size=1 << 25).stream_reader(packed).read(largest + 1)
    except zstandard.ZstdError:
        plain = None
    if plain is None or len(plain) > largest:
        problem = "Bytes from another site do not unpack" if plain is None else f"They unpack to more than {largest}"
        raise DataError(problem, remedy="Install the same version at both sites")
    return plain
