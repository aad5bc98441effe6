"""Survivors of a travel l from birth (derived).

A contact born at y with threshold xi is there after a travel l with the chance
exp(-(Lambda(y + l) - Lambda(y))) while y + l < xi, or while l < xi s(l) if thresholds
grow by s(l). Differences of Lambda are written from the upper end, so that nothing
cancels however short l is. Means are by Gauss-Legendre panels over births, which end
where lives of contacts born there change their character at this travel, and over
thresholds, which end at fixed shares of the stronger contacts and where the hazard
passes fixed levels.
"""

import numpy as np

from eqsim.laws.aging import Langevin
from eqsim.laws.barrier.bell import ByForce
from eqsim.laws.newborn import BirthLaw, DeltaBirths, ExponentialBirths, NormalBirths
from eqsim.laws.threshold import rank_above
from eqsim.master import flow
from eqsim.master.annealed import pooled_polynomials
from eqsim.master.fokker_planck import fluctuating_survivors
from eqsim.master.newborn import law_of_births, marks_of_births
from eqsim.master.quenched import (
    different_steps,
    greatest_of,
    kappa_of,
    rarest_that_counts,
    stiffness_of_survivors,
    thresholds_above,
)
from eqsim.model.reduced import Reduced
from eqsim.numerics.quadrature import gauss_legendre
from eqsim.numerics.tables import Array

# The rules of panels over births and thresholds, and of differences of hazards.
_OF_PANELS = gauss_legendre(8)
_OF_SHORTER_TRAVEL = gauss_legendre(4)
# How much further the thresholds of contacts born stretched reach, in -ln J_c: force
# variances of heavy tails count.
_HEAVY_TAIL = 45.0
# ln of the hazard passed where panels over thresholds end.
_PASSED = np.array([-24.0, -12.0, -7.0, -4.0, -2.0, -1.0, 0.0, 0.75, 1.5, 2.25, 3.0,
                    4.0])  # fmt: skip
_PASSED_RANGE = _PASSED[0] - 10.0, _PASSED[-1] + 10.0
# ln(xi/least - 1) from where these are sought, on a grid of so many points, and how
# often it is refined: where the hazard falls with xi, and where it rises.
_SHALLOWEST = -44.0
_GRID_POINTS = 32
_REFINED = 1
_REFINED_RISING = 3
# Pairs of birth and travel that are followed at once, to bound memory, and those of
# them and a threshold of a discrete law.
_PAIRS_AT_ONCE = 1000
_LIVES_AT_ONCE = 200_000
# Weight of births that do not count.
_NEGLIGIBLE_WEIGHT = 1e-13
# -ln J_c of thresholds where panels of births that are fractions of these end.
_TOP = np.array([1e-4, 0.03, 0.1, 0.25, 0.5, 0.8, 1.2, 1.7, 2.3, 3.0, 4.0, 6.0, 10.0,
                 30.0])  # fmt: skip
_POWERS_OF_STRETCH = np.arange(3)[:, None]


def survivor_moments(contacts: Reduced, travel: Array) -> Array:
    """Moments of contacts that outlast a travel > 0, shape (n,): E[x^i kappa^j; l >
    travel], x the stretch there, i and j from 0 to 2, shape (3, 3, n)."""
    powers = travel ** _POWERS_OF_STRETCH[:, None]
    if isinstance(contacts.aging, Langevin):
        return powers * fluctuating_survivors(contacts, travel)
    if not contacts.newborn.active:
        return _born_at(contacts, np.zeros(travel.size), travel)
    births = law_of_births(contacts)
    if isinstance(births, DeltaBirths):
        return _born_at(contacts, np.full(travel.size, births.stretch), travel)
    edges = _birth_edges(contacts, births, travel)
    y, weights = _OF_PANELS.between(edges[:, :-1], edges[:, 1:])
    weights *= births.pdf(y)
    row, *_ = where = np.nonzero(weights > _NEGLIGIBLE_WEIGHT)
    values = _born_at(contacts, y[where], travel[row]) * weights[where]
    means = [np.bincount(row, value, travel.size) for value in values.reshape(9, -1)]
    return np.array(means).reshape(3, 3, travel.size)


def _birth_edges(contacts: Reduced, births: BirthLaw, travel: Array) -> Array:
    """Edges of panels over births, shape (n, any), for each travel."""
    law, t = contacts.law, travel[:, None]
    low, high = births.range
    fixed, at = law.kinks / law.scale, np.linspace(low, high, 5)
    if isinstance(births, ExponentialBirths):
        at = births.mean * np.array([0.0, 0.5, 2.0, 5.0, 11.0, 20.0, 36.0])
    elif isinstance(births, NormalBirths):
        deviates = np.array([-8.3, -5.0, -2.5, 0.0, 2.5, 5.0, 8.3])
        at = births.mean + births.std * deviates
    if contacts.newborn.of == "threshold":
        top = np.empty(0) if law.steps.size else law.inverse_survival(_TOP) / law.scale
        moving = [1.0 - t / np.append(top, fixed[fixed > 0]), np.zeros_like(t)]
    else:
        fixed = np.concatenate(([0.0], fixed, -fixed))
        moving = [np.broadcast_to(fixed, (t.size, fixed.size)), fixed - t, -0.5 * t]
    edges = np.concatenate((np.broadcast_to(at, (t.size, at.size)), *moving), axis=1)
    return np.sort(np.clip(edges, low, high), axis=1)


def _born_at(contacts: Reduced, birth: Array, travel: Array) -> Array:
    """`survivor_moments` given the births, fractions or lengths, shape (n,)."""
    if contacts.one_sided if contacts.newborn.active else contacts.annealed:
        return _published_survivors(contacts, birth, travel)
    law, share = contacts.law, np.ones_like(birth)
    if contacts.newborn.of == "threshold":
        least = travel / (1.0 - birth)
    else:
        least = np.maximum(np.abs(birth), birth + travel)
        least /= contacts.aging.growth_at(travel)
        share = np.maximum(law.sf(np.abs(birth) * law.scale), 1e-300)
    found, steps = np.empty((3, 3, birth.size)), max(law.steps.size, 1)
    at_once = min(_PAIRS_AT_ONCE, _LIVES_AT_ONCE // steps + 1)
    for start in range(0, birth.size, at_once):
        part = slice(start, start + at_once)
        every = birth[part], travel[part], least[part]
        found[:, :, part] = _over_thresholds(contacts, *every)
    return found / share


def _over_thresholds(
    contacts: Reduced, birth: Array, travel: Array, least: Array
) -> Array:
    """Means over thresholds above `least`."""
    law, barrier = contacts.law, contacts.barrier
    of_threshold = contacts.newborn.of == "threshold"
    if law.steps.size:
        xi, share, _ = different_steps(contacts)
        # at its own end a contact is broken, whichever way that was rounded
        row, step = np.nonzero(xi > least[:, None] * (1.0 + 1e-13))
        xi, terms = xi[step, None], share[step, None]
    else:
        layer = np.empty((birth.size, 0))
        if barrier.thermal and not contacts.annealed:
            at = birth[:, None], travel[:, None], least
            layer = _thresholds_at_levels(contacts, *at)
            if isinstance(barrier, ByForce) and contacts.stiffness == "sqrt":
                slips = contacts._replace(barrier=barrier.opened_alone)
                rising = _thresholds_at_levels(slips, *at, falls=False)
                layer = np.concatenate((layer, rising), axis=1)
        rarest = rarest_that_counts(barrier) + _HEAVY_TAIL * contacts.newborn.active
        edges = thresholds_above(law, least, layer, rarest)
        row, column = np.nonzero(np.diff(edges, axis=1) > 0)
        xi, weights = _OF_PANELS.between(edges[row, column], edges[row, column + 1])
        terms = weights * law.pdf(xi * law.scale) * law.scale
        terms[~np.isfinite(terms)] = 0.0  # the density may be infinite at an end
    y, way = birth[row, None] * (xi if of_threshold else 1.0), travel[row, None]
    y, way = np.broadcast_arrays(y, way + 0.0 * xi)
    terms = terms * np.exp(-np.minimum(hazard_passed(contacts, y, way, xi), 700.0))
    growth = contacts.aging.growth_at(travel)[row, None]
    kappa, x = flow.kappa_along(contacts, xi, xi * growth), y + way
    found = np.empty((3, 3, birth.size))
    for i in range(3):
        weighed = terms
        for j in range(3):
            same = j > 0 and contacts.stiffness == "uniform"
            mean = np.bincount(row, weighed.sum(axis=1), birth.size)
            found[i, j] = found[i, 0] if same else mean
            weighed = weighed * kappa
        terms = terms * x
    if not (barrier.thermal or law.steps.size):  # a law knows its share better
        share = law.sf(least * law.scale)
        found *= np.where(found[0, 0] > 0.0, share / found[0, 0].clip(1e-300), 0.0)
    return found


def _thresholds_at_levels(
    contacts: Reduced, birth: Array, travel: Array, least: Array, *, falls: bool = True
) -> Array:
    """Thresholds above `least`, (n,), about where the logarithm of the hazard passed
    passes each level, shape (n, levels): from the weakest on, where it falls with xi,
    or from the strongest on, where it rises. Only panels depend on it."""
    least = np.maximum(least, contacts.law.support[0] / contacts.law.scale)[:, None]
    most = np.log1p(greatest_of(contacts.law) / least)
    share = np.linspace(0.0, 1.0, _GRID_POINTS)
    depth = _SHALLOWEST + share * (most - _SHALLOWEST)
    known, value = np.empty((least.size, 0)), np.empty((least.size, 0))
    for _ in range((_REFINED if falls else _REFINED_RISING) + 1):
        xi = least * (1.0 + np.exp(depth))
        y = birth * (xi if contacts.newborn.of == "threshold" else np.ones_like(xi))
        passed = hazard_passed(contacts, y, travel + 0.0 * xi, xi)
        known = np.append(known, depth, axis=1)
        # far from the levels it is steep, and known to be so is enough
        near = np.clip(np.log(np.maximum(passed, 1e-300)), *_PASSED_RANGE)
        value = np.append(value, near, axis=1)
        order = np.argsort(known if falls else -known, axis=1)
        known, value = (np.take_along_axis(at, order, 1) for at in (known, value))
        # where attempts hardly need energy it may rise, but nothing is steep
        value = np.minimum.accumulate(value, axis=1)
        after = (value[:, :, None] > _PASSED).sum(axis=1)
        after = np.clip(after, 1, known.shape[1] - 1)
        high, low = (np.take_along_axis(value, after - i, 1) for i in (1, 0))
        start, end = (np.take_along_axis(known, after - i, 1) for i in (1, 0))
        part = np.clip((high - _PASSED) / np.maximum(high - low, 1e-12), 0.0, 1.0)
        depth = start + part * (end - start)
    return np.asarray(least * (1.0 + np.exp(depth)))


def _published_survivors(contacts: Reduced, y: Array, travel: Array) -> Array:
    """J_c(x)/J_c(y) exp(-(Delta U(x) - Delta U(y))), thresholds counting for x > 0 only
    (Q11a)."""
    law, x = contacts.law, y + travel
    up, born = np.maximum(x, 0.0), np.maximum(y, 0.0)
    J = law.sf(up * law.scale)
    with np.errstate(invalid="ignore"):
        stiff = [J * part for part in stiffness_of_survivors(contacts, up)]
    tails = np.where(J > 0, np.stack((J, *stiff)), 0.0)
    J_born = np.maximum(law.sf(born * law.scale), 1e-300)
    passed = hazard_passed(contacts, y, travel, born)
    alive = np.exp(-np.minimum(passed, 700.0)) / J_born
    return np.asarray(x ** _POWERS_OF_STRETCH[:, None] * tails * alive)


def hazard_passed(contacts: Reduced, y: Array, travel: Array, xi: Array) -> Array:
    """Lambda(y + travel) - Lambda(y) of thresholds xi, arrays of one shape."""
    barrier = contacts.barrier
    if not barrier.thermal:
        return np.zeros(xi.shape)
    if not contacts.aging.closed:
        return flow.hazard_along(contacts, travel, xi)
    if not (contacts.annealed or contacts.newborn.active):
        with np.errstate(divide="ignore"):
            a, x = barrier.b * kappa_of(contacts, xi), np.minimum(travel, xi)
            log_passed = barrier.log_hazard(x, xi, a) + barrier.log_w
        return np.exp(np.minimum(log_passed, 300.0))
    down, up = np.maximum(-y, 0.0), np.maximum(y + travel, 0.0)
    before, after = np.minimum(travel, down), np.minimum(travel, up)
    # Lambda is continued as an odd function
    parts = (
        _passed_up_to(contacts, down, before, xi),
        _passed_up_to(contacts, up, after, xi),
    )
    return np.where(before > 0, parts[0], 0.0) + np.where(after > 0, parts[1], 0.0)


def _passed_up_to(contacts: Reduced, x: Array, way: Array, xi: Array) -> Array:
    """Lambda(x) - Lambda(x - way), 0 <= way <= x."""
    if contacts.annealed or contacts.one_sided:
        rate = pooled_polynomials(contacts)
        found = rate.integral(x) - rate.integral(x - way)
        short = (way > 0) & (way < 0.01 * x)
        at, weights = _OF_SHORTER_TRAVEL.between(x[short] - way[short], x[short])
        found[short] = (rate(at) * weights).sum(axis=1)
        return np.asarray(found)
    a = contacts.barrier.b * kappa_of(contacts, xi)
    return contacts.barrier.hazard_over(x, way, xi, a)


def kinks_of_survival(contacts: Reduced) -> Array:
    """Travels at which survival of contacts born stretched, or its slope, may jump."""
    births, law = law_of_births(contacts), contacts.law
    at = law.kinks / law.scale
    if contacts.newborn.of == "threshold":
        found = np.outer(1.0 - np.array(births.range), at).ravel()
    else:
        y = marks_of_births(births)
        found = np.concatenate(((at - y[:, None]).ravel(), -y, -2.0 * y))
    return np.unique(found[found > 0])


def longest_travel(contacts: Reduced) -> float:
    """A travel that hardly a contact born stretched outlasts."""
    law, (low, high) = contacts.law, law_of_births(contacts).range
    length = contacts.newborn.of == "length"
    born = rank_above(law, max(abs(low), abs(high)) * length)
    rarest = rarest_that_counts(contacts.barrier) + _HEAVY_TAIL + min(born, 470.0)
    top = law.steps[-1] if law.steps.size else law.inverse_survival(min(rarest, 510.0))
    return float(top / law.scale) * (1.0 if length else 1.0 - low) - low * length
