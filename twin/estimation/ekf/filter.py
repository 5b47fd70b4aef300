"""The extended Kalman filter of the extended model: prediction errors along a whole campaign.

The state and the prediction are those of `twin/model/extended.py`; the Jacobians are its finite differences.  For each
sample: predict (`predict.py`), initialise a recording or flight that begins there, correct (`correct.py`).
R. E. Kalman, J. Basic Eng. 82, 1960.

Rule 1: the flags are those of `../innovations.py`.  RESTS_LOW, RESTS_HIGH: the ball rests at a stop of known position.
        This tests the position sensor alone (offset, scale, crosstalk), without any force.  RESTS_UNSEEN: the ball
        rests beyond the sensor's range, and only i_c is valid.  LOST: the row of a lost sample
        (`twin/evidence/lost_rows.py`) has no readings, and u_c from it on is unknown.
Rule 2: the covariance contains only the states that are independent under the model's causes: three for the paper's
        model.  This keeps the cost of each candidate low.
Rule 3: the first readings of a flight, which determine its initial state, correct the state and are not counted as
        predicted.
Rule 4: warmth at the start of a recording is unknown and is estimated.
Rule 5: the two readings of i_c after a lost sample correct the state and are not counted as predicted, whatever delay
        the model has.  The first of them determined the lost u_c (`../propagate.py`).
"""

from __future__ import annotations

import math

import numpy as np

from twin.compiled import inlined, kernel
from twin.estimation.ekf.correct import (
    OF_I,
    OF_X,
    compare_at_stop,
    correct,
    expected_current_reading,
    forget,
    measure_current,
    start_flight,
    start_recording,
    take_readings,
)
from twin.estimation.ekf.memory import (
    Memory,
    base_of,
    memory_for,
    scale_noise,
    see_instrument,
    states_in,
    wandered,
)
from twin.estimation.ekf.predict import (
    add_jitter,
    add_process_noise,
    advance,
    carry,
    differences,
    doubt_input,
    predict_held,
    slopes_of_colour,
    step_linearised,
    take_slopes,
)
from twin.estimation.innovations import CAPTURED, FLIES, FOLLOWS, LOST, RESTS_HIGH, RESTS_LOW, USE_I, USE_X
from twin.estimation.propagate import copy, delay_s, find_input, input_over, see_delays
from twin.estimation.structures import NO_STEPS, Results, Samples, Steps, System, room_for
from twin.model.extended import I_C, V, X, reading_of_current
from twin.model.integration import FREE, SHORT_S

UNKNOWN_INPUTS = 2  # samples after a start whose u_c may not be in force yet, the same for all models


def filtered(
    system: System,
    samples: Samples,
    known: Steps = NO_STEPS,
    *,
    state: bool = False,
    spread: bool = False,
    steps: bool = False,
) -> Results:
    """Run the filter of one model along a series.

    Args:
        system: the model and its noise.
        samples: of the series.
        known: steps of a nearby model to reuse: its gains alone, its Jacobians alone, or also its states if the models
            differ only in their noise.  With known gains the results have no covariance.
        state: whether to return the states.
        spread: whether to return their covariance.
        steps: whether to return the steps.
    """
    results = room_for(len(samples.u), states_in(system.c, system.noise), state=state, spread=spread, steps=steps)
    fill(system, samples, known, results)
    return results


def fill(system: System, samples: Samples, known: Steps, results: Results) -> None:
    """Run `filtered` into existing arrays; arguments as there."""
    _run(memory_for(system), samples, known, results)


@inlined
def _write_step(f: Memory, written: Steps, n: int) -> None:
    """Write the step to n, where steps are requested."""
    if written.slopes.shape[0] > 0:
        for row in range(f.m):
            written.before[n, row] = f.y[f.places[row]]
            for k in range(f.m):
                written.slopes[n, row, k] = f.F[row, k]


@inlined
def _write_correction(f: Memory, written: Steps, n: int) -> None:
    """Write state and gains after the correction at n, where steps are requested."""
    if written.after.shape[0] > 0:
        for k in range(f.m):
            written.after[n, k] = f.y[f.places[k]]
            written.gains[n, OF_I, k], written.gains[n, OF_X, k] = f.gains[OF_I, k], f.gains[OF_X, k]


@inlined
def _held_at(f: Memory, flags: int, reading: float) -> float:
    """Return the position of a held ball, m: at a stop that of the stop, which errors of the sensor do not change."""
    if flags & RESTS_LOW != 0:
        return float(f.low_m)
    if flags & RESTS_HIGH != 0:
        return float(f.high_m)
    return float(min(max(reading, 0.0), f.paper[-1]))


@kernel
def _run(f: Memory, samples: Samples, known: Steps, results: Results) -> None:
    t, step, u, y_i, y_x, flags, noise_ratio = samples
    out, state, spread, written = results
    # One pass over all recordings in a row: FOLLOWS marks where a new chain begins, and everything is initialised
    # there. A run for each of many short captures would pay for a call each time.
    inputs = u.copy()  # those of lost samples are estimated
    r_x, fast = f.r_x, False
    f.reuses_gains = known.gains.shape[0] > 0
    for n in range(len(u)):
        for column in range(out.shape[1]):
            out[n, column] = np.nan
        follows, flies = flags[n] & FOLLOWS != 0 and n > 0, flags[n] & FLIES != 0
        if not follows:
            fast = flags[n] & CAPTURED != 0 or (n + 1 < len(u) and step[n + 1] < SHORT_S)
            see_instrument(f, fast)
        if noise_ratio.shape[0] > 0:
            scale_noise(f, fast, r_x, noise_ratio[n, 0], noise_ratio[n, 1])
        if f.reuses_gains:
            for k in range(f.m):
                f.gains[OF_I, k], f.gains[OF_X, k] = known.gains[n, OF_I, k], known.gains[n, OF_X, k]
        wandered(f, f.y)
        use_i, use_x = flags[n] & USE_I != 0, flags[n] & USE_X != 0
        f.in_flight = f.in_flight and flies and follows
        if f.in_flight:
            T_s = step[n]
            copy(f.previous[:], f.y[:])
            lost = n - 1 - int(delay_s(f.c[:]) / T_s)  # its input comes into force on the way here
            unknown = lost >= f.first and flags[lost] & LOST != 0
            if unknown and use_i:
                # Approximately the reading without its coloured noise.
                reading = y_i[n] - (expected_current_reading(f) - reading_of_current(f.c[:], f.y))
                find_input(
                    base_of(f), f.c[:], f.previous[:], inputs, lost, n, f.first, t[n - 1], T_s, reading, f.moved[:]
                )
            # With known steps the prediction is linear around them, which suffices for a model that differs only in
            # its noise. A step across a lost input depends on the model itself, so it is always integrated.
            held = input_over(f.c[:], inputs, n, f.first, T_s)
            if known.after.shape[0] > 0 and not unknown:
                step_linearised(f, known, n, T_s)
            else:
                advance(f, f.y[:], held, t[n - 1], T_s, FREE)
            if not f.reuses_gains:
                if known.slopes.shape[0] > 0:
                    take_slopes(f, known, n)
                    slopes_of_colour(f, T_s)
                else:
                    differences(f, held, t[n - 1], T_s)
                _write_step(f, written, n)
                carry(f.F, f.P, f.G, f.m)
                if unknown:
                    doubt_input(f, inputs, lost, n, t[n - 1], T_s)
                add_process_noise(f, T_s)
                add_jitter(f, inputs, n, T_s)
        elif follows:
            held = input_over(f.c[:], inputs, n, f.first, step[n])
            predict_held(f, held, inputs, n, t[n - 1], step[n], _held_at(f, flags[n - 1], y_x[n - 1]), known)
            _write_step(f, written, n)
        if not follows:
            f.first = n
            see_delays(f.c[:], f.usual[:], flags[n] & CAPTURED != 0)
            start_recording(f, use_i, y_i[n], u[n])
            use_i = False
        elif use_i and step[n] > SHORT_S and not f.closed_form:
            blind = not f.in_flight and flags[n - 1] & USE_I == 0
            if blind or n - f.first <= UNKNOWN_INPUTS:
                # The input before the first sample and the motion while i_c is not used are unknown: the current is
                # initialised again.
                measure_current(f, y_i[n])
                use_i = False
        if flies and not f.in_flight:
            if use_x:
                start_flight(f, y_x[n])
            use_x = False
        # The first of these readings determined the lost input (rule 5), so it does not test a model.
        if use_i and f.in_flight and n - f.first > 1 and (flags[n - 1] | flags[n - 2]) & LOST != 0:
            correct(f, OF_I, f.h_i[:], f.r_i, y_i[n] - expected_current_reading(f))
            use_i = False
        if use_x and not f.in_flight and flags[n] & (RESTS_LOW | RESTS_HIGH) != 0:
            compare_at_stop(f, out, n, y_x[n], f.low_m if flags[n] & RESTS_LOW != 0 else f.high_m, use_i)
        take_readings(f, out, n, y_i[n], y_x[n], use_i, use_x and f.in_flight)
        _write_correction(f, written, n)
        if spread.shape[0] > 0:
            for row in range(f.m):
                for k in range(f.m):
                    spread[n, row, k] = f.P[row, k]
        if state.shape[0] > 0:
            for k in range(state.shape[1]):
                state[n, k] = f.y[k] if f.in_flight else np.nan
        if not math.isfinite(f.y[X] + f.y[I_C] + f.y[V]):
            # Not an exception: the optimiser may try such parameters, and a likelihood that is not finite makes it
            # turn back.
            forget(f)  # the parameters are impossible
