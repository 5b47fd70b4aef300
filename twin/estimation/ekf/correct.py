"""The filter at a sample: initialisation of recordings and flights, and correction by the readings."""

from __future__ import annotations

from twin.compiled import inlined, kernel
from twin.estimation.ekf.lines import lines_of_current, lines_of_position, share_of_lines, variance_of_lines
from twin.estimation.ekf.memory import Floats, Memory, base_of, wandered
from twin.estimation.innovations import SPEED_STD_M_S
from twin.model.causes import current_sensor_lag, eddy_current_lag, position_sensor_lag, sensor_crosstalk
from twin.model.causes.wander import MINUTE_S
from twin.model.extended import (
    FIELD,
    I_C,
    I_COLOUR,
    I_SENSOR,
    LOOP,
    RATE,
    SENSOR,
    WARMTH,
    X_COLOUR,
    Base,
    V,
    X,
    current_of_reading,
    position_of_reading,
    position_reading,
    reading_of_current,
    settle_current,
)

OF_I, OF_X = 0, 1  # rows of the gains
# After the first of a flight.  With a lag of 1 ms later ones hardly depend on the start, with one of 1.6 ms a little.
TELLING_READINGS = 5
_ACCELERATION_M_S2 = 15.0  # standard deviation at the beginning of a flight
_WARMTH = (0.25, 0.3)  # A^2: mean and standard deviation at the beginning of a recording
_LAGGING_STD_A = 0.1  # current of a second loop or a core at the beginning of a recording, about that of the coil
_RATE_A_S = 50.0  # standard deviation of the rate of the current where a slow sensor or a lagging field begins
_LOOP_STD = 0.7  # place of the iron on its loop at the beginning of a recording, of a range of -1 to 1
_CURRENT_VARIANCE = 1e2  # A^2, initial variance without a reading of i_c


@kernel
def _forget(f: Memory, row: int) -> None:
    for k in range(f.m):
        f.P[row, k] = 0.0
        f.P[k, row] = 0.0


@kernel
def forget(f: Memory) -> None:
    """Set state and covariance to 0, with the ball not in flight."""
    f.in_flight = False
    for row in range(len(f.y)):
        f.y[row] = 0.0
    for row in range(f.m):
        _forget(f, row)


@kernel
def measure_current(f: Memory, reading: float) -> None:
    """Set the current to its reading, A: that is the correction of a current of which nothing is known."""
    _forget(f, 0)
    f.y[I_C] = current_of_reading(f.c[:], reading)
    f.P[0, 0] = _CURRENT_VARIANCE
    if f.i_sensor >= 0:
        _forget(f, f.i_sensor)
        f.y[I_SENSOR] = f.y[I_C]
        f.P[f.i_sensor, f.i_sensor] = _CURRENT_VARIANCE
        f.P[0, f.i_sensor] = _CURRENT_VARIANCE
        f.P[f.i_sensor, 0] = _CURRENT_VARIANCE
    correct(f, OF_I, f.h_i[:], f.r_i, reading - expected_current_reading(f))
    if f.i_sensor >= 0:
        # A slow sensor shows the current of a time constant ago, and the rate at which it changed since is unknown.
        f.P[0, 0] += (f.c[current_sensor_lag.TAU] * _RATE_A_S) ** 2


@kernel
def start_recording(f: Memory, reads: bool, reading: float, u: float) -> None:
    """Initialise currents, warmth and loop at the first sample of a chain.

    Args:
        f: the filter.
        reads: whether i_c was read; otherwise the current is K_A u.
        reading: of i_c, A.
        u: u_c, V.
    """
    for k in range(f.wandering, f.m):
        _forget(f, k)
        f.y[f.places[k]] = 0.0
        if k < f.coloured:
            f.P[k, k] = f.q_w[k - f.wandering] * MINUTE_S
        elif k >= f.lines:
            f.P[k, k] = f.v_line[(k - f.lines) // 2]
        else:
            f.P[k, k] = f.v_i if k == f.i_colour else f.v_x
    wandered(f, f.y)
    if reads:
        measure_current(f, reading)
    else:
        _forget(f, 0)
        f.y[I_C], f.P[0, 0] = f.paper[0] * u, _CURRENT_VARIANCE
    # As after a long time at this current: the inputs before the first sample are not known.
    settle_current(f.c[:], f.y, f.y[I_C])
    for k in (f.second, f.core):
        if k >= 0:
            _forget(f, k)
            f.P[k, k] = _LAGGING_STD_A**2
    if f.warmth >= 0:
        _forget(f, f.warmth)
        f.y[WARMTH], f.P[f.warmth, f.warmth] = _WARMTH[0], _WARMTH[1] ** 2
    f.y[LOOP] = 0.0
    if f.loop >= 0:
        _forget(f, f.loop)
        f.P[f.loop, f.loop] = _LOOP_STD**2


@kernel
def start_flight(f: Memory, reading: float) -> None:
    """Initialise the position at the first reading of a flight, m, with unknown speed."""
    p, c, y, P = Base(*base_of(f)), f.c[:], f.y[:], f.P
    for k in range(1, f.lasting):
        _forget(f, k)
    r_x = f.r_x
    if f.x_colour >= 0:
        share = f.share_x
        reading -= share * y[X_COLOUR]
        r_x += share * share * P[f.x_colour, f.x_colour]
    if f.lines_count > 0:
        reading -= lines_of_position(f, y, f.h_x[:])
        r_x += variance_of_lines(f)
    y[X], y[V] = position_of_reading(p, c, reading, y[I_C]), 0.0
    y[SENSOR], y[RATE] = reading, 0.0
    f.in_flight, f.readings = True, 0
    # The speed starts unknown and is not set from two readings: the filter weighs all of them, and a difference of
    # readings would have to treat offset, colour and lag of the sensor a second time.
    # With crosstalk the error of the current adds to that of the position.
    slope = (position_reading(p, c, y[X], y[I_C] + 1e-3) - position_reading(p, c, y[X], y[I_C])) / 1e-3
    P[1, 1], P[2, 2] = r_x + slope * slope * P[0, 0], SPEED_STD_M_S**2
    if f.field >= 0:
        # A field that lags is that of a time constant ago.  Were it known here, each flight would favour this cause.
        P[f.field, f.field] = P[0, 0] + (c[eddy_current_lag.TAU] * _RATE_A_S) ** 2
        P[0, f.field] = P[0, 0]
        P[f.field, 0] = P[0, 0]
        for k in range(f.lasting, f.m):
            P[k, f.field] = P[0, k]
            P[f.field, k] = P[0, k]
    for k in (0, f.field):
        if k >= 0:
            P[1, k] = -slope * P[0, k]
            P[k, 1] = P[1, k]
    for k in range(f.lasting, f.m):
        P[1, k] = -slope * P[0, k]
        P[k, 1] = P[1, k]
    if f.x_offset >= 0:
        P[1, 1] += P[f.x_offset, f.x_offset] + 2.0 * slope * P[0, f.x_offset]
        P[1, 0] -= P[f.x_offset, 0]
        P[0, 1] = P[1, 0]
        for k in range(f.lasting, f.m):
            P[1, k] -= P[f.x_offset, k]
            P[k, 1] = P[1, k]
    if f.x_colour >= 0:
        for k in range(f.lasting, f.m):
            P[1, k] -= f.share_x * P[f.x_colour, k]
            P[k, 1] = P[1, k]
    if f.lines_count > 0:
        for k in range(f.lasting, f.m):
            P[1, k] -= share_of_lines(f, k)
            P[k, 1] = P[1, k]
    if f.sensor >= 0:
        # Behind a lagging sensor the position depends on the unknown speed.
        tau = c[position_sensor_lag.TAU]
        P[1, 1] += (tau * SPEED_STD_M_S) ** 2 + (tau * tau * _ACCELERATION_M_S2) ** 2
        P[1, f.sensor] = r_x
        P[f.sensor, 1] = r_x
        P[1, 2] = tau * SPEED_STD_M_S**2
        P[2, 1] = P[1, 2]
        P[f.sensor, f.sensor] = r_x
        if f.x_colour >= 0:
            P[f.sensor, f.x_colour] = -f.share_x * P[f.x_colour, f.x_colour]
            P[f.x_colour, f.sensor] = P[f.sensor, f.x_colour]
        for k in range(f.lines, f.m):
            P[f.sensor, k] = -share_of_lines(f, k)
            P[k, f.sensor] = P[f.sensor, k]
    if f.rate >= 0:
        # The sensor's output moves as the ball did a time constant ago.
        for k in range(f.m):
            P[k, f.rate] = P[k, 2]
            P[f.rate, k] = P[k, 2]
        P[f.rate, f.rate] = P[2, 2] + (c[position_sensor_lag.TAU] * _ACCELERATION_M_S2) ** 2


@inlined
def take_readings(f: Memory, out: Floats, n: int, i: float, x: float, use_i: bool, use_x: bool) -> None:
    """Compute the innovations of the readings and correct the state, first by i_c.

    Args:
        f: the filter.
        out: receives nu_i, nu_x, S_ii, S_ix, S_xx in a row, shape (n_samples, 5).
        n: of this row.
        i: reading of i_c, A.
        x: reading of x, m.
        use_i: whether i is used.
        use_x: whether x is used; only in flight.
    """
    wandered(f, f.y)
    m = f.m
    # One reading after the other instead of both with a 2 x 2 inverse: the result is the same, as the noise of the two
    # is independent, and no matrix is inverted.  The joint covariance is noted first, for the likelihood.
    n_i, n_x = i - expected_current_reading(f), 0.0
    if use_x:
        n_x = x - position_slopes(f, f.y[:], f.h_x[:])
        # The first readings of a flight determine the initial speed and the state of the sensor, so they are not
        # counted as predicted: a model with a smaller initial variance (friction, a settled field) would seem better.
        if f.readings >= TELLING_READINGS:
            out[n, 1] = n_x
            if not f.reuses_gains:
                out[n, 4] = variance(f, f.h_x[:], f.r_x)
                if use_i:
                    out[n, 3] = covariance(f, f.h_i[:], f.h_x[:])
        f.readings += 1
    if use_i:
        out[n, 0], out[n, 2] = n_i, correct(f, OF_I, f.h_i[:], f.r_i, n_i)
        if use_x:
            for a in range(m):
                n_x -= f.h_x[a] * f.gains[OF_I, a] * n_i
    if use_x:
        correct(f, OF_X, f.h_x[:], f.r_x, n_x)
    if f.field < 0:
        f.y[FIELD] = f.y[I_C]
    if f.sensor < 0:
        f.y[SENSOR] = position_reading(Base(*base_of(f)), f.c[:], f.y[X], f.y[I_C])


@inlined
def compare_at_stop(f: Memory, out: Floats, n: int, x: float, stop_m: float, use_i: bool) -> None:
    """Compute the position sensor's innovation for a ball at rest at `stop_m`; arguments as in `take_readings`."""
    out[n, 1], out[n, 4] = x - position_reading(Base(*base_of(f)), f.c[:], stop_m, f.y[I_C]), f.r_x
    if use_i:
        out[n, 3] = 0.0
    if f.x_colour >= 0 or f.lines_count > 0:
        for a in range(f.m):
            f.h_x[a] = f.share_x if a == f.x_colour else 0.0
        out[n, 1] -= lines_of_position(f, f.y[:], f.h_x[:])
        if f.x_colour >= 0:
            out[n, 1] -= f.share_x * f.y[X_COLOUR]
        out[n, 4] = correct(f, OF_X, f.h_x[:], f.r_x, out[n, 1])


@inlined
def expected_current_reading(f: Memory) -> float:
    """The predicted reading of i_c, A."""
    reading = reading_of_current(f.c[:], f.y)
    if f.i_colour >= 0:
        reading += f.h_i[f.i_colour] * f.y[I_COLOUR]
    if f.lines_count > 0:
        reading += lines_of_current(f, f.y[:])
    return float(reading)


@inlined
def position_slopes(f: Memory, y: Floats, h: Floats) -> float:
    """The reading of x in state y, m; h, shape (m,) or longer, receives its derivatives; c of f is that of y."""
    for a in range(len(h)):
        h[a] = 0.0
    noise = 0.0
    if f.x_colour >= 0:
        h[f.x_colour] = f.share_x
        noise = f.share_x * y[X_COLOUR]
    if f.lines_count > 0:
        noise += lines_of_position(f, y, h)
    if f.sensor >= 0:
        h[f.sensor] = 1.0
        return float(y[SENSOR] + noise)
    p, c = Base(*base_of(f)), f.c[:]
    if f.x_offset >= 0:
        h[f.x_offset] = 1.0
    reading = position_reading(p, c, y[X], y[I_C])
    h[0] = sensor_crosstalk.disturbed(c, 0.0, 1.0)
    h[1] = (position_reading(p, c, y[X] + 1e-6, y[I_C]) - reading) / 1e-6
    return reading + noise


@inlined
def variance(f: Memory, h: Floats, r: float) -> float:
    """Return the variance of the innovation of a reading with derivatives h and noise variance r: r + h' P h."""
    return r + covariance(f, h, h)


@inlined
def covariance(f: Memory, g: Floats, h: Floats) -> float:
    """Return g' P h, with g and h of shape (m,) or longer."""
    return _form(f.P, g, h, 3) if f.m == 3 else _form(f.P, g, h, 4) if f.m == 4 else _form(f.P, g, h, f.m)


@inlined
def _form(P: Floats, g: Floats, h: Floats, m: int) -> float:
    total = 0.0
    for a in range(m):
        for b in range(m):
            total += g[a] * P[a, b] * h[b]
    return total


@inlined
def correct(f: Memory, channel: int, h: Floats, r: float, innovation: float) -> float:
    """Correct state and covariance by one reading; returns the variance s of its innovation, or 0 with known gains.

        s = h' P h + r,   K = P h / s,   y -> y + K nu,   P -> P - K s K'    (Kalman, 1960)

    P has shape (m, m), h has (m,), and K is f.gains[channel]: OF_I or OF_X.  If the ball is held, only the current and
    the lasting states are corrected.
    """
    s = 0.0
    if f.reuses_gains:
        pass
    elif f.m == 3:  # as in `predict.carry`
        s = _gain(f.P, f.gains, channel, h, r, 3)
    elif f.m == 4:
        s = _gain(f.P, f.gains, channel, h, r, 4)
    else:
        s = _gain(f.P, f.gains, channel, h, r, f.m)
    for a in range(f.m):
        if a == 0 or f.in_flight or a >= f.lasting:
            f.y[f.places[a]] += f.gains[channel, a] * innovation
    return s


@inlined
def _gain(P: Floats, gains: Floats, channel: int, h: Floats, r: float, m: int) -> float:
    """Set K and P of `correct` in the first m rows and columns; returns s."""
    s = r
    for a in range(m):
        gains[channel, a] = 0.0
        for b in range(m):
            gains[channel, a] += P[a, b] * h[b]
    for a in range(m):
        s += h[a] * gains[channel, a]
    for a in range(m):
        gains[channel, a] /= s
    for a in range(m):
        for b in range(a, m):
            # P - K s K' for one reading is symmetric by construction.  Joseph's form would cost three products of
            # matrices.
            P[a, b] -= gains[channel, a] * gains[channel, b] * s
            P[b, a] = P[a, b]
    return s
