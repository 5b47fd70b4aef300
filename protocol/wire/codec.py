"""Encodes and decodes message bodies, driven by the table in `messages.py`."""

from __future__ import annotations

import struct

from protocol.wire.messages import ROW_OF_NAME, ROWS, Field, Message, Row, Value

_F32_MAX = (2 - 2**-23) * 2.0**127  # largest finite IEEE 754 single
_FORMATS = {"u8": "B", "flags": "B", "i8": "b", "u16": "H", "i16": "h", "u32": "I", "f32": "f"}


class _Codec:
    """struct format of a row; a pair of `counts` fields is packed as one 3-byte string."""

    def __init__(self, row: Row) -> None:
        self.row = row
        parts = ["<B"]
        pending = False
        for field in row.fields:
            if field.type == "counts":
                parts += ["3s"] if pending else []
                pending = not pending
            elif field.type.startswith("bytes"):
                parts.append(field.type[5:] + "s")
            else:
                parts.append(_FORMATS[field.type])
        assert not pending, f"{row.name}: counts come in pairs"
        self.struct = struct.Struct("".join(parts))

    def pack(self, values: dict[str, Value]) -> bytes:
        flat: list[Value] = [self.row.type]
        pending: int | None = None
        for field in self.row.fields:
            value = values[field.name]
            # Checked here, not by struct: a count of 4096 would run into its neighbour in the packed pair.
            if not _in_range(field, value):
                bounds = "" if field.low is None else f" within {field.low} .. {field.high}"
                raise ValueError(f"{self.row.name}.{field.name} = {value!r} is not {field.type}{bounds}")
            if field.type != "counts":
                flat.append(value)
            elif pending is None:
                assert isinstance(value, int)
                pending = value
            else:
                assert isinstance(value, int)
                flat.append(pack_pair(pending, value))
                pending = None
        return self.struct.pack(*flat)

    def unpack(self, body: bytes) -> dict[str, Value] | str:
        """Return the values by field name, or the name of the first field that is out of range."""
        flat = iter(self.struct.unpack(body)[1:])
        values: dict[str, Value] = {}
        second: int | None = None
        for field in self.row.fields:
            if field.type == "counts":
                if second is None:
                    value, second = unpack_pair(next(flat))
                else:
                    value, second = second, None
            else:
                value = next(flat)
            if not _in_range(field, value):
                return field.name
            values[field.name] = value
        return values


def _in_range(field: Field, value: Value) -> bool:
    if field.type == "f32":
        return isinstance(value, float) and abs(value) <= _F32_MAX  # also false for NaN
    if field.type.startswith("bytes"):
        return isinstance(value, bytes) and len(value) == int(field.type[5:])
    assert field.low is not None
    assert field.high is not None
    if not isinstance(value, int) or not field.low <= value <= field.high:
        return False
    return field.type != "flags" or value & 3 != 3  # there is no mode 3


def pack_pair(a: int, b: int) -> bytes:
    """Pack two 12-bit counts into three bytes: a[7:0], b[3:0] a[11:8], b[11:4]."""
    return (a | b << 12).to_bytes(3, "little")


def unpack_pair(packed: bytes) -> tuple[int, int]:
    """Undo `pack_pair`."""
    both = int.from_bytes(packed, "little")
    return both & 0xFFF, both >> 12


def unpack_counts(packed: bytes) -> list[int]:
    """Return the counts of the samples of a CAPTURE_BLOCK."""
    return [count for at in range(0, len(packed), 3) for count in unpack_pair(packed[at : at + 3])]


_CODECS = {row.type: _Codec(row) for row in ROWS}
BODY_SIZE = {row.name: _CODECS[row.type].struct.size for row in ROWS}


def encode_body(name: str, /, **values: Value) -> bytes:
    """Encode the body of message `name`.

    Raises:
        ValueError: a value is out of range or has the wrong type.
        KeyError: a field is missing or unknown, or the message does not exist.
    """
    row = ROW_OF_NAME[name]
    unknown = values.keys() - {field.name for field in row.fields}
    if unknown:
        raise KeyError(f"{name} has no field {sorted(unknown)}")
    return _CODECS[row.type].pack(values)


def decode_body(body: bytes) -> Message | str:
    """Decode a body; return the message, or the reason for its rejection: `type`, `length` or `range`."""
    codec = _CODECS.get(body[0]) if body else None
    if codec is None:
        return "type"
    if len(body) != codec.struct.size:
        return "length"
    values = codec.unpack(body)
    return "range" if isinstance(values, str) else Message(codec.row.name, values)
