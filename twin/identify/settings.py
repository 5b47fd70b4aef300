"""Every number by which `identify` decides, with what it means and where it comes from.

The origins are marked as in `twin/diagnose/settings.py`: *level* follows from an error rate, which is stated;
*reasoned* is an engineer's judgement.  How far the optimiser climbs stands in `fit.py`, how recordings are cut into
flights in `twin/estimation/prepare.py`.

Rates are per question, two-sided normal tails unless said otherwise.
"""

# --- Fit ---

# Level.  Gain of log-likelihood by which a process noise must be better than none.  2.3 % of right models without it
# get one (half of chi-square with one degree of freedom above 4, as none is the end of its range): their intervals are
# wider than need be.
PROCESS_NOISE_GAIN = 2.0
# Level.  Relative standard error of a noise level up to which it is given as measured: its variance is then five of its
# standard errors from 0, 6e-7.
NOISE_KNOWN = 0.1
# Reasoned.  Of the travel: nearer to x_max, (3) changes by a fifth to a half over the error of one prediction (10 to 50
# um).  The filter, linear in that error, then follows nothing, and where a reading is missing, too, its derivatives by
# the parameters reach a million standard errors: three such samples outvote a campaign.  No ball is there, but where
# x_max lies below the coil's real plane.
POLE_DISTANCE = 0.05
# Reasoned.  Prediction that a wrong force law cannot hide in, s: one and a half e-folds of the ball's instability.
AHEAD_S = 20e-3
# Reasoned.  Memory of the residuals that the sandwich covariance covers, s: as long as a flight's state lasts.
RESIDUAL_MEMORY_S = 0.1

# --- Intervals ---

# Reasoned.  Relative standard error of a parameter from which the parabola of its log-likelihood misleads and the
# interval is that of the profile.
PROFILE_FROM = 0.15
# Level.  Standard errors of b from 0 below which its interval is that of the profile: 0.3 %.
DRAG_NEAR_ZERO = 3.0
# Reasoned.  Logarithm of a parameter beyond which a bound is called absent: a factor of 50.
BOUND_FARTHEST = 4.0
# Reasoned.  Relative standard error, at least: no volt, ampere or metre of a laboratory is known better.
LEAST_RELATIVE_ERROR = 1e-6

# --- Do two estimates of a number agree? ---

# Level.  Standard errors between them: 6e-5; five comparisons are made, so 3e-4 per campaign.
AGREEMENT_ERRORS = 4.0
# Reasoned.  Relative difference of two values of K_c from which it is said, however sure.
K_C_DIFFERENT = 0.02
# Reasoned.  Of the largest level: smaller offsets and bends are not mentioned, however sure.
LEVEL_SHARE = 2e-3

# --- Steps of the amplifier ---

# Reasoned.  Samples of a level; shorter ones have no steady half worth a median.
LEVEL_SAMPLES = 12
# Reasoned.  Of the range of u_c: smaller changes are the same level.
SAME_LEVEL = 2e-3
# Level.  Standard deviations of a chi-square by which a transient is no first-order lag (about 3e-7), and, reasoned,
# the rms of its residual over the noise below which it is near enough to one.
SHAPE_ERRORS = 5.0
SHAPE_RATIO = 1.3
# Level.  Standard errors of a level off the line through all: 6e-7 each.
LINE_ERRORS = 5.0
# Reasoned.  Of the range of i_c: no converter of such a rig resolves less, whatever a file says.
RESOLUTION = 2.0**-16
# Reasoned.  Ratio of residual to noise that is given as a number; a larger one only says how small the noise came out.
RATIO_SHOWN = 100.0
# Reasoned.  Standard errors from which an outlying level counts by its distance only (P. J. Huber,
# Annals of Mathematical Statistics 35(1), 1964).
HUBER_ERRORS = 1.5

# --- Lift-off ---

# Level.  Spreads of x at rest by which the ball has left its stop: 1e-15 per reading.
DEPARTURE_ERRORS = 8.0
# Reasoned.  Current before the departure that is taken as a line, s; part of the travel over which the linear solution
# describes the flight.
LINE_S = 0.2
LINEAR_SHARE = 0.06

# --- Regression for starting values: windows, s, and how many are enough ---

WINDOW_S = 0.06
WINDOWS = 40

# --- Input delay ---

# Level.  Gain of log-likelihood of u_c later by a sample or two: z = 10, nothing that chance does; a wrong model makes
# some of it.
DELAY_GAIN = 50.0
DELAY_SAMPLES = 2  # reasoned: at most

# --- Does the control law of the campaign file explain u_c? ---

LAW_WINDOW_S = 1.0  # reasoned: an integrator's start is free in each
LAW_SAMPLES = 200  # reasoned: in flight, at least
LAW_QUANTILE = 0.9  # reasoned: of the errors; the worst tenth may be limits and transients
LAW_SHARE = 0.05  # reasoned: of the movement of u_c; a smaller error is not mentioned
LAW_BETTER = 3.0  # reasoned: other gains leave so many times less
LAW_MOST = 0.5  # reasoned: a law that leaves more did not run, whatever did
LAW_EXPLAINED = 0.9  # reasoned: of the variance; gains that explain so much can be named

# --- Dead channels ---

CONSTANT_SAMPLES = 10  # reasoned: of a channel that is called constant
STILL_SPREAD = 1.5  # reasoned: times the sensor's noise; x that spreads no wider does not move
ANSWER_SHARE = 0.3  # reasoned: of what (6) says; a ball that answers less to the force is not the one of this current
# Level.  Standard errors by which that answer must be missing: 3e-7, one-sided.
ANSWER_ERRORS = 5.0

# --- Units and columns: each test looks for a factor of several, no laboratory is near (reasoned) ---

CURRENT_MOST_A = 30.0  # no coil of this size takes it; 30 mA would not lift a ball either
CURRENT_LEAST_A = 0.05  # no current of this size carries a ball
INPUT_MOST_V = 400.0  # more than any amplifier of such a coil
INTERVAL_MOST_S = 0.2  # slower than this no ball is controlled, so t is not in seconds
INTERVAL_SPREAD = 0.02  # relative: a smaller spread of the interval is not mentioned
REPEATED_SHARE = 0.2  # of the times; so many that do not rise are a mistake of the table, not of a clock
RESPONSE_S = 0.1  # within this the ball has answered its reference
