"""The controller file of `board51 design --out`, and its law as the twin runs it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from protocol.campaign import Controller, OperatingPoint
from protocol.checked import KEYS, Number, checked, key
from protocol.errors import DataError
from protocol.files import parse_json, read_small
from twin.control import LawNumbers
from twin.control_design.gains import Law
from twin.evidence.checks import control_law

REMEDY = "Give a controller.json as `board51 design --out` writes it"
Gains = tuple[Number, Number, Number, Number]  # in the order of the law (protocol/README.md, rule 9), SI units


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """The operating point."""

    __pydantic_config__ = KEYS

    i_0_a: Number
    x_0_m: Number
    u_0_v: Number


@dataclass(frozen=True, slots=True, kw_only=True)
class CostWeights:
    """The weights of the design."""

    __pydantic_config__ = KEYS

    Q: tuple[Number, Number, Number, Number]
    R: Number


@dataclass(frozen=True, slots=True, kw_only=True)
class ControllerFile:
    """The content of a controller file."""

    __pydantic_config__ = KEYS

    law: Law
    gains: Gains
    operating_point: Point
    sample_time_s: Annotated[Number, key("T_s, s", 1e-4, 2e-2)]
    weights: CostWeights | None = None  # of gains that no design here made
    gain_names: Any = None
    gain_units: Any = None
    observer: Any = None


def read_controller(path: Path) -> ControllerFile:
    """Read a controller file.

    Raises:
        DataError: the file is missing, or is not a controller file; the message names the key.
    """
    data = parse_json(read_small(path, remedy=REMEDY), where=str(path), remedy=REMEDY)
    file: ControllerFile = checked(ControllerFile, data, where=str(path), error=DataError)
    return file


def numbers_of(
    law: Law, gains: Gains, point: Point, sample_time_s: float, *, u_range_v: tuple[float, float], x_lsb_m: float
) -> LawNumbers:
    """Return a law as the twin runs it.

    Args:
        law: of the board.
        gains: of the law.
        point: around which it acts.
        sample_time_s: T_s, s.
        u_range_v: limits of u_c, V.
        x_lsb_m: one count of x, m, which limits the integral; 0: no limit.
    """
    at = OperatingPoint(i_c_a=point.i_0_a, x_m=point.x_0_m, u_c_v=point.u_0_v)
    controller = Controller(kind=law, gains=gains, operating_point=at)
    low, high = u_range_v
    numbers = control_law.numbers_of(controller, sample_time_s, u_low=low, u_high=high, x_lsb_m=x_lsb_m)
    assert numbers is not None  # all of them are there, and finite
    return numbers
