"""Quenched contacts that heat breaks, along a programme: kernels that replace those of
`master.cohorts` for pooled contacts.

The integrated hazard z is followed for contacts that are born at the edges of steps
with the thresholds of nodes. Between two edges and two nodes, in a cell of births and a
stratum of thresholds, births are spread evenly and ln z is taken for a plane. The share
that heat has broken there is a second difference over the corners (derived) of

    W(y) = int_{-oo}^y du int_{-oo}^u (1 - exp(-e^w)) dw
         = sum_n (-1)^(n+1) e^(n y)/(n^2 n!).

For a plane it is exact, however steep, so that neither cells nor strata need be narrow.
"""

import functools
import math
from typing import Any, NamedTuple

import numpy as np
from scipy import special

from eqsim.laws.aging.base import growth
from eqsim.laws.barrier.base import height, prefactor
from eqsim.laws.stiffness import Springs, kappa
from eqsim.master.cohorts import (
    Cohort,
    Cohorts,
    Growth,
    PathStep,
    Scratch,
    ages_of_survivors,
    bear,
    carry,
    copy,
    mean_exponential,
)
from eqsim.numerics.compiled import routine
from eqsim.numerics.quadrature import gauss_legendre
from eqsim.numerics.tables import Array, hermite
from eqsim.numerics.vector_math import exp

# ln z below which heat has broken next to nothing of a cell and a stratum: exp(-36) =
# 2e-16.
_NONE_BROKEN = -36.0
# ln z above which heat has left next to nothing: exp(-exp(3.6)) = 1e-16.
_ALL_BROKEN = 3.6
# z beyond which it is no longer followed.
_LARGEST_Z = 1e12
# -ln of a growth of z in a step that is neglected.
_NEGLIGIBLE_GROWTH = 640.0
# ln z where the table of W begins; W is 0 there.
W_BEGINS = -40.0
# ln z where it ends.
_W_ENDS = 6.0
# Knots per unit of ln z.
W_PER_UNIT = 64
# Least difference of ln z over a cell or stratum: the table is not good enough for the
# second difference over a smaller one.
_LEAST_DIFFERENCE = 0.03
# Deviation of the barrier from a straight line over a step, beyond which the step is
# taken in halves; from half of it on both values are blended.
_STRAIGHTNESS = 0.01
# Age of the last births of a cohort over its width, up to which it is young.
_YOUNG = 12.0
# Substeps of the births of a step where thresholds grow.
_SUBSTEPS_OF_BIRTHS = 12


class Strata(NamedTuple):
    """Classes of contacts by threshold at birth, ascending: of a smooth law between
    neighbouring nodes, of a discrete law at one node. Edges, arrays (strata,); and the
    share of births, E[k_i/k] and E[(k_i/k)^2] of each, and of it and all above, shape
    (3, strata)."""

    left: Array
    right: Array
    share: Array
    above: Array


class Fronts(NamedTuple):
    """Contacts for kernels: the thresholds of nodes, strata between them, laws, and the
    table of W."""

    nodes: Array
    strata: Strata
    growth: Growth
    barrier: Any
    springs: Springs
    delay: Any  # `Waits` or `DrawnWaits`
    table: Array


# Cached, as it has no parameters, and takes 1.3 ms, a third of a short solve.
@functools.cache
def table_of_w() -> Array:
    """W and its slope at y = W_BEGINS, ..., _W_ENDS, shape (knots, 2)."""
    y = np.linspace(W_BEGINS, _W_ENDS, int((_W_ENDS - W_BEGINS) * W_PER_UNIT) + 1)

    def slope(y: Array) -> Array:  # Ein(e^y)
        z = np.exp(y)
        small = z * (1.0 - z / 4.0 * (1.0 - z * 2.0 / 9.0 * (1.0 - z * 3.0 / 16.0)))
        return np.where(y < -6.0, small, y + np.euler_gamma + special.exp1(z))

    nodes, weights = gauss_legendre(8).between(y[:-1], y[1:])
    w = math.exp(W_BEGINS) + np.append(0.0, np.cumsum((weights * slope(nodes)).sum(1)))
    return np.stack((w, slope(y)), axis=1)


@routine(inline=True)
def _w(table: Array, y: float) -> float:
    """W; beyond the table its slope goes on as y + gamma."""
    steps = (min(y, _W_ENDS) - W_BEGINS) * W_PER_UNIT
    if steps <= 0.0:
        return 0.0
    i = min(int(steps), table.shape[0] - 2)
    u, h = steps - i, 1.0 / W_PER_UNIT
    rise, d0, d1 = table[i + 1, 0] - table[i, 0], table[i, 1] * h, table[i + 1, 1] * h
    w = hermite(u, table[i, 0], rise, d0, d1)
    beyond = y - min(y, _W_ENDS)
    return w + beyond * (table[table.shape[0] - 1, 1] + 0.5 * beyond)


@routine
def _too_much(middle: float, difference: float, other: float) -> float:
    """How much more is broken if a `difference` of ln z, spread evenly around `middle`,
    is taken for the least one: to first order (least^2 - difference^2)/24 times the
    mean of d^2(1 - exp(-z))/d(ln z)^2 over an `other` difference (derived)."""
    excess = _LEAST_DIFFERENCE**2 - difference**2
    if excess <= 0.0:
        return 0.0
    z0 = math.exp(min(middle - 0.5 * other, _W_ENDS))
    z1 = math.exp(min(middle + 0.5 * other, _W_ENDS))
    return excess / 24.0 * (z1 * math.exp(-z1) - z0 * math.exp(-z0)) / other


@routine
def _broken(table: Array, middle: float, by_threshold: float, by_birth: float) -> float:
    """Mean of 1 - exp(-z) over a cell and a stratum: ln z = `middle` in the middle, and
    differs by `by_threshold` across the stratum, by `by_birth` across the cell."""
    p = max(abs(by_threshold), _LEAST_DIFFERENCE)
    q = max(abs(by_birth), _LEAST_DIFFERENCE)
    outer, inner = 0.5 * (p + q), 0.5 * (p - q)
    above = _w(table, middle + outer) - _w(table, middle + inner)
    below = _w(table, middle - inner) - _w(table, middle - outer)
    broken = (above - below) / (p * q)
    broken -= _too_much(middle, by_threshold, q) + _too_much(middle, by_birth, p)
    return min(max(broken, 0.0), 1.0)


@routine
def _add_hazard(contacts: Fronts, cohort: Cohort, z: Array, step: PathStep) -> None:
    """Add to z of all nodes its growth in a step, for contacts born at the older edge
    of a cohort."""
    dt = step.t1 - step.t0
    x0, x1 = step.X0 - cohort.X_first, step.X1 - cohort.X_first
    g0 = growth(contacts.growth.law, step.t0 - cohort.t_first)
    g1 = growth(contacts.growth.law, step.t1 - cohort.t_first)
    gm, xm = 0.5 * (g0 + g1), 0.5 * abs(x0 + x1)
    x0, x1 = abs(x0), abs(x1)
    barrier, springs = contacts.barrier, contacts.springs
    limit = barrier.log_w + math.log(dt) + _NEGLIGIBLE_GROWTH if dt > 0.0 else -math.inf
    for k in range(z.size):
        if z[k] > _LARGEST_Z:
            continue
        xi = contacts.nodes[k]
        a0 = a1 = barrier.b * kappa(springs, xi)
        if contacts.growth.stiffens:
            a0 = barrier.b * kappa(springs, xi * g0)
            a1 = barrier.b * kappa(springs, xi * g1)
        low, high = height(barrier, xi * g0, x0, a0), height(barrier, xi * g1, x1, a1)
        # safe, as are the stronger ones; no bond comes to this limit
        if min(low, high) > limit:
            break
        middle = height(barrier, xi * gm, xm, 0.5 * (a0 + a1))
        # until x passes the threshold, or that falls below x, if it does
        gaps = max(xi * g0 - x0, 0.0) + max(xi * g1 - x1, 0.0)
        p = dt * prefactor(barrier, xi * gm, min(xm, xi * gm - 0.5 * gaps))
        bent = 2.0 * abs(middle - 0.5 * (low + high)) / _STRAIGHTNESS
        halves = min(max(bent - 1.0, 0.0), 1.0)
        middle -= barrier.log_w
        low, high = low - barrier.log_w, high - barrier.log_w
        if halves < 1.0:
            z[k] += p * (1.0 - halves) * mean_exponential(low, high)
        if halves > 0.0:
            both = mean_exponential(low, middle) + mean_exponential(middle, high)
            z[k] += 0.5 * p * halves * both


@routine(inline=True)
def _logarithms(z: Array, y: Array) -> None:
    for k in range(z.size):
        y[k] = math.log(max(z[k], 1e-300))


@routine(inline=True)
def _below(left: float, right: float, y: float) -> float:
    """int_0^y of the share of a stratum above y."""
    if y <= left:
        return y
    if y >= right:
        return 0.5 * (left + right)
    return y - 0.5 * (y - left) ** 2 / (right - left)


@routine(inline=True)
def _unbroken(left: float, right: float, low: float, high: float) -> float:
    """Share of a stratum above y, in the mean over low < y < high."""
    if high - low > 1e-9 * high:
        return (_below(left, right, high) - _below(left, right, low)) / (high - low)
    if high <= left and high < right:
        return 1.0
    return max(right - high, 0.0) / (right - left) if right > left else 0.0


@routine
def _find_pinned_by_strata(
    contacts: Fronts, cohort: Cohort, older: Array, newer: Array, g: float
) -> None:
    """Find the pinned share and the stiffness of a cohort, with ln z at its older and
    newer edge; `g` is the growth of thresholds."""
    strata, pinned, stiffness, stiffness2 = contacts.strata, 0.0, 0.0, 0.0
    apart, top = contacts.nodes.size - strata.left.size, contacts.nodes.size - 1
    low = min(cohort.weakest_first, cohort.weakest_last)
    high = max(cohort.weakest_first, cohort.weakest_last)
    for k in range(strata.left.size):
        if strata.right[k] <= low and strata.left[k] < high:
            continue
        weak0, strong0 = older[k], older[k + apart]
        weak1, strong1 = newer[k], newer[k + apart]
        if min(weak0, weak1, strong0, strong1) > _ALL_BROKEN:
            continue
        intact = 1.0
        if max(weak0, weak1, strong0, strong1) > _NONE_BROKEN:
            middle = 0.25 * (weak0 + strong0 + weak1 + strong1)
            by_threshold = 0.5 * (strong0 + strong1 - weak0 - weak1)
            by_birth = 0.5 * (weak1 + strong1 - weak0 - strong0)
            intact = 1.0 - _broken(contacts.table, middle, by_threshold, by_birth)
        # then none of the stronger either: the strongest may be stiffer bonds
        elif strata.left[k] >= high and max(older[top], newer[top]) < _NONE_BROKEN:
            pinned += strata.above[0, k]
            stiffness += strata.above[1, k]
            stiffness2 += strata.above[2, k]
            break
        intact *= _unbroken(strata.left[k], strata.right[k], low, high)
        pinned += intact * strata.share[0, k]
        stiffness += intact * strata.share[1, k]
        stiffness2 += intact * strata.share[2, k]
    if contacts.growth.stiffens:
        stiffness, stiffness2 = stiffness * g, stiffness2 * g * g
    cohort.pinned = cohort.births * pinned
    cohort.stiffness = cohort.births * stiffness
    cohort.stiffness2 = cohort.births * stiffness2


@routine(inline=True)
def _exponential_integral(table: Array, y: float) -> float:
    """E_1(e^y); below the table -y - gamma."""
    if y >= _W_ENDS:
        return 0.0
    steps = max(y - W_BEGINS, 0.0) * W_PER_UNIT
    i, h = min(int(steps), table.shape[0] - 2), 1.0 / W_PER_UNIT
    u, rise = steps - i, table[i + 1, 1] - table[i, 1]
    d0 = -math.expm1(-math.exp(W_BEGINS + i * h)) * h
    d1 = -math.expm1(-math.exp(W_BEGINS + (i + 1) * h)) * h
    return hermite(u, table[i, 1], rise, d0, d1) - y - np.euler_gamma


@routine(inline=True)
def _across(weak: float, strong: float, fall: float, apart: float) -> float:
    """Mean of m = int_0^1 u^p exp(-z u) du, given at the ends of a stratum across which
    ln z is spread evenly: the integral of m over ln z is -(E_1(z) + m)/(p + 1)
    (derived). `fall` is that of E_1, and ln z differs by `apart` times p + 1."""
    if abs(apart) < _LEAST_DIFFERENCE:
        return 0.5 * (weak + strong)
    return (strong - weak + fall) / apart


@routine
def _add_up_births(
    contacts: Fronts, cohort: Cohort, z: Array, scratch: Scratch, step: PathStep
) -> None:
    """Find z of contacts that age, born at the beginning of a step, and E[1], E[u],
    E[u^2] of survivors of births in it, u the age over the step. z grows evenly with age
    within a substep, and each substep is twice as long as the one before."""
    share, age, age2 = scratch.share, scratch.age, scratch.age2
    for k in range(z.size):
        share[k], age[k], age2[k] = 0.0, 0.0, 0.0
    u, dt, dX = 0.0, step.t1 - step.t0, step.X1 - step.X0
    for i in range(_SUBSTEPS_OF_BIRTHS):
        after = 0.5 ** (_SUBSTEPS_OF_BIRTHS - 1 - i)
        width = after - u
        copy(z, scratch.before)
        t, X = step.t0 + u * dt, step.X0 + u * dX
        substep = PathStep(t, X, step.t0 + after * dt, step.X0 + after * dX)
        _add_hazard(contacts, cohort, z, substep)
        for k in range(z.size):
            before = scratch.before[k]
            if before > 700.0:
                continue
            left = ages_of_survivors(z[k] - before)
            alive = exp(-before) * left.share * width
            square = u * u + 2.0 * u * width * left.age + width * width * left.age2
            share[k] += alive
            age[k] += alive * (u + width * left.age)
            age2[k] += alive * square
        u = after


@bear.register(Fronts)
def _bear(contacts: Fronts, cohorts: Cohorts, row: int, step: PathStep) -> None:
    """Find what is pinned at the end of a step of one birth spread over it, and z of
    contacts born at its beginning."""
    cohort, z, scratch = cohorts.rows[row], cohorts.z[row], cohorts.scratch
    for k in range(z.size):
        z[k] = 0.0
    if contacts.growth.ages:
        _add_up_births(contacts, cohort, z, scratch, step)
    else:
        _add_hazard(contacts, cohort, z, step)
    _logarithms(z, scratch.newer)
    strata, weakest = contacts.strata, cohort.weakest_first
    share, age, age2 = scratch.share, scratch.age, scratch.age2
    middle = 0.5 * (step.t1 - step.t0)
    g = growth(contacts.growth.law, middle) if contacts.growth.stiffens else 1.0
    cohort.pinned, cohort.stiffness, cohort.stiffness2 = 0.0, 0.0, 0.0
    for k in range(strata.left.size):
        j = k + contacts.nodes.size - strata.left.size
        unbroken = _unbroken(strata.left[k], strata.right[k], 0.0, weakest)
        apart = scratch.newer[k] - scratch.newer[j]
        fall = _exponential_integral(contacts.table, scratch.newer[j])
        fall -= _exponential_integral(contacts.table, scratch.newer[k])
        weak, strong = ages_of_survivors(z[k]), ages_of_survivors(z[j])
        # the means if z grew evenly with age over the whole step
        pinned = _across(weak.share, strong.share, fall, apart)
        weak1, strong1 = weak.share * weak.age, strong.share * strong.age
        first = _across(weak1, strong1, fall, 2.0 * apart)
        weak2, strong2 = weak.share * weak.age2, strong.share * strong.age2
        second = _across(weak2, strong2, fall, 3.0 * apart)
        if contacts.growth.ages:
            pinned *= 0.5 * (share[k] / weak.share + share[j] / strong.share)
            first *= 0.5 * (age[k] / weak1 + age[j] / strong1)
            second *= 0.5 * (age2[k] / weak2 + age2[j] / strong2)
        cohort.pinned += unbroken * strata.share[0, k] * pinned
        # `observe` takes them at the middle and spread evenly; survivors are younger
        cohort.stiffness += unbroken * strata.share[1, k] * 2.0 * g * first
        cohort.stiffness2 += unbroken * strata.share[2, k] * 3.0 * g * g * second


@routine
def _even_young(older: Array, newer: Array, log_ages: float) -> None:
    """Move ln z at both edges of a young cohort so that z, whose logarithm is taken for
    a plane between them, has the mean and the variance of one that grows evenly with
    age, as far as it does so between the ages of the edges, whose ratio has the
    logarithm `log_ages`. With the ratio s of its variance to its squared mean m and c =
    m (1 + s), the edges are c (1 -+ tanh t), tanh(t)/t = 1/(1 + s) (derived), to 1e-3
    of t here."""
    for k in range(newer.size):
        # of contacts that are past their thresholds z may not grow with age
        fall = max(older[k] - newer[k], 0.0)
        power, share = fall / log_ages, math.exp(-fall)
        if power < 2.0:
            mean, even = 0.5 + 0.5 * share, min(2.0 - power, 1.0)
            ratio = (1.0 - share) ** 2 / (12.0 * mean * mean)
            t = math.sqrt(15.0 * ratio / (5.0 - ratio))
            middle = older[k] + math.log(mean * (1.0 + ratio) / math.cosh(t))
            older[k] += even * (middle + t - older[k])
            newer[k] += even * (middle - t - newer[k])


@carry.register(Fronts)
def _carry(contacts: Fronts, cohorts: Cohorts, row: int, step: PathStep) -> None:
    cohort, z, scratch = cohorts.rows[row], cohorts.z[row], cohorts.scratch
    _add_hazard(contacts, cohort, z, step)
    _logarithms(z, scratch.older)
    young, width = step.t1 - cohort.t_last, cohort.t_last - cohort.t_first
    older = scratch.older
    if young < _YOUNG * width:
        older = scratch.before
        copy(scratch.older, older)
        _even_young(older, scratch.newer, math.log1p(width / young))
    g = growth(contacts.growth.law, step.t1 - 0.5 * (cohort.t_first + cohort.t_last))
    _find_pinned_by_strata(contacts, cohort, older, scratch.newer, g)
    copy(scratch.older, scratch.newer)
