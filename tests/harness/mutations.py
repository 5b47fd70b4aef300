"""Valid input made wrong: a key, a number, a line, a few bytes.  What is still well-formed gets furthest into a parser.

Each function takes a source of chance (hypothesis draws it, and makes an example smaller through it) and returns the
mutant; several mutations may meet in one.
"""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Callable
from random import Random
from typing import Any

HOSTILE: tuple[Any, ...] = (
    None, True, False, -1, 0, 1, 2**31, 2**63, 2**64, 10**30, 10**400, -0.0, 1e-320, 1e308, -1e308, math.nan, math.inf,
    -math.inf, "", " ", "x" * 300, "\x00", "\n", "1e5", "nan", "../../etc/passwd", "/dev/zero", "é\u202e", [], {},
    [[]], [None], [1.0, 2.0], [1.0] * 50, {"a": 1}, {"": {}},
)  # fmt: skip
TOKENS = (
    "", "nan", "inf", "-inf", "1e999", "-1e308", "1e-320", "0x10", "1_000", "1,5", "'", '"', "#", ";", "\t", "\x00",
    "=", "[", "]", "{", "}", "-", "1" * 5000, "é", "true", "NULL", "1979-05-27", "\r",
)  # fmt: skip
Mutation = Callable[[Random, Any], Any]


def tree(chance: Random, valid: Any) -> Any:
    """Return a tree of dicts and lists with one to three values, keys or branches changed."""
    root = {"": copy.deepcopy(valid)}
    for _ in range(chance.randint(1, 3)):
        holders = list(_holders(root))
        holder, key = holders[chance.randrange(len(holders))]
        _change(chance, holder, key, holders)
    return root.get("", None)


def _holders(node: Any) -> list[tuple[Any, Any]]:
    """Return every (dict or list, key) of a tree."""
    keys = list(node) if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else []
    return [pair for key in keys for pair in [(node, key), *_holders(node[key])]]


def _change(chance: Random, holder: Any, key: Any, holders: list[tuple[Any, Any]]) -> None:
    value = holder[key]
    kind = chance.randrange(6)
    if kind == 0 and key != "":
        del holder[key]
    elif kind == 1 and isinstance(holder, dict) and key != "":
        holder[chance.choice([f"{key}s", "", "x" * 300, str(key).upper()])] = holder.pop(key)
    elif kind == 2 and isinstance(value, list) and value:
        value.append(copy.deepcopy(chance.choice(value)))
    elif kind == 3 and isinstance(value, int | float) and not isinstance(value, bool):
        holder[key] = chance.choice([-value, value * 1000, value * 1e-3 if abs(value) < 1e300 else 1e-9, str(value)])
    elif kind == 4:
        other, index = holders[chance.randrange(len(holders))]
        holder[key] = copy.deepcopy(other.get(index) if isinstance(other, dict) else other[index % max(len(other), 1)])
    else:
        holder[key] = copy.deepcopy(chance.choice(HOSTILE))


def as_json(value: Any) -> bytes:
    """Return a tree as JSON, with NaN and Infinity as Python's reader takes them."""
    return json.dumps(value).encode()


def as_toml(value: Any) -> bytes:
    """Return a tree as TOML, tables inline; what TOML has no word for is written as it is."""
    if not isinstance(value, dict):
        return _toml(value).encode()
    return "".join(f"{json.dumps(str(key))} = {_toml(item)}\n" for key, item in value.items()).encode()


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(str(key))} = {_toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value) if isinstance(value, str | bool) else str(value)


def text(chance: Random, valid: bytes) -> bytes:
    """Return a text with some of its lines or cells changed."""
    lines = valid.decode().split("\n")
    for _ in range(chance.randint(1, 3)):
        at = chance.randrange(len(lines))
        match chance.randrange(5):
            case 0:
                del lines[at]
            case 1:
                lines.insert(at, chance.choice(lines))
            case 2:
                lines[at] = lines[at][: chance.randint(0, len(lines[at]))]
            case _:
                cells = lines[at].split(",")
                cells[chance.randrange(len(cells))] = chance.choice(TOKENS)
                lines[at] = ",".join(cells)
        lines = lines or [""]
    return "\n".join(lines).encode()


def binary(chance: Random, valid: bytes) -> bytes:
    """Return bytes of which some are changed, gone, doubled or cut off."""
    data = bytearray(valid)
    for _ in range(chance.randint(1, 4)):
        at, length = chance.randint(0, len(data)), chance.choice([1, 2, 4, 8, 64])
        match chance.randrange(6):
            case 0:
                del data[at : at + length]
            case 1:
                data[at:at] = data[at : at + length]
            case 2:
                del data[at:]
            case 3:
                data[at : at + length] = chance.choice([b"\x00", b"\xff", b"\x7f", b"\x80"]) * length
            case 4:
                data[at : at + length] = chance.randbytes(length)
            case _:
                if at < len(data):
                    data[at] ^= 1 << chance.randrange(8)
    return bytes(data)
