"""A regime: kernel parameters, expected errors and thresholds for one T_s and one set of board parameters."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from protocol.bus import board51_pb2 as pb
from twin.compiled import Packed
from twin.control import LawNumbers, integral_behind, law_numbers
from twin.mirror.monitor.alarms import probability_per_window, white_threshold
from twin.mirror.monitor.divergence import Windows
from twin.mirror.monitor.expected import Expectation, ExpectedError
from twin.mirror.observer import observer_of
from twin.mirror.sample import Sample
from twin.mirror.step import Twin
from twin.model.parameters import Model
from twin.model.simulate import plant_numbers
from twin.settings.mirror import OFF_PROBABILITY, SETTLE_DRIVEN_S, SETTLE_MAX_S, SETTLE_MIN_S, SETTLING_SHARE, Settings

# In the board's Parameters these neither shape what it does at a tick nor how it is seen.
_IRRELEVANT = (
    "host_time_ns",
    "from_tick",
    "firmware",
    "stream_divider",
    "host_loss_policy",
    "host_loss_timeout_s",
    "x_ref_slew_m_s",
    "x_ref_step_max_m",
    "x_ref_min_m",
    "x_ref_max_m",
)


class KnownParameters:
    """The parameters of each session by the tick from which they may have shaped what the board did."""

    def __init__(self) -> None:
        self._history: dict[int, list[tuple[int, pb.Parameters]]] = {}

    def add(self, parameters: pb.Parameters) -> bool:
        """Store the parameters; False if they contain nothing new."""
        relevant = pb.Parameters()
        relevant.CopyFrom(parameters)
        for name in _IRRELEVANT:
            relevant.ClearField(name)
        history = self._history.setdefault(parameters.session, [])
        if history and history[-1][1] == relevant:
            return False
        history.append((parameters.from_tick, relevant))
        for session in list(self._history)[:-2]:  # the present one and the one that may just be ending
            del self._history[session]
        return True

    def first(self, session: int) -> bool:
        """Return whether at most one set of parameters is known of `session`."""
        return len(self._history.get(session, ())) <= 1

    def at(self, session: int, tick: int) -> pb.Parameters | None:
        """Return the parameters in force at `tick`, or None if they are not known."""
        history = self._history.get(session)
        if not history:
            return None
        # Dropped once they are past: the ticks of a session only rise.
        while len(history) > 1 and history[1][0] <= tick:
            history.pop(0)
        return history[0][1] if history[0][0] <= tick else None


class Regime:
    """Numbers for one T_s and one set of parameters (None: only the observer can run)."""

    def __init__(
        self, model: Model, settings: Settings, *, sample_time_s: float, parameters: pb.Parameters | None
    ) -> None:
        self.sample_time_s = sample_time_s
        self.parameters = parameters
        self.plant = plant_numbers(model, sample_time_s)
        self.law = law_numbers(parameters) if parameters else None
        self.window = max(2, round(settings.window_s / sample_time_s))
        # Of an alarm on errors without evidence (rule 4 of `monitor/divergence.py`).
        self.hold = self.window + round(SETTLE_MAX_S / sample_time_s)
        self.i_lsb_a = parameters.i_lsb_a if parameters else 0.0
        self.x_lsb_m = parameters.x_lsb_m if parameters else 0.0
        probability = probability_per_window(settings.false_alarms_per_day, self.window * sample_time_s)
        self.nis_on = white_threshold(self.window, 2, probability)
        self.nis_off = white_threshold(self.window, 2, OFF_PROBABILITY)
        self._expected: ExpectedError | None = None
        if parameters and self.law:
            self._expected = ExpectedError(
                model,
                self.law,
                i_lsb_a=self.i_lsb_a,
                x_lsb_m=self.x_lsb_m,
                u_lsb_v=parameters.u_lsb_v,
                window=self.window,
                probability=probability,
            )
        # Sensor noise alone: what a driven twin at rest differs by, and the yardstick where no other exists.
        self.sensors = Expectation(
            std=(
                math.sqrt(model.noise.sigma_x_m**2 + self.x_lsb_m**2 / 12.0),
                math.sqrt(model.noise.sigma_i_c_a**2 + self.i_lsb_a**2 / 12.0),
                math.nan,  # there u_c drives the twin: it cannot differ
            ),
            on=(white_threshold(self.window, 1, probability),) * 2,
            off=(white_threshold(self.window, 1, OFF_PROBABILITY),) * 2,
        )
        # As the kernels take them; where there is no law there is no free twin, and nobody looks at the zeros.
        self.packed_plant: Packed = tuple(self.plant)
        self.packed_law: Packed = tuple(self.law) if self.law else (0.0,) * len(LawNumbers._fields)
        self._observer = observer_of(self.plant, model.noise, i_lsb_a=self.i_lsb_a, x_lsb_m=self.x_lsb_m)
        self.sensors_yardstick = self._pack(self.sensors)
        self._yardstick = (math.nan, self.sensors_yardstick)

    def expectation(self, x_ref: float) -> Expectation:
        """Return the expected errors in closed loop around `x_ref`.

        If the model calls this loop unstable there is no expected error, although the rig may fly.  Then the sensor
        noise is the yardstick, and the error of the twin's flight raises the alarm.
        """
        return (self._expected.at(x_ref) if self._expected else None) or self.sensors

    def yardstick(self, x_ref: float) -> Packed:
        """Return `expectation` and the NIS thresholds as `step` takes them, cached: references rarely change."""
        if self._yardstick[0] != x_ref:
            self._yardstick = (x_ref, self._pack(self.expectation(x_ref)))
        return self._yardstick[1]

    def packed(self, windows: Windows, free: NDArray[np.float64]) -> Packed:
        """Pack what stays constant during the regime for `step`; `free` is the memory of the free twin."""
        return tuple(
            Twin(
                plant=self.packed_plant,
                law=self.packed_law,
                observer=tuple(self._observer),
                windows=tuple(windows),
                free=free,
            )
        )

    def _pack(self, expected: Expectation) -> Packed:
        return (*expected.std, *expected.on, *expected.off, self.nis_on, self.nis_off)

    def settle_ticks(self, *, closed_loop: bool, x_ref: float) -> int:
        """Return the ticks until the effect of the start has decayed."""
        seconds = SETTLE_DRIVEN_S
        if closed_loop:
            ticks = self._expected.settle_ticks(x_ref, share=SETTLING_SHARE) if self._expected else None
            seconds = 1.0 if ticks is None else ticks * self.sample_time_s
        # At most SETTLE_MAX_S: a loop at the edge of stability would never count as settled.
        return round(min(max(seconds, SETTLE_MIN_S), SETTLE_MAX_S) / self.sample_time_s)

    def memory_at(self, now: Sample, before: Sample | None) -> tuple[float, float, float] | None:
        """Return (speed, integral, previous x) of the rig and its law at a sample; None if they are not determined.

        `before` is the sample one tick earlier, if there is one.  The previous x is NaN if the law starts anew.
        """
        v = 0.0
        if before is not None and math.isfinite(before.x):
            v = (now.x - before.x) / self.sample_time_s
        if not now.closed_loop:
            return v, 0.0, math.nan
        if before is not None and not before.closed_loop:
            return 0.0, 0.0, math.nan  # as the board does: it enters closed loop with speed 0 and an empty integrator
        if self.law is None or before is None or not math.isfinite(before.x + now.u):
            return None
        # The board computed u_c from the samples that it reports, so their noise cancels in the integral.
        s = integral_behind(self.law, i=now.i, x=now.x, x_prev=before.x, x_ref=now.x_ref, u=now.u)
        return None if s is None else (v, s, before.x)
