"""Thresholds of the diagnosis, each with its reason."""

LEVEL = 0.004
"""Probability that noise alone passes for an effect, over all hypotheses together."""
NEAR = 0.2
"""The same of a screening of short recordings after which the best hypotheses are fitted: their fits may pass where
derivatives do not. In long ones the derivatives see enough, and such fits have passed by chance."""
LEAST_SHARE = 0.03
"""A further effect must gain this share of what the accepted effects gained in the same outputs, and an alternative
this share of the effect chosen at the same time: smaller gains may only reflect misfit of laws."""
DISCREPANCY = 1.0
"""Share of its contribution by which a law may be wrong: that much is not credited to further effects."""
MOST_EFFECTS = 4
"""Maximum number of different effects, and of terms of a nonparametric law: a longer search would fit the misfit of
those found."""
MOST_SUPPORTS = 3
"""Maximum number of supports (regimes, onsets, windows); each costs a whole search."""
MOST_SITES = 6
"""Maximum number of steps of a search: an effect takes one for each of its sites and constants."""
LIKELY = 0.3
"""Minimum probability of a name: each of three equally likely ones still has it, if the cause is surely among them."""
KNOWN = 0.5
"""Minimum probability, calibrated on machines drawn at random, that the cause is among the names of an effect for it to
be named: below, it is likelier that it has no name."""
EXPLAINED = 0.5
"""Minimum share of what there is to explain that an effect, or all of them together, must explain, and of its gain with
an engine's tables that it must also have with the engine itself: below it, something unnamed explains more.
Also of what a rival lacks to be level that its scores must promise, for it to be fitted from a time on."""
BLOCK = 20
"""Rows per block; scores of rows in the same block are treated as dependent."""
LEAST_BLOCK = 4
"""Rows per block in short recordings, at least: the innovations of a right model do not depend on each other at all."""
FEW = 10
"""Minimum number of blocks for the estimate of a variance."""
LEAST_SESSIONS = 5
"""Minimum number of sessions for a bootstrap over sessions; with fewer, it draws runs of rows."""
MARGIN = 0.005
"""Minimum relative increase of the error of a model called worse: any two differ by chance in the fourth digit."""
POWER = 0.9
"""Probability with which an effect of the reported size would have been found."""
CREDIBLE = 0.95
"""Total probability of a credible set."""
REQUIRED = 8.0
"""Gain [nats] that an onset or a window must add: it has two numbers, the best of some hundreds tried."""
REQUIRED_OF_REGIMES = 16.0
"""Gain [nats] that a regime must add: it is the best of thousands tried."""
SHORTEST_PUSH = 8
"""Minimum length [rows] of a push; as many rows next to it may still show its echo."""
SHORTEST_WINDOW = 50
"""Minimum length [rows] of a window in which a law of motion holds and not elsewhere."""
NO_ONSET = 0.025
"""Share of a session at either end in which no onset is reported: it would split off too few rows."""
LEAST_ROWS_OF_REGIME = 0.04
"""Minimum share of the rows inside a regime, and outside it."""
SILENT = 4.0
"""Maximum gain [nats] of an effect of another size outside a regime, apart from `LEAST_SHARE` of the gain inside."""
CLEARLY = 1.1
"""Factor on the gain of a push: another law in the same window must gain more than that, plus `REQUIRED`."""
EXCEPTION = 3.0
"""Factor on the gain of the best other window that a push must reach: what recurs is something else."""
AT_BOUND = 1e-3
"""Distance from a bound, as a share of the range, below which a value counts as being at that bound."""
REQUIRED_OF_NOISE = 10.0
"""Minimum gain [nats] of an effect on the noise, which has two or three constants, and of predicting innovations from
earlier ones, beyond the gain by chance."""
SURE_OF_NOISE = 3.5
"""Standard deviations, over blocks of rows, by which the gain of an effect on all rows' noise must exceed zero."""
SET_ASIDE = 3
"""Best blocks of rows that do not count for an effect on few rows: it must occur repeatedly."""
LINE_LEVEL = 1e-3
"""Maximum p-value of a spectral line, over all frequencies and outputs."""
STRONGER = 1.5
"""Factor on the largest amplitude in a baseline that an oscillation must exceed to be new."""
PREDICTABLE = 0.02
"""Predictable shares of an output's squared innovations below this count as zero."""
TOUCHED = 0.05
"""An effect improves an output if it gains more than this share of its total gain there."""
MOST_ROWS = 0.6
"""Maximum share of the rows in a regime that is reported as the place of a mismatch."""
STANDS_OUT = 0.25
"""Minimum difference between a regime's share of the excess error and its share of the rows for it to be reported."""
Z95 = 1.96
"""Standard deviations of a normal distribution at the ends of a 95 % interval."""
