"""The thresholds of `identify`, each with its meaning and its origin.

The origins are marked as in `twin/settings/diagnosis.py`: *level* follows from the stated error rate; *reasoned* is an
engineer's judgement.  The bounds and largest steps are in `twin/inference/theta.py`, those of
flights in `twin/estimation/prepare.py`.

Rates are per question, two-sided normal tails unless said otherwise.
"""

# --- Fit ---

# Level.  Improvement of log-likelihood that justifies a process noise.  2.3 % of right models without one get one (half
# of chi-square with one degree of freedom above 4, as 0 is the end of its range); their intervals are too wide.
PROCESS_NOISE_GAIN = 2.0
# Level.  Relative standard error up to which a noise level is certainly present: its variance is then at least five
# standard errors from 0 (6e-7).
NOISE_KNOWN = 0.1
# Reasoned.  Of the travel.  Nearer to x_max, (3) changes by a fifth to a half over the error of one prediction (10 to
# 50 um), and the linearisation of the filter is invalid.  If a reading is missing there, the derivatives by the
# parameters reach a million standard errors, and three samples dominate a campaign.  A ball is only there if x_max is
# below the coil's real plane.
POLE_DISTANCE = 0.05
# Reasoned.  Horizon that reveals a wrong force law, s: one and a half time constants of the unstable pole.
AHEAD_S = 20e-3
# Reasoned.  Correlation time of the residuals in the sandwich covariance, s: the memory of a flight's state.
RESIDUAL_MEMORY_S = 0.1

# --- Intervals ---

# Reasoned.  Relative standard error from which the log-likelihood is not a parabola and the profile gives the interval.
PROFILE_FROM = 0.15
# Level.  Standard errors of b from 0 below which the profile gives its interval: 0.3 %.
SMALL_DRAG = 3.0
# Reasoned.  Logarithm of a parameter beyond which an interval has no end: a factor of 50.
BOUND_FARTHEST = 4.0
# Reasoned.  Smallest relative standard error: laboratory instruments are not more accurate.
MIN_RELATIVE_ERROR = 1e-6

# --- Do two estimates of a number agree? ---

# Level.  Standard errors between them: 6e-5; five comparisons are made, so 3e-4 per campaign.
AGREEMENT_ERRORS = 4.0
# Reasoned.  Relative difference of two values of K_c below which it is not reported, however significant.
K_C_DIFFERENT = 0.02
# Reasoned.  Of the largest level: smaller offsets and bends are not reported, however significant.
LEVEL_SHARE = 2e-3

# --- Steps of the amplifier ---

# Reasoned.  Fewest samples of a level; the median is taken over its second half.
LEVEL_SAMPLES = 12
# Reasoned.  Of the range of u_c: smaller changes are the same level.
SAME_LEVEL = 2e-3
# Level.  Standard deviations of a chi-square from which a transient is not first order (about 3e-7).  Reasoned: rms of
# its residual over the noise below which it counts as first order all the same.
SHAPE_ERRORS = 5.0
SHAPE_RATIO = 1.3
# Level.  Standard errors of a level from the line through all levels: 6e-7 each.
LINE_ERRORS = 5.0
# Reasoned.  Of the range of i_c: smallest plausible resolution of a converter, whatever the digits of a file.
RESOLUTION = 2.0**-16
# Reasoned.  Largest ratio of residual to noise that is printed; a larger one depends only on the tiny noise.
MAX_RATIO = 100.0
# Reasoned.  Standard errors from which the loss of a level is linear (P. J. Huber, Annals of Mathematical Statistics
# 35(1), 1964).
HUBER_ERRORS = 1.5

# --- Lift-off ---

# Level.  Standard deviations of x at rest from which the ball has left its stop: 1e-15 per reading.
DEPARTURE_ERRORS = 8.0
# Reasoned.  Time before lift-off over which the current is fitted by a line, s; part of the travel over which the
# linearised solution describes the flight.
LINE_S = 0.2
LINEAR_SHARE = 0.06

# --- Regression for starting values (reasoned) ---

WINDOW_S = 0.06  # length of a window
WINDOWS = 40
SHORTEST_T_A, LONGEST_T_A = 0.03, 100.0  # ends of the grid of T_A, in sampling intervals
START_SAMPLES = 5_000  # of one piece: enough for a starting value

# --- Input delay ---

# Level.  Improvement of log-likelihood that shows a delay of u_c: z = 10, to leave room for errors of the model.
DELAY_GAIN = 50.0
DELAY_SAMPLES = 2  # reasoned: largest delay
# Level.  Improvement of the log-likelihood of i_c that shows a delay by a part of a sample: z = 4.5.
LOOP_DELAY_GAIN = 10.0
LOOP_DELAY_SHARES = (0.05, 0.15, 0.3, 0.6, 0.9)  # reasoned: delays at which the search begins, in samples

# --- Does the control law of the campaign file explain u_c? ---

LAW_WINDOW_S = 1.0  # reasoned: the initial integral is free in each window
LAW_SAMPLES = 200  # reasoned: fewest samples in flight
LAW_QUANTILE = 0.9  # reasoned: of the errors; the largest tenth may be limits and transients
LAW_SHARE = 0.05  # reasoned: of the variation of u_c; a smaller error is not reported
LAW_BETTER = 3.0  # reasoned: factor by which other gains must reduce the error
LAW_LIMIT = 0.5  # reasoned: of the variation of u_c; a law with a larger error did not run
LAW_EXPLAINED = 0.9  # reasoned: of the variance of u_c; gains that explain as much are reported

# --- Dead channels ---

CONSTANT_SAMPLES = 10  # reasoned: a channel with fewer samples is not called constant
UNMOVING_SPREAD = 1.5  # reasoned: times the sensor's noise; with a smaller spread x does not move
ANSWER_SHARE = 0.3  # reasoned: of the response by (6); a smaller response is not that of this current
# Level.  Standard errors by which that response must be too small: 3e-7, one-sided.
ANSWER_ERRORS = 5.0

# --- Units and columns (reasoned): the limits are several times beyond what any laboratory rig has ---

MAX_CURRENT_A = 30.0  # too much for a coil of this size; as 30 mA too little to lift a ball
MIN_CURRENT_A = 0.05  # too little to carry a ball
MAX_INPUT_V = 400.0  # more than any amplifier of such a coil
MAX_INTERVAL_S = 0.2  # too slow to control a ball, so t is not in seconds
INTERVAL_SPREAD = 0.02  # relative: a smaller spread of the interval is not reported
REPEATED_SHARE = 0.2  # of the times; more repeated times are an error of the table, not of a clock
RESPONSE_S = 0.1  # longest delay between reference and position
