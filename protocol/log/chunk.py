"""Decoding of MCAP chunks, and of the two compound types of the format: pure functions of bytes.

Rule: a chunk is decompressed to the size that it states at most, and that size is bounded.  32 kB of zstd may hold a
      gigabyte, whatever the chunk and its compressed frame state.

Format: mcap.dev/spec.  Integers are little-endian; a string is its length (4 bytes) and UTF-8.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator

import lz4.frame
import zstandard

CHANNEL, CHUNK = 0x04, 0x06  # opcodes
RECORD = struct.Struct("<BQ")  # opcode, length of the content that follows
CHUNK_HEAD = struct.Struct("<QQQII")  # start, end, uncompressed size, CRC, length of the compression's name
LARGEST_CHUNK = 1 << 25  # bytes, unpacked: other recorders end a chunk after a megabyte, ours after CHUNK_BYTES


def unpack(content: bytes) -> tuple[bytes, str]:
    """Return (records of a chunk, ""), or (b"", description of the error)."""
    try:
        _, _, size, crc, name_length = CHUNK_HEAD.unpack_from(content)
        at = CHUNK_HEAD.size + name_length
        name = content[CHUNK_HEAD.size : at]
        (length,) = struct.unpack_from("<Q", content, at)
        if length > len(content) - at - 8:
            return b"", "a chunk whose lengths contradict each other"
        packed = content[at + 8 : at + 8 + length]
        # Before anything is unpacked: 32 kB may unpack to a gigabyte.
        if size > LARGEST_CHUNK:
            return b"", f"a chunk that unpacks to {size} bytes, more than {LARGEST_CHUNK}"
        if name not in (b"", b"lz4", b"zstd"):
            return b"", f"a chunk compressed with {name!r}, which is unknown"
        # One byte more than stated shows a chunk that holds more, without unpacking the rest of it.
        plain = _decompress(name, packed, size + 1)
    except (struct.error, RuntimeError, zstandard.ZstdError, MemoryError):
        return b"", "a chunk that does not decompress"
    if len(plain) > size:
        return b"", f"a chunk that holds more than the {size} bytes it states"
    # A CRC of 0 means that the writer has computed none: such a chunk cannot be checked, but is not damaged.
    if len(plain) != size or (crc and zlib.crc32(plain) != crc):
        return b"", "a chunk whose CRC is wrong"
    return plain, ""


def unpack_prefix(content: bytes) -> bytes:
    """Return the records that can be decompressed from a chunk without its end."""
    try:
        _, _, _, _, name_length = CHUNK_HEAD.unpack_from(content)
        at = CHUNK_HEAD.size + name_length
        name, packed = content[CHUNK_HEAD.size : at], content[at + 8 :]
        # Without its end a chunk has no CRC to check, but decompression gives exact bytes or none.
        return _decompress(name, packed, LARGEST_CHUNK)
    except (struct.error, RuntimeError, zstandard.ZstdError, MemoryError):
        return b""


def stated_size(content: bytes) -> int:
    """Return the unpacked size that a chunk states; 0 if its head is cut off."""
    return int(CHUNK_HEAD.unpack_from(content)[2]) if len(content) >= CHUNK_HEAD.size else 0


def _decompress(name: bytes, packed: bytes, max_bytes: int) -> bytes:
    """Return the first `max_bytes` bytes at most; b"" for an unknown compression."""
    if name == b"lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=max_bytes))
    if name == b"zstd":
        # `decompress(max_output_size=)` ignores its bound where the frame states a size of its own.
        decompressor = zstandard.ZstdDecompressor(max_window_size=LARGEST_CHUNK)
        return decompressor.stream_reader(packed).read(max_bytes)
    return packed[:max_bytes] if name == b"" else b""


def channel_records(written: bytes) -> dict[int, bytes]:
    """Return the channel records in the complete chunks of `written`, by channel id."""
    channels = {}
    for opcode, chunk in records(written):
        for inner, content in records(unpack(chunk)[0]) if opcode == CHUNK else ():
            if inner == CHANNEL:
                (number,) = struct.unpack_from("<H", content)
                channels[number] = RECORD.pack(CHANNEL, len(content)) + content
    return channels


def records(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and content of each record; the last one may be cut off."""
    at = 0
    while at + RECORD.size <= len(data):
        opcode, length = RECORD.unpack_from(data, at)
        at += RECORD.size
        yield opcode, data[at : at + length]
        at += length


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
