"""Lives from given uniforms: for steady estimates, predictions and what the law says of
errors."""

import functools
import math
from typing import Any, NamedTuple

import numpy as np
from scipy import optimize

from eqsim.engine import langevin
from eqsim.engine.contacts import Contacts, contacts
from eqsim.engine.lanes import LANES, Lives, draw_thresholds, life_work
from eqsim.laws.aging import Langevin
from eqsim.laws.aging.base import break_lives
from eqsim.laws.barrier.base import travel
from eqsim.laws.newborn import Stretched, newborn_draw
from eqsim.laws.stiffness import kappa
from eqsim.laws.threshold import threshold_draw
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.compiled import by_law, kernel, routine
from eqsim.numerics.streams import Key
from eqsim.numerics.streams import key as key_of
from eqsim.numerics.tables import Array
from eqsim.numerics.vector_math import log


@routine(inline=True)
def square_of(stiffness: Any, travel: Any, y: Any) -> Any:
    """`Sample.square` of one life, or of many."""
    return stiffness**2 * travel * (y * y + travel * (y + travel / 3.0))


class Sample(NamedTuple):
    """Lives, arrays (n,): work over k, int (k_i/k) x dx from birth to breaking, travel,
    k_i/k at birth and stretch at birth."""

    work: Array
    travel: Array
    stiffness: Array
    birth: Array

    @property
    def square(self) -> Array:
        """int (k_i x/k)^2 dx from birth to breaking, of contacts whose stiffness does
        not change."""
        with np.errstate(over="ignore"):  # of laws so broad that it is not finite
            return square_of(self.stiffness, self.travel, self.birth)


class Source(NamedTuple):
    """Where the random numbers of paths come from, contacts from `first` on; and the
    accuracy of their steps."""

    key: Key
    first: int
    step: float


def typical_lives(c: Contacts) -> Sample:
    """64 x 64 lives, at mid-points of equal shares of thresholds and of clocks, and
    births in between: a rough picture that costs nothing; of 16 x 16 where thresholds
    fluctuate and lives cost something."""
    u, v = typical_uniforms(c)
    return lives(c, Source(key_of(0, 0), 0, langevin.STEP), u, v)


def typical_uniforms(c: Contacts) -> tuple[Array, Array]:
    """The uniforms of `typical_lives`."""
    shares = 16 if c.aging.fluctuates else 64
    share = (np.arange(shares) + 0.5) / shares
    u, v = (grid.ravel() for grid in np.meshgrid(share, share))
    return u, v


def spread(n: int) -> Array:
    """Numbers spread evenly over (0, 1), in an order of no pattern: a Kronecker
    sequence."""
    return (0.5 + 0.6180339887498949 * np.arange(n)) % 1.0


@functools.lru_cache(maxsize=32)
def rough_stretch(ensemble: Ensemble, velocity: float) -> float | None:
    """The mean stretch at breaking C (length) of annealed contacts that age, to a few
    per cent, from `typical_lives` whose births have aged accordingly; None for all
    others, whose births do not depend on it."""
    if not ensemble.self_consistent:
        return None

    def next_one(log_stretch: float) -> float:
        c = contacts(ensemble, velocity, math.exp(log_stretch))
        return math.log(
            float(typical_lives(c).travel.mean()) * ensemble.thresholds.scale
        )

    found = optimize.fixed_point(
        next_one, math.log(ensemble.thresholds.mean), xtol=1e-3, maxiter=100
    )
    return math.exp(float(found))


def lives(
    c: Contacts, source: Source, u: Array, v: Array, birth: Array | None = None
) -> Sample:
    """Lives from uniforms `u` (threshold), `v` (clock) and `birth` (`spread` evenly
    unless given), shape (n,). Paths of fluctuating thresholds are those of the contacts
    of `source`."""
    sample = Sample(
        np.empty(u.size), np.empty(u.size), np.empty(u.size), np.zeros(u.size)
    )
    if isinstance(c.newborn, Stretched):
        fill_stretched(c, u, v, spread(u.size) if birth is None else birth, sample)
    else:
        fill_lives(c, source, u, v, sample, _scratch(c, source, sample))
    return sample


class _Paths(NamedTuple):
    """Scratch of lives whose thresholds fluctuate."""

    paths: langevin.Paths
    walkers: langevin.Walkers


def _scratch(c: Contacts, source: Source, sample: Sample) -> Lives | _Paths:
    """Scratch of `fill`."""
    if not c.aging.fluctuates:
        return Lives.empty(c, rounds=1)
    n = sample.travel.size
    contact, number = source.first + np.arange(n), np.zeros(n, np.int64)
    paths = langevin.Paths(
        contact, number, np.empty(n), np.empty(n), sample.travel, sample.work
    )
    return _Paths(paths, langevin.Walkers.empty())


@kernel
def fill_stretched(
    c: Contacts, u: Array, v: Array, birth: Array, sample: Sample
) -> None:
    """The kernel of `lives` of contacts that are born stretched."""
    for i in range(u.size):
        xi, y = newborn_draw(c.newborn, c.thresholds, u[i], birth[i])
        k = kappa(c.springs, xi)
        s = travel(c, xi, k, y, -math.log(v[i]))
        sample.work[i] = k * s * (y + 0.5 * s)
        sample.travel[i] = s
        sample.stiffness[i] = k
        sample.birth[i] = y


@kernel
def fill_lives(
    c: Contacts, source: Source, u: Array, v: Array, sample: Sample, scratch: Any
) -> None:
    """The kernel of `lives` of others."""
    fill(c.aging, c, source, u, v, sample, scratch)


@by_law
def fill(
    law: Any,
    c: Contacts,
    source: Source,
    u: Array,
    v: Array,
    sample: Sample,
    scratch: Any,
) -> None:
    """Fill a sample, LANES lives at a time."""
    r = np.int64(0)  # typed: a literal 0 would be compiled for itself
    rank, clock = scratch.rank, scratch.clock
    for first in range(0, u.size, LANES):
        count = min(LANES, u.size - first)
        for i in range(count):
            rank[i] = u[first + i]
            clock[r, i] = -log(v[first + i])
        draw_thresholds(c.thresholds, rank, scratch, r, count)
        break_lives(law, c, scratch, r, count)
        for i in range(count):
            sample.travel[first + i] = scratch.travel[r, i]
            sample.stiffness[first + i] = scratch.stiffness[r, i]
            sample.work[first + i] = life_work(law, c, scratch, r, i)


@fill.register(Langevin)
def _fill_paths(
    law: Langevin,
    c: Contacts,
    source: Source,
    u: Array,
    v: Array,
    sample: Sample,
    scratch: Any,
) -> None:
    threshold, clock = scratch.paths.threshold, scratch.paths.clock
    for i in range(u.size):
        threshold[i] = threshold_draw(c.thresholds, u[i])
        clock[i] = -log(v[i])
        sample.stiffness[i] = c.springs.constant
    langevin.walk_all(
        langevin.pinned(c), source.key, source.step, scratch.paths, scratch.walkers
    )
