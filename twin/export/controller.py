"""The control law that an exported rig has: that of a design for its model, or of a controller file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from protocol.errors import DataError, UsageError
from twin.control import LawNumbers
from twin.control_design.board import Converters
from twin.control_design.controller_file import Point, numbers_of, read_controller
from twin.control_design.design import Design
from twin.control_design.gains import Law, OperatingPoint, Weights


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


def of_design(design: Design, *, u_max_v: float) -> Controller:
    """The law with the gains of a design and an input from 0 to `u_max_v`, V."""
    return _controller(
        design.law, design.gains, design.point, design.weights, design.sample_time_s, design.converters, u_max_v
    )


def of_file(path: Path, *, u_max_v: float) -> Controller:
    """The law of a controller file.

    Raises:
        DataError: the file is missing, or is not a controller file with weights; the message names the key.
    """
    file = read_controller(path)
    if file.weights is None:
        raise DataError(
            f"{path}: weights is missing", remedy="Give a controller.json as `board51 design --out` writes it"
        )
    at = file.operating_point
    point = OperatingPoint(i_a=at.i_0_a, x_m=at.x_0_m, u_v=at.u_0_v)
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
    at = Point(i_0_a=point.i_a, x_0_m=point.x_m, u_0_v=point.u_v)
    numbers = numbers_of(law, gains, at, sample_time_s, u_range_v=(0.0, u_max_v), x_lsb_m=converters.x_lsb_m)
    return Controller(law=law, gains=gains, point=point, weights=weights, numbers=numbers)
