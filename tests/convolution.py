"""A plain solution of the renewal equation: lives on a lattice, and a convolution.

Nothing here is shared with eqsim's solvers. Survival of a travel is summed by brute
force from the survival function of the law of thresholds. Each life is then moved to
the two lattice points next to it, with the shares that keep its mean length, so that
the lattice is of second order in its spacing, and exact for thresholds and delays that
lie on it. Breaks and births are sums of such lives; the series is inverted by Newton's
method for power series.

Units: the threshold law's length. b = k/(2 kT) and the attempts are per unit
displacement, omega/v.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage, special
from scipy.signal import fftconvolve

_GAUSS = np.polynomial.legendre.leggauss(6)
# Cells of thresholds beyond the lattice in each e-fold, up to where a share of 1e-13 is
# stronger.
_MOST = 4000


@dataclass(frozen=True)
class Contacts:
    """Contacts born unstretched, as the lattice needs them.

    Attributes
    ----------
    law : object
        With `sf`, `mean`, `rms` and `inverse_survival`, and `steps` (the equally likely
        thresholds of a discrete law).
    b, attempts : float
        k/(2 kT) (1/length^2) and omega/v (1/length); heat breaks none if `attempts` is
        0.
    delay : float
        Mean displacement while detached; `random`: exponential, else always the same.
    drag : float
        Force of a detached contact, eta v/k (length).
    """

    law: Any
    stiffness: str = "uniform"
    b: float = 0.0
    attempts: float = 0.0
    barrier: str = "soft"
    annealed: bool = False
    delay: float = 0.0
    random: bool = False
    drag: float = 0.0


class Means(NamedTuple):
    """Force <F>/(N k) and pinned share at displacements X, and how far they may be from
    the truth."""

    X: np.ndarray
    force: np.ndarray
    pinned: np.ndarray
    force_error: np.ndarray
    pinned_error: np.ndarray


class _Lives(NamedTuple):
    """At lattice points: the mean force m of a life, at a jump that of both sides, and
    int_0^x S dx."""

    force: np.ndarray
    travel: np.ndarray


def passed(c: Contacts, x, xi, kappa):
    """(omega/v) int_0^x of the rate of breaking, x < xi."""
    a = c.b * kappa
    if c.barrier == "soft":  # rate exp(-a (xi^2 - y^2))
        root = np.sqrt(a)
        return c.attempts * special.dawsn(root * x) * np.exp(-a * (xi**2 - x**2)) / root
    # rate q^(1/2) exp(-a xi^2 q^(3/2)), q = 1 - y/xi
    height = a * xi**2
    rest = np.exp(-height * np.maximum(1.0 - x / xi, 0.0) ** 1.5) - np.exp(-height)
    return c.attempts * rest / (1.5 * a * xi)


def rate(c: Contacts, x, xi, kappa):
    """The rate of breaking per unit displacement."""
    a = c.b * kappa
    if c.barrier == "soft":
        return c.attempts * np.exp(-a * (xi**2 - x**2))
    q = np.maximum(1.0 - x / xi, 0.0)
    return c.attempts * np.sqrt(q) * np.exp(-a * xi**2 * q**1.5)


def _classes(c: Contacts, x):
    """Thresholds and their shares: those of a discrete law, or cells that end at `x`,
    and beyond."""
    if c.law.steps.size:
        xi, counts = np.unique(c.law.steps, return_counts=True)
        return xi, counts / counts.sum()
    top = max(float(c.law.inverse_survival(30.0)), 1.01 * x[-1])
    decades = np.log(top / x[-1])
    beyond = x[-1] * np.exp(
        np.linspace(0.0, decades, int(decades * min(x.size, _MOST)) + 2)
    )
    edges = np.append(x, beyond[1:])
    return 0.5 * (edges[1:] + edges[:-1]), -np.diff(c.law.sf(edges))


def _means_at(c: Contacts, x):
    """S and E[kappa; pinned] at ascending x from 0, means of the limits from the left
    and from the right."""
    stiff = (lambda xi: xi / c.law.rms) if c.stiffness == "sqrt" else np.ones_like
    if not c.attempts and c.law.steps.size == 0:
        survive = c.law.sf(x)
        if c.stiffness == "uniform":
            return survive, survive
        half = 0.5 * np.diff(x)[:, None]  # E[xi; xi > x] = x sf(x) + int_x^inf sf
        cells = (
            c.law.sf(x[:-1, None] + half * (1.0 + _GAUSS[0])) * _GAUSS[1] * half
        ).sum(axis=1)
        return survive, (
            x * survive + c.law.mean - np.append(0.0, np.cumsum(cells))
        ) / c.law.rms
    xi, share = _classes(c, x)
    use = share > 0.0
    xi, share = xi[use], share[use]
    kappa = stiff(xi)
    survive, weighed, pooled = np.zeros(x.size), np.zeros(x.size), np.zeros(x.size)
    for start in range(0, xi.size, 256):
        part = slice(start, start + 256)
        y, own, k, weight = (
            np.minimum(x[:, None], xi[part]),
            xi[part],
            kappa[part],
            share[part],
        )
        # a threshold on the lattice counts half there
        above = np.where(
            np.isclose(x[:, None], own, rtol=1e-12, atol=0.0), 0.5, x[:, None] < own
        )
        if c.annealed:
            alive = above
            pooled += (
                np.where(
                    x[:, None] <= own, passed(c, y, own, k), passed(c, own, own, k)
                )
                @ weight
            )
        else:
            alive = above * (np.exp(-passed(c, y, own, k)) if c.attempts else 1.0)
        survive += alive @ weight
        weighed += alive @ (weight * k)
    return np.exp(-pooled) * survive, np.exp(-pooled) * weighed


def _lives(c: Contacts, h: float, cells: int) -> _Lives:
    x = 0.5 * h * np.arange(2 * cells + 1)
    survive, stiff = _means_at(c, x)
    if not c.attempts and c.law.steps.size == 0:
        inner = x[:-2:2, None] + 0.5 * h * (1.0 + _GAUSS[0])
        travel = (c.law.sf(inner) * _GAUSS[1] * 0.5 * h).sum(axis=1)
    elif c.law.steps.size:
        # Gauss nodes between lattice points, on which jumps are
        inner = (x[:-2:2, None] + 0.5 * h * (1.0 + _GAUSS[0])).ravel()
        travel = _means_at(c, inner)[0].reshape(-1, _GAUSS[0].size) @ (
            _GAUSS[1] * 0.5 * h
        )
    else:
        travel = h * (survive[:-2:2] + 4.0 * survive[1::2] + survive[2::2]) / 6.0
    return _Lives((x * stiff)[::2], np.append(0.0, np.cumsum(travel)))


def _masses(travel, h):
    """Shares of lattice points, that keep the mean, of a life with int_0^x S dx =
    `travel` there."""
    late = h * np.arange(travel.size) - travel  # E[(x - life)+]
    bend = np.append(np.diff(late, 2), np.nan) / h
    return np.append(late[1] / h, bend)


def _inverse(series):
    """1/series of power series with a first coefficient that is not 0."""
    found = np.array([1.0 / series[0]])
    while found.size < series.size:
        size = min(2 * found.size, series.size)
        rest = -fftconvolve(series[:size], found)[:size]
        rest[0] += 2.0
        found = fftconvolve(found, rest)[:size]
    return found


def _solved(c: Contacts, h: float, cells: int) -> tuple[np.ndarray, np.ndarray]:
    """Force and pinned share at lattice points."""
    lives = _lives(c, h, cells + 1)
    life = _masses(lives.travel, h)[: cells + 1]
    x = h * np.arange(cells + 2)
    if c.random:
        wait = _masses(c.delay * -np.expm1(-x / c.delay), h)[: cells + 1]
        late = np.exp(-x / c.delay)[: cells + 1]  # still detached
        late[0] = 0.5
    else:
        wait = np.zeros(cells + 1)
        at = round(c.delay / h)
        assert abs(at * h - c.delay) < 1e-9 * h, "the delay has to be on the lattice"
        wait[at : at + 1] = 1.0
        late = np.where(np.arange(cells + 1) < at, 1.0, 0.0)
        late[[0, at]] = 0.5 if at else 0.0  # the mean of both sides of a jump
    cycle = fftconvolve(life, wait)[: cells + 1]
    # all births, the first ones at 0 included
    again = _inverse(np.append(1.0 - cycle[0], -cycle[1:]))
    breaks = fftconvolve(again, life)[: cells + 1]
    detached = fftconvolve(breaks, late)[: cells + 1]
    force = fftconvolve(again, lives.force[: cells + 1])[: cells + 1]
    return force + c.drag * detached, 1.0 - detached


def means(c: Contacts, h: float, cells: int) -> Means:
    """Means at 0, h, 2 h, ... of a lattice of spacing h/2.

    Four times what that of spacing h differs by nearby is quoted as their error: twelve
    times the error where the lattice is of second order, four times that where it is of
    first, at jumps and kinks, and 1.3 times that of order 0.4, where densities of the
    power -0.6 are infinite.

    Where forces jump on the lattice it is the mean of both sides.
    """
    coarse, fine = (
        _solved(c, h, cells),
        [part[::2] for part in _solved(c, 0.5 * h, 2 * cells)],
    )
    rough = 1e-12 * cells**0.5
    apart = [np.abs(a - b) for a, b in zip(coarse, fine, strict=True)]
    # the difference may vanish by chance where the error does not
    errors = [
        4.0 * ndimage.maximum_filter1d(part, max(cells // 100, 1)) + rough
        for part in apart
    ]
    return Means(h * np.arange(cells + 1), *fine, *errors)
