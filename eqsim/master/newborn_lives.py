"""Survivors of a travel l from birth, of contacts born stretched (derived).

A contact born at y with threshold xi is there after a travel l with the chance
exp(-(Lambda(y + l) - Lambda(y))) while y + l < xi. Differences of Lambda are written
from the upper end, so that nothing cancels however short l is. Means are by
Gauss-Legendre panels over births, which end where lives of contacts born there change
their character at this travel, and over thresholds as in `master.quenched`.
"""

import functools
import math

import numpy as np
from scipy import special

from eqsim.laws.barrier.soft import Soft
from eqsim.laws.newborn import BirthLaw, DeltaBirths, ExponentialBirths, NormalBirths
from eqsim.laws.threshold import ThresholdLaw
from eqsim.master.newborn import (
    births_of,
    marks,
    pooled_polynomials,
    rank,
    stiffness_of_survivors,
)
from eqsim.master.quenched import different_steps, kappa_of, rarest_that_counts
from eqsim.model.reduced import Reduced
from eqsim.numerics.tables import Array

_NODES, _WEIGHTS = special.roots_legendre(8)
_SHORT, _SHORT_WEIGHTS = special.roots_legendre(10)
_SHORTER, _SHORTER_WEIGHTS = special.roots_legendre(4)
_COMMON = 45.0  # -ln J_c, beyond what usually counts, that force variances of heavy tails count
_OF_BIRTHS, _WEIGHTS_OF_BIRTHS = special.roots_legendre(8)
_LEVELS = np.array([-16.0, -8.0, -4.0, -2.0, -0.75, 0.25, 1.0, 1.75, 2.5, 3.25, 4.0])
_SHARES = np.array(
    [
        1e-6,
        1e-4,
        2e-3,
        0.01,
        0.05,
        0.15,
        0.4,
        0.8,
        1.5,
        2.5,
        4.0,
        6.0,
        9.0,
        13.0,
        18.0,
        25.0,
        35.0,
    ]
)
# -ln J_c of the strongest contact that is asked for.
_RAREST = 510.0
# ln(xi/left - 1) from where levels are sought, on a grid of so many.
_SHALLOWEST = -30.0
_GRID = 32
# Births that are followed at once, to bound memory.
_AT_ONCE = 1000
# Weight of births that do not count.
_NEGLIGIBLE = 1e-13
_TOP = np.array(
    [1e-4, 0.03, 0.1, 0.25, 0.5, 0.8, 1.2, 1.7, 2.3, 3.0, 4.0, 6.0, 10.0, 30.0]
)
_POWERS = np.arange(3)[:, None]


def passed(contacts: Reduced, y: Array, travel: Array, xi: Array) -> Array:
    """Lambda(y + travel) - Lambda(y) of contacts of thresholds xi, arrays that
    broadcast."""
    if not contacts.barrier.thermal:
        return 0.0 * (y + travel + xi)
    x = y + travel
    before, after = (
        np.minimum(travel, np.maximum(-y, 0.0)),
        np.minimum(travel, np.maximum(x, 0.0)),
    )
    down = _up_to(contacts, np.maximum(-y, 0.0), before, xi)
    return np.where(before > 0, down, 0.0) + np.where(
        after > 0, _up_to(contacts, np.maximum(x, 0.0), after, xi), 0.0
    )


def _up_to(contacts: Reduced, x: Array, way: Array, xi: Array) -> Array:
    """Lambda(x) - Lambda(x - way), 0 <= way <= x."""
    if contacts.annealed:
        return _pooled_up_to(contacts, x, way)
    barrier, kappa = contacts.barrier, kappa_of(contacts, xi)
    gap, a = np.maximum(xi - x, 0.0), barrier.b * kappa
    if isinstance(barrier, Soft):
        root = np.sqrt(a)
        z, way = root * x, root * way
        less = way * (2.0 * z - way)
        far = special.dawsn(z) - np.exp(-less) * special.dawsn(z - way)
        near = np.zeros_like(less)
        small = less < 1.0
        w, top = (
            np.broadcast_to(way, less.shape)[small],
            np.broadcast_to(z, less.shape)[small],
        )
        t = 0.5 * w[:, None] * (1.0 + _SHORT)
        near[small] = (np.exp(-t * (2.0 * top[:, None] - t)) @ _SHORT_WEIGHTS) * 0.5 * w
        return (
            np.exp(np.minimum(barrier.log_w - a * gap * (xi + x), 300.0))
            * np.where(small, near, far)
            / root
        )
    c, q, step = a * xi**2, gap / xi, way / xi
    lower = q + step
    with np.errstate(divide="ignore", invalid="ignore"):
        rise = np.where(
            step > 0, step * (lower**2 + lower * q + q**2) / (lower**1.5 + q**1.5), 0.0
        )
    size = np.exp(np.minimum(barrier.log_w - c * q**1.5, 300.0)) / (1.5 * a * xi)
    return np.asarray(-np.expm1(-c * rise) * size)


def _pooled_up_to(contacts: Reduced, x: Array, way: Array) -> Array:
    rate = pooled_polynomials(contacts)
    x, way = np.broadcast_arrays(x, way)
    found = rate.integral(x) - rate.integral(x - way)
    short = (way > 0) & (way < 0.01 * x)
    t = x[short][:, None] - 0.5 * way[short][:, None] * (1.0 + _SHORTER)
    found[short] = (rate(t) @ _SHORTER_WEIGHTS) * 0.5 * way[short]
    return np.asarray(found)


def survivors(contacts: Reduced, travel: Array) -> Array:
    """Moments of contacts that outlast a travel > 0, shape (n,): E[x^i kappa^j; l >
    travel], x = y + travel, i and j from 0 to 2, shape (3, 3, n)."""
    births = births_of(contacts)
    if isinstance(births, DeltaBirths):
        return _born_at(contacts, np.full(travel.size, births.stretch), travel)
    found = np.zeros((3, 3, travel.size))
    edges = _births_at(contacts, travel)
    half = 0.5 * np.diff(edges, axis=1)[:, :, None]
    y = edges[:, :-1, None] + half * (1.0 + _OF_BIRTHS)
    weights = half * _WEIGHTS_OF_BIRTHS * births.pdf(y)
    row, *_ = where = np.nonzero(weights > _NEGLIGIBLE)
    weights, y = weights[where], y[where]
    for start in range(0, y.size, _AT_ONCE):
        part = slice(start, start + _AT_ONCE)
        values = (
            _born_at(contacts, y[part], travel[row[part]]) * weights[part]
        ).reshape(9, -1)
        found += np.array(
            [np.bincount(row[part], value, travel.size) for value in values]
        ).reshape(found.shape)
    return found


def _parts(births: BirthLaw) -> Array:
    """Where panels of births end at any travel."""
    if isinstance(births, ExponentialBirths):
        return births.mean * np.array([0.0, 0.5, 2.0, 5.0, 11.0, 20.0, 36.0])
    if isinstance(births, NormalBirths):
        return births.mean + births.std * np.array(
            [-8.3, -5.0, -2.5, 0.0, 2.5, 5.0, 8.3]
        )
    return np.linspace(births.range[0], births.range[1], 5)


def _births_at(contacts: Reduced, travel: Array) -> Array:
    """Edges of panels over births, shape (n, any), for each travel."""
    births, law = births_of(contacts), contacts.law
    low, high = births.range
    at = _parts(births)
    t, fixed = travel[:, None], law.kinks / law.scale
    if contacts.newborn.of == "threshold":
        top = (
            np.empty(0)
            if law.steps.size
            else np.asarray(law.inverse_survival(_TOP)) / law.scale
        )
        moving = [1.0 - t / np.append(top, fixed[fixed > 0]), np.zeros_like(t)]
    else:
        fixed = np.concatenate(([0.0], fixed, -fixed))
        moving = [np.broadcast_to(fixed, (t.size, fixed.size)), fixed - t, -0.5 * t]
    edges = np.concatenate((np.broadcast_to(at, (t.size, at.size)), *moving), axis=1)
    return np.sort(np.clip(edges, low, high), axis=1)


def _born_at(contacts: Reduced, birth: Array, travel: Array) -> Array:
    """`survivors` given the births, fractions or lengths, shape (n,)."""
    if contacts.one_sided:
        return published(contacts, birth, travel)
    of_threshold, law = contacts.newborn.of == "threshold", contacts.law
    if of_threshold:
        least, share = travel / (1.0 - birth), np.ones_like(birth)
    else:
        least, share = (
            np.maximum(np.abs(birth), birth + travel),
            law.sf(np.abs(birth) * law.scale),
        )
    found = np.zeros((3, 3, birth.size))
    if law.steps.size:
        for xi, part, kappa in zip(*different_steps(contacts), strict=True):
            y = birth * xi if of_threshold else birth
            alive = np.where(
                xi > least,
                np.exp(-np.minimum(passed(contacts, y, travel, np.asarray(xi)), 700.0)),
                0.0,
            )
            found += (
                part
                * (y + travel) ** _POWERS[:, None]
                * kappa**_POWERS
                * alive
                / np.maximum(share, 1e-300)
            )
        return found
    for start in range(0, birth.size, _AT_ONCE):
        part = slice(start, start + _AT_ONCE)
        found[:, :, part] = _over_thresholds(
            contacts, birth[part], travel[part], least[part]
        )
    return found / np.maximum(share, 1e-300)


def _over_thresholds(
    contacts: Reduced, birth: Array, travel: Array, least: Array
) -> Array:
    """Means over thresholds above `least` of a smooth law."""
    law, of_threshold = contacts.law, contacts.newborn.of == "threshold"
    e, grid = _ranks(law)
    left = np.maximum(least, law.support[0] / law.scale)[:, None]
    origin = np.interp(left, grid, e)
    shares = np.append(
        _SHARES, np.arange(50.0, rarest_that_counts(contacts.barrier) + _COMMON, 20.0)
    )
    inside = [left, np.interp(np.minimum(origin + shares, _RAREST), e, grid)]
    inside.append(
        np.broadcast_to(law.breakpoints / law.scale, (left.size, law.breakpoints.size))
    )
    if contacts.barrier.thermal and not contacts.annealed:
        inside.append(
            left
            * (
                1.0
                + np.exp(
                    _levels(contacts, birth[:, None], travel[:, None], left, grid[-1])
                )
            )
        )
    top = min(float(grid[-1]), law.support[1] / law.scale)
    edges = np.sort(
        np.minimum(np.maximum(np.concatenate(inside, axis=1), left), top), axis=1
    )
    row, column = np.nonzero(np.diff(edges, axis=1) > 0)
    half = 0.5 * (edges[row, column + 1] - edges[row, column])[:, None]
    xi = edges[row, column, None] + half * (1.0 + _NODES)
    y = birth[row, None] * xi if of_threshold else birth[row, None] + 0.0 * xi
    way = travel[row, None] + 0.0 * xi
    density = law.pdf(xi * law.scale) * law.scale
    terms = (
        half
        * _WEIGHTS
        * density
        * np.exp(-np.minimum(passed(contacts, y, way, xi), 700.0))
    )
    terms = np.where(np.isfinite(terms), terms, 0.0)
    kappa, x = kappa_of(contacts, xi), y + way
    found = np.empty((3, 3, birth.size))
    for i in range(3):
        weighed = terms
        for j in range(3):
            same = j > 0 and contacts.stiffness == "uniform"
            found[i, j] = (
                found[i, 0]
                if same
                else np.bincount(row, weighed.sum(axis=1), birth.size)
            )
            weighed = weighed * kappa
        terms = terms * x
    return found


def _levels(
    contacts: Reduced, birth: Array, travel: Array, left: Array, most: float
) -> Array:
    """ln(xi/left - 1) about where the logarithm of the hazard passed, which falls with
    xi, passes each level, shape (n, levels), between values on a grid."""
    share = np.linspace(0.0, 1.0, _GRID)
    at = _SHALLOWEST + share * (np.log1p(most / left) - _SHALLOWEST)
    xi = left * (1.0 + np.exp(at))
    value = np.log(
        np.maximum(
            passed(
                contacts,
                birth * xi if contacts.newborn.of == "threshold" else birth,
                travel,
                xi,
            ),
            1e-300,
        )
    )
    value = np.minimum.accumulate(value, axis=1)
    above = (value[:, :, None] > _LEVELS).sum(axis=1)
    index = np.clip(above, 1, _GRID - 1)
    high, low = (
        np.take_along_axis(value, index - 1, 1),
        np.take_along_axis(value, index, 1),
    )
    part = np.clip((high - _LEVELS) / np.maximum(high - low, 1e-12), 0.0, 1.0)
    start, end = np.take_along_axis(at, index - 1, 1), np.take_along_axis(at, index, 1)
    return np.asarray(start + part * (end - start))


# A transient asks for it 30 times, and quantiles that SciPy finds numerically may take
# 2 s.
@functools.lru_cache(maxsize=8)
def _ranks(law: ThresholdLaw) -> tuple[Array, Array]:
    """-ln J_c and the thresholds that have it: only panels depend on this table."""
    e = np.exp(np.linspace(-36.0, math.log(_RAREST), 700))
    xi, which = np.unique(
        np.asarray(law.inverse_survival(e)) / law.scale, return_index=True
    )
    return e[which], xi


def published(contacts: Reduced, y: Array, travel: Array) -> Array:
    """J_c(x)/J_c(y) exp(-(Delta U(x) - Delta U(y))), thresholds counting for x > 0 only
    (Q11a)."""
    law, x = contacts.law, y + travel
    up, born = np.maximum(x, 0.0), np.maximum(y, 0.0)
    if law.steps.size:
        xi, share, kappa = different_steps(contacts)
        above = np.searchsorted(xi, up, side="right")
        tails = [
            np.append(np.cumsum((share * kappa**p)[::-1])[::-1], 0.0)[above]
            for p in range(3)
        ]
    else:
        J = law.sf(up * law.scale)
        with np.errstate(divide="ignore", invalid="ignore"):
            tails = [
                J,
                *(
                    np.where(J > 0, J * part, 0.0)
                    for part in stiffness_of_survivors(contacts, up)
                ),
            ]
    hazard = _both_sides(contacts, y, travel) if contacts.barrier.thermal else 0.0
    J_born = np.maximum(law.sf(born * law.scale), 1e-300)
    return np.asarray(
        x ** _POWERS[:, None]
        * np.array(tails)
        / J_born
        * np.exp(-np.minimum(hazard, 700.0))
    )


def _both_sides(contacts: Reduced, y: Array, travel: Array) -> Array:
    """Delta U(y + travel) - Delta U(y), odd."""
    x = y + travel
    before, after = (
        np.minimum(travel, np.maximum(-y, 0.0)),
        np.minimum(travel, np.maximum(x, 0.0)),
    )
    return _pooled_up_to(contacts, np.maximum(-y, 0.0), before) + _pooled_up_to(
        contacts, np.maximum(x, 0.0), after
    )


def kinks(contacts: Reduced) -> Array:
    """Travels at which survival, or its slope, may jump."""
    births, law = births_of(contacts), contacts.law
    at = law.kinks / law.scale
    if contacts.newborn.of == "threshold":
        y = np.array(births.range)
        found = np.outer(1.0 - y, at).ravel()
    else:
        y = marks(births)
        found = np.concatenate(((at - y[:, None]).ravel(), -y, -2.0 * y))
    return np.unique(found[found > 0])


def longest(contacts: Reduced) -> float:
    """A travel that hardly a contact outlasts."""
    births, law = births_of(contacts), contacts.law
    low, high = births.range
    per = 1.0 if contacts.newborn.of == "length" else 0.0
    most = max(abs(low), abs(high)) * per
    rarest = min(
        rarest_that_counts(contacts.barrier) + _COMMON + min(rank(law, most), 470.0),
        _RAREST,
    )
    top = (
        float(law.steps[-1] if law.steps.size else law.inverse_survival(rarest))
        / law.scale
    )
    return top - low if per else top * (1.0 - low)
