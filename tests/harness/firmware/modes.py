"""The table of modes in firmware/README.md, and the drawings that follow from it and from the times of a tick.

python -m tests.harness.firmware.modes writes them to docs/assets; `test_modes.py` fails where they are older.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from gateway.emulator.native.flags import SOURCES
from protocol.wire.messages import Mode

ASSETS = Path(__file__).parents[3] / "docs" / "assets"
MODES = {"idle": Mode.IDLE, "open loop": Mode.OPEN_LOOP, "closed loop": Mode.CLOSED_LOOP}
_HEAD = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="system-ui, sans-serif"'
    ' font-size="13" fill="#263238">\n'
    '  <marker id="a" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
    '<path d="M0 0 8 4 0 8z" fill="#546e7a"/></marker>\n'
    '  <rect width="{width}" height="{height}" rx="8" fill="#fafafa"/>\n'  # readable in a dark page, too
)
_PLACES = {Mode.IDLE: (70, 258), Mode.OPEN_LOOP: (520, 40), Mode.CLOSED_LOOP: (520, 480)}  # x, y of the box
_BOX = (120, 44)
# Where an arrow begins and ends, and its text: x, y of the first line.
_ARROWS = {
    (Mode.IDLE, Mode.OPEN_LOOP): ("M130 256 516 54", (150, 140)),
    (Mode.OPEN_LOOP, Mode.IDLE): ("M520 80 194 268", (380, 176)),
    (Mode.IDLE, Mode.CLOSED_LOOP): ("M130 304 516 506", (130, 420)),
    (Mode.CLOSED_LOOP, Mode.IDLE): ("M520 482 194 294", (380, 292)),
    (Mode.OPEN_LOOP, Mode.CLOSED_LOOP): ("M600 86V476", (612, 460)),
    (Mode.CLOSED_LOOP, Mode.OPEN_LOOP): ("M560 478V88", (612, 112)),
}
# Of a tick of the ATmega328P: the lane, then from where to where it is drawn, and what it is with its time in us.
_LANES: dict[str, tuple[tuple[int, int, str], ...]] = {
    "timer 1": ((120, 126, "tick"), (860, 866, "tick")),
    "main loop": (
        (120, 190, "i_c: 55"),
        (190, 260, "x: 55"),
        (260, 330, "law"),
        (330, 410, "u_c, bus: 75"),
        (410, 510, "queue STATE"),
        (510, 570, "frame"),
        (570, 650, "a command"),
        (860, 930, "i_c: 55"),
    ),
    "line out": tuple((120 + 24 * n, 136 + 24 * n, "") for n in range(15)),
    "line in": tuple((at, at + 16, "") for at in (160, 400, 424, 448, 720)),
    "timer 2": ((180, 186, "a sample"), (254, 260, ""), (328, 334, "each 200, while a capture runs")),
}


class Row(NamedTuple):
    """A row of the table."""

    event: str
    after: dict[Mode, Mode]
    fault: str


def rows() -> list[Row]:
    """Read the table."""
    text = (SOURCES / "README.md").read_text(encoding="utf-8")
    table = text.partition("| what happens | in idle ")[2].partition("\n\n")[0]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()[2:]]
    return [Row(row[0], dict(zip(Mode, (MODES[name] for name in row[1:4]), strict=True)), row[4]) for row in cells]


def states(table: Iterable[Row]) -> str:
    """Draw the modes, and each change of one into another with what makes it."""
    events: dict[tuple[Mode, Mode], list[str]] = {}
    for row in table:
        for before, after in row.after.items():
            if before != after:
                events.setdefault((before, after), []).append(row.event)
    lines = [_HEAD.format(width=760, height=560)]
    lines.append('  <g fill="none" stroke="#546e7a" stroke-width="2" marker-end="url(#a)">')
    lines += [f'    <path d="{_ARROWS[change][0]}"/>' for change in sorted(events)]
    lines += ['    <path d="M20 280H66"/>', "  </g>", '  <text x="20" y="272" font-size="11">a reset</text>']
    for name, mode in MODES.items():
        (x, y), (width, height) = _PLACES[mode], _BOX
        lines.append(f'  <rect x="{x}" y="{y}" width="{width}" height="{height}" rx="6" fill="#fff" stroke="#546e7a"/>')
        lines.append(f'  <text x="{x + 60}" y="{y + 27}" font-weight="600" text-anchor="middle">{name}</text>')
    for change, causes in sorted(events.items()):
        x, y = _ARROWS[change][1]
        lines += [f'  <text x="{x}" y="{y + 14 * n}" font-size="11">{cause}</text>' for n, cause in enumerate(causes)]
    return "\n".join([*lines, "</svg>", ""])


def tick() -> str:
    """Draw a tick of the ATmega328P in closed loop, lane by lane, not to scale."""
    lines = [_HEAD.format(width=950, height=300)]
    for n, (lane, spans) in enumerate(_LANES.items()):
        y = 40 + 52 * n
        lines.append(f'  <text x="16" y="{y + 17}" font-weight="600">{lane}</text>')
        for start, end, text in spans:
            fill = "#cfd8dc" if end - start > 20 else "#546e7a"
            lines.append(
                f'  <rect x="{start}" y="{y}" width="{end - start}" height="26" fill="{fill}" stroke="#546e7a"/>'
            )
            at, anchor = ((start + end) // 2, "middle") if end - start > 20 else (end + 4, "start")
            lines.append(f'  <text x="{at}" y="{y + 17}" font-size="11" text-anchor="{anchor}">{text}</text>')
    notes = (
        (660, 109, "sleeps until an interrupt has work"),
        (486, 161, "a byte each 85; 15 of them are STATE"),
        (750, 213, "whenever the host sends"),
        (190, 24, "sample of x to u_c in force: 260"),
        (884, 24, "2000"),
    )
    lines += [f'  <text x="{x}" y="{y}" font-size="11">{text}</text>' for x, y, text in notes]
    lines.append('  <path d="M190 30H408" fill="none" stroke="#546e7a" stroke-width="2" marker-end="url(#a)"/>')
    return "\n".join([*lines, "</svg>", ""])


def drawings() -> dict[Path, str]:
    """Return each drawing with the file it belongs to."""
    return {ASSETS / "modes.svg": states(rows()), ASSETS / "tick.svg": tick()}


if __name__ == "__main__":
    for file, drawing in drawings().items():
        file.write_text(drawing, encoding="utf-8")
