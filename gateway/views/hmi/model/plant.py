"""The plant card of a rig on its page: what it says, and what is wrong about values that somebody has typed.

Rule: the page shows and takes mm and g; the gateway judges again what is stated.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any

from gateway.views.hmi.texts import text_of
from protocol.bus import board51_pb2 as pb
from protocol.bus.plant_card import EMULATED, card_plant
from protocol.plant import GRAVITY_M_S2, MAX_NAME, Objection, objections, with_defaults

# Field of the page: key of `[plant]`, SI units in one unit of the page.
FIELDS: Mapping[str, tuple[str, float]] = {
    "mass_g": ("mass_kg", 1e-3),
    "diameter_mm": ("ball_diameter_m", 1e-3),
    "travel_mm": ("travel_m", 1e-3),
    "x_max_mm": ("x_max_m", 1e-3),
    "gravity": ("gravity_m_s2", 1.0),
}
_NEEDED = ("mass_g", "travel_mm")


def stated_ms(card: pb.PlantCard | None) -> int:
    """Return when a card was stated, Unix time in ms; 0: nobody stated it, -1: no card has arrived."""
    return -1 if card is None else card.stated_ns // 1_000_000


def plant_card(card: pb.PlantCard | None, board: str) -> dict[str, Any]:
    """Return the card for the page of a board, in the units of the page; empty texts where nobody stated a value."""
    plant = card_plant(card)
    fields = dict.fromkeys(FIELDS, "") | {"gravity": f"{GRAVITY_M_S2:g}"}
    if plant is not None:
        values = {field: getattr(plant, name) for field, (name, _) in FIELDS.items()}
        fields = {field: "" if value is None else f"{value / FIELDS[field][1]:.6g}" for field, value in values.items()}
    seconds = card.stated_ns / 1e9 if card is not None else 0.0
    return {
        "stated_ms": stated_ms(card),
        "emulated": card is not None and card.who == EMULATED,  # stated by the build of an emulated board
        "who": card.who if card is not None else "",
        "when": time.strftime("%Y-%m-%d %H:%M", time.localtime(seconds)) if seconds else "",
        "name": plant.name if plant is not None else board,
        "fields": fields,
    }


def judged(typed: Mapping[str, str], parameters: pb.Parameters | None) -> dict[str, Any]:
    """Return what is wrong or unusual about typed values, by field, and the command that would state them.

    Args:
        typed: Text of each field of the page, and of `name`.
        parameters: Of the board, if known: its references lie in the travel.
    """
    values: dict[str, object] = {}
    answers: list[dict[str, Any]] = []
    for field, (name, unit) in FIELDS.items():
        text = typed.get(field, "").strip().replace(",", ".")
        if text:
            value = _number(text)
            if value is None:
                answers.append(_answer(field, text_of("plant.no_number"), is_error=True))
            else:
                values[name] = value * unit
        elif field in _NEEDED:
            answers.append(_answer(field, text_of("plant.missing"), is_error=True))
    name = typed.get("name", "").strip()
    if not 0 < len(name) <= MAX_NAME:
        answers.append(_answer("name", text_of("plant.no_name", most=MAX_NAME), is_error=True))
    whole = with_defaults(values)
    assert isinstance(whole, dict)
    highest_m = parameters.x_ref_max_m if parameters is not None else None
    answers += map(_of_objection, objections(whole, highest_reference_m=highest_m))
    return {"answers": answers, "command": {"set_plant": {"plant": {**whole, "name": name}}}}


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _of_objection(objection: Objection) -> dict[str, Any]:
    field = next(field for field, (name, _) in FIELDS.items() if name == objection.key)
    return _answer(field, objection.text, is_error=objection.is_error)


def _answer(field: str, text: str, *, is_error: bool) -> dict[str, Any]:
    return {"field": field, "text": text, "error": is_error}
