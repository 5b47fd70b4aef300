"""The interface page and the tables in the code say the same, row by row.

The tables in the code are the source.  Where a comparison fails, paste the rendered lines that pytest shows into the
page.
"""

from __future__ import annotations

import re
from enum import IntEnum
from pathlib import Path

import pytest

from protocol.bus import encoding, topics
from protocol.wire import framing, messages
from protocol.wire.codec import BODY_SIZE, encode_body
from protocol.wire.messages import ROWS, EventCode, Field, Flag, Reason, Row

PAGE = (Path(__file__).parents[2] / "protocol" / "README.md").read_text(encoding="utf-8")
LINE_BITS_PER_BYTE = 10  # 8N1
BAUD = 115200
DRAWING_WIDTH = 110


def section(heading: str) -> str:
    """Return the text under the one heading that starts with `heading`, down to the next heading."""
    matches = re.findall(rf"^#+ {re.escape(heading)}[^\n]*\n(.*?)(?=^#+ |\Z)", PAGE, re.MULTILINE | re.DOTALL)
    assert len(matches) == 1, f"{len(matches)} headings start with {heading!r}"
    return str(matches[0])


def table(text: str) -> list[str]:
    """The lines of the one table in `text`, without its head."""
    outside_drawings = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    lines = [line for line in outside_drawings.splitlines() if line.startswith("|")]
    assert set(lines[1]) <= set("|- "), "the second line of a table separates its head"
    return lines[2:]


def field_size(field: Field) -> float:
    """Bytes that a field takes; the two of a pair of `counts` share three."""
    sizes = {"u8": 1, "i8": 1, "flags": 1, "u16": 2, "i16": 2, "u32": 4, "f32": 4, "counts": 1.5}
    return float(field.type.removeprefix("bytes")) if field.type.startswith("bytes") else sizes[field.type]


def field_lines(row: Row) -> list[str]:
    lines = []
    at = 1.0  # after the type byte
    for field in row.fields:
        if field.type == "counts":
            position = (
                f"{int(at)}-{int(at) + 2}, bits 0-11" if at.is_integer() else f"{int(at) - 1}-{int(at) + 1}, bits 12-23"
            )
        else:
            last = int(at + field_size(field)) - 1
            position = f"{int(at)}" if last == at else f"{int(at)}-{last}"
        at += field_size(field)
        limits = "finite" if field.type == "f32" else "any" if field.low is None else f"{field.low} .. {field.high}"
        lines.append(
            f"| {position} | {field.name} | {field.type} | {field.unit or '-'} | {limits} | {field.description} |"
        )
    return lines


def drawing(row: Row) -> list[str]:
    """The body as boxes: names above, sizes in bytes below; a pair of `counts` is one box."""
    boxes: list[tuple[str, int]] = [(f"{row.type:02X}", 1)]
    names: list[str] = []
    for field in row.fields:
        names.append(field.name)
        if field.type == "counts" and len(names) < 2:
            continue
        boxes.append((" and ".join(names), int(field_size(field) * len(names))))
        names = []
    lines = ["", ""]
    for name, size in boxes:
        if len(lines[-1]) + len(name) + 3 > DRAWING_WIDTH:
            lines += ["", ""]
        lines[-2] += f"| {name} "
        lines[-1] += f"| {size:^{len(name)}} "
    return [line + "|" for line in lines]


def enum_lines(codes: type[IntEnum]) -> list[tuple[str, str]]:
    return [(str(code.value), code.name) for code in codes]


def test_the_page_says_early_that_the_format_is_our_own() -> None:
    first_lines = PAGE[:1200]

    assert "does not publish" in first_lines
    assert "our own design" in first_lines


def test_the_message_table_is_that_of_the_code() -> None:
    expected = [
        f"| 0x{row.type:02X} | {row.name} | {'board' if row.to_board else 'host'} | {BODY_SIZE[row.name]} "
        f"| {BODY_SIZE[row.name] + 5} | {row.description} |"
        for row in ROWS
    ]

    assert table(section("Message table")) == expected


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_every_field_table_is_that_of_the_code(row: Row) -> None:
    assert table(section(f"0x{row.type:02X} {row.name}")) == field_lines(row)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_every_drawing_is_that_of_the_code(row: Row) -> None:
    text = section(f"0x{row.type:02X} {row.name}")

    drawn = text.split("```")[1].strip("\n").splitlines()

    assert drawn == drawing(row)


@pytest.mark.parametrize(("heading", "codes"), [("Reasons", Reason), ("Events", EventCode)])
def test_codes_are_those_of_the_code(heading: str, codes: type[IntEnum]) -> None:
    on_page = [line.split("|")[1:3] for line in table(section(heading))]

    assert [(code.strip(), name.strip()) for code, name in on_page] == enum_lines(codes)


def test_flags_are_those_of_the_code() -> None:
    on_page = [line.split("|")[1:4] for line in table(section("Flags"))]

    assert [(int(bit), int(mask, 16), name.strip()) for bit, mask, name in on_page] == [
        (flag.value.bit_length() - 1, flag.value, str(flag.name)) for flag in Flag
    ]


def test_the_topic_table_is_that_of_the_code() -> None:
    expected = [
        f"| `<site>/<board>/{topic.name}` | {encoding.schema_name(topic.message)} | {topic.source} | {topic.rate} "
        f"| {'yes' if topic.bus else 'no'} | {'yes' if topic.logged else 'no'} | {topic.description} |"
        for topic in topics.TOPICS
    ]

    assert table(section("Topics")) == expected
    assert f"`<site>/<board>/{topics.ALIVE}`" in section("Topics")


def test_the_line_budget_on_the_page_is_that_of_the_table() -> None:
    state = len(framing.encode_frame(encode_body("STATE", sequence=0, i_c=0, x=0, u_c=0, x_ref=0, flags=0)))
    load = state * LINE_BITS_PER_BYTE * 500 / BAUD

    assert load <= 0.70, "at least 30 % of the line stays free at 500 Hz"
    assert f"{state} bytes" in section("Line budget")
    assert f"{100 * load:.1f} %" in section("Line budget")
    assert f"{100 - 100 * load:.1f} %" in section("Line budget")


def test_limits_of_the_page_are_those_of_the_code() -> None:
    text = section("Framing")

    assert f"1 to {framing.MAX_BODY} bytes" in text
    assert f"{framing.MAX_ENCODED} bytes" in text
    assert "0x29B1" in text
    assert framing.crc16(b"123456789") == 0x29B1
    assert f"version {messages.VERSION}" in PAGE.splitlines()[0]


def test_every_worked_example_is_a_golden_frame() -> None:
    golden = (Path(__file__).parent / "golden_frames.txt").read_text(encoding="utf-8")
    frames = re.findall(r"^ *wire +((?:[0-9A-F]{2} ?)+)$", section("Worked examples"), re.MULTILINE)

    assert len(frames) >= 8
    for frame in frames:
        assert f"wire {frame.strip()}\n" in golden, frame
