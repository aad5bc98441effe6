"""Lives from given uniforms, for steady estimates, predictions and errors from the
law."""

import functools
import math
from typing import Any, NamedTuple

import numpy as np
from scipy import optimize

from eqsim.engine import langevin
from eqsim.engine.contacts import Contacts, contacts
from eqsim.engine.lanes import LANES, Lives, draw_thresholds, life_work
from eqsim.laws.aging.base import break_lives
from eqsim.laws.barrier.base import travel
from eqsim.laws.newborn import Stretched, newborn_draw
from eqsim.laws.stiffness import kappa
from eqsim.laws.threshold import threshold_draw
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.compiled import kernel, routine
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
    """Random numbers of paths, those of contacts from `first` on, and the accuracy
    `step` of their steps."""

    key: Key
    first: int
    step: float


def typical_lives(c: Contacts) -> Sample:
    """64 x 64 lives, at mid-points of equal shares of thresholds and of clocks, and
    births in between: rough, but fast; 16 x 16 where thresholds fluctuate and lives
    take long."""
    return unnamed_lives(c, *typical_uniforms(c))


def typical_uniforms(c: Contacts) -> tuple[Array, Array]:
    """The uniforms of `typical_lives`."""
    shares = 16 if c.aging.fluctuates else 64
    u, v = np.meshgrid(*2 * [(np.arange(shares) + 0.5) / shares])
    return u.ravel(), v.ravel()


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

    def again(log_stretch: float) -> float:
        c = contacts(ensemble, velocity, math.exp(log_stretch))
        mean = float(typical_lives(c).travel.mean())
        return math.log(mean * ensemble.thresholds.scale)

    begin = math.log(ensemble.thresholds.mean)
    found = optimize.fixed_point(again, begin, xtol=1e-3, maxiter=100)
    return math.exp(float(found))


def unnamed_lives(c: Contacts, u: Array, v: Array) -> Sample:
    """`lives` with a fixed key: paths of fluctuating thresholds do not depend on a
    seed."""
    return lives(c, Source(key_of(0, 0), 0, langevin.STEP), u, v)


def lives(
    c: Contacts, source: Source, u: Array, v: Array, birth: Array | None = None
) -> Sample:
    """Lives from uniforms `u` (threshold), `v` (clock) and `birth` (`spread` evenly
    unless given), shape (n,). Paths of fluctuating thresholds are those of the contacts
    of `source`."""
    n = u.size
    sample = Sample(np.empty(n), np.empty(n), np.empty(n), np.zeros(n))
    if isinstance(c.newborn, Stretched):
        fill_stretched(c, u, v, spread(n) if birth is None else birth, sample)
    elif c.aging.fluctuates:
        sample.stiffness[:] = c.springs.constant
        contact, number = source.first + np.arange(n), np.zeros(n, np.int64)
        begins = contact, number, np.empty(n), np.empty(n)
        paths = langevin.Paths(*begins, sample.travel, sample.work)
        fill_paths(c, source, u, v, paths, langevin.Walkers.empty())
    else:
        fill_lives(c, u, v, sample, Lives.empty(c, rounds=1))
    return sample


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
def fill_lives(c: Contacts, u: Array, v: Array, sample: Sample, scratch: Lives) -> None:
    """The kernel of `lives` of others, LANES at a time."""
    r = np.int64(0)  # typed: a literal 0 would be compiled for itself
    rank, clock = scratch.rank, scratch.clock
    for first in range(0, u.size, LANES):
        count = min(LANES, u.size - first)
        for i in range(count):
            rank[i] = u[first + i]
            clock[r, i] = -log(v[first + i])
        draw_thresholds(c.thresholds, rank, scratch, r, count)
        break_lives(c.aging, c, scratch, r, count)
        for i in range(count):
            sample.travel[first + i] = scratch.travel[r, i]
            sample.stiffness[first + i] = scratch.stiffness[r, i]
            sample.work[first + i] = life_work(c.aging, c, scratch, r, i)


@kernel
def fill_paths(
    c: Contacts,
    source: Source,
    u: Array,
    v: Array,
    paths: langevin.Paths,
    walkers: langevin.Walkers,
) -> None:
    """The kernel of `lives` of thresholds that fluctuate."""
    for i in range(u.size):
        paths.threshold[i] = threshold_draw(c.thresholds, u[i])
        paths.clock[i] = -log(v[i])
    laws = langevin.pinned(c, 1.0)
    langevin.walk_all(laws, source.key, source.step, paths, walkers)
