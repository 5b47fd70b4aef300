"""The control law that an exported rig has: that of a design for its model, or of a controller file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from protocol.bus import board51_pb2 as pb
from protocol.checked import KEYS, Number, checked, key
from protocol.errors import DataError, UsageError
from protocol.files import parse_json, read_small
from twin.control import LawNumbers, law_numbers
from twin.control_design.board import Converters
from twin.control_design.design import Design
from twin.control_design.gains import Law, OperatingPoint, Weights

_REMEDY = "Give a controller.json as `design --out` writes it"


@dataclass(frozen=True, slots=True, kw_only=True)
class Controller:
    """A law with the weights it came from."""

    law: Law
    gains: tuple[float, float, float, float]  # in the order of the law (protocol/README.md, rule 9), SI units
    point: OperatingPoint
    weights: Weights
    numbers: LawNumbers  # as the twin runs it

    @property
    def sample_time_s(self) -> float:
        """Return T_s, s."""
        return self.numbers.sample_time_s


@dataclass(frozen=True, slots=True, kw_only=True)
class _Point:
    __pydantic_config__ = KEYS

    i_0_a: Number
    x_0_m: Number
    u_0_v: Number


@dataclass(frozen=True, slots=True, kw_only=True)
class _Weights:
    __pydantic_config__ = KEYS

    Q: tuple[Number, Number, Number, Number]
    R: Number


@dataclass(frozen=True, slots=True, kw_only=True)
class _File:
    __pydantic_config__ = KEYS

    law: Law
    gains: tuple[Number, Number, Number, Number]
    operating_point: _Point
    sample_time_s: Annotated[Number, key("T_s, s", 1e-4, 2e-2)]
    weights: _Weights
    gain_names: Any = None
    gain_units: Any = None
    observer: Any = None


def of_design(design: Design, *, u_max_v: float) -> Controller:
    """The law with the gains of a design and an input from 0 to `u_max_v`, V."""
    return _controller(
        design.law, design.gains, design.point, design.weights, design.sample_time_s, design.converters, u_max_v
    )


def of_file(path: Path, *, u_max_v: float) -> Controller:
    """The law of a controller file.

    Raises:
        DataError: the file is missing, or is no controller file; the message names the key.
    """
    data = parse_json(read_small(path, remedy=_REMEDY), where=str(path), remedy=_REMEDY)
    file: _File = checked(_File, data, where=str(path), error=DataError)
    point = OperatingPoint(
        i_a=file.operating_point.i_0_a, x_m=file.operating_point.x_0_m, u_v=file.operating_point.u_0_v
    )
    weights = Weights(Q=file.weights.Q, R=file.weights.R)
    return _controller(file.law, file.gains, point, weights, file.sample_time_s, Converters(), u_max_v)


def _controller(
    law: Law,
    gains: tuple[float, float, float, float],
    point: OperatingPoint,
    weights: Weights,
    sample_time_s: float,
    converters: Converters,
    u_max_v: float,
) -> Controller:
    if not 0.0 < point.u_v < u_max_v:
        raise UsageError(
            f"the input at the operating point is {point.u_v:.3g} V, and the range is 0 to {u_max_v:g} V",
            remedy="Give the end of the range with --u-max",
        )
    numbers = law_numbers(
        pb.Parameters(
            law=pb.LAW_PID if law == "pid" else pb.LAW_LQI,
            gains=gains,
            i_0_a=point.i_a,
            x_0_m=point.x_m,
            u_0_v=point.u_v,
            u_min_v=0.0,
            u_max_v=u_max_v,
            sample_time_s=sample_time_s,
            x_lsb_m=converters.x_lsb_m,
        )
    )
    assert numbers is not None  # all of them are there, and finite
    return Controller(law=law, gains=gains, point=point, weights=weights, numbers=numbers)
