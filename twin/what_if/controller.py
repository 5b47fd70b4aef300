"""The controller file of `board51 design`, as the law of a board."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from protocol.bus import board51_pb2 as pb
from protocol.checked import KEYS, Number, checked, key
from protocol.errors import DataError, UsageError
from protocol.files import parse_json, read_small
from twin.control import LawNumbers, law_numbers

REMEDY = "Give a controller.json as `board51 design --out` writes it"


@dataclass(frozen=True, slots=True, kw_only=True)
class OperatingPoint:
    """The point around which the law acts."""

    __pydantic_config__ = KEYS

    i_0_a: Number
    x_0_m: Number
    u_0_v: Number


@dataclass(frozen=True, slots=True, kw_only=True)
class ControllerFile:
    """Law, gains and operating point; the other keys are those of the designer and are not used."""

    __pydantic_config__ = KEYS

    law: Literal["lqi", "pid"]
    gains: tuple[Number, Number, Number, Number]
    operating_point: OperatingPoint
    sample_time_s: Annotated[Number, key("T_s, s", 1e-6, 1.0)]
    gain_names: tuple[str, ...] = ()
    gain_units: tuple[str, ...] = ()
    weights: Mapping[str, Any] = field(default_factory=dict)
    observer: Mapping[str, Any] | None = None


def read_controller(path: Path, *, sample_time_s: float, u_range_v: tuple[float, float], x_lsb_m: float) -> LawNumbers:
    """Read a controller file as the law of a board.

    Args:
        path: of the file.
        sample_time_s: T_s of the flight, s.
        u_range_v: limits of u_c, V.
        x_lsb_m: one count of x, m; 0: unknown, and the integral is not limited.

    Raises:
        DataError: the file is missing or not a controller.
        UsageError: it was designed for another T_s.
    """
    content = parse_json(read_small(path, remedy=REMEDY), where=str(path), remedy=REMEDY)
    file: ControllerFile = checked(ControllerFile, content, where=str(path), error=DataError)
    if abs(file.sample_time_s - sample_time_s) > 0.05 * sample_time_s:
        raise UsageError(
            f"{path} is designed for T_s = {file.sample_time_s:g} s, the flight is sampled every {sample_time_s:g} s",
            remedy=f"Design with --sample-time {sample_time_s:g}",
        )
    point = file.operating_point
    law = law_numbers(
        pb.Parameters(
            sample_time_s=sample_time_s,
            law=pb.LAW_LQI if file.law == "lqi" else pb.LAW_PID,
            gains=file.gains,
            i_0_a=point.i_0_a,
            x_0_m=point.x_0_m,
            u_0_v=point.u_0_v,
            u_min_v=u_range_v[0],
            u_max_v=u_range_v[1],
            x_lsb_m=x_lsb_m,
        )
    )
    if law is None:
        raise DataError(f"{path} holds no law", remedy=REMEDY)
    return law
