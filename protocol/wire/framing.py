"""Encoding and decoding of one frame: body -> body + CRC -> COBS -> delimiters.  Pure functions of bytes.

    00 | COBS( body | CRC-16 high | CRC-16 low ) | 00

`protocol/README.md` shows an example.  The high byte of the CRC comes first, so the CRC over body and CRC is 0.
The receiver computes one CRC over all bytes and compares it with 0.
"""

from __future__ import annotations

from binascii import crc_hqx

MAX_BODY = 64  # bytes; what the board's receive buffer holds
MAX_ENCODED = MAX_BODY + 2 + 1  # CRC and one COBS code; below 254 bytes the overhead is one byte
DELIMITER = b"\x00"


def crc16(data: bytes) -> int:
    """Return CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF, no reflection or XOR ("123456789" -> 0x29B1)."""
    return crc_hqx(data, 0xFFFF)


def cobs_encode(data: bytes) -> bytes:
    """Encode with consistent overhead byte stuffing: no 0x00 in the result, one byte longer (below 254 bytes)."""
    return b"".join(bytes((len(run) + 1,)) + run for run in data.split(b"\x00"))


def cobs_decode(encoded: bytes) -> bytes | None:
    """Return the decoded data, or None if the chain of codes does not end exactly at the end of `encoded`."""
    size = len(encoded)
    if size == 0:
        return None
    end = encoded[0]
    if end == size:  # no zero in the data: about every second state frame
        return encoded[1:]
    data = bytearray(encoded)
    while end < size:
        code = data[end]
        # In place: each code tells where the next zero was.
        data[end] = 0
        end += code
        if code == 0:
            return None
    return bytes(data[1:]) if end == size else None


def encode_frame(body: bytes) -> bytes:
    """Return the bytes on the UART for `body` (1 to 64 bytes), with a delimiter at both ends.

    Raises:
        ValueError: the body is empty or longer than MAX_BODY.
    """
    if not 0 < len(body) <= MAX_BODY:
        raise ValueError(f"a body has 1 to {MAX_BODY} bytes, this one has {len(body)}")
    # One delimiter would do on a perfect line. With two, noise before a frame costs only itself.
    return DELIMITER + cobs_encode(body + crc16(body).to_bytes(2, "big")) + DELIMITER
