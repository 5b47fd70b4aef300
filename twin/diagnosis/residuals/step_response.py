"""Step responses of the rig and of both simulations.

Each judge recording in closed loop is simulated under the board's law from its first state.  Its reference is the
recorded one, its sensor noise that of the ball at rest.  The figures are those of `board51 validate`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from protocol.campaign import Controller, Plant
from twin.diagnosis.experiments.closed_loop import Rig
from twin.diagnosis.experiments.virtual_recordings import resimulate
from twin.estimation.record import FloatArray, Record
from twin.estimation.step_figures import Compared, LoopRun, compare_steps, responses
from twin.inference.noise_floor import Floor
from twin.inference.theta import Theta


@dataclass(frozen=True, slots=True, kw_only=True)
class Steps:
    """Mean of all step responses, scaled to unit steps, and the figures of `twin/estimation/step_figures.py`."""

    t_s: FloatArray  # from the change of the reference, shape (n,)
    rig: FloatArray  # shape (n,)
    baseline: FloatArray
    extended: FloatArray
    count: int  # of the steps in the mean
    figures: tuple[tuple[Compared, Compared], ...]  # (against baseline, against extended)


def step_responses(
    records: Sequence[Record],
    before: Theta,
    after: Theta,
    floor: Floor,
    plant: Plant,
    controller: Controller | None,
    tick_s: float,
) -> Steps | str:
    """The step responses of these recordings, or a string with the reason why there are none.

    Args:
        records: the judge recordings.
        before: the baseline.
        after: the extended model.
        floor: noise floor with the sensor noise.
        plant: mass, travel, x_max, gravity.
        controller: the law of the closed-loop recordings.
        tick_s: the sampling interval, s.
    """
    flown = [record for record in records if record.kind == "closed-loop" and record.has("x", "x_ref", "u_c", "i_c")]
    if not flown:
        return "no recording in closed loop has x and x_ref"
    if controller is None:
        return "the campaign has no [controller]: the law that ran on the board is unknown"
    sigma = floor.sigma_x_m
    # Without process noise: it stands for what a model lacks, and would be noise of the simulated ball.
    rigs = [
        Rig(theta=floor.quiet(theta), plant=plant, controller=controller, tick_s=tick_s) for theta in (before, after)
    ]
    loops = [_runs(flown, rig) for rig in rigs]
    shares = [responses(runs, sigma) for runs in loops]
    if not shares[0]:
        return "the reference has no step after which it stays for 0.15 s"
    # The mean is over the longer three quarters of the steps: with all of them it would be as short as the shortest.
    n = int(np.quantile([len(response.t_s) for response in shares[0]], 0.25))
    long = [[response for response in each if len(response.t_s) >= n] for each in shares]
    curves = [np.nanmean([response.rig[:n] for response in long[0]], axis=0)]
    curves += [np.nanmean([response.simulation[:n] for response in each], axis=0) for each in long]
    figures = zip(*(compare_steps(runs, sigma) for runs in loops), strict=True)
    return Steps(
        t_s=long[0][0].t_s[:n],
        rig=curves[0],
        baseline=curves[1],
        extended=curves[2],
        count=len(long[0]),
        figures=tuple((first, second) for first, second in figures),
    )


def _runs(records: Sequence[Record], rig: Rig) -> list[LoopRun]:
    # Under the law, not with the recorded u_c: the ball is unstable, and would leave its place within a few time
    # constants.
    again = resimulate(rig, records, seed=0)
    return [
        LoopRun(
            name=record.name,
            t_s=record.t,
            x_ref_m=record.x_ref,
            x_m=record.x,
            i_c_a=record.i_c,
            u_c_v=record.u_c,
            simulated_x_m=other.x[None, :],
            simulated_i_c_a=other.i_c[None, :],
            simulated_u_c_v=other.u_c[None, :],
            quiet_x_m=other.x,
            expected_std_m=float("nan"),
        )
        for record, other in zip(records, again, strict=True)
    ]
