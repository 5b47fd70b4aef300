"""The result of one sample as numbers; its messages are built on first use."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

from protocol.bus import board51_pb2 as pb
from twin.mirror.monitor.divergence import ALARMS
from twin.mirror.sample import Sample
from twin.mirror.step import Answer

IN_STEP, SETTLING, OUT_OF_STEP = "in-step", "settling", "out-of-step"


@dataclass(eq=False)
class Output:
    """The mirror's answer to one sample."""

    sample: Sample
    sync: str  # in-step, settling or out-of-step
    bridged_ticks: int  # simulated over lost samples just before it
    flying: bool  # whether there is a free twin
    answer: Answer | None  # of `step`; None where the sample time is not known or not supported
    alarms: tuple[pb.Alarm, ...]  # that change state with it
    nis_on: float  # threshold of the alarm on the mean NIS; 0 where there is none

    # On first use: a summary of a log only counts its samples, and a message costs about as much as a tick.
    @cached_property
    def state(self) -> pb.TwinState | None:
        """The free twin at the sample's tick; None where there is none."""
        if not self.flying or self.answer is None:
            return None
        sample, (i, x, v, u) = self.sample, self.answer[1]
        return pb.TwinState(
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
            bridged_ticks=self.bridged_ticks,
        )

    @cached_property
    def divergence(self) -> pb.Divergence:
        """Compare measured with twin, and report the observer's innovation."""
        sample, answer = self.sample, self.answer
        n_i, n_x, nis, nis_mean, valid = answer[0] if answer else (math.nan, math.nan, math.nan, math.nan, False)
        divergence = pb.Divergence(
            sequence=sample.sequence,
            tick=sample.tick,
            session=sample.session,
            t_s=sample.t_s,
            sync=self.sync,
            bridged_ticks=self.bridged_ticks,
            innovation_i_c_a=n_i,
            innovation_x_m=n_x,
            nis=nis,
            nis_mean=nis_mean,
            nis_on=self.nis_on,
            innovation_valid=valid,
        )
        if answer and self.flying:
            for signal, figures in zip((divergence.x_m, divergence.i_c_a, divergence.u_c_v), answer[2:5], strict=True):
                signal.error, signal.normalised, signal.rolling_rmse = figures[:3]
                signal.rolling_mean, signal.fit_percent, signal.window_full = figures[3:]
        return divergence

    def judges(self, alarm: str) -> bool:
        """Return whether this sample is evidence for or against an alarm, one of ALARMS."""
        answer, row = self.answer, ALARMS.index(alarm)
        if answer is None:
            return False
        (_, _, _, _, valid), _, of_x, of_i, _, _, _ = answer
        if row == 0:  # the innovation
            return valid
        figures = of_x if row == 1 else of_i
        return self.sync == IN_STEP and self.sample.closed_loop and math.isfinite(figures[1])
