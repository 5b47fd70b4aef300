"""Writes a campaign as the text of `campaign.toml`: the inverse of `protocol.campaign.parse`.

Rule: `parse(emit(campaign))` equals `campaign`, every number bit for bit.  Default values are omitted.
"""

from __future__ import annotations

import json
from collections.abc import Iterable

from protocol.campaign import CHANNELS, GRAVITY_M_S2, Campaign, Channel, Column, Controller, Plant, Recording
from protocol.units import unit_of_name


def emit(campaign: Campaign, *, comments: Iterable[str] = ()) -> str:
    """Return a campaign as TOML.

    Args:
        campaign: Campaign with at least one recording and finite numbers only.
        comments: Comment lines for the top of the file.
    """
    blocks = [[f"# {line}".rstrip() for line in comments], _plant(campaign.plant)]
    if campaign.controller is not None:
        blocks.append(_controller(campaign.controller))
    blocks += [_recording(recording) for recording in campaign.recordings]
    return "\n\n".join("\n".join(block) for block in blocks if block) + "\n"


def _plant(plant: Plant) -> list[str]:
    lines = ["[plant]", f"name = {_text(plant.name)}", f"mass_kg = {_number(plant.mass_kg)}"]
    lines.append(f"travel_m = {_number(plant.travel_m)}")
    if plant.x_max_m != plant.travel_m:
        lines.append(f"x_max_m = {_number(plant.x_max_m)}")
    if plant.gravity_m_s2 != GRAVITY_M_S2:
        lines.append(f"gravity_m_s2 = {_number(plant.gravity_m_s2)}")
    if plant.assumed:
        lines.append("assumed = true")
    return lines


def _controller(controller: Controller) -> list[str]:
    point = controller.operating_point
    numbers = f"i_c_a = {_number(point.i_c_a)}, x_m = {_number(point.x_m)}, u_c_v = {_number(point.u_c_v)}"
    return [
        "[controller]",
        f"kind = {_text(controller.kind)}",
        f"gains = {_list(controller.gains)}",
        f"operating_point = {{ {numbers} }}",
    ]


def _recording(recording: Recording) -> list[str]:
    lines = ["[[recording]]", f"file = {_text(recording.file)}", f"kind = {_text(recording.kind)}"]
    lines.append(f"use = {_text(recording.use)}")
    if recording.skip_s:
        lines.append(f"skip_s = {_number(recording.skip_s)}")
    if recording.board:
        lines.append(f"board = {_text(recording.board)}")
    mapped = [f"{name} = {_column(recording.columns[name], name)}" for name in CHANNELS if name in recording.columns]
    if mapped:
        lines.append(f"columns = {{ {', '.join(mapped)} }}")
    return lines


def _column(column: Column, channel: Channel) -> str:
    parts = [f"column = {_text(column.column)}"]
    if column.scale != 1.0 or unit_of_name(column.column, channel):  # such a name requires an explicit scale
        parts.append(f"scale = {_number(column.scale)}")
    if column.offset != 0.0:
        parts.append(f"offset = {_number(column.offset)}")
    if column.table:
        parts.append(f"table = [{', '.join(_list(point) for point in column.table)}]")
    return f"{{ {', '.join(parts)} }}" if len(parts) > 1 else _text(column.column)


def _list(values: Iterable[float]) -> str:
    return f"[{', '.join(_number(value) for value in values)}]"


def _number(value: float) -> str:
    return repr(float(value))


def _text(value: str) -> str:
    # A JSON string is a valid TOML basic string, except for DEL: TOML requires it escaped, JSON does not escape it.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")
