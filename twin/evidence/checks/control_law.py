"""Check of the control law: whether it reproduces the recorded u_c from the recorded samples.

Rule 1: signals are compared within windows of 1 s, without their means.  The integral before the recording is unknown,
        and an outlier or a limit shifts it permanently.
Rule 2: errors are measured by quantiles, so that single outliers have no influence.
Rule 3: a law is contradicted if other gains on the same samples explain u_c several times better.  It is also
        contradicted if it leaves most of u_c unexplained.  Noise and rounding are not a contradiction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from protocol.bus import board51_pb2 as pb
from protocol.campaign import Controller, Plant
from twin.control import LawNumbers, law_numbers
from twin.estimation.prepare import flights, spikes
from twin.estimation.record import FloatArray, Record
from twin.settings import identification as settings

WIDE_V = 1e6  # stands for an unknown input limit


@dataclass(frozen=True, slots=True, kw_only=True)
class LawGap:
    """The difference between a law and the recorded u_c."""

    off_v: float  # its size (quantile)
    share: float  # its size over that of the variation of u_c
    fitted: tuple[float, ...]  # gains that fit best, in the order of the law
    explained: float  # of the variance of u_c, by those
    contradicted: bool

    def text(self) -> str:
        """A clause for the user: the gains that u_c follows instead."""
        if self.explained < settings.LAW_EXPLAINED:
            return (
                f"no gains on i_c, x, speed and integral give it (the best explain {100 * self.explained:.0f} %): "
                "another filter or another law was in use"
            )
        listed = ", ".join(f"{value:.4g}" for value in self.fitted)
        return f"it follows gains of about [{listed}], which explain {100 * self.explained:.1f} % of it"


def numbers_of(
    controller: Controller, interval_s: float, *, u_low: float = -WIDE_V, u_high: float = WIDE_V, x_lsb_m: float = 0.0
) -> LawNumbers | None:
    """The law of a `[controller]` as the twin runs it; None if it is not known.

    Args:
        controller: of a campaign.
        interval_s: T_s, s.
        u_low: limits of u_c, V.
        u_high: likewise.
        x_lsb_m: one count of x, m, which limits the integral; 0: no limit.
    """
    point = controller.operating_point
    return law_numbers(
        pb.Parameters(
            sample_time_s=interval_s,
            law=pb.LAW_LQI if controller.kind == "lqi" else pb.LAW_PID,
            gains=controller.gains,
            i_0_a=point.i_c_a,
            x_0_m=point.x_m,
            u_0_v=point.u_c_v,
            u_min_v=u_low,
            u_max_v=u_high,
            x_lsb_m=x_lsb_m,
        )
    )


def law_gap(record: Record, plant: Plant, c: LawNumbers) -> LawGap | None:
    """Compare u_c with the law over the longest flight; None if a channel is missing or the flight is too short."""
    if not record.has("u_c", "i_c", "x", "x_ref"):
        return None
    part = max(flights(record, plant), key=lambda s: s.stop - s.start, default=None)
    if part is None or part.stop - part.start < settings.LAW_SAMPLES:
        return None
    x_whole = np.where(spikes(record.x, plant), np.nan, record.x)
    u, i, x, x_ref = record.u_c[part], record.i_c[part], x_whole[part], record.x_ref[part]
    T_s = record.interval_s
    error = x_ref - x
    integral = np.append(0.0, np.cumsum(np.where(np.isfinite(error), error, 0.0))[:-1]) * T_s
    speed = np.append(np.nan, np.diff(x)) / T_s
    if c.k_p != 0.0 or (c.k_x == 0.0 and c.k_i == 0.0):
        columns, gains = np.column_stack((error, integral, -speed)), np.array([c.k_p, c.k_s, c.k_v])
    else:
        columns, gains = np.column_stack((-i, -x, -speed, -integral)), np.array([c.k_i, c.k_x, c.k_v, -c.k_s])
    # Without the ends of u_c: at a limit no gains give it.
    good = (u > np.nanmin(record.u_c)) & (u < np.nanmax(record.u_c)) & np.isfinite(columns).all(axis=1)
    group = (np.arange(len(u)) * T_s / settings.LAW_WINDOW_S).astype(int)[good]
    u, columns = _centred(u[good][:, None], group)[:, 0], _centred(columns[good], group)
    if len(u) < settings.LAW_SAMPLES // 2:
        return None
    spread = _size(u)
    if spread <= 0.0:
        return None
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    # By least squares on the recorded samples, not by a simulated loop: a wrong model of the ball would count against
    # the law.
    fitted = np.linalg.lstsq(columns / scale, u, rcond=None)[0] / scale
    rest = u - columns @ fitted
    off, left = _size(u - columns @ gains), _size(rest)
    share = off / spread
    return LawGap(
        off_v=off,
        share=share,
        fitted=tuple(float(value) for value in fitted),
        explained=max(1.0 - float(rest @ rest) / float(u @ u), 0.0),
        contradicted=(share > settings.LAW_SHARE and off > settings.LAW_BETTER * left) or share > settings.LAW_LIMIT,
    )


def _centred(values: FloatArray, group: np.ndarray[tuple[int], np.dtype[np.int_]]) -> FloatArray:
    out = values.copy()
    for g in np.unique(group):
        out[group == g] -= values[group == g].mean(axis=0)
    return out


def _size(values: FloatArray) -> float:
    return float(np.quantile(np.abs(values), settings.LAW_QUANTILE))
