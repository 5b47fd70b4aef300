"""The frames of golden_frames.txt, which was written from the interface page, against our encoder and decoder.

CRC and COBS are written here a second time, bit by bit from the page, so that a mistake in `protocol/wire`
cannot hide in the file.
"""

from __future__ import annotations

import pytest

from protocol.wire.codec import encode_body
from protocol.wire.decoder import BadFrame, State, StreamDecoder
from protocol.wire.framing import MAX_ENCODED, cobs_decode, cobs_encode, crc16, encode_frame
from protocol.wire.messages import ROW_OF_NAME, Field, Message
from tests.harness.protocol.golden import BAD, FRAMES, GOLDEN, Golden


def documented_crc(data: bytes) -> int:
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


def documented_cobs(data: bytes) -> bytes:
    stuffed, piece = bytearray(), bytearray()
    for byte in (*data, 0):  # the end cuts like a zero
        if byte:
            piece.append(byte)
        else:
            stuffed += bytes([len(piece) + 1]) + piece
            piece.clear()
    return bytes(stuffed)


def documented_frame(body: bytes) -> bytes:
    crc = documented_crc(body)
    return b"\x00" + documented_cobs(body + bytes([crc >> 8, crc & 0xFF])) + b"\x00"


def fields_of(name: str) -> tuple[Field, ...]:
    return ROW_OF_NAME[name].fields


def test_there_is_a_golden_frame_of_every_message_and_a_bad_one_of_every_cause() -> None:
    assert {golden.title for golden in FRAMES} == set(ROW_OF_NAME)
    assert {golden.title.split()[1] for golden in BAD} == {"oversize", "cobs", "crc", "type", "length", "range"}


@pytest.mark.parametrize("golden", FRAMES, ids=lambda golden: golden.title)
def test_the_file_follows_the_rules_of_the_page(golden: Golden) -> None:
    assert documented_frame(golden.hex("body")) == golden.hex("wire")


@pytest.mark.parametrize("golden", FRAMES, ids=lambda golden: golden.title)
def test_encoding_gives_the_golden_bytes(golden: Golden) -> None:
    body = encode_body(golden.title, **golden.values())

    assert body.hex(" ") == golden.hex("body").hex(" ")
    assert encode_frame(body).hex(" ") == golden.hex("wire").hex(" ")


@pytest.mark.parametrize("golden", FRAMES, ids=lambda golden: golden.title)
def test_decoding_gives_the_golden_fields(golden: Golden) -> None:
    events = StreamDecoder().feed(golden.hex("wire"))

    if golden.title == "STATE":
        assert events == [State(**{name: value for name, value in golden.values().items() if isinstance(value, int)})]
    else:
        assert events == [Message(golden.title, golden.values())]


@pytest.mark.parametrize("golden", BAD, ids=lambda golden: golden.keys["why"])
def test_a_bad_frame_is_reported_with_its_cause_and_its_bytes(golden: Golden) -> None:
    between_delimiters = golden.hex("wire").strip(b"\x00")

    events = StreamDecoder().feed(golden.hex("wire"))

    assert events == [BadFrame(golden.title.split()[1], between_delimiters[: MAX_ENCODED + 1])]


def test_the_whole_file_as_one_stream_gives_every_event_in_order() -> None:
    expected = [golden.title if golden in FRAMES else golden.title.split()[1] for golden in GOLDEN]

    events = StreamDecoder().feed(b"".join(golden.hex("wire") for golden in GOLDEN))

    names = [
        "STATE" if isinstance(event, State) else event.cause if isinstance(event, BadFrame) else event.name
        for event in events
    ]
    assert names == expected


def test_crc_has_the_check_value_and_the_residue_of_the_page() -> None:
    assert documented_crc(b"123456789") == crc16(b"123456789") == 0x29B1
    for golden in FRAMES:
        body = golden.hex("body")
        assert crc16(body) == documented_crc(body)
        assert crc16(body + crc16(body).to_bytes(2, "big")) == 0


@pytest.mark.parametrize(
    "data", [b"", b"\0", b"\0\0", b"a\0", b"\0a", b"ab", bytes(66), bytes(range(66)), b"\xff" * 66]
)
def test_cobs_is_that_of_the_page_and_comes_undone(data: bytes) -> None:
    assert cobs_encode(data) == documented_cobs(data)
    assert cobs_decode(documented_cobs(data)) == data
    assert len(cobs_encode(data)) == len(data) + 1
    assert 0 not in cobs_encode(data)


def test_the_fields_in_the_file_are_in_the_order_of_the_table() -> None:
    for golden in FRAMES:
        assert list(golden.values()) == [field.name for field in fields_of(golden.title)], golden.title
