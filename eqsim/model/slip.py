"""The definition of a slip of a slider behind a spring, the same for simulated records
and for the mean field.

The spring is stretched by Y - X, the stage's displacement less the slider's. In a slip
it becomes shorter by at least `least_slip` before it becomes longer by as much. A
shorter fall is one of the steps in which any interface moves: of a single contact that
breaks, or of one value in a table of thresholds.
"""

import numpy as np

from eqsim.laws.threshold import ThresholdLaw

# Share of the law's width. Contacts that are still pinned after a smaller motion hold
# most of the force they held before it; the share is a convention, and enters which
# slips are listed, not how large they are.
LEAST_SLIP = 0.25
# -ln of the shares of thresholds above the ends of the width, 84 % and 17 %: two
# standard deviations of a normal law.
_WIDTH_ENDS = np.array([0.17, 1.8])
# Least width over the mean threshold: that of a law of equal thresholds.
_NARROWEST = 0.02


def width_of(law: ThresholdLaw) -> float:
    """Width of a law of thresholds (length): two standard deviations, at least 0.02 and
    at most 1 mean threshold."""
    low, high = np.asarray(law.inverse_survival(_WIDTH_ENDS))
    return float(min(max(high - low, _NARROWEST * law.mean), law.mean))


def least_slip(law: ThresholdLaw) -> float:
    """Shortening of the spring in the smallest motion that is a slip (length)."""
    return LEAST_SLIP * width_of(law)
