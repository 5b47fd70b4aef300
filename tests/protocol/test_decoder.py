"""The stream decoder's promises: it never raises, chunking is invisible, damage stays, memory is bounded."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.wire.codec import decode_body, encode_body
from protocol.wire.decoder import CAUSES, BadFrame, Event, State, StreamDecoder
from protocol.wire.framing import MAX_BODY, MAX_ENCODED, cobs_decode, cobs_encode, encode_frame
from protocol.wire.messages import ROWS, Field, Message, Row, Value

F32_MAX = 3.4028234663852886e38


def values_of(field: Field) -> st.SearchStrategy[Value]:
    if field.type == "f32":
        return st.floats(-F32_MAX, F32_MAX, width=32)
    if field.type.startswith("bytes"):
        size = int(field.type[5:])
        return st.binary(min_size=size, max_size=size)
    assert field.low is not None
    assert field.high is not None
    numbers = st.integers(int(field.low), int(field.high))
    return numbers.filter(lambda flags: flags & 3 != 3) if field.type == "flags" else numbers


def messages_of(row: Row) -> st.SearchStrategy[Message]:
    fields = st.fixed_dictionaries({field.name: values_of(field) for field in row.fields})
    return fields.map(lambda values: Message(row.name, values))


any_message = st.one_of([messages_of(row) for row in ROWS])
junk = st.binary(max_size=200)
quiet_junk = junk.map(lambda data: data.replace(b"\x00", b"\x7f"))  # no delimiter: noise inside one gap


def frame_of(message: Message) -> bytes:
    return encode_frame(encode_body(message.name, **message.values))


def event_of(message: Message) -> Event:
    if message.name != "STATE":
        return message
    return State(*(message.int(name) for name in State._fields))


@given(message=any_message)
def test_every_message_comes_back_from_the_line(message: Message) -> None:
    frame = frame_of(message)

    assert StreamDecoder().feed(frame) == [event_of(message)]
    assert len(frame) - 2 <= MAX_ENCODED
    assert frame.count(0) == 2
    assert decode_body(encode_body(message.name, **message.values)) == message


@given(st.lists(st.one_of(any_message.map(frame_of), junk), max_size=8).map(b"".join), st.lists(st.integers(0, 600)))
def test_chunking_never_changes_the_events(data: bytes, cuts: list[int]) -> None:
    edges = [0, *sorted(cut for cut in cuts if cut < len(data)), len(data)]
    piecewise, byte_wise = StreamDecoder(), StreamDecoder()

    expected = StreamDecoder().feed(data)

    assert [event for a, b in pairwise(edges) for event in piecewise.feed(data[a:b])] == expected
    assert [event for n in range(len(data)) for event in byte_wise.feed(data[n : n + 1])] == expected


@given(st.lists(st.binary(max_size=300), max_size=20))
def test_noise_is_an_outcome_and_never_an_exception(chunks: list[bytes]) -> None:
    decoder = StreamDecoder()

    for chunk in chunks:
        for event in decoder.feed(chunk):
            assert isinstance(event, State | Message) or (isinstance(event, BadFrame) and event.cause in CAUSES)


@given(st.binary(max_size=MAX_BODY))
def test_any_body_with_a_right_crc_is_taken_apart_or_rejected_with_a_cause(body: bytes) -> None:
    """What noise reaches only once in 65536: the checks behind the CRC."""
    if not body:
        return
    (event,) = StreamDecoder().feed(encode_frame(body))

    if isinstance(event, BadFrame):
        assert event.cause in ("type", "length", "range")
    else:
        assert encode_body_of(event) == body


def encode_body_of(event: Event) -> bytes:
    if isinstance(event, State):
        return encode_body("STATE", **event._asdict())
    assert isinstance(event, Message)
    return encode_body(event.name, **event.values)


@given(before=junk, message=any_message, after=junk)
def test_junk_around_a_frame_never_costs_the_frame(before: bytes, message: Message, after: bytes) -> None:
    events = StreamDecoder().feed(before + frame_of(message) + after)

    assert event_of(message) in events


@given(damaged=any_message, following=any_message, data=st.data())
def test_one_damaged_frame_never_costs_the_next(damaged: Message, following: Message, data: st.DataObject) -> None:
    frame = bytearray(frame_of(damaged))
    kind = data.draw(st.sampled_from(["flip", "lose", "insert", "duplicate", "cut"]))
    at = data.draw(st.integers(0, len(frame) - 1))
    if kind == "flip":
        frame[at] ^= data.draw(st.integers(1, 255))
    elif kind == "lose":
        del frame[at]
    elif kind == "insert":
        frame.insert(at, data.draw(st.integers(0, 255)))
    elif kind == "duplicate":
        frame.insert(at, frame[at])
    else:
        del frame[at:]

    events = StreamDecoder().feed(bytes(frame) + frame_of(following))

    assert events[-1] == event_of(following)


@given(before=any_message, noise=quiet_junk, after=any_message)
def test_noise_between_two_frames_costs_neither_and_is_reported_once(
    before: Message, noise: bytes, after: Message
) -> None:
    first, *middle, last = StreamDecoder().feed(frame_of(before) + noise + frame_of(after))

    assert (first, last) == (event_of(before), event_of(after))
    assert len(middle) == bool(noise)


@pytest.mark.parametrize("chunk", [1, 7, 4096])
def test_an_endless_frame_keeps_a_bounded_number_of_bytes_and_is_reported_once(chunk: int) -> None:
    decoder = StreamDecoder()

    for _ in range(100_000 // chunk):
        assert decoder.feed(b"\x55" * chunk) == []
        assert len(decoder._pending) <= MAX_ENCODED + 1
    events = decoder.feed(b"\x00" + frame_of(Message("PING", {"id": 1})))

    assert events == [BadFrame("oversize", b"\x55" * (MAX_ENCODED + 1)), Message("PING", {"id": 1})]


def test_the_longest_frame_passes_and_one_byte_more_is_oversize() -> None:
    longest = encode_frame(bytes([0x3F]) * MAX_BODY).strip(b"\x00")
    assert len(longest) == MAX_ENCODED

    (fits, too_long) = StreamDecoder().feed(longest + b"\x00" + longest + b"\x01\x00")

    assert (fits, too_long) == (BadFrame("type", longest), BadFrame("oversize", longest + b"\x01"))


@given(st.binary(min_size=10, max_size=10).map(lambda body: b"\x40" + body[1:]))
def test_the_fast_path_of_states_is_the_row_of_the_table(body: bytes) -> None:
    expected = decode_body(body)

    (event,) = StreamDecoder().feed(encode_frame(body))

    if isinstance(expected, str):
        assert event == BadFrame(expected, cobs_encode(body + crc_bytes(body)))
    else:
        assert isinstance(event, State)
        assert event._asdict() == expected.values


def crc_bytes(body: bytes) -> bytes:
    decoded = cobs_decode(encode_frame(body).strip(b"\x00"))
    assert decoded is not None
    return decoded[-2:]


def test_empty_frames_are_nothing() -> None:
    assert StreamDecoder().feed(b"\x00" * 1000) == []
    assert StreamDecoder().feed(b"") == []


@given(st.binary(max_size=80))
def test_cobs_decoding_accepts_only_what_encoding_makes(encoded: bytes) -> None:
    data = cobs_decode(encoded.replace(b"\x00", b"\x01"))

    assert data is None or cobs_encode(data) == encoded.replace(b"\x00", b"\x01")


@pytest.mark.parametrize("size", [0, MAX_BODY + 1])
def test_a_body_that_does_not_fit_is_refused(size: int) -> None:
    with pytest.raises(ValueError, match=f"1 to {MAX_BODY} bytes"):
        encode_frame(bytes(size))


def test_of_all_crcs_only_the_right_one_is_accepted() -> None:
    body = encode_body("STATE", sequence=4660, i_c=1229, x=2048, u_c=1720, x_ref=2049, flags=2)
    stream = b"".join(cobs_encode(body + crc.to_bytes(2, "big")) + b"\x00" for crc in range(1 << 16))

    accepted = [event for event in StreamDecoder().feed(stream) if not isinstance(event, BadFrame)]

    assert accepted == [State(4660, 1229, 2048, 1720, 2049, 2)]
