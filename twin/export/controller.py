"""The control law that an exported rig has: that of a design for its model, or of a controller file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from protocol.errors import DataError, UsageError
from twin.control import LawNumbers
from twin.control_design.board import Converters
from twin.control_design.controller_file import REMEDY, Point, numbers_of, read_controller
from twin.control_design.design import Design
from twin.control_design.gains import Law, Weights


@dataclass(frozen=True, slots=True, kw_only=True)
class Controller:
    """A law with the weights it came from."""

    law: Law
    weights: Weights
    numbers: LawNumbers  # as the twin runs it


def of_design(design: Design, *, u_max_v: float) -> Controller:
    """The law with the gains of a design and an input from 0 to `u_max_v`, V."""
    point = Point(i_0_a=design.point.i_a, x_0_m=design.point.x_m, u_0_v=design.point.u_v)
    range_v, lsb = _range_around(point, u_max_v), design.converters.x_lsb_m
    numbers = numbers_of(design.law, design.gains, point, design.sample_time_s, u_range_v=range_v, x_lsb_m=lsb)
    return Controller(law=design.law, weights=design.weights, numbers=numbers)


def of_file(path: Path, *, u_max_v: float) -> Controller:
    """The law of a controller file.

    Raises:
        DataError: the file is missing, or is not a controller file with weights; the message names the key.
    """
    file = read_controller(path)
    if file.weights is None:
        raise DataError(f"{path}: weights is missing", remedy=REMEDY)
    weights = Weights(Q=file.weights.Q, R=file.weights.R)
    range_v, lsb = _range_around(file.operating_point, u_max_v), Converters().x_lsb_m
    numbers = numbers_of(file.law, file.gains, file.operating_point, file.sample_time_s, u_range_v=range_v, x_lsb_m=lsb)
    return Controller(law=file.law, weights=weights, numbers=numbers)


def _range_around(point: Point, u_max_v: float) -> tuple[float, float]:
    """Return the range of the input, V.  Raises UsageError if the input at rest is outside it."""
    if not 0.0 < point.u_0_v < u_max_v:
        raise UsageError(
            f"the input at the operating point is {point.u_0_v:.3g} V, and the range is 0 to {u_max_v:g} V",
            remedy="Give the end of the range with --u-max",
        )
    return 0.0, u_max_v
