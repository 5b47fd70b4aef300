"""The result of one sample as numbers; its messages are built on first use."""

from __future__ import annotations

import math

from protocol.bus import board51_pb2 as pb
from twin.mirror.monitor.divergence import ALARMS, Figures
from twin.mirror.sample import Sample
from twin.mirror.step import Answer

IN_STEP, SETTLING, OUT_OF_STEP = "in-step", "settling", "out-of-step"


class Output:
    """The mirror's answer to `sample`.

    Args:
        sample: the one that is answered.
        sync: in-step, settling or out-of-step.
        bridged_ticks: simulated over lost samples just before it.
        flying: whether there is a free twin.
        answer: of `step`; None where the sample time is not known or not supported.
        alarms: that change state with it.
        nis_on: threshold of the alarm on the mean NIS; 0 where there is none.
    """

    __slots__ = (
        "_answer",
        "_bridged_ticks",
        "_divergence",
        "_flying",
        "_nis_on",
        "_sample",
        "_state",
        "alarms",
        "sync",
    )

    def __init__(
        self,
        sample: Sample,
        sync: str,
        bridged_ticks: int,
        flying: bool,
        answer: Answer | None,
        alarms: tuple[pb.Alarm, ...],
        nis_on: float,
    ) -> None:
        self._sample = sample
        self.sync = sync
        self._bridged_ticks = bridged_ticks
        self._flying = flying
        self._answer = answer
        self.alarms = alarms
        self._nis_on = nis_on
        self._state: pb.TwinState | None = None
        self._divergence: pb.Divergence | None = None

    @property
    def state(self) -> pb.TwinState | None:
        """The free twin at the sample's tick; None where there is none."""
        if self._state is None and self._flying and self._answer is not None:
            sample = self._sample
            i, x, v, u = self._answer[1]
            self._state = pb.TwinState(
                sequence=sample.sequence,
                tick=sample.tick,
                session=sample.session,
                t_s=sample.t_s,
                i_c_a=i,
                x_m=x,
                v_m_s=v,
                u_c_v=u,
                x_ref_m=sample.x_ref,
                sync=self.sync,
                bridged_ticks=self._bridged_ticks,
            )
        return self._state

    @property
    def divergence(self) -> pb.Divergence:
        """Compare measured with twin, and report the observer's innovation."""
        if self._divergence is None:
            self._divergence = self._compared()
        return self._divergence

    def judges(self, alarm: str) -> bool:
        """Return whether this sample is evidence for or against an alarm, one of ALARMS."""
        answer, row = self._answer, ALARMS.index(alarm)
        if answer is None:
            return False
        (_, _, _, _, valid), _, of_x, of_i, _, _, _ = answer
        if row == 0:  # the innovation
            return valid
        figures = of_x if row == 1 else of_i
        return self.sync == IN_STEP and self._sample.closed_loop and math.isfinite(figures[1])

    def _compared(self) -> pb.Divergence:
        sample, answer = self._sample, self._answer
        n_i, n_x, nis, nis_mean, valid = answer[0] if answer else (math.nan, math.nan, math.nan, math.nan, False)
        divergence = pb.Divergence(
            sequence=sample.sequence,
            tick=sample.tick,
            session=sample.session,
            t_s=sample.t_s,
            sync=self.sync,
            bridged_ticks=self._bridged_ticks,
            innovation_i_c_a=n_i,
            innovation_x_m=n_x,
            nis=nis,
            nis_mean=nis_mean,
            nis_on=self._nis_on,
            innovation_valid=valid,
        )
        if answer and self._flying:
            _fill(divergence.x_m, answer[2])
            _fill(divergence.i_c_a, answer[3])
            _fill(divergence.u_c_v, answer[4])
        return divergence


def _fill(signal: pb.SignalDivergence, figures: Figures) -> None:
    signal.error, signal.normalised, signal.rolling_rmse = figures[:3]
    signal.rolling_mean, signal.fit_percent, signal.window_full = figures[3:]
