"""Design of a controller from a model and weights, and analysis of its loop.

Rule: the analysis is of the gains after rounding to the board's format.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocol.errors import DataError, UsageError
from twin.control import linearise
from twin.control_design.board import Converters, QuantisedGain, from_order_of, quantise
from twin.control_design.cautions import changes, thin, unsure
from twin.control_design.controller_file import ControllerFile
from twin.control_design.gains import Law, OperatingPoint, Weights, bryson, design_gains, in_order_of, operating_point
from twin.control_design.loop import Controller, Noise, backward, closed_loop, ideal, kalman_gain, noise_rms, observer
from twin.control_design.margins import Margins, margins
from twin.control_design.robust import Robustness, over_intervals, plant_at, stable_range_m
from twin.model.linear import delay_s
from twin.model.parameters import Model

SAMPLE_TIME_MIN_S, SAMPLE_TIME_MAX_S = 1e-4, 2e-2


@dataclass(frozen=True, slots=True, kw_only=True)
class Specification:
    """The specification of a controller; `twin.design` explains the fields.

    Raises:
        UsageError: a value is out of range.
    """

    law: Law = "lqi"
    x_m: float | None = None
    sample_time_s: float = 2e-3
    Q: tuple[float, float, float, float] | None = None
    R: float | None = None
    settling_time_s: float | None = None
    converters: Converters | None = None
    u_max_v: float = 5.0
    with_observer: bool = False
    seed: int = 1
    before: ControllerFile | None = None

    def __post_init__(self) -> None:
        if not SAMPLE_TIME_MIN_S <= self.sample_time_s <= SAMPLE_TIME_MAX_S:
            raise UsageError(
                f"--sample-time {self.sample_time_s:g} s",
                remedy=f"Give {SAMPLE_TIME_MIN_S:g} to {SAMPLE_TIME_MAX_S:g} s; the board runs at 0.002",
            )
        if not (math.isfinite(self.u_max_v) and self.u_max_v > 0.0):
            raise UsageError(f"--u-max {self.u_max_v:g} V", remedy="Give a positive voltage")
        if self.seed < 0:
            raise UsageError(f"--seed {self.seed}", remedy="Give a number from 0")
        if self.with_observer and self.law != "lqi":
            raise UsageError("--observer with --law pid", remedy="An observer needs state feedback: use --law lqi")
        if self.settling_time_s is not None and self.Q is not None and self.R is not None:
            raise UsageError("--settling-time has no effect with --Q and --R", remedy="Leave out the one or the other")
        if self.before is not None and abs(self.before.sample_time_s - self.sample_time_s) > 1e-6 * self.sample_time_s:
            raise UsageError(
                f"the gains of --before are for T_s = {self.before.sample_time_s:g} s, not {self.sample_time_s:g} s",
                remedy="Give gains for the T_s of this design",
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopAnalysis:
    """Analysis of one controller on the model."""

    name: str
    poles: NDArray[np.complex128]  # of z, largest first
    margins: Margins | None  # None: unstable
    x_rms_m: float  # under sensor, process and quantisation noise
    u_rms_v: float
    x_rms_analog_m: float  # the same without quantisation
    u_rms_analog_v: float

    @property
    def stable(self) -> bool:
        """Return whether every pole is inside the unit circle."""
        return bool(abs(self.poles[0]) < 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Design:
    """A controller with its analysis."""

    law: Law
    sample_time_s: float
    point: OperatingPoint
    weights: Weights
    gains: tuple[float, float, float, float]  # as designed, in the order of the law (rule 9)
    quantised: tuple[QuantisedGain, ...]
    converters: Converters
    loops: tuple[LoopAnalysis, ...]  # ideal, the board's law, the board's law with rounded gains, observer if requested
    observer_gain: NDArray[np.float64] | None  # L, shape (3, 2)
    robustness: Robustness  # of the board's loop
    observer_robustness: Robustness | None
    stable_range_m: tuple[float, float]
    warnings: tuple[str, ...]
    before: LoopAnalysis | None = None  # of the gains that are to be replaced, at the same point
    causes: tuple[str, ...] = ()  # sentences on the model's causes and their effect on the design

    @property
    def board(self) -> LoopAnalysis:
        """The loop that the board runs."""
        return self.loops[2]


def design(model: Model, wanted: Specification | None = None) -> Design:
    """Design a controller and analyse its loop, as `twin.design` does (results: `README.md`).

    Raises:
        DataError: K_A or K_c of the model is a placeholder.
        UsageError: the operating point is not possible, the weights have no solution, or a gain exceeds the format.
    """
    _require_known(model)
    wanted = Specification() if wanted is None else wanted
    law, sample_time_s = wanted.law, wanted.sample_time_s
    converters = Converters() if wanted.converters is None else wanted.converters
    point = operating_point(model, wanted.x_m, u_max_v=wanted.u_max_v)
    usual = bryson(model, point, settling_time_s=wanted.settling_time_s)
    weights = Weights(Q=usual.Q if wanted.Q is None else wanted.Q, R=usual.R if wanted.R is None else wanted.R)
    K = design_gains(model, point, weights, sample_time_s=sample_time_s, law=law)
    gains = in_order_of(law, K)
    quantised = quantise(gains, law, converters, sample_time_s)
    # What follows is of the gains that the board stores, not of those that were designed.
    K_board = from_order_of(law, tuple(gain.value for gain in quantised))
    plant = plant_at(model, point.x_m, sample_time_s)
    noise = _noise(model, sample_time_s, (converters.i_lsb_a, converters.x_lsb_m, converters.u_lsb_v))
    on_board = backward(K_board, sample_time_s)
    candidates = [
        ("ideal state feedback", ideal(K, sample_time_s)),
        ("backward difference", backward(K, sample_time_s)),
        ("the same, gains rounded", on_board),
    ]
    filter_gain = kalman_gain(plant, noise) if wanted.with_observer else None
    if filter_gain is not None:
        candidates.append(("Kalman filter", observer(K, plant, filter_gain, sample_time_s)))

    def judged(name: str, controller: Controller) -> LoopAnalysis:
        return _judge(model, point, name, controller, noise, sample_time_s)

    loops = tuple(judged(name, controller) for name, controller in candidates)
    replaced = wanted.before

    def robustness(controller: Controller) -> Robustness:
        return over_intervals(model, controller, point.x_m, sample_time_s, seed=wanted.seed)

    box = robustness(on_board)
    return Design(
        law=law,
        sample_time_s=sample_time_s,
        point=point,
        weights=weights,
        gains=gains,
        quantised=quantised,
        converters=converters,
        loops=loops,
        observer_gain=filter_gain,
        robustness=box,
        observer_robustness=None if filter_gain is None else robustness(candidates[-1][1]),
        stable_range_m=stable_range_m(model, on_board, point.x_m, sample_time_s),
        warnings=unsure(model) + _warnings(loops[2], box, point, wanted.u_max_v),
        before=None
        if replaced is None
        else judged("before", backward(from_order_of(replaced.law, replaced.gains), sample_time_s)),
        causes=changes(model, point, weights, K, sample_time_s, law),
    )


def _require_known(model: Model) -> None:
    """Check that K_A and K_c of a model are not placeholders.

    Raises:
        DataError: one is; the message names the parameter and why it is not known.
    """
    for name in ("K_A", "K_c"):
        parameter = model.parameters[name]
        if parameter.verdict == "not-identifiable":
            raise DataError(
                f"{name} = {parameter.value:.4g} {parameter.unit} is not identifiable ({parameter.method})",
                remedy="Record what is missing and identify again: gains for a guessed plant would drop the ball",
            )


def _noise(model: Model, sample_time_s: float, lsb: tuple[float, float, float]) -> Noise:
    """The noise with converters of these counts of i_c, x and u_c; 0: no rounding."""
    n = model.noise
    return Noise(
        i=n.sigma_i_c_a**2 + lsb[0] ** 2 / 12,
        x=n.sigma_x_m**2 + lsb[1] ** 2 / 12,
        u=lsb[2] ** 2 / 12,
        process_i=n.process_i_c_a**2,
        process_v=(n.process_a_m_s2 * sample_time_s) ** 2,
    )


def _judge(
    model: Model, point: OperatingPoint, name: str, controller: Controller, noise: Noise, sample_time_s: float
) -> LoopAnalysis:
    plant = plant_at(model, point.x_m, sample_time_s)
    poles = np.linalg.eigvals(closed_loop(plant, controller)).astype(np.complex128)
    model_delay_s = delay_s(model) if model.causes else 0.0
    x, u = noise_rms(plant, controller, noise)
    # Without rounding as well: the difference is what the converters cost.
    x_analog, u_analog = noise_rms(plant, controller, _noise(model, sample_time_s, (0.0, 0.0, 0.0)))
    return LoopAnalysis(
        name=name,
        poles=poles[np.argsort(-np.abs(poles), kind="stable")],
        # From the continuous plant, because a delay margin is seldom a whole number of ticks.
        margins=margins(*linearise(model, point.x_m), controller, sample_time_s, model_delay_s=model_delay_s),
        x_rms_m=x,
        u_rms_v=u,
        x_rms_analog_m=x_analog,
        u_rms_analog_v=u_analog,
    )


def _warnings(board: LoopAnalysis, box: Robustness, point: OperatingPoint, u_max_v: float) -> tuple[str, ...]:
    messages = []
    if not board.stable:
        messages.append(
            f"the loop on the board is UNSTABLE, largest pole {abs(board.poles[0]):.4f}; increase R, or --settling-time"
        )
    elif box.unstable_share > 0.0:
        where = ", ".join(f"{name} = {value:.4g}" for name, value in box.worst_at.items())
        messages.append(
            f"the model's uncertainty could destabilise the loop: {100 * box.unstable_share:.1f} % of {box.loops} "
            f"loops within the 95 % intervals are unstable, worst pole {box.worst_pole:.4f} at {where}"
        )
    if not box.varied:
        messages.append(
            "no parameter of this model has an interval: robustness was not checked. Identify the rig first"
        )
    elif box.fixed:
        messages.append(f"without an interval, hence not varied: {', '.join(box.fixed)}")
    if board.margins is not None:
        messages += thin(board.margins)
    if board.margins is not None and board.margins.delay_s < 0.5e-3:
        messages.append(f"only {board.margins.delay_s * 1e3:.2f} ms of additional delay make it unstable")
    room = min(point.u_v, u_max_v - point.u_v)
    # Three standard deviations are exceeded in 0.3 % of the ticks; the linear analysis knows no limit.
    if board.stable and 3.0 * board.u_rms_v > room:
        messages.append(
            f"noise alone moves u_c by {board.u_rms_v:.2g} V rms, and only {room:.2g} V are left to its limit"
        )
    return tuple(messages)
