"""The plant of a rig: what is known of it without identification, and whether that can be right.  Pure.

`Plant` is the table `[plant]` of a file and the card that a gateway keeps of a rig.  `objections` judges its values.

Rule 1: an error cannot be right and is refused.  A question may be right: whoever states the plant confirms it.
Rule 2: an objection names the key, shows the value with its unit, and says what may be meant instead.
Rule 3: no recording shows a wrong mass, and hardly a wrong travel.  So they are judged where they are stated.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Annotated

from pydantic import Field

from protocol.checked import Flag, Keys, Number, RuleError, bounds, key, keys_of

GRAVITY_M_S2 = 9.81
MAX_NAME = 64  # characters of the name on a plant card
STEEL_KG_M3 = 7850.0  # balls of bearings: 7.7e3 (stainless) .. 7.85e3 (chromium steel)
_MASS_SHARE = 0.1  # of the mass of a steel ball; the published ball of a CE 152 is 2 % lighter than its diameter says
_EARTH_M_S2 = (9.75, 9.84)  # 9.764 on high mountains near the equator, 9.834 at the poles
_SHORT = 0.99  # of the highest reference: a count of the converter less is not a contradiction
_REACH = 3.0  # a travel of more than this many times the board's highest reference needs a confirmation
# Of laboratory rigs; what is outside may be right.
_USUAL = {
    "mass_kg": (5e-4, 0.2),
    "ball_diameter_m": (4e-3, 0.05),
    "travel_m": (5e-4, 0.05),
    "x_max_m": (5e-4, 0.1),
    "gravity_m_s2": _EARTH_M_S2,
}
_SLIPS = (1e-3, 1e3, 1e-2, 1e2, 1e-6)  # g for kg, mm for m and the reverse; cm; mg and um


@dataclass(frozen=True, slots=True, kw_only=True)
class Plant(Keys):
    """The parameters that are known without identification: `[plant]`.

    The bounds cover the physical range of magnetic levitation rigs.  They detect a wrong unit or a wrong power of ten.
    A mass in grams instead of kilograms makes K_c a thousand times too large, and the recordings cannot reveal it.
    """

    name: Annotated[str, Field(min_length=1, description="name of the rig")]
    mass_kg: Annotated[Number, key("mass of the ball, as steel balls of 2.9 to 79 mm have", 1e-4, 2.0)]
    travel_m: Annotated[Number, key("highest position of the ball (top stop); 0 is the sensor", 1e-4, 0.5)]
    x_max_m: Annotated[Number, key("x_max of eq. (3)", 1e-4, 0.5)]
    gravity_m_s2: Annotated[Number, key("acceleration of gravity", 1.0, 20.0)]
    assumed: Flag = False  # nobody stated it: K_c and b, which rest on it, may be wrong
    # Of a steel ball; the mass is compared with it, and nothing else is computed from it.
    ball_diameter_m: Annotated[Number | None, key("diameter of a ball of steel", 1e-3, 0.1)] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Objection:
    """An answer to one value of a plant that is wrong or unusual."""

    key: str  # of `[plant]`
    problem: str  # the value with its unit, and why not
    remedy: str
    is_error: bool  # impossible; else a question that can be confirmed

    @property
    def text(self) -> str:
        """Return problem and remedy as sentences."""
        return f"{self.problem}. {self.remedy}."


def with_defaults(table: object) -> object:
    """Add the defaults of `[plant]` to a parsed table: a name, standard gravity, and the travel as x_max."""
    if not isinstance(table, dict):
        return table
    x_max = {"x_max_m": table["travel_m"]} if "travel_m" in table else {}
    return {"name": "plant", "gravity_m_s2": GRAVITY_M_S2, **x_max, **table}


def refuse_impossible(table: object) -> object:
    """Return a parsed `[plant]`; raise RuleError with the first error of `objections`."""
    for objection in objections(table) if isinstance(table, dict) else ():
        if objection.is_error:
            raise RuleError(f": {objection.problem}", remedy=objection.remedy, key=objection.key)
    return table


def objections(values: Mapping[str, object], *, highest_reference_m: float | None = None) -> tuple[Objection, ...]:
    """Judge the values of a plant, SI units; at most one objection for each key, in the order of the keys.

    Missing values and those that are not finite are not judged.  `highest_reference_m`: that the board takes, if known.
    """
    known = {
        name: float(value)
        for name, value in values.items()
        if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    }
    objected: list[Objection] = []
    for name in _USUAL:
        objection = name in known and (
            _out_of_range(name, known[name])
            or (name in _RULES and _RULES[name](known, highest_reference_m))
            or _unusual(name, known)
        )
        if objection:
            objected.append(objection)
    return tuple(objected)


def in_words(plant: Plant) -> str:
    """Return the values of a plant for people: "a ball of 8.28 g, travel 5.7 mm, x_max 8.138 mm, g 9.81 m/s2"."""
    ball = f" ({with_unit('ball_diameter_m', plant.ball_diameter_m)})" if plant.ball_diameter_m is not None else ""
    return (
        f"a ball of {with_unit('mass_kg', plant.mass_kg)}{ball}, travel {with_unit('travel_m', plant.travel_m)},"
        f" x_max {with_unit('x_max_m', plant.x_max_m)}, g {with_unit('gravity_m_s2', plant.gravity_m_s2)}"
    )


def with_unit(name: str, value: float) -> str:
    """Return a value of `[plant]` with the unit that people use for it."""
    if name == "mass_kg":
        return f"{value * 1e3:.4g} g" if value < 1.0 else f"{value:.4g} kg"
    if name == "gravity_m_s2":
        return f"{value:.5g} m/s2"
    return f"{value * 1e3:.4g} mm" if value < 1.0 else f"{value:.4g} m"


def steel_ball_kg(diameter_m: float) -> float:
    """Return the mass of a steel ball, kg."""
    return STEEL_KG_M3 * math.pi / 6.0 * diameter_m**3


def steel_ball_m(mass_kg: float) -> float:
    """Return the diameter of a steel ball, m."""
    return float((6.0 * mass_kg / (math.pi * STEEL_KG_M3)) ** (1.0 / 3.0))


def is_possible(plant: Plant) -> bool:
    """Return whether all numbers of a plant are within the bounds of `[plant]`."""
    numbers = {f.name: getattr(plant, f.name) for f in fields(plant) if f.name in _USUAL}
    return all(value is None or _out_of_range(name, value) is None for name, value in numbers.items())


def _out_of_range(name: str, value: float) -> Objection | None:
    low, high = bounds(keys_of(Plant)[name])
    if low is None or high is None or low <= value <= high:
        return None
    problem = f"{with_unit(name, value)} is outside {with_unit(name, low)} .. {with_unit(name, high)}"
    remedy = _meant(name, value) or "Check the unit and the power of ten"
    return Objection(key=name, problem=problem, remedy=remedy, is_error=True)


def _unusual(name: str, known: Mapping[str, float]) -> Objection | None:
    value, (low, high) = known[name], _USUAL[name]
    if low <= value <= high:
        return None
    problem = f"{with_unit(name, value)} is unusual, {with_unit(name, low)} .. {with_unit(name, high)} are usual"
    if name == "gravity_m_s2":
        problem = f"{with_unit(name, value)} is not measured anywhere on Earth, {low:g} .. {high:g} m/s2 are"
    remedy = f"{_meant(name, value) or 'Check the unit'}, or confirm it"
    return Objection(key=name, problem=problem, remedy=remedy, is_error=False)


def _meant(name: str, value: float) -> str:
    """Return what a value in another unit may mean; empty if no unit makes it usual."""
    low, high = _USUAL[name]
    meant = next((value * slip for slip in _SLIPS if low <= value * slip <= high), None)
    if meant is None:
        return f"You may mean {GRAVITY_M_S2:g} m/s2" if name == "gravity_m_s2" else ""
    return f"You may mean {with_unit(name, meant)} ({name} = {meant:.4g})"


def _mass(known: Mapping[str, float], _highest_m: float | None) -> Objection | None:
    mass, diameter = known["mass_kg"], known.get("ball_diameter_m")
    if diameter is None or _out_of_range("ball_diameter_m", diameter):
        return None
    steel = steel_ball_kg(diameter)
    if abs(mass / steel - 1.0) <= _MASS_SHARE:
        return None
    ball = f"a steel ball of {with_unit('ball_diameter_m', diameter)} weighs {with_unit('mass_kg', steel)}"
    problem = f"{with_unit('mass_kg', mass)} does not fit the diameter: {ball}"
    remedy = "Weigh the ball and measure it; confirm it if it is hollow or of another material"
    return Objection(key="mass_kg", problem=problem, remedy=remedy, is_error=False)


def _travel(known: Mapping[str, float], highest_m: float | None) -> Objection | None:
    travel = known["travel_m"]
    if highest_m is None or _SHORT * highest_m <= travel <= _REACH * highest_m:
        return None
    problem = (
        f"{with_unit('travel_m', travel)} does not fit the board, whose references end at {highest_m * 1e3:.4g} mm"
    )
    remedy = "Measure the way of the ball between its stops, or confirm it"
    return Objection(key="travel_m", problem=problem, remedy=remedy, is_error=False)


def _x_max(known: Mapping[str, float], _highest_m: float | None) -> Objection | None:
    x_max, travel = known["x_max_m"], known.get("travel_m")
    if travel is None or x_max >= travel:
        return None
    problem = f"{with_unit('x_max_m', x_max)} lies within the travel of {with_unit('travel_m', travel)}"
    remedy = "The force (3) is infinite at x_max: give at least the travel, or correct the travel"
    return Objection(key="x_max_m", problem=problem, remedy=remedy, is_error=True)


_Rule = Callable[[Mapping[str, float], float | None], Objection | None]
_RULES: Mapping[str, _Rule] = {"mass_kg": _mass, "travel_m": _travel, "x_max_m": _x_max}
