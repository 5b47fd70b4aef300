"""The numbers by which `diagnose` decides, with their meaning and origin.

Three kinds of origin are marked:

- *level*: follows from an error rate, which is stated;
- *tuned*: chosen on simulated campaigns of the matrix (the seeds of its evaluation draws are not among them);
- *reasoned*: an engineer's judgement, neither derived nor tuned.

Log-likelihoods are natural logarithms.  Twice a gain of one parameter is chi-square with one degree of freedom where
the parameter is absent (S. S. Wilks, Annals of Mathematical Statistics 9(1), 1938), so a gain g is z = sqrt(2 g)
standard errors.  What each number does to the answers when it is halved and doubled: docs/theory/settings.md.

Modules read these as attributes (`settings.MIN_GAIN`), so that a benchmark can vary them.

Elsewhere stand the numbers of a model or a method: ranges of parameters (`twin/inference/theta.py` and the catalogue of
causes), tolerances and steps of iterations, sizes of figures.
"""

# --- Evidence: which samples count, and whose noise is it? ---

# Reasoned.  Samples that are taken off both ends of each flight between stops: a lagging sensor shows the impact later.
TRIM_SAMPLES = 2
# Reasoned.  Share of the lift-off current from which the ball may rise, and the time after it within which the ball
# rises by 10 um at most, s.
LIFTS_SHARE = 0.97
STAYS_S = 3e-3
# Reasoned.  Of the travel below x_max, where (3) has its pole: not used as flight.
POLE_SHARE = 0.06
# Reasoned.  Flight without which nothing is diagnosed, s: 120 time constants of the unstable pole.
MIN_FLIGHT_S = 2.0
# Reasoned.  Samples that stay together where a part of them is used, s: twelve time constants of the unstable pole, and
# a whole capture.  A model with a delay needs the input before its first sample.
THINNED_BLOCK_S = 0.2
# Reasoned.  Readings of a window that shows the noise of an instrument, and its fewest windows.
INSTRUMENT_WINDOW = 25
INSTRUMENT_WINDOWS = 8
# Reasoned.  Samples for which i_c shows a single change of u_c; slow lags stand for later ones.
INPUT_SHOWS = 8
# Reasoned.  Highest order of the polynomial of the logarithm of the noise over the height.
NOISE_BENDS = 2
# Reasoned.  The same for the colour of the noise; readings after a change of u_c that are left out, as the current
# still settles, and the same of captures, 20 ms at 25 kHz.
COLOUR_WINDOW = 100
COLOUR_WINDOWS = 3
COLOUR_SETTLES = 50
COLOUR_SETTLES_FAST = 500
OUTLIER_READINGS = 200  # reasoned: fewer do not show the usual size of a difference
# Reasoned.  Longest sampling interval of a step response that shows both a delay and T_A, and longest delay, s.
DEAD_TIME_FAST_S = 2e-4
DEAD_TIME_LONGEST_S = 6e-3

# --- Noise and adequacy: is the rest only sensor noise? ---

# Level.  Share of the noise level by which it may be off: 2 % of a standard deviation is 0.02 of log-likelihood per
# reading, and a converter's rounding and the filter's linearisation make about 1 %.
NOISE_TOLERANCE = 0.02
# Level, then tuned.  Standard errors of the noise level, where the rest was too short for 2 %: nominally 0.13 % per
# campaign (one-sided), in fact more, as rounding and linearisation add to what is left: 2.5 gave 3 false alarms in 60
# campaigns with nothing hidden (nominally 0.6 %), 3.0 none.
NOISE_ERRORS = 3.0
# Level.  Autocorrelation of the whitened innovations, in standard errors 1 / sqrt(n): the largest of 50 lags exceeds 4
# by chance in 0.3 % of campaigns (two-sided normal tail times 50).
AUTOCORRELATION_ERRORS = 4.0
# Reasoned.  Autocorrelation below which nothing physical is missing, however many samples prove it: such a rest adds
# less than 0.4 % to the error of a one-step prediction.
MAX_AUTOCORRELATION = 0.06
# Reasoned.  Standard deviation of the position of a stop in a plant's data, m (a caliper).
STOP_STD_M = 2e-5
# Level.  A stop farther from its position contradicts the plant: 5 standard deviations, 6e-7 two-sided.
MISPLACED_STOP_M = 5.0 * STOP_STD_M
# Reasoned.  The fit may not make the sensors better than this share of their noise at rest.
MIN_NOISE_SHARE = 0.7
# Level.  Sum of squares of a window at rest over that of the median window; above it, something moved.  Of 1e4
# windows of white noise none is expected there (chi-square with 23 degrees of freedom: 1e-13 each).
RESTLESS = 5.0
# Level.  Chance that noise is split between instruments, or follows the height, in a campaign where it does neither:
# over all pairs of recordings; means of the windows' logarithms are near to normal.
INSTRUMENT_CHANCE = 1e-3
# Level.  Chance that white noise of a channel counts as coloured: the likelihood ratio of two more
# numbers.  The search for the correlation time makes more of noise than that; of 3000 simulated rests none was
# coloured.
COLOUR_CHANCE = 1e-4
# Level.  Standard errors of the score test below which noise is white without more work: its gain, 4.5 of
# log-likelihood, is half of what COLOUR_CHANCE asks for.
COLOUR_SCORE = 3.0
# Level.  Standard deviations of the fourth difference beyond which a single reading is an outlier: of Gaussian noise
# one in ten million.
OUTLIER_ERRORS = 5.3
# Level.  Variances of a fourth difference that five of them may hold once the shape of a single reading is taken off:
# of noise one in a hundred holds more, so that one outlier in a hundred stays; a corner of the signal holds more.
OUTLIER_SHAPE = 11.3
# Reasoned.  Share of outliers that is not a property of an instrument: at ten times the noise they raise its level by
# 5 %, the tolerance of the floor.  The end of a slew limit may look like one.
OUTLIER_SHARE = 1e-3
# Reasoned.  Mean square of the innovations at one height over the smallest, from which a height is mentioned.
UNEVEN_SQUARE = 1.5

# --- Score test: can these data show a cause at all? ---

# Reasoned.  Share of the square of a signature that nothing else in the model takes up.  Less is rounding; more would
# leave out a displaced sensor, which shows most at rest, where the places of the stops take it up.
VISIBLE = 1e-7
# Level.  Standard errors by which a cause of usual strength shows: below one it cannot be seen.
MIN_INFORMATION = 1.0
# Reasoned.  A further probe of what displaces coil, stop or sensor, over the usual one: their effects differ by bends
# alone, which a wide probe would hide.
SMALL_PROBE = 0.02
# Reasoned.  Time over which a rate of change is measured, s: within one sample of a capture it is all noise.  Samples
# without which a probe is not measured.
RATE_SPAN_S = 4e-4
PROBE_SAMPLES = 20

# --- Stepwise selection: does the model need a cause? ---

# Level.  Gain of log-likelihood: z = 4.5, two-sided 7.7e-6 for one cause, 2.3e-4 for the best of thirty.
MIN_GAIN = 10.0
# Tuned.  Share of the lack that a cause must explain while more than noise is missing, in the part of the data where it
# gains most (i_c, x, points of rest).  A significant but minor effect next to a large unexplained rest is typical of a
# false name.
MIN_SHARE = 0.2
# Reasoned.  The same for two causes of which neither explains enough alone; and after a short fit of both.
PAIR_SHARE = 0.8
PAIR_PROMISE = 0.2
# Tuned.  A smaller share is enough for a cause that removes this much of the mean square error of x, BENEFIT_HORIZON_S
# ahead, over at least BENEFIT_PREDICTIONS predictions.
MIN_BENEFIT = 0.5
BENEFIT_HORIZON_S = 0.02
BENEFIT_PREDICTIONS = 200
BENEFIT_QUANTILE = 0.99  # of the errors before; those above are due to single events
# Tuned.  Share of all that the paper's model lacks, below which a gain corrects the form of a cause or of the unknown
# rest and is not a further cause.
MINOR_SHARE = 0.005
# Tuned.  The same once hardly more than noise is left, of what the causes gain together.
MINOR_SHARE_AT_NOISE = 0.015
MAX_CAUSES = 4  # reasoned: in one answer

# --- Trade-offs: which parameters do these data not determine one by one? ---

# Reasoned.  Correlation of two parameters from which they are reported: either interval is then at least 2.3 times as
# wide as with the other known.
MIN_TRADE_OFF = 0.9
MAX_TRADE_OFFS = 3  # reasoned: pairs in a report, the strongest
TRADE_OFF_LEVEL = 0.05  # level: chance that two numbers lie outside their region
TRADE_OFF_END = 1.96  # level: standard errors of the ends of its long axis, 5 %, and of a number that is told from 0

# --- Equivalence classes: which other cause would do as well? ---

# Level.  Difference of log-likelihood below which two causes are one class: z = 3, so that the true one is left out of
# its class in 0.13 % of cases (one-sided).
EQUIVALENT_GAIN = 4.5
# Reasoned.  So far behind, a candidate is outside the class whatever its fit may still gain.
OUT_OF_CLASS_GAIN = 60.0
# Tuned.  Share of the cause's own score from which a candidate may be its equivalent, and from which it is fitted again
# from the cause's own numbers.
COMPARABLE_SCORE = 0.2
SIMILAR_SCORE = 0.8
# Reasoned.  Share of a periodic force's gain that phases of another cause may cost (8 degrees cost a quarter), and the
# number of candidates that are fitted with phases of their own.
PHASE_SHARE = 0.5
PHASE_CANDIDATES = 2
# Effort.  Newton steps of a stated value in the place of a cause: the first finds the maximum of a parabola, the others
# correct what is not one.
STATED_STEPS = 3

# --- Lines in a spectrum: a periodic force, an error of a sensor ---

# Level.  Chance that noise makes a line in a spectrum, over all frequencies; what a wrong model leaves is not noise,
# and the likelihood judges it.
LINE_CHANCE = 1e-4
LINE_LOWEST_HZ = 10.0  # reasoned: below, the reference moves the ball, and what a model lacks has lines, too
LINE_NYQUIST_SHARE = 0.98  # reasoned: a line at the end of the spectrum has no neighbours
LINE_SAMPLES = 500  # reasoned: of a stretch for a spectrum
LINE_WIDTH_HZ = 0.06  # reasoned: error of three times a frequency from stretches of ten seconds
LINE_NEIGHBOURS_HZ = 3.0  # reasoned: the spectrum on either side that a line is compared with
PHASE_GAIN = EQUIVALENT_GAIN  # phases that gain less say the same
PHASE_ROUNDS = 4  # effort: rounds of the phases, at most
FORCE_HIGHEST = 0.4  # reasoned: of the sampling frequency; beyond it a force hardly moves the ball
WAVE_READINGS = 50  # reasoned: fewest readings for the two numbers of a sinusoid
MAX_LINES = 6  # reasoned: lines of a channel at rest, their harmonics included
LINE_SIZES = (1.0, 2.0, 4.0, 8.0)  # effort: starts, over the line in the innovations; the filter follows a part of it
# Reasoned.  Share of a gain within which least squares do not tell a force from an error of x: a large line is not
# quite linear.
PLACE_SHARE = 1e-3

# --- Effort: which candidates are fitted, and how far.  Tuned for time; a wrong number costs a name, not its truth. ---

# Filter steps of a diagnosis (a million takes 0.06 to 0.09 s of processor time), and the share of them for experiments
# and gain, whatever the search takes.
BUDGET_QUICK, BUDGET_FULL = 800e6, 20_000e6
BUDGET_RESERVED = 0.2
# With --quick, samples of a closed-loop or open-loop recording (four seconds at 500 Hz), and of all flights together.
QUICK_FLIGHT_SAMPLES = 2000
QUICK_SAMPLES = 40_000
CANDIDATES = 6  # fitted in a round
CANDIDATES_QUICK = 3  # the same with --quick
MIN_SCORE_SHARE = 0.02  # of the best score: candidates below are not fitted
MIN_SCORE = 0.5  # of MIN_GAIN: candidates below are not fitted, as a score is a parabola's gain
MIN_CLASS_SCORE = 0.3  # the same of candidates for a class, which they may join with a lower gain
PASSES = 30  # of a fit, at most
PASSES_FIRST = 2  # of a candidate's first fit
# Measured.  A climb towards a goal is given up where this many times what its slope promised, or its last step gained,
# does not reach it: climbs went up to 5.1 times as far.
GOAL_REACH = 10.0
# Samples of the approach to the start of a fit, its passes over them, and the multiple of them from which it is used.
APPROACH_SAMPLES = 8000
PASSES_APPROACH = 12
APPROACH_RATIO = 2.0
ROUGH_LEFT = 0.5  # measured: log-likelihood that cheaper slopes leave, 0.1 to 2 in trials
PASSES_QUICK = 10  # of a model without one of its causes, with --quick
HALVING = ((4, 0.1, 6), (8, 0.35, 4), (PASSES, 0.5, 4))  # then: passes, least share of the best gain, most candidates
STEEPNESS = 8.0  # a likelihood rises at most so many times what its slope promises (up to five in trials)
STEEPNESS_DELAY = 50.0  # the same of a delay, whose likelihood is flat at zero
STEEPNESS_DOUBT = 0.2  # share of the best gain that an early fit may be behind its end
SAFE_CANDIDATES = 2  # with the best scores: they pass the first halving in any case
# Reasoned.  Share of the largest gain from which the next cause decides between candidates.  In a campaign of three
# causes the right one gained 1 % less than a false one.
LEADERS_SHARE = 0.8
PAIR_CANDIDATES = 14  # of which any two are tried together where none explains enough alone (tuned: one was eleventh)
PAIRS_FITTED = 3  # of these
ROUND_TRIPS = 3  # forward and backward, while causes replace each other
# Starts of a fit: the linear step, in probes (beyond the largest the signature changes), and its parts, as the whole
# one overshoots where the likelihood is far from a parabola; sizes of a cause in the place of another, in probes.
START_MAX_REACH = 20.0
START_MIN_REACH = 0.05
START_USUAL_REACH = 0.3  # where the step is shorter than that
START_PARTS = (1.0, 0.3, 0.1)
START_SIZES = (0.5, 0.7, 0.85, 1.0, 1.4, 2.0, 3.0, 5.0)
# Reasoned.  Of the usual probe of what varies from tick to tick: its likelihood is flat at zero, so it is tried there.
START_SPREAD = 0.25
# Samples of the same u_c before i_c / u_c is K_A, change of u_c that counts as the same, share of the largest u_c from
# which the ratio counts, and readings without which it is not computed.
STEADY_SAMPLES = 5
STEADY_CHANGE = 0.02
STEADY_INPUT = 0.2
STEADY_READINGS = 20
STEP_EXPLAINED = 0.9  # share of the variance of a step response from which its T_A counts
EXACT_SLOPES_SQUARE = 1.5  # mean square of the innovations above which rough slopes may point the wrong way

# --- Checks: is it the same effect in all recordings? ---

# Level.  Standard errors by which a block of a recording must contradict the others: 1e-15, many blocks are asked.
DRIFT_ERRORS = 8.0
DRIFT_BLOCK_S = 1.0  # reasoned: length of a block, s
# Reasoned.  Change of the logarithm of a parameter below which a drift does not matter.
DRIFT = {"K_A": 0.03, "K_c": 0.05}
# Level.  Gain of a beginning within a recording (z = 7), z of the effect after it; reasoned: the share of the later
# strength below which an effect is absent.
BEGINNING_GAIN = 25.0
BEGINNING_Z = 4.0
BEGINNING_ABSENT = 0.25
# Level.  Gain of a change between recordings over the same causes all the time; the places that are tried make about 6
# by chance.
CHANGE_GAIN = 25.0
CHANGE_AHEAD = 1.2  # reasoned: and so many times the score without a change
CHANGE_SHARE = 0.4  # reasoned: share of what is left that each cause must explain
CHANGE_SAME = 0.01  # reasoned: share of the gain by which two places are the same
CHANGE_POSITIONS = 2  # effort: places that are searched with fits
# Level.  Gain by parameters of its own that makes a recording an outlier (z > 9 for four parameters, 1e-20).
OUTLIER_GAIN = 50.0
OUTLIER_SAMPLES = 500  # reasoned: in flight; fewer do not fix four parameters
OUTLIER_RECORDINGS = 4  # reasoned: of two that disagree, neither is known to be the outlier

# --- Lost samples ---

# Reasoned.  Gaps of a recording and share of missing samples from which lost samples are a cause: one gap or two are an
# interruption.  A gap of more sampling intervals is a pause.
MIN_GAPS = 5
MIN_MISSING = 5e-4
LONGEST_GAP = 50

# --- Errors of prediction ---

# Reasoned.  Blocks of the bootstrap, s: forty times the memory of a flight.  Of fewer blocks the interval would be too
# narrow.
ERROR_BLOCK_S = 0.5
ERROR_BLOCKS = 10
# Reasoned.  Factor on the error of the reference from which a model is worse: nobody would notice less, and right
# models differ by as much through the errors of their parameters.
WORSE_ERROR = 1.02
# Effort.  Models with fewer causes that are judged where the one with all of them is refused.
FEWER_CAUSES_COMPARED = 4

# --- The remainder: curves through what is left ---

# Effort.  Curves that are fitted in a round, the best by the score test.
CURVES_FITTED = 3
# Reasoned.  Curves in addition to the causes: the parts of more curves cannot be separated.
MAX_CURVES = 2
# Reasoned.  Share of the samples that may lie beyond either end of the range of a curve.
CURVE_OUTER = 0.001
# Effort.  Causes of its form that are fitted in its place.
MAX_SUBSTITUTES = 2
# Effort.  Passes of such a fit, at most, and the step in standard errors at which it ends: its error tells it from
# others long before its maximum is known.
CURVE_PASSES = 30
CURVE_TOLERANCE = 0.2
# Reasoned.  A curve is selected if the error of x surely (95 %) falls below this share of what it was.
CURVE_RATIO = 0.95
# Reasoned.  A cause has the form of a curve that takes up so much of what the recordings could show of it, if it gains
# at least this share of what the curve gains; the simpler of two models is preferred if its error is at most so many
# times as large (errors of a right model differ by 5 %).
LIKE_SHARE = 0.5
LIKE_GAIN = 0.3
LIKE_ERROR = 1.05

# Measured.  Factor on the evidence of a curve by the score test from which it may reach a name: fits had up to 6
# times as much.
RIVAL_SCORE = 10.0
# Effort.  Curves that are fitted in the place of a name, the best by the score test.
RIVALS_FITTED = 2
# Reasoned.  A name stays beside its own free form if it explains at least this share of what that does: the rest is
# another formula for the same effect.
FREE_FORM_SHARE = 0.9

# --- Experiments and reference model ---

# Reasoned.  Of an experiment's samples at a stop: with more, the loop does not hold the ball and nothing is proposed.
CONTACT_SHARE = 0.05
# Reasoned.  Relative difference of a mass or length by which a model is of another plant: a balance or a caliper errs
# by less.
SAME_PLANT = 0.01
# Reasoned.  Factor on the error of the refitted model from which the parameters of a reference model are wrong, and the
# relative change from which one is mentioned.
REFERENCE_WORSE = 1.1
REFERENCE_OFF = 0.01

# --- Verdict and confidence ---

# Reasoned.  `partly-explained`: error of x over its noise floor, at most, and the least share of the mean square above
# the floor that the causes remove.  A share of LARGE_SHARE is enough whatever is left: with a quieter sensor the same
# rest is a larger multiple of the floor, and the names are no less right.
PARTLY_ERROR = 2.0**0.5
PARTLY_SHARE = 0.5
LARGE_SHARE = 0.85
# Reasoned.  Lead of log-likelihood over which the doubt falls by e.
CONFIDENCE_LEAD = 6.0
# Measured.  Upper limit of the confidence by verdict, the share of names that were right: 133 of 135 with
# `causes-found`, 8 of 12 with `partly-explained`, 6 of 21 candidates with `unknown-cause`.
MAX_CONFIDENCE = {"causes-found": 0.98, "partly-explained": 0.64, "unknown-cause": 0.294, "unfinished": 0.294}

# --- Diagnosis from points of rest alone ---

STATIC_LEVEL = 0.05  # level: of the F test, divided by the number of causes tried
STATIC_POINTS = 3  # reasoned: K_c, one cause, and one degree of freedom
STATIC_ABSORBED = 1e-4  # reasoned: share of the squares below which a cause is K_c under another name
STATIC_TIE = 1.01  # reasoned: ratio of sums of squares
STATIC_Z = 3.0  # level: separation that an experiment must promise, as EQUIVALENT_GAIN
STATIC_NEARLY = 0.9  # reasoned: share of the squares from which a cause is mentioned though too few points hold it
STATIC_CONFIDENCE = 0.98  # reasoned: at most
