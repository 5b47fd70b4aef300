"""One frame: body -> body + CRC -> COBS -> delimiters, and back.  Pure functions of bytes.

    00 | COBS( body | CRC-16 high | CRC-16 low ) | 00

`protocol/README.md` draws it.  The CRC goes high byte first, so the CRC over body and CRC is 0: the
receiver runs one loop over everything and compares with 0.
"""

from __future__ import annotations

from binascii import crc_hqx

MAX_BODY = 64  # bytes; what the board's receive buffer holds
MAX_ENCODED = MAX_BODY + 2 + 1  # CRC, one COBS code (below 254 bytes there is just one of overhead)
DELIMITER = b"\x00"


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF, not reflected, no final XOR ("123456789" -> 0x29B1)."""
    return crc_hqx(data, 0xFFFF)


def cobs_encode(data: bytes) -> bytes:
    """Consistent overhead byte stuffing: no 0x00 in the result; one byte longer (data under 254 bytes)."""
    return b"".join(bytes((len(run) + 1,)) + run for run in data.split(b"\x00"))


def cobs_decode(encoded: bytes) -> bytes | None:
    """The stuffed data, or None where the chain of codes does not end exactly at the end of `encoded`."""
    size = len(encoded)
    if size == 0:
        return None
    end = encoded[0]
    if end == size:  # no zero in the data: about every second state frame
        return encoded[1:]
    data = bytearray(encoded)
    while end < size:
        code = data[end]
        data[end] = 0
        end += code
        if code == 0:
            return None
    return bytes(data[1:]) if end == size else None


def encode_frame(body: bytes) -> bytes:
    """The bytes on the UART for `body` (1 to 64 bytes), with the delimiter at both ends.

    Raises:
        ValueError: the body is empty or longer than MAX_BODY.
    """
    if not 0 < len(body) <= MAX_BODY:
        raise ValueError(f"a body has 1 to {MAX_BODY} bytes, this one {len(body)}")
    return DELIMITER + cobs_encode(body + crc16(body).to_bytes(2, "big")) + DELIMITER
