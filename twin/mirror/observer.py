"""The one-step prediction: an extended Kalman filter, driven by the measured u_c, corrected by the measured i_c and x.

Rule 1: u_c of sample k is in force from tick k to k+1.  So sample k+1 is predicted from the estimate at k and u_c(k).
        A delay of the model, of input and sensors together, is one of the input.
Rule 2: near a stop, over a gap and until it has settled, the innovation is not valid.
Rule 3: prediction, slopes, covariance and correction are those of every other estimate (`twin/estimation/ekf`).
Rule 4: if the coil was switched off or the ball hit a stop within a tick, the instant or the restitution is unknown.
        This adds to the predicted variance (`twin/estimation/ekf/branches.py`).  The ticks after it are judged.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from twin.compiled import Packed, inlined, kernel
from twin.estimation.ekf.branches import spread_over_cases
from twin.estimation.ekf.correct import (
    TELLING_READINGS,
    forget,
    measure_current,
    start_flight,
    start_recording,
    take_readings,
)
from twin.estimation.ekf.lines import doubt_lines, turn_covariance, turn_state
from twin.estimation.ekf.memory import Floats, Memory, base_of, memory_for
from twin.estimation.ekf.predict import add_jitter, add_process_noise, advance, carry, differences
from twin.estimation.prepare import CONTACT_SHARE
from twin.estimation.propagate import copy, input_over
from twin.estimation.rollout import SETTLE_S
from twin.estimation.structures import AT_THE_ENDS, NoiseLevels, System
from twin.model.causes import amplifier_gain_drift, eddy_current_lag, magnetic_hysteresis, second_time_constant
from twin.model.extended import (
    CORE,
    FIELD,
    I_C,
    LOOP,
    SECOND,
    WARMTH,
    Base,
    X,
    current_of_reading,
    lasting_warmth,
    position_of_reading,
)
from twin.model.integration import FREE
from twin.model.parameters import Noise
from twin.model.simulate import PlantNumbers


class Observer(NamedTuple):
    """The filter with its settings and memory; made by `observer_of`."""

    f: Memory
    inputs: Floats  # V, newest last, as many as a delay asks for; the last NaN: nothing to predict from
    out: Floats  # room: nu_i, nu_x, S_ii, S_ix, S_xx, shape (1, 5)
    ticks: Floats  # shape (1,): predicted in a row away from the stops
    since_cut: Floats  # shape (1,): samples since the one that showed the coil switched off; inf: long ago
    sample_time_s: float
    low_m: float  # lowest and highest x away from the stops
    high_m: float
    settle_ticks: float


def observer_of(plant: PlantNumbers, noise: Noise, *, i_lsb_a: float = 0.0, x_lsb_m: float = 0.0) -> Observer:
    """The observer of a model.

    Args:
        plant: the model, frozen for one T_s.
        noise: of the model file.
        i_lsb_a: one count of the current converter, A; 0 where unknown.
        x_lsb_m: one count of the position converter, m; 0 where unknown.
    """
    travel_m, T_s = Base(*plant.base).travel_m, plant.sample_time_s
    # Ten standard deviations: noise alone must not put a ball on its rest into flight.
    margin_m = max(CONTACT_SHARE * travel_m, 10.0 * noise.sigma_x_m)
    # One count adds lsb^2 / 12, the variance of a rounding error (B. Widrow, 1956).
    levels = NoiseLevels(
        sigma_i_c_a=math.sqrt(noise.sigma_i_c_a**2 + i_lsb_a**2 / 12.0),
        sigma_x_m=math.sqrt(noise.sigma_x_m**2 + x_lsb_m**2 / 12.0),
        process_i_c_a=noise.process_i_c_a,
        process_a_m_s2=noise.process_a_m_s2,
        tick_s=T_s,
    )
    inputs = np.full(plant.in_whole + 3, math.nan)
    return Observer(
        f=memory_for(System(plant.base, plant.c, levels, AT_THE_ENDS, closed_form=plant.closed_form)),
        inputs=inputs,
        out=np.empty((1, 5)),
        ticks=np.zeros(1),
        since_cut=np.full(1, math.inf),
        sample_time_s=T_s,
        low_m=margin_m,
        high_m=travel_m - margin_m,
        settle_ticks=float(max(1, round(SETTLE_S / T_s))),
    )


@inlined
def _begin(o: Observer, i: float, x: float, u: float, first: bool) -> None:
    """Start the estimate from the measurement with unknown speed; `first`: the warmth is unknown, too."""
    f, current = o.f, current_of_reading(o.f.c[:], i)
    if first:
        forget(f)
        start_recording(f, True, i, u)
        f.y[WARMTH] = lasting_warmth(f.c[:], current)  # of a coil that has carried this for long
    else:
        before = f.y[I_C]
        measure_current(f, i)
        # States that no sensor shows are carried on, driven by the measured current.
        f.y[SECOND] = second_time_constant.settled(f.c[:], f.y[SECOND], f.y[I_C], o.sample_time_s)
        f.y[CORE] = eddy_current_lag.slow(f.c[:], f.y[CORE], before, f.y[I_C], o.sample_time_s)
        f.y[LOOP] = magnetic_hysteresis.turned(f.c[:], f.y[LOOP], f.y[FIELD], f.y[I_C])
        f.y[FIELD] = f.y[I_C]
        f.y[WARMTH] += o.sample_time_s * amplifier_gain_drift.warmth_rate(f.c[:], current, f.y[WARMTH])
    start_flight(f, x)
    f.readings = TELLING_READINGS  # who watches wants every innovation; until it has settled none is valid
    o.ticks[0] = 0.0


@inlined
def _predict_and_correct(o: Observer, i: float, x: float) -> float:
    """Predict one tick, correct by its readings, write innovations and covariance into `out`, return the NIS."""
    f, n, T_s, out = o.f, len(o.inputs), o.sample_time_s, o.out
    copy(f.previous, f.y)
    held = input_over(f.c[:], o.inputs, n, f.first, T_s)
    advance(f, f.y[:], held, 0.0, T_s, FREE)
    differences(f, held, 0.0, T_s)
    carry(f.F, f.P, f.G, f.m)
    add_process_noise(f, T_s)
    add_jitter(f, o.inputs, n, T_s)
    cut = n - 1 - int(o.since_cut[0]) if o.since_cut[0] < n - 1 else -1
    # Only where a cut or a stop may lie within the tick: each case is one more run of the model over it.
    if cut >= 0 or not 0.0 <= f.y[X] <= Base(*base_of(f)).travel_m:
        spread_over_cases(f, o.inputs, n, T_s, cut)
    take_readings(f, out, 0, i, x, True, True)
    # nu' inv(S) nu by elimination: i_c first, then x given i_c.
    n_i, n_x, s_ii, s_ix, s_xx = out[0, 0], out[0, 1], out[0, 2], out[0, 3], out[0, 4]
    left, spread = n_x - s_ix / s_ii * n_i, s_xx - s_ix * s_ix / s_ii  # of x given i_c
    return float(n_i * n_i / s_ii + left * left / spread)


@kernel
def observe(
    observer: Packed, follows: bool, usable: bool, switched_off: bool, i: float, x: float, u: float
) -> tuple[float, float, float, bool]:
    """Take one sample.

    Args:
        observer: tuple(Observer).
        follows: one tick after the one before.
        usable: finite and within the sensors' ranges.
        switched_off: the first sample in idle; the coil was switched off since the sample before.
        i: A.
        x: m.
        u: V, from this tick on.

    Returns:
        (innovation of i_c in A, innovation of x in m, NIS, valid); NaN where nothing was predicted.
        NIS = nu' inv(S) nu is chi-square with 2 degrees under a right model.
    """
    o = Observer(*observer)
    f, inputs, newest = o.f, o.inputs, len(o.inputs) - 1
    if not (follows and usable):
        inputs[newest] = math.nan
    if not usable:
        return math.nan, math.nan, math.nan, False
    # A stop is where the ball is, not where a sensor with an offset or crosstalk reads it.
    position = position_of_reading(Base(*base_of(f)), f.c[:], x, current_of_reading(f.c[:], i))
    first = math.isnan(inputs[newest])
    o.since_cut[0] = math.inf if first else 0.0 if switched_off else o.since_cut[0] + 1.0
    n_i = n_x = nis = math.nan
    valid = False
    if first or not o.low_m <= position <= o.high_m:
        if not first and f.lines_count > 0:
            turn_state(f, f.y[:], o.sample_time_s)
            turn_covariance(f, o.sample_time_s)
            doubt_lines(f, o.sample_time_s)
        _begin(o, i, x, u, first)
    else:
        nis = _predict_and_correct(o, i, x)
        n_i, n_x = o.out[0, 0], o.out[0, 1]
        o.ticks[0] += 1.0
        if not (math.isfinite(nis) and o.low_m <= f.y[X] <= o.high_m):  # the filter, not the ball, is at a stop
            _begin(o, i, x, u, not math.isfinite(nis))
        valid = o.ticks[0] > o.settle_ticks
    # Behind a gap the past inputs are taken for the present one; until it has settled nothing is valid.
    for k in range(newest):
        inputs[k] = u if first else inputs[k + 1]
    inputs[newest] = u
    return n_i, n_x, nis, valid
