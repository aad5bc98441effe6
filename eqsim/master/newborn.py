"""Contacts born stretched: stationary equations by collocation (Q5a of Braun and
Peyrard, 2011, with R(x); derived).

A contact born at y survives to y + s with exp(-(Lambda(y + s) - Lambda(y))), Lambda
continued as an odd function, and not beyond its threshold. Downwards from where it must
break, the moments of the rest of its life obey

    L' = p L - 1,        W' = p W - kappa x,        V' = p V - kappa^2 x^2,

p the hazard per unit displacement: L(y) is the mean travel of contacts born at y, W(y)
their mean work, V(y) the mean integral of the square of their force. One sweep gives
them at every y, and where p is so large that life ends within a panel the solution is
smooth, as 1/p is, so that no layer is missed. Panels are solved by Chebyshev
collocation of the integrated equation; they are implicit, and errors fade from one to
the next.

Quenched contacts, and those whose birth is a fraction of the threshold, have L(y; xi)
for each xi: in x = xi cos(2 phi) rates of stiff contacts are smooth at both ends, and
distances from either are known without cancellation. Panels end where the integrated
hazard passes fixed levels. Annealed ones of given births have p = P_c/J_c + (omega/v)
h, for x > 0 only as to the first term (Q11a), and one sweep in x for the whole
ensemble; their stiffness is that of the survivors.
"""

import functools
import itertools
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from eqsim.errors import InputError
from eqsim.laws.newborn import (
    BirthLaw,
    DeltaBirths,
    ExponentialBirths,
    NormalBirths,
    UniformBirths,
)
from eqsim.laws.threshold import Gamma, diverges, rank_above
from eqsim.master.annealed import pooled_polynomials, successful_attempts
from eqsim.master.quenched import (
    BIRTHS,
    CONVERGED,
    beyond,
    different_steps,
    kappa_of,
    over_births,
    stiffness_of_survivors,
    terms_of_births,
)
from eqsim.model.reduced import Reduced
from eqsim.numerics.panels import ClenshawCurtis, Panels, clenshaw_curtis, refined
from eqsim.numerics.quadrature import gauss_legendre
from eqsim.numerics.roots import bisected
from eqsim.numerics.tables import Array

# Levels of ln Lambda where panels end, and their distance beyond, where the solution
# follows 1/p.
_SPENT = np.array([-36.0, -24.0, -16.0, -10.0, -6.0, -3.0, -1.5, -0.5, 0.25, 1.0, 1.75,
                   2.5, 3.25, 4.0])  # fmt: skip
_SPENT_APART = 5.0
# Hazards at the threshold's full rate, next to the threshold, where panels end.
_LAYER = np.array([0.3, 1.5, 4.0, 10.0, 25.0, 50.0])
# Order of the rule, and of a coarser one that tells the error.
_ORDER_FINE = 16
_ORDER_COARSE = 12
# By how much levels are shifted with the coarser rule.
_LEVEL_SHIFT = 0.3

# -ln J_c beyond that of births.
_RARER_THAN_BIRTHS = np.array([0.0, 0.3, 1.0, 3.0, 8.0, 20.0, 45.0])
# -ln J_c where the chance that a threshold is above a birth has fallen.
_FALLEN = np.array([1.0, 3.0, 7.0, 14.0, 28.0, 60.0, 120.0, 250.0])
# So little below a discrete threshold contacts still hold.
_BELOW = 1e-13
# The narrowest panel of thresholds.
_NARROWEST_RANKS = 1e-5
# ln of a hazard that no life outlives.
_NO_LIFE = np.log([110.0])
# -ln J_c of the strongest contact that is asked for.
_STRONGEST = 510.0
# Thresholds that are solved for at once, to bound memory.
_THRESHOLDS_AT_ONCE = 300
# The least relative error that is quoted.
_ROUNDED_SWEEP = 1e-11
# Share of the work's parts that its error is measured by where they cancel.
_CANCELLED = 1e-2

# Hazard up to the highest threshold that the pooled rate of bonds may have: it is
# resolved to 2e-15 of that, and lives, whose hazard is 1, need 1e-9.
_MOST_POOLED = 5e5

# -ln J_c where panels of the stretches of annealed contacts end.
_ENDS = np.array([1e-4, 0.02, 0.3, 1.0, 2.5, 6.0, 15.0, 40.0, 120.0, 300.0, 550.0])
# Where a panel is split.
_SPLIT = np.array([0.0, 0.1, 0.5, 0.9, 1.0])
# The shortest panel, relative to its distance from 0.
_SHORTEST_PANEL = 1e-14
# Panels of stretches at most.
_MOST_STRETCHES = 1000
# Longest panel in ln x at first beyond the scale of thresholds.
_LONGEST_SWEPT = 4.0
# Where panels of normal births end, in standard deviations, and of exponential ones, in
# means.
_DEVIATES = np.array([-8.3, -6.5, -5.0, -3.5, -2.5, -1.5, -0.7, 0.0, 0.7, 1.5, 2.5, 3.5,
                      5.0, 6.5, 8.3])  # fmt: skip
_DECAYS = np.array([0.0, 0.25, 0.7, 1.5, 3.0, 5.0, 8.0, 12.0, 18.0, 26.0, 36.0])


def law_of_births(contacts: Reduced) -> BirthLaw:
    """R in units of `law.scale`, or of fractions."""
    births: BirthLaw = contacts.newborn.reduced(contacts.law.scale)
    return births


def marks_of_births(births: BirthLaw) -> Array:
    """Ascending stretches where panels of births end."""
    if isinstance(births, UniformBirths):
        return np.array([births.low, births.high])
    if isinstance(births, ExponentialBirths):
        return births.mean * _DECAYS
    if isinstance(births, NormalBirths):
        return births.mean + births.std * _DEVIATES
    return np.array([births.stretch])


def _density(births: BirthLaw, y: Array, middle: Array) -> Array:
    """R(y) on panels around `middle`, none of which a jump of R is inside; at their
    ends y may be rounded across it."""
    low, high = births.range
    inside = (middle > low) & (middle < high)
    return np.where(inside, births.pdf(np.clip(y, low, high)), 0.0)


def _has_square(contacts: Reduced) -> bool:
    """True if the mean square of the force of a life is finite, as in
    `Ensemble.divergence`. Else no error may be measured by it."""
    law, barrier = contacts.law, contacts.barrier
    if barrier.thermal and barrier.lasting and not contacts.annealed:
        return True
    power = 5 if contacts.stiffness == "sqrt" else 3
    return isinstance(law, Gamma) or not diverges(law, power)


def stretched_moments(contacts: Reduced) -> Array:
    """Row of `LifeMoments`, shape (7,), of contacts born stretched."""
    solve = _swept if contacts.one_sided else _moments_over_thresholds
    mean, error = solve(contacts)
    of_threshold, law = contacts.newborn.of == "threshold", contacts.law
    birth = law_of_births(contacts).mean
    birth *= law.mean / law.scale if of_threshold else 1.0
    square = mean[2], error[2]
    if not error[2] < mean[2]:  # of broad laws nothing may be known
        square = math.nan, 0.0
    return np.array([*mean[:2], *error[:2], birth, *square])


def _scales(mean: Array) -> Array:
    """Scales of errors of travel, work and square: the work may vanish though its parts
    do not."""
    parts = _CANCELLED * math.sqrt(abs(mean[0] * mean[2]))
    return np.abs([mean[0], np.abs(mean[1]) + parts, mean[2]])


def _coarse_error(mean: Array, coarse: Array) -> Array:
    """Errors of a rule, from a coarser one."""
    return np.abs(mean - coarse) + _ROUNDED_SWEEP * _scales(mean)


def _collocated(rate: Array, sources: Array, order: int) -> Array:
    """Solutions of f' = sources - rate f on panels, primes per unit of a panel's own
    variable from -1 to 1: those that begin at 0, and the one that begins at 1 without
    sources, shape (panels, nodes, 4). `rate` has the shape (panels, nodes), `sources`
    (panels, nodes, 3)."""
    cumulative = clenshaw_curtis(order).cumulative.T
    matrix = np.eye(order + 1) + cumulative * rate[:, None, :]
    starts = np.ones((*rate.shape, 1))
    right = np.concatenate((cumulative @ sources, starts), axis=2)
    return np.asarray(np.linalg.solve(matrix, right))


# -----------------------------------------------------------------------------------------------
# for each threshold


class Hazard(NamedTuple):
    """Hazard of a contact of threshold xi before it reaches the threshold: its `rate`
    per unit displacement, from gap = xi - |x|, total = xi + |x|, xi and kappa, arrays
    that broadcast; `levels`, |x| where panels end, (n, any), from xi, kappa (n,) and a
    shift of levels; and the `layer` of gaps where they end, (n, any), from xi."""

    rate: Callable[[Array, Array, Array, Array], Array]
    levels: Callable[[Array, Array, float], Array]
    layer: Callable[[Array], Array]


def hazard_of(contacts: Reduced) -> Hazard:
    """Own attempts, or pooled ones."""
    barrier = contacts.barrier
    if not barrier.thermal:

        def nowhere(xi: Array, *_: object) -> Array:
            return np.empty((xi.size, 0))

        return Hazard(lambda gap, *_: 0.0 * gap, nowhere, nowhere)
    if contacts.annealed:
        return _hazard_of_pool(contacts)

    def rate(gap: Array, total: Array, xi: Array, kappa: Array) -> Array:
        log_rate = barrier.log_attempt(gap, total, xi, barrier.b * kappa)
        return np.exp(barrier.log_w + log_rate)

    def levels(xi: Array, kappa: Array, shift: float) -> Array:
        most = barrier.log_w + 4.0
        if barrier.log_w < 5.0:
            most = float(np.log(barrier.whole_hazard(xi, kappa)).max())
        at = _spent_levels(most) + shift
        return barrier.ends_of_panels(at, xi, barrier.b * kappa)

    def layer(xi: Array) -> Array:
        xi = xi[:, None]

        def below(log_share: Array) -> Array:
            gap = xi * np.exp(log_share)
            log_rate = barrier.log_w + barrier.log_prefactor(gap, xi)
            return np.asarray(np.log(gap) + log_rate <= np.log(_LAYER))

        low = np.full((xi.size, _LAYER.size), -600.0)
        return np.asarray(xi * np.exp(bisected(below, low, 0.0 * low, 25)[1]))

    return Hazard(rate, levels, layer)


def _spent_levels(most: float) -> Array:
    """Levels of ln Lambda up to `most`."""
    beyond = np.arange(_SPENT[-1] + _SPENT_APART, most, _SPENT_APART)
    return np.concatenate((_SPENT, beyond))


def _hazard_of_pool(contacts: Reduced) -> Hazard:
    pooled = pooled_polynomials(contacts)
    even = np.linspace(0.0, pooled.edges[-1], 2000)
    grid = np.unique(np.concatenate((pooled.edges, even)))
    passed = pooled.integral(grid)
    if contacts.barrier.by_force and not passed[-1] < _MOST_POOLED:
        raise InputError(
            f'newborn.of = "threshold": off-rates of annealed bonds rise too far up to '
            f"the highest thresholds for a reference (hazard {passed[-1]:.0e}, at most "
            f"{_MOST_POOLED:.0e})"
        )

    def levels(xi: Array, kappa: Array, shift: float) -> Array:
        at = np.exp(_spent_levels(max(math.log(passed[-1] + 1e-300), 5.0)) + shift)
        inner = np.concatenate((np.interp(at, passed, grid), pooled.edges))
        return np.broadcast_to(inner, (xi.size, inner.size))

    def layer(xi: Array) -> Array:
        return np.minimum(_LAYER / np.maximum(pooled(xi), 1e-200)[:, None], xi[:, None])

    def rate(gap: Array, total: Array, xi: Array, kappa: Array) -> Array:
        return pooled(0.5 * (total - gap))

    return Hazard(rate, levels, layer)


def _turned(x: Array, xi: Array) -> Array:
    """phi of stretches x in x = xi cos(2 phi)."""
    return np.arcsin(np.sqrt(np.clip((xi - x) / (2.0 * xi), 0.0, 1.0)))


def _mean_lives(
    contacts: Reduced, hazard: Hazard, xi: Array, gap: Array, *, fine: bool = True
) -> Array:
    """Travel, work and square of contacts of thresholds xi (n,), averaged over births
    that know them, shape (3, n), by the finer rule, or the coarser on other panels.
    `gap` (n,) is xi - |y| of identical births; of others it does not count, and means
    are over R(y)/J_c(|y|) for given births."""
    births, of_threshold = law_of_births(contacts), contacts.newborn.of == "threshold"
    kappa, barrier = kappa_of(contacts, xi), contacts.barrier
    scaled = contacts.annealed or of_threshold
    if barrier.by_force and barrier.thermal and not scaled:
        # none lives beyond: x would be lost in a threshold far out of reach
        alone = barrier.stretch_at(_NO_LIFE, xi, barrier.b * kappa)[:, 0]
        reach = np.minimum(xi, np.max(np.abs(births.range)) + alone)
        xi, gap = reach, np.where(reach < xi, alone, gap)
    per = xi[:, None]
    level = hazard.levels(xi, kappa, 0.0 if fine else _LEVEL_SHIFT)
    inside = [level, -level]
    if isinstance(births, DeltaBirths):
        # one of the two distances is known without cancellation
        half = np.sqrt(gap / (2.0 * xi))
        end = np.arcsin(half) if births.stretch >= 0 else np.arccos(half)
    else:
        at = marks_of_births(births) * (per if of_threshold else np.ones_like(per))
        end = _turned(np.maximum(at[:, 0], -xi), xi)
        inside += [at] if of_threshold else [at, _steep_shares(contacts) + 0.0 * per]
    phi = [_turned(part, per) for part in inside]
    phi.append(np.arcsin(np.sqrt(np.minimum(hazard.layer(xi) / (2.0 * per), 1.0))))
    phi += [0.0 * per, 0.0 * per + 0.25 * math.pi, end[:, None]]
    edges = np.sort(np.minimum(np.concatenate(phi, axis=1), end[:, None]), axis=1)
    found, order = np.empty((3, xi.size)), _ORDER_FINE if fine else _ORDER_COARSE
    for start in range(0, xi.size, _THRESHOLDS_AT_ONCE):
        part = slice(start, start + _THRESHOLDS_AT_ONCE)
        held = xi[part], kappa[part]
        found[:, part] = _marched(contacts, hazard, held, edges[part], order)
    return found


def _steep_shares(contacts: Reduced) -> Array:
    """Births where 1/J_c(|y|) has risen, or jumps."""
    law = contacts.law
    at = np.unique(law.steps)
    if not law.steps.size:
        ends = [edge for edge in law.support if 0.0 < edge < math.inf]
        rare = np.asarray(law.inverse_survival(_FALLEN))
        at = np.concatenate((rare, law.breakpoints, ends))
    return np.append(at, -at) / law.scale


def _marched(
    contacts: Reduced,
    hazard: Hazard,
    held: tuple[Array, Array],
    edges: Array,
    order: int,
) -> Array:
    """`_mean_lives` on panels with these `edges` in phi, of contacts `held`: how far
    they are stretched at most, and their stiffness, both (n,)."""
    births, rule, (xi, springs) = law_of_births(contacts), clenshaw_curtis(order), held
    row, column = np.nonzero(np.diff(edges, axis=1) > 1e-15 * edges[:, 1:])
    half = 0.5 * (edges[row, column + 1] - edges[row, column])[:, None]
    phi = edges[row, column][:, None] + half * (1.0 + rule.nodes)
    size, kappa = xi[row, None], springs[row, None]
    above, below = 2.0 * size * np.sin(phi) ** 2, 2.0 * size * np.cos(phi) ** 2
    x = size * np.cos(2.0 * phi)
    pace = half * 2.0 * size * np.sin(2.0 * phi)  # dq, q = xi - x
    near, far = np.minimum(above, below), np.maximum(above, below)
    rate = pace * hazard.rate(near, far, size, kappa)
    rate[~np.isfinite(rate)] = 0.0
    force = kappa * x
    square = force**2 if _has_square(contacts) else np.zeros_like(x)
    sources = pace[..., None] * np.stack((np.ones_like(x), force, square), axis=2)
    solved = _collocated(rate, sources, order)
    at, total = np.zeros((xi.size, 3)), np.zeros((xi.size, 3))
    alone = isinstance(births, DeltaBirths)
    weights = x if alone else _weights_of_births(contacts, births, x, size)
    weights = weights * pace * rule.weights
    for i in range(edges.shape[1] - 1):
        now = np.flatnonzero(column == i)
        on = row[now]
        values = solved[now, :, :3] + solved[now, :, 3:] * at[on, None, :]
        at[on] = values[:, -1]
        if not alone:
            total[on] += (weights[now, :, None] * values).sum(axis=1)
    return np.asarray((at if alone else total).T)


def _weights_of_births(
    contacts: Reduced, births: BirthLaw, x: Array, xi: Array
) -> Array:
    """R per unit stretch at the nodes x of panels, for given births over J_c."""
    middle, law = x.mean(axis=1, keepdims=True), contacts.law
    if contacts.newborn.of == "threshold":
        return _density(births, x / xi, middle / xi) / xi
    at = np.abs(x)
    if law.steps.size:
        # J_c jumps between panels only, the last of which are very narrow
        at = np.minimum(np.abs(middle), (1.0 - _BELOW) * xi)
    return _density(births, x, middle) / np.maximum(law.sf(at * law.scale), 1e-300)


def _moments_over_thresholds(contacts: Reduced) -> tuple[Array, Array]:
    """Travel, work and square of contacts with thresholds of their own, and errors,
    both of shape (3,)."""
    law, births, hazard = contacts.law, law_of_births(contacts), hazard_of(contacts)
    of_threshold = contacts.newborn.of == "threshold"
    stretch = abs(births.stretch) if isinstance(births, DeltaBirths) else 0.0
    bound = 0.0 if of_threshold else stretch

    def gap_of(xi: Array) -> Array:
        return xi * (1.0 - stretch) if of_threshold else xi - bound

    if law.steps.size:
        xi, share, _ = different_steps(contacts)
        on = xi > bound
        xi, share = xi[on], share[on] / share[on].sum()
        mean, coarse = (
            _mean_lives(contacts, hazard, xi, gap_of(xi), fine=fine) @ share
            for fine in (True, False)
        )
        return mean, _coarse_error(mean, coarse)

    origin = rank_above(law, bound)

    def lives(e: Array, xi: Array, fine: bool = True) -> tuple[Array, float]:
        gap = gap_of(xi)
        if bound > 0.0:
            gap = _gaps(contacts, bound, gap, e)
            xi = bound + gap
        good, found = (xi > 0) & (gap > 0), np.zeros((3, xi.size))
        found[:, good] = _mean_lives(contacts, hazard, xi[good], gap[good], fine=fine)
        return found, 0.0

    (mean, missed), p = over_births(
        contacts,
        lives,
        CONVERGED,
        _NARROWEST_RANKS,
        origin=origin,
        edges=_first_ranks(contacts, births, origin),
        scales=_scales,
    )
    coarser = functools.partial(lives, fine=False)
    terms, _ = terms_of_births(law, coarser, p.left, p.right, origin)
    coarse = (terms @ ClenshawCurtis.weights).sum(axis=1)
    error = missed + _coarse_error(mean, coarse)
    error[:2] += beyond(contacts) * math.exp(min(origin, 460.0))
    if _has_square(contacts):
        rest, unsure = _squares_beyond(contacts, hazard, origin, gap_of)
        mean[2] += rest
        error[2] += unsure
    return mean, error


def _squares_beyond(
    contacts: Reduced, hazard: Hazard, origin: float, gap_of: Callable[[Array], Array]
) -> tuple[float, float]:
    """Contribution of lives to the mean square beyond the last panel, and a bound on
    its error: as they fall with e before it. Nothing where there is no such mean."""
    law, last = contacts.law, min(math.exp(BIRTHS[-1]), _STRONGEST - origin)
    if law.support[1] < math.inf:
        return 0.0, 0.0
    e = last - np.array([50.0, 25.0, 0.0])
    xi = np.asarray(law.inverse_survival(origin + e)) / law.scale
    with np.errstate(divide="ignore", invalid="ignore"):  # terms that vanish
        log_terms = np.log(_mean_lives(contacts, hazard, xi, gap_of(xi))[2]) - e
        before, decay = -np.diff(log_terms) / 25.0
    if log_terms[-1] == -math.inf or not min(before, decay) > 1e-9:
        return 0.0, 0.0
    rest = math.exp(log_terms[-1]) / decay
    # as in `threshold.means_above`
    return rest, rest * (abs(decay - before) / 25.0 / decay**2 + 1e-12 / decay)


def _gaps(contacts: Reduced, bound: float, gap: Array, e: Array) -> Array:
    """xi - bound where -ln J_c(xi)/J_c(bound) = e, small ones without cancellation."""
    near = (gap < 0.1 * bound) & (e < 0.1)
    if not near.any():
        return gap
    law, scale = contacts.law, contacts.law.scale
    share = float(law.sf(bound * scale)) * -np.expm1(-e[near])
    g = share / max(float(law.pdf(bound * scale)) * scale, 1e-300)
    g = np.where(gap[near] > 0.3 * g, np.minimum(gap[near], 3.0 * g), g)
    for _ in range(4):
        nodes, weights = gauss_legendre(5).between(0.0 * g, g)
        held = (law.pdf((bound + nodes) * scale) * scale * weights).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            g = np.where(held > 0, share / (held / g), g)
    better = np.isfinite(g) & (np.abs(g - gap[near]) < 1e-6 * bound)
    gap = gap.copy()
    gap[near] = np.where(better, g, gap[near])
    return gap


def _first_ranks(contacts: Reduced, births: BirthLaw, origin: float) -> Array:
    """Ends of the first panels in ln(-ln J_c/J_c(bound))."""
    law, barrier, low = contacts.law, contacts.barrier, BIRTHS[0]
    low -= max(barrier.log_w, 0.0) if barrier.thermal else 0.0
    inner = [rank_above(law, float(x)) for x in law.breakpoints / law.scale]
    if not isinstance(births, DeltaBirths) and contacts.newborn.of == "length":
        kinks = marks_of_births(births)
        for y in births.range if isinstance(births, UniformBirths) else kinks:
            born = min(rank_above(law, abs(float(y))), 465.0)
            inner += (born + _RARER_THAN_BIRTHS).tolist()
    at = np.array(inner) - origin
    more = np.log(at[np.isfinite(at) & (at > 0)])
    short = np.arange(low, BIRTHS[0], 12.0)
    edges = np.unique(np.concatenate((BIRTHS, short, more)))
    top = min(BIRTHS[-1], math.log(_STRONGEST - origin))
    edges = np.append(edges[(edges >= low) & (edges < top - 1e-3)], top)
    return edges[np.append(True, np.diff(edges) > 1e-9)]


# ------------------------------------------------------------------------------------------------------
# in one sweep


class _Sweep:
    """The published master equation with births R(x): solutions on panels, downwards
    from where nothing survives."""

    def __init__(self, contacts: Reduced) -> None:
        self.contacts, self.births = contacts, law_of_births(contacts)
        self.steps = contacts.law.steps / contacts.law.scale
        self.has_square = _has_square(contacts)

    def evaluate(self, left: Array, right: Array, _: Array) -> Array:
        """Solutions of panels, the last axis."""
        return np.moveaxis(self.solve(left, right, _ORDER_FINE), 0, -1)

    def solve(
        self, left: Array, right: Array, order: int, *, finer: bool = False
    ) -> Array:
        """`_collocated` on panels in x, from right to left."""
        contacts, law = self.contacts, self.contacts.law
        half = 0.5 * (right - left)[:, None]
        x = right[:, None] - half * (1.0 + clenshaw_curtis(order).nodes)
        size, up = np.abs(x).ravel(), np.broadcast_to(left[:, None] >= 0.0, x.shape)
        # stiffness and attempts on a discrete law jump between panels only
        middle, rate = np.repeat(0.5 * (left + right), order + 1), np.zeros_like(x)
        if contacts.barrier.thermal:
            above = np.abs(middle)
            attempts = successful_attempts(contacts, size, above=above, finer=finer)
            rate += attempts.reshape(x.shape)
        ahead = np.where(up.ravel(), middle if law.steps.size else x.ravel(), 0.0)
        stiff = stiffness_of_survivors(contacts, ahead)
        mean, square = (part.reshape(x.shape) for part in stiff)
        if not law.steps.size:
            at = size * law.scale
            with np.errstate(divide="ignore", invalid="ignore"):
                broken = law.pdf(at) * law.scale / law.sf(at)
            broken[~np.isfinite(broken)] = 0.0
            rate += np.where(up, broken.reshape(x.shape), 0.0)
        square = square * x**2 if self.has_square else np.zeros_like(x)
        sources = np.stack((np.ones_like(x), mean * x, square), axis=2)
        return _collocated(half * rate, half[..., None] * sources, order)

    def combined(self, panels: Panels, values: Array) -> Array:
        """Solutions at nodes, shape (panels, nodes, 3)."""
        found = np.empty((*values.shape[:2], 3))
        at = np.zeros(3)
        for i in range(panels.left.size - 1, -1, -1):
            at = at * self.passing(float(panels.right[i]))
            found[i] = values[i, :, :3] + values[i, :, 3:] * at
            at = found[i, -1]
        return found

    def passing(self, x: float) -> float:
        """The factor by which moments of the rest of life fall just below a stretch x,
        where contacts of a discrete law may break."""
        steps = self.steps
        if x <= 0.0 or not steps.size:
            return 1.0
        left, right = np.searchsorted(steps, x * np.array([1.0 - 1e-13, 1.0 + 1e-13]))
        return float(steps.size - right) / max(float(steps.size - left), 1.0)

    def weighed(self, panels: Panels, solution: Array) -> tuple[Array, Array]:
        """Means over births, and the integrand of each panel at its nodes times half
        the width."""
        if isinstance(self.births, DeltaBirths):
            return solution[0, -1], np.zeros_like(solution)
        rule = clenshaw_curtis(solution.shape[1] - 1)
        half = 0.5 * (panels.right - panels.left)[:, None]
        middle = panels.left[:, None] + half
        weights = _density(self.births, middle - half * rule.nodes, middle) * half
        integrand = weights[..., None] * solution
        return (rule.weights @ integrand).sum(axis=0), integrand

    def judge(self, panels: Panels) -> tuple[Array, tuple[Array, Array]]:
        """Find panels that are too rough; means over births and what they miss."""
        found = self.combined(panels, np.moveaxis(panels.values, -1, 0))
        mean, integrand = self.weighed(panels, found)
        tail = np.abs(ClenshawCurtis.tail.T @ found).sum(axis=1)
        L = np.abs(found[..., 0]).max(axis=1)
        size = np.maximum(np.abs(panels.left), np.abs(panels.right))
        far = np.maximum(size, L)
        most = L[:, None] * np.array([np.ones_like(size), far, far**2]).T
        missed = np.abs(ClenshawCurtis.tail.T @ integrand).sum(axis=1)
        most = np.maximum(most, _scales(mean))  # what is missed fades downwards
        rough = (tail > CONVERGED * most).any(axis=1)
        rough |= (missed > CONVERGED * _scales(mean)).any(axis=1)
        wide = panels.right - panels.left > _SHORTEST_PANEL * size
        return rough & wide, (mean, missed.sum(axis=0))

    def first_stretches(self) -> Array:
        """Ends of the first panels, from the lowest birth to where nothing survives."""
        law, at = self.contacts.law, marks_of_births(self.births)
        up, top = self.steps, float(self.steps.max(initial=0.0))
        if not law.steps.size:
            up = np.append(law.inverse_survival(_ENDS), law.breakpoints) / law.scale
            up = up[(up > 0) & np.isfinite(up)]
            top = min(float(up.max()), law.support[1] / law.scale)
            # errors are relative to the right end of a panel, and a life is not
            far = np.sort(np.log(up[up > 1.0]))
            for left, right in itertools.pairwise(far):
                pieces = math.ceil((right - left) / _LONGEST_SWEPT)
                up = np.append(up, np.exp(np.linspace(left, right, pieces + 1)[1:-1]))
            up = np.append(up, max(law.support[0] / law.scale, 0.0))
        sides = np.concatenate((up, -up, at, [0.0, top]))
        return np.unique(sides[(sides >= at[0]) & (sides <= top)])


def _swept(contacts: Reduced) -> tuple[Array, Array]:
    """Travel, work and square of contacts of the published master equation, and errors,
    both of shape (3,)."""
    sweep = _Sweep(contacts)
    first = sweep.first_stretches()
    p, (mean, missed) = refined(
        sweep.evaluate, sweep.judge, first, pieces=_SPLIT, most=_MOST_STRETCHES
    )
    other = sweep.solve(p.left, p.right, _ORDER_COARSE, finer=True)
    coarse, _ = sweep.weighed(p, sweep.combined(p, other))
    return mean, missed + _coarse_error(mean, coarse)
