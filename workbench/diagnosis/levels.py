"""The levels of a diagnosis in one table: chances of a false alarm, confidence, and what is only rounding.

Levels differ because they guard against different mistakes. A false name costs more than a missed one, and what is
said of the data themselves (outliers, random effects) or of the parameters of a simulation is checked by
no held-out sample, so that its level alone guards it.
"""

import math

UNMODELLED_LEVEL = 0.005
"""Chance that a recording with nothing missing is said to miss something; held-out samples guard it, too."""
DATA_FAULT_LEVEL = 1e-3
"""Chance that something is said about the noise of a recording, or about a parameter of its simulation, with nothing
wrong: no held-out sample guards it."""
RANDOM_EFFECT_LEVEL = 1e-4
"""Chance that a random effect is reported at a place: its test covers all places, and its null is only nearly right."""
CONFIDENCE = 0.95
"""Probability from which on a name is certain, and share of the posterior that alternatives are listed for."""
CONFOUNDED_SHARE = 0.9
"""Share of a finding's signature from which on another effect that makes it is an alternative to it."""
LISTED_PROBABILITY = 0.005
"""Probability from which on an alternative is worth mentioning: half a percent is what rounding to percents hides."""
LEAST_LOG_ODDS = math.log(3.0)
"""Log odds, 3 to 1, from which on another set or name is worth a solution: Jeffreys calls less a bare mention."""
CRITICAL_T = 2.0
"""t of paired falls of an error above which a held-out gain counts as significant: one in fifty by chance at most."""
CRITICAL_CLARK_WEST_T = 2.5
"""t of a change of the predictions in held-out errors above which it counts as significant: about one in fifty by
chance, for up to six coefficients and errors of poses that are independent. It is about twice the t of the fall."""
SIGNIFICANT_SIGMAS = 3.0
"""Standard deviations by which a number that was chosen among a few differs significantly from another."""
UNDETERMINED_STD = 10.0
"""Typical sizes of a parameter: one whose standard deviation is larger is as good as unknown by itself. A prior as wide
leaves it to the data."""
OUTLIER_WEIGHT = 0.05
"""Robust weight below which a sample is another process's and judges nothing."""
MOST_LISTED = 12
"""Alternatives that are listed at most: nobody reads more."""
MAJORITY = 0.5
"""Share from which on something is most of a thing: half."""
RARE_PRIOR = 0.1
"""Prior chance of what is rare: that what is missing is in no row of the library, that a recording has outliers."""
NEGLIGIBLE_SHARE = 1e-3
"""Share of a whole below which a difference is none, after rounding and refitting."""
NOTABLE_SHARE = 0.03
"""Share of a sum of squares below which a contribution does not matter."""
LEAST_NUMBER = 30
"""Samples, or poses, from which on a spread or a correlation can be estimated: to a sixth."""
ANGLE_DECIMALS = 6
"""Decimals of a degree or a millimetre that conversions between units leave right."""
MAX_ROUNDS = 20
"""Rounds of an iteration that ends where nothing changes any more; few take as many."""
ROUNDING = 1e-9
"""Share of a column below which what is left of it after a projection is only rounding: 1e-16 times a condition."""
CHUNK_SIZE = 1_000_000
"""Numbers of an array that is made at once, eight megabytes: more are made in parts."""
