"""Decoding of MCAP chunks, and of the two compound types of the format: pure functions of bytes.

Format: mcap.dev/spec.  Integers are little-endian; a string is its length (4 bytes) and UTF-8.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator

import lz4.frame  # type: ignore[import-untyped]  # ships no types
import zstandard

CHANNEL, CHUNK = 0x04, 0x06  # opcodes
RECORD = struct.Struct("<BQ")  # opcode, length of the content that follows
CHUNK_HEAD = struct.Struct("<QQQII")  # start, end, uncompressed size, CRC, length of the compression's name
_LARGEST_CHUNK = 1 << 30  # a length beyond this is damage, not data


def unpack(content: bytes) -> tuple[bytes, str]:
    """Return (records of a chunk, ""), or (b"", description of the error)."""
    try:
        _, _, size, crc, name_length = CHUNK_HEAD.unpack_from(content)
        at = CHUNK_HEAD.size + name_length
        name = content[CHUNK_HEAD.size : at]
        (length,) = struct.unpack_from("<Q", content, at)
        packed = content[at + 8 : at + 8 + length]
        if len(packed) != length or size > _LARGEST_CHUNK:
            return b"", "a chunk whose lengths contradict each other"
        if name == b"lz4":
            plain = lz4.frame.decompress(packed)
        elif name == b"zstd":
            plain = zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
        elif name == b"":
            plain = packed
        else:
            return b"", f"a chunk compressed with {name!r}, which is unknown"
    except (struct.error, RuntimeError, zstandard.ZstdError, MemoryError):
        return b"", "a chunk that does not decompress"
    if len(plain) != size or (crc and zlib.crc32(plain) != crc):
        return b"", "a chunk whose CRC is wrong"
    return plain, ""


def channel_records(written: bytes) -> dict[int, bytes]:
    """Return the channel records in the complete chunks of `written`, by channel id."""
    found = {}
    for opcode, chunk in _records(written):
        for inner, content in _records(unpack(chunk)[0]) if opcode == CHUNK else ():
            if inner == CHANNEL:
                (number,) = struct.unpack_from("<H", content)
                found[number] = RECORD.pack(CHANNEL, len(content)) + content
    return found


def _records(data: bytes) -> Iterator[tuple[int, bytes]]:
    at = 0
    while at + RECORD.size <= len(data):
        opcode, length = RECORD.unpack_from(data, at)
        at += RECORD.size
        yield opcode, data[at : at + length]
        at += length


def unpack_prefix(content: bytes) -> bytes:
    """Return the records that can be decompressed from a chunk without its end."""
    try:
        _, _, _, _, name_length = CHUNK_HEAD.unpack_from(content)
        at = CHUNK_HEAD.size + name_length
        name, packed = content[CHUNK_HEAD.size : at], content[at + 8 :]
        if name == b"lz4":
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed))
        if name == b"zstd":
            return zstandard.ZstdDecompressor().decompressobj().decompress(packed)
        return packed if name == b"" else b""
    except (struct.error, RuntimeError, zstandard.ZstdError):
        return b""


def text(content: bytes, at: int) -> tuple[str, int]:
    """Return the string at offset `at`, and the offset of its end.

    Raises:
        struct.error, IndexError, UnicodeDecodeError: there is no valid string.
    """
    (length,) = struct.unpack_from("<I", content, at)
    end = at + 4 + length
    if end > len(content):
        raise IndexError
    return content[at + 4 : end].decode(), end


def text_map(content: bytes, at: int) -> dict[str, str]:
    """Return the map of strings at offset `at`; raises the same errors as `text`."""
    (length,) = struct.unpack_from("<I", content, at)
    at += 4
    end = at + length
    values = {}
    while at < end:
        key, at = text(content, at)
        values[key], at = text(content, at)
    return values
