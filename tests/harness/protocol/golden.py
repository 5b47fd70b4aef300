"""The frames of tests/protocol/golden_frames.txt, read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from protocol.wire.messages import Value

LINES = (Path(__file__).parents[2] / "protocol" / "golden_frames.txt").read_text(encoding="utf-8").splitlines()


@dataclass(frozen=True, slots=True)
class Golden:
    title: str  # NAME or BAD CAUSE
    keys: dict[str, str]  # body, wire, fields, why

    def hex(self, key: str) -> bytes:
        return bytes.fromhex(self.keys[key])

    def values(self) -> dict[str, Value]:
        return {name: _value(text) for name, text in (pair.split("=") for pair in self.keys["fields"].split())}


def _value(text: str) -> Value:
    if text.startswith("hex:"):
        return bytes.fromhex(text[4:])
    return float(text) if "." in text else int(text)


def read_golden() -> list[Golden]:
    entries: list[Golden] = []
    for line in LINES:
        if not line or line.startswith("#"):
            continue
        key, _, rest = line.partition(" ")
        if key in ("body", "wire", "fields", "why"):
            entries[-1].keys[key] = rest
        else:
            entries.append(Golden(line, {}))
    return entries


GOLDEN = read_golden()
FRAMES = [golden for golden in GOLDEN if not golden.title.startswith("BAD ")]
BAD = [golden for golden in GOLDEN if golden.title.startswith("BAD ")]
