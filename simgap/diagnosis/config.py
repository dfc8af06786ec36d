"""Numbers that decide what is claimed, each with its reason."""

LEVEL = 0.004
"""Chance at which noise alone may pass for an effect, over all hypotheses together."""
LEAST_SHARE = 0.03
"""A further effect must gain this share of what those before it gained in the same outputs: less may be no more than
the difference between their laws and the robot's."""
DISCREPANCY = 1.0
"""By which share of its contribution a law may be wrong: as much of it is not credited to further effects."""
MOST_EFFECTS = 4
"""Different effects that a diagnosis adds at most: a search that goes on fits what the laws found do not."""
MOST_SUPPORTS = 3
"""Regimes, times or stretches in which effects may act at the same time; each costs a whole search."""
MOST_SITES = 6
"""Steps of a search at most: an effect at several sites with several constants takes a step for each."""
RIVAL = 0.03
"""Share of what a member was expected to gain when it was chosen that a rival must have been expected to gain."""
LIKELY = 0.3
"""Probability below which a name is but one of many: three as likely as each other may still be a credible set."""
EXPLAINED = 0.5
"""Share of what there is to explain that named physics must explain for the vocabulary to be the answer."""
BLOCK = 20
"""Rows whose scores are taken to be dependent."""
FEW = 10
"""Blocks that are too few to tell a variance."""
LEAST_SESSIONS = 5
"""Sessions from which on a session is the unit of a bootstrap; of fewer, runs of rows are."""
MARGIN = 0.005
"""Share of its error by which a model must be worse to be called so: any two differ by chance in the fourth digit."""
LARGE = 0.1
"""Share of the error in its outputs that an effect must remove, at one horizon at least, to be named whatever else is
missing."""
WELL_DETERMINED = 5.0
"""Standard deviations from zero at which a constant is known to 40 %, with 95 % confidence."""
POWER = 0.9
"""Chance with which an effect of the reported size would have been found."""
CREDIBLE = 0.95
"""Probability that a credible set holds together."""
REQUIRED = 8.0
"""Gain [nats] that an onset or a stretch must add: two numbers, the best of some hundreds tried."""
REQUIRED_OF_REGIMES = 16.0
"""Gain [nats] that a regime must add: the best of thousands tried."""
