"""The message table: every bound of every field holds, both ways, and wrong calls are refused with the field's name."""

from __future__ import annotations

import math
import struct

import pytest

from protocol.wire.codec import BODY_SIZE, decode_body, encode_body, pack_pair, unpack_pair
from protocol.wire.decoder import BadFrame, StreamDecoder
from protocol.wire.framing import MAX_BODY, encode_frame
from protocol.wire.messages import ROW_OF_NAME, ROWS, EventCode, Field, HostLoss, Law, Mode, Reason, Row, Shape, Value

FORMATS = {"u8": "<B", "flags": "<B", "u16": "<H", "i16": "<h", "u32": "<I", "f32": "<f"}
EVERY_FIELD = [(row, field) for row in ROWS for field in row.fields]


def allowed_value(field: Field) -> Value:
    """A value that is allowed."""
    if field.type == "f32":
        return 0.0
    if field.type.startswith("bytes"):
        return bytes(int(field.type[5:]))
    assert field.low is not None
    return int(field.low)


def valid(row: Row) -> dict[str, Value]:
    return {field.name: allowed_value(field) for field in row.fields}


def offset(row: Row, target: Field) -> int:
    """Return the byte at which a field begins in the body, from the types alone."""
    at = 1.0
    for field in row.fields:
        if field is target:
            return int(at)
        if field.type == "counts":
            at += 1.5
        else:
            at += int(field.type[5:]) if field.type.startswith("bytes") else struct.calcsize(FORMATS[field.type])
    raise AssertionError(target)


def invalid_values(field: Field) -> list[Value]:
    """Values just outside the range, or of the wrong type."""
    if field.type == "f32":
        return [math.nan, math.inf, -math.inf, 3.5e38, -3.5e38, 1]
    if field.type.startswith("bytes"):
        size = int(field.type[5:])
        return [bytes(size + 1), bytes(size - 1), b"", 0]
    assert field.low is not None
    assert field.high is not None
    outside: list[Value] = [int(field.low) - 1, int(field.high) + 1, float(field.low), b"\x01"]
    return [*outside, 3] if field.type == "flags" else outside


@pytest.mark.parametrize(("row", "field"), EVERY_FIELD, ids=lambda part: part.name)
def test_encoding_refuses_what_is_out_of_range_and_names_the_field(row: Row, field: Field) -> None:
    for value in invalid_values(field):
        with pytest.raises(ValueError, match=rf"^{row.name}\.{field.name} = "):
            encode_body(row.name, **(valid(row) | {field.name: value}))


@pytest.mark.parametrize(("row", "field"), EVERY_FIELD, ids=lambda part: part.name)
def test_decoding_refuses_what_is_out_of_range(row: Row, field: Field) -> None:
    if field.type == "counts" or field.type.startswith("bytes"):
        return  # 12 bits hold 0..4095 and bytes anything: nothing can be out of range on the line
    layout = struct.Struct(FORMATS[field.type])
    tried = 0
    for value in invalid_values(field):
        try:
            raw = layout.pack(value)
        except (struct.error, OverflowError):
            continue  # the type on the line cannot hold it
        if field.type == "f32" and not isinstance(value, float):
            continue
        body = bytearray(encode_body(row.name, **valid(row)))
        body[offset(row, field) : offset(row, field) + layout.size] = raw
        tried += 1

        assert decode_body(bytes(body)) == "range", value
        (event,) = StreamDecoder().feed(encode_frame(bytes(body)))
        assert isinstance(event, BadFrame)
        assert event.cause == "range"
    limits = {"u8": (0, 255), "u16": (0, 65535), "u32": (0, 2**32 - 1), "i16": (-32768, 32767)}
    if limits.get(field.type) != (field.low, field.high):
        assert tried, "the range is narrower than the type, so some value on the line is outside"


@pytest.mark.parametrize(("row", "field"), EVERY_FIELD, ids=lambda part: part.name)
def test_both_ends_of_every_range_pass(row: Row, field: Field) -> None:
    if field.low is None or field.high is None:
        return
    top = 0xFE if field.type == "flags" else int(field.high)  # 0xFF has mode 3
    for value in (int(field.low), top):
        values = valid(row) | {field.name: value}

        message = decode_body(encode_body(row.name, **values))

        assert not isinstance(message, str)
        assert message.values == values


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_every_other_length_is_refused(row: Row) -> None:
    body = encode_body(row.name, **valid(row))

    assert len(body) == BODY_SIZE[row.name] <= MAX_BODY
    for wrong in (body[:-1], body + b"\x00", body[:1]):
        assert decode_body(wrong) == "length"


def test_unknown_types_are_refused() -> None:
    for unknown in set(range(256)) - {row.type for row in ROWS}:
        assert decode_body(bytes([unknown, 1])) == "type"
    assert decode_body(b"") == "type"


def test_wrong_names_are_refused() -> None:
    with pytest.raises(KeyError, match="volume"):
        encode_body("PING", id=1, volume=11)
    with pytest.raises(KeyError, match="mode"):
        encode_body("SET_MODE", id=1)
    with pytest.raises(KeyError, match="LEVITATE"):
        encode_body("LEVITATE", id=1)


def test_the_table_is_in_order() -> None:
    assert [row.type for row in ROWS] == sorted({row.type for row in ROWS})
    assert len(ROW_OF_NAME) == len(ROWS)
    for row in ROWS:
        assert row.to_board == (row.type < 0x40)
        assert len({field.name for field in row.fields}) == len(row.fields)
        assert all(field.description for field in row.fields), row.name
        if row.to_board:
            assert row.fields[0].name == "id"
            assert row.fields[0].low == 1


@pytest.mark.parametrize(
    ("name", "field", "codes"),
    [
        ("SET_MODE", "mode", Mode),
        ("SET_GAINS", "law", Law),
        ("PARAMETERS", "law", Law),
        ("EXCITE", "shape", Shape),
        ("SET_HOST_LOSS", "policy", HostLoss),
        ("PARAMETERS", "policy", HostLoss),
        ("NACK", "reason", Reason),
        ("EVENT", "code", EventCode),
    ],
)
def test_the_range_of_a_coded_field_is_that_of_its_codes(
    name: str, field: str, codes: type[Mode | Law | Shape | HostLoss | Reason | EventCode]
) -> None:
    (row_field,) = [candidate for candidate in ROW_OF_NAME[name].fields if candidate.name == field]

    assert [code.value for code in codes] == list(range(int(row_field.low or 0), int(row_field.high or 0) + 1))


def test_a_pair_of_counts_lies_in_three_bytes_as_drawn() -> None:
    assert pack_pair(0x4CD, 0x800) == bytes.fromhex("CD 04 80")
    assert unpack_pair(bytes.fromhex("B8 16 80")) == (0x6B8, 0x801)
    for a in range(0, 4096, 63):
        for b in range(0, 4096, 65):
            assert unpack_pair(pack_pair(a, b)) == (a, b)
