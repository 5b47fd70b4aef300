"""Frames and fields in C: the golden frames of the page, and whatever else may stand between two delimiters."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.wire.codec import decode_body
from protocol.wire.framing import MAX_ENCODED, cobs_decode, crc16, encode_frame
from protocol.wire.messages import ROW_OF_NAME, ROWS, Message, Reason, Row
from tests.harness.firmware.core import Core
from tests.harness.gateway.board_host import FIRMWARES, Bench, frame
from tests.harness.protocol.golden import BAD, FRAMES, Golden
from tests.harness.protocol.port import take_output

COMMANDS = [golden for golden in FRAMES if ROW_OF_NAME[golden.title].to_board]


@pytest.mark.parametrize("golden", FRAMES, ids=lambda golden: golden.title)
def test_a_golden_frame_is_made_and_read(core: Core, golden: Golden) -> None:
    body, wire = golden.hex("body"), golden.hex("wire")

    assert core.encode(body) == wire
    assert core.decode(wire[1:-1]) == body
    assert core.c.b51_crc_of(body, len(body)) == crc16(body)


@pytest.mark.parametrize("golden", COMMANDS, ids=lambda golden: golden.title)
def test_a_golden_command_is_understood(core: Core, golden: Golden) -> None:
    assert core.check(golden.hex("body")) == (0, 0)


@pytest.mark.parametrize("golden", BAD, ids=lambda golden: golden.keys["why"])
def test_a_bad_frame_is_refused_where_the_page_says(core: Core, golden: Golden) -> None:
    between = golden.hex("wire").strip(b"\x00")

    if golden.title == "BAD oversize":
        assert len(between) > MAX_ENCODED  # the receiver drops it: test_firmware_frames.py
    elif golden.title in ("BAD cobs", "BAD crc"):
        assert core.decode(between) is None
    else:
        assert core.decode(between) is not None


@settings(max_examples=200)
@given(body=st.binary(min_size=1, max_size=64))
def test_any_body_comes_back(core: Core, body: bytes) -> None:
    wire = core.encode(body)

    assert wire == encode_frame(body)
    assert core.decode(wire[1:-1]) == body


@settings(max_examples=300)
@given(encoded=st.lists(st.integers(1, 255), min_size=1, max_size=MAX_ENCODED).map(bytes))
def test_what_is_no_chain_or_has_a_wrong_crc_is_no_body(core: Core, encoded: bytes) -> None:
    data = cobs_decode(encoded)
    good = data is not None and len(data) >= 3 and crc16(data) == 0

    assert core.decode(encoded) == (data[:-2] if good and data is not None else None)


@settings(max_examples=500)
@given(
    row=st.sampled_from([row for row in ROWS if row.to_board]),
    fields=st.binary(min_size=62, max_size=62) | st.just(b"\xff" * 62) | st.just(bytes(62)),
    change=st.integers(-2, 2) | st.just(0),
)
def test_a_command_is_understood_where_the_table_understands_it(
    core: Core, row: Row, fields: bytes, change: int
) -> None:
    size = 1 + sum({"u8": 1, "u16": 2, "i16": 2, "u32": 4}[field.type] for field in row.fields)
    body = (bytes((row.type, 1)) + fields)[: max(size + change, 2)]

    understood = decode_body(body)
    reason, _ = core.check(body)

    expected = {"type": Reason.UNKNOWN_TYPE, "length": Reason.BAD_LENGTH, "range": Reason.OUT_OF_RANGE}
    assert reason == (0 if isinstance(understood, Message) else expected[understood])


@pytest.mark.parametrize("golden", COMMANDS, ids=lambda golden: golden.title)
@pytest.mark.usefixtures("core")
def test_both_boards_answer_a_golden_command_alike(golden: Golden) -> None:
    outputs = []
    for make in FIRMWARES.values():
        board = make(Bench())
        board.feed(frame("HELLO", id=200, session=7, version_min=1, version_max=1))
        board.tick()
        board.feed(golden.hex("wire"))
        board.tick()
        outputs.append(take_output(board))

    assert outputs[0] == outputs[1]
