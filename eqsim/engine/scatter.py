"""Scatter of forces from the law of the contacts: error bars that few contacts cannot
supply.

The sample variance of few contacts, or of a rare kind among many, lacks what the sample
did not meet, and is smallest just where the mean is too low. But the law is known, and
with it the moments of the force f of a contact at X. From lives, each with a
probability, from the law (`births`), with the work they do over k, int_0^{x_b} (k_i/k)
x dx, that is with an average k_i/k where it follows an aging threshold:

    stationary    E f^p = E[int_y^{x_b} (k_i x/k)^p dx] / (E[l] + v<tau>)                         (p = 0: pinned)
    fresh         E f^p = int_0^X B(Y) m_p(X - Y) dY,   m_p(s) = E[(k_i (y + s)/k)^p; l > s],   B = delta + B * g

(derived) and (eta v/k)^p for detached contacts, with y the stretch at birth and l = x_b
- y the travel, B the density of births, that at X = 0 included, and g the law of l + v
tau. On a lattice of displacements B is the power series of 1/(1 - g). Births are shared
between the two nearest nodes, so that the mean life is kept; forces are averaged over
the cells in between. However coarse the lattice, the stationary values are exact; the
transient is good to a few per cent where a cell is a fraction of a life.

This serves error bars only: forces come from the contacts that were simulated.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy import special

from eqsim.engine.contacts import Contacts
from eqsim.engine.sample import spread, unnamed_lives
from eqsim.numerics.tables import Array

_LATTICE = 1024  # cells
# cells of the finer lattice in the mean life that a snapshot finds
_CELLS_IN_A_LIFE = 32
# Stands for an infinite delay: pinned shares of its inverse, cubed, do not underflow.
ENDLESS = 1e50
_FORCE_POWERS = 7  # of forces: 0 to 6
_LOG_RANKS = -16.0, 45.0
_PATHS = 2**12  # of thresholds that fluctuate
_LAW_TOLERANCE = 0.05  # relative error of the law's variance, by lattice and lives
# a force is reliable if it is off by five standard errors with a smaller probability
RARE = 1e-4
ENOUGH = 100  # least effective number of lives for errors of a mean to be normal


class Births(NamedTuple):
    """Lives from the law: their shares, mean k_i/k, travel and stretch at birth."""

    share: Array
    stiffness: Array
    travel: Array
    birth: Array


def births(c: Contacts) -> Births:
    """Lives on a grid of thresholds and clocks, each ln(1 + exp(s)) by the trapezoidal
    rule in s: of even relative spacing where they are small, even where they are large,
    up to 45: beyond, contacts are too rare to matter. The clocks of different
    thresholds lie between each other."""
    if c.aging.fluctuates:  # a path for each threshold
        u, share = _uniforms(np.linspace(*_LOG_RANKS, _PATHS))
        v = spread(_PATHS)
    else:
        # lives that age take long
        rows, clocks = (500, 70) if c.aging.closed else (150, 30)
        u, share = _uniforms(np.linspace(*_LOG_RANKS, rows))
        steps = c.thresholds.steps.size
        if 0 < steps <= rows:
            rows = steps * math.ceil(rows / steps)
            u, share = (np.arange(rows) + 0.5) / rows, np.full(rows, 1.0 / rows)
        v = np.ones(rows)
        if c.barrier.thermal:
            s, spacing = np.linspace(*_LOG_RANKS, clocks, retstep=True)
            v, clock_share = _uniforms(s + spacing * (spread(rows)[:, None] - 0.5))
            u, v = np.repeat(u, clocks), v.ravel()
            share = (share[:, None] * clock_share).ravel()
    found = unnamed_lives(c, u, v)
    stiffness = found.stiffness
    if not found.birth.any():  # the mean along a life, in which it may change
        stiffness = 2.0 * found.work / found.travel**2
    return Births(share, stiffness, found.travel, found.birth)


def _uniforms(s: Array) -> tuple[Array, Array]:
    """exp(-ln(1 + exp(s))), and its share in each row."""
    share = special.expit(s) * special.expit(-s)
    return special.expit(-s), share / share.sum(axis=-1, keepdims=True)


class Scatter(NamedTuple):
    """Moments of the force of a contact at the nodes `X`, in the units of
    `Contacts`."""

    X: Array
    mean: Array
    pinned: Array  # fraction
    variance: Array
    fourth: Array  # central moment
    sixth: Array  # central moment
    one: Array  # mean square force if pinned, or if detached where drag makes it larger
    most: Array  # largest square of the force with k_i = k
    lives: float  # number of random lives that would be as accurate

    def at(self, X: Array) -> "Scatter":
        """The same at other displacements."""
        at_nodes = {name: getattr(self, name) for name in self._fields[1:-1]}
        values = {name: np.interp(X, self.X, y) for name, y in at_nodes.items()}
        return self._replace(X=X, **values)


def scatter(c: Contacts, born: Births, distance: float | None, drag: float) -> Scatter:
    """Moments of forces from a fresh start over a distance, or (None) in the stationary
    state."""
    if distance is None:
        X, moments = np.zeros(1), _stationary(c, born)[:, None]
    else:
        time = np.sum(born.share * born.travel)
        size = float(np.sum(born.share * born.travel**2) / time)
        X, moments = _fresh(c, born, min(size / _CELLS_IN_A_LIFE, distance / _LATTICE))
        if X[-1] < distance:
            further, later = _fresh(c, born, distance / _LATTICE)
            beyond = further > X[-1]
            X = np.append(X, further[beyond])
            moments = np.hstack((moments, later[:, beyond]))
    pinned = np.minimum(moments[0], 1.0)
    with np.errstate(all="ignore"):  # of laws so broad that their moments overflow
        one = np.where(pinned > 0, moments[2] / pinned, 0.0)
        if c.delay.mean > 0:
            one = np.maximum(one, drag**2)
            powers = drag ** np.arange(len(moments))[:, None]
            moments = moments + (1.0 - pinned) * powers
        moments[0] = 1.0
        mean = moments[1]

        def central(p: int) -> Array:
            about = (math.comb(p, j) * (-mean) ** (p - j) for j in range(p + 1))
            return np.maximum(sum(map(np.multiply, about, moments)), 0.0)

        variance, fourth, sixth = central(2), central(4), central(6)
    lives = math.inf  # by quadrature
    if c.aging.fluctuates:
        lives = 1.0 / float(np.sum(born.share**2))
    most = np.full(1, math.inf)
    if distance is not None:
        most = np.maximum(X + float(np.abs(born.birth).max()), drag) ** 2
    return Scatter(X, mean, pinned, variance, fourth, sixth, one, most, lives)


def _stationary(c: Contacts, born: Births) -> Array:
    """E f^p of pinned contacts, p = 0, 1, ..., times the pinned fraction."""
    cycle = np.sum(born.share * born.travel) + min(c.delay.mean, ENDLESS)
    reached = born.birth + born.travel
    ends, begins, moments = born.share * reached, born.share * born.birth, []
    with np.errstate(over="ignore", invalid="ignore"):
        for p in range(_FORCE_POWERS):
            moments.append(np.sum(ends - begins) / ((p + 1) * cycle))
            ends *= born.stiffness * reached
            begins *= born.stiffness * born.birth
    return np.array(moments)


def _births_after(renewals: Array) -> Array:
    """Births in each cell, shape (n,), from one in the first; `renewals` is the share
    of it that is born again in each cell. `scipy.signal.lfilter` gives the same, but
    its import takes as long as 500 calls."""
    first, later = renewals[0], -renewals[1:] / (1.0 - renewals[0])
    found, pending = np.empty(renewals.size), np.zeros(renewals.size)
    pending[0] = 1.0 / (1.0 - first)
    for k in range(renewals.size):
        found[k] = pending[0]
        pending[:-1] = pending[1:] - found[k] * later
    return found


def _fresh(c: Contacts, born: Births, step: float) -> tuple[Array, Array]:
    """X = 0 and the middle of each cell of a lattice, and E f^p of pinned contacts
    there, shape (p, X)."""
    n = _LATTICE
    edges = step * np.arange(n + 1)
    at = np.minimum(born.travel / step, n)
    cell = at.astype(np.int64)
    ends = np.bincount(cell, born.share * (1.0 - at + cell), n + 2)
    ends[1:] += np.bincount(cell, born.share * (at - cell), n + 1)
    # a delay T is shared likewise: second differences of E[(T - x)+]
    rest = c.delay.law.rest(edges)
    waits = np.append(1.0 + (rest[1] - rest[0]) / step, np.diff(rest, 2) / step)
    density = _births_after(np.convolve(ends, waits)[:n])
    moments = np.zeros((_FORCE_POWERS, n + 1))
    moments[0, 0] = 1.0
    stretched = born.birth.any()
    with np.errstate(over="ignore", invalid="ignore"):
        for p in range(len(moments)):
            within, strong = np.zeros(n), born.stiffness**p
            for q in range(p + 1) if stretched else (p,):  # (y + s)^p in powers q of s
                strength = math.comb(p, q) * born.share * strong * born.birth ** (p - q)
                ending = np.bincount(cell, strength, n + 1)
                lasting = np.cumsum(ending[::-1])[-2::-1]  # lives that outlast the cell
                power = edges ** (q + 1)
                whole = np.bincount(cell, strength * born.travel ** (q + 1), n + 1)
                carried = (whole - ending * power)[:-1]
                within += (carried + lasting * np.diff(power)) / (q + 1)
            moments[p, 1:] = np.convolve(density, within)[:n] / step
        for p in range(1, len(moments)):
            moments[p, 0] = np.sum(born.share * (born.stiffness * born.birth) ** p)
    return np.append(0.0, edges[:-1] + 0.5 * step), moments


def pinned_variance(pinned: Array, contacts: int, delayed: bool) -> Array:
    """Variance of the pinned fraction of `contacts` contacts, any shape. A sample does
    not tell what fewer than about two of them do (Agresti and Coull, 1998): without
    these two an error bar would vanish wherever none happens to be pinned, or all
    are."""
    unseen = (2.0 / contacts) ** 2 if delayed else 0.0
    return pinned * (1.0 - pinned) / contacts + unseen


def unmet_force(variance: Array, force: Array, contacts: int) -> Array:
    """Change of the mean force of `contacts` contacts by one of them that breaks, of
    root mean square force. `variance` is that of the mean, any shape. A sample in which
    no such contact broke has no scatter, and tells its mean to no more than this."""
    return np.asarray(np.sqrt(variance * contacts + force**2) / contacts)


def known_variance(
    law: Scatter, level: Scatter, sample: Array, contacts: int
) -> tuple[Array, Array]:
    """Variance of the mean force of `contacts` contacts whose forces scatter with
    variance `sample`, and a bound on the probability that the mean is off by more than
    five times its root; `level` is the stationary state.

    The sample variance has a relative variance of K/N, K = E(f - Ef)^4/Var^2 large
    where few contacts make the force (derived), and so has the law's, N being its
    `lives`, besides 5 %; they are weighted accordingly. N/K contacts of size s, s^2 = K
    Var, would have the same moments. Where fewer than one is expected, one stands for
    those that are not met (as pseudo-counts do in Agresti and Coull, 1998), s being at
    most twice the stationary root mean square force of a pinned contact, and just that
    where the law's lives, too, may have met none of them; it is never more than twice
    what there can be. The bound is Markov's for sixth powers, of the large deviations
    that single contacts make: N E(f - Ef)^6/(5 N error)^6.
    """
    with np.errstate(all="ignore"):
        doubt = law.fourth / law.variance / contacts
        noise = 1.0 + _LAW_TOLERANCE**2 * law.variance / doubt + contacts / law.lives
        share = np.nan_to_num(1.0 / noise)
        size: Array | float = math.inf
        if law.lives == math.inf:
            size = np.nan_to_num(contacts * doubt, nan=0.0, posinf=math.inf)
        one = np.minimum(size, 4.0 * np.minimum(level.one, law.most))
        unmet = np.nan_to_num(one / (1.0 + contacts * law.variance / one))
        sampled = np.zeros_like(sample)
        if contacts > 1:
            sampled = sample * contacts / (contacts - 1)
        mixed = share * law.variance + (1.0 - share) * sampled
        variance = (mixed + unmet / contacts) / contacts
        rare = law.sixth / contacts**5 / (25.0 * variance) ** 3
        rare = np.where(law.sixth > 0, rare, 0.0)
    return variance, np.where(rare < 1.0, rare, 1.0)
