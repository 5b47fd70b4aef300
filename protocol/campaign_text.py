"""Writes a campaign as the text of `campaign.toml`: the inverse of `protocol.campaign.parse`.

Rule: `parse(emit(campaign))` equals `campaign`, every number bit for bit.  Default values are omitted.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict

from protocol.campaign import CHANNELS, GRAVITY_M_S2, Campaign, Channel, Column, Plant
from protocol.units import unit_of_name


def emit(campaign: Campaign, *, comments: Iterable[str] = ()) -> str:
    """Return a campaign with a recording and finite numbers as TOML, below lines of comments."""
    blocks = [_comments(comments), _plant(campaign.plant)]
    if campaign.controller is not None:
        blocks.append(_table("[controller]", asdict(campaign.controller)))
    for recording in campaign.recordings:
        columns = {name: _column(recording.columns[name], name) for name in CHANNELS if name in recording.columns}
        values = asdict(recording) | {"columns": columns}
        blocks.append(_table("[[recording]]", {k: v for k, v in values.items() if v}))
    return _joined(blocks)


def plant_text(plant: Plant, stated: Mapping[str, object], *, comments: Iterable[str]) -> str:
    """Return a plant as TOML that `load_plant` reads, and a table `[stated]` that says by whom and when."""
    return _joined([_comments(comments), _plant(plant), _table("[stated]", stated)])


def _joined(blocks: Iterable[list[str]]) -> str:
    return "\n\n".join("\n".join(block) for block in blocks if block) + "\n"


def _comments(lines: Iterable[str]) -> list[str]:
    return [f"# {line}".rstrip() for line in lines]


def _plant(plant: Plant) -> list[str]:
    defaults = {"x_max_m": plant.travel_m, "gravity_m_s2": GRAVITY_M_S2, "assumed": False, "ball_diameter_m": None}
    return _table("[plant]", {k: v for k, v in asdict(plant).items() if k not in defaults or v != defaults[k]})


def _table(title: str, values: Mapping[str, object]) -> list[str]:
    return [title, *(f"{key} = {_value(value)}" for key, value in values.items())]


def _column(column: Column, channel: Channel) -> object:
    plain = Column(column=column.column)
    values = {key: value for key, value in asdict(column).items() if key == "column" or value != getattr(plain, key)}
    if unit_of_name(column.column, channel):  # such a name requires an explicit scale
        values["scale"] = column.scale
    return values if len(values) > 1 else column.column


def _value(value: object) -> str:
    match value:
        case bool():
            return str(value).lower()
        case int() | float():
            return repr(float(value))
        case Mapping():
            return f"{{ {', '.join(f'{key} = {_value(item)}' for key, item in value.items())} }}"
        case tuple() | list():
            return f"[{', '.join(map(_value, value))}]"
    # A JSON string is a valid TOML basic string, except for DEL: TOML requires it escaped, JSON does not escape it.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")
