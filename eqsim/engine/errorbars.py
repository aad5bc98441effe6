"""Relative errors of steady estimates that the scatter of randomisations does not show:
those of tables and steps, and of lives too rare to be met."""

import math
from typing import NamedTuple

import numpy as np

from eqsim.engine.contacts import Contacts
from eqsim.engine.langevin import step_error
from eqsim.engine.proposal import Proposal, births_per_log, lives_on_grid
from eqsim.laws.barrier.pooled import Pooled
from eqsim.laws.threshold import Smooth
from eqsim.model.ensemble import Ensemble

_TABLES = 1e-9  # relative error of averages over tables
# likewise over the inverse of a pooled hazard, of smooth and of discrete laws
_POOLED_SMOOTH = 2e-7
POOLED_STEPS = 3e-5


class Unseen(NamedTuple):
    """Relative errors that the scatter of randomisations does not show: of the means
    over lives, and of that of squares."""

    means: float
    squares: float


def table_errors(ensemble: Ensemble, c: Contacts, step: float) -> Unseen:
    """Errors of the tables of lives, and of a `step` of paths."""
    means = _TABLES
    if isinstance(c.barrier, Pooled):
        means = POOLED_STEPS if c.thresholds.steps.size else _POOLED_SMOOTH
    if c.aging.fluctuates:
        means = step_error(c.aging, step)
    law, squares = ensemble.thresholds, means
    if isinstance(law, Smooth):
        means = max(means, law.drawn_to)
        if not ensemble.divergence:
            drawn_to = law.squares_drawn_to[ensemble.stiffness_law == "sqrt"]
            squares = max(means, drawn_to)
    return Unseen(means, squares)


def hidden_errors(
    c: Contacts, proposal: Proposal | None, count: int, tables: Unseen, diverges: bool
) -> Unseen:
    """Errors of tables, and of kinds of lives so rare that `count` lives may have met
    too few; of unmet squares only if their mean does not diverge."""
    others = math.hypot(rare_clocks(c, proposal, count), uneven_thresholds(c, count))
    # both lower the mean square, so that they add up
    unmet = 0.0 if diverges else unmet_squares(c, proposal, count)
    squares = math.hypot(tables.squares + unmet, others)
    return Unseen(math.hypot(tables.means, others), squares)


def rare_clocks(c: Contacts, proposal: Proposal | None, count: int) -> float:
    """Error due to clocks, early or late, of which `count` lives meet fewer than four;
    0 without heat, and for paths, whose other errors are larger."""
    if not c.barrier.thermal or c.aging.fluctuates:
        return 0.0
    shares, rare = (np.arange(16) + 0.5) / 16, 4.0 * 0.5 ** np.arange(37) / count
    p = np.append(rare, 1.0 - rare)
    clock, weight = proposal.clock.draw(p) if proposal else (p, np.ones(p.size))
    weight = weight.reshape(2, rare.size)
    found, errors = lives_on_grid(c, shares, clock), []
    for reward in (found.work, found.travel):
        reward = reward.reshape(shares.size, *weight.shape)
        # grows with rarity
        change = np.abs(reward - reward[:, :, :1]).mean(axis=0) * weight
        size = np.abs(reward[:, :, 0]).mean()
        errors.append(float(change.sum(axis=0)[1:] @ -np.diff(rare) / size))
    return max(errors)


def unmet_squares(c: Contacts, proposal: Proposal | None, count: int) -> float:
    """Share that lives add to the mean square of forces, relative to all others, of
    which `count` may have met none: those beyond the last threshold, and all that are
    too rare among plain births."""
    if proposal is not None:
        return proposal.squares.beyond
    squares = Proposal.of(c).squares
    births = births_per_log(squares.log_e)
    share = squares._replace(density=births).unmet(count)
    return math.inf if share >= 1.0 else (squares.beyond + share) / (1.0 - share)


def uneven_thresholds(c: Contacts, count: int) -> float:
    """Error that a few different thresholds may hide; 0 for laws with a density. A
    scrambled Sobol sequence gives each distinct threshold its expected number of lives
    to within one. If a threshold is rare, all sequences may round the same way, and
    their scatter is 0. One life more or less shifts a mean by at most (max - min)/count
    per jump of the quantile function. Three times that is returned; an error z times as
    large has probability exp(-3 z)."""
    steps = c.thresholds.steps
    jumps = np.unique(steps).size - 1
    if isinstance(c.barrier, Pooled) or jumps < 1:
        return 0.0
    parts = steps, steps ** (3 if c.springs.slope else 2)
    return max(3.0 * float(np.ptp(x) / x.mean()) / jumps / count for x in parts)
