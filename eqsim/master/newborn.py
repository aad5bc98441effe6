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
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev
from scipy import special

from eqsim.laws.newborn import (
    BirthLaw,
    DeltaBirths,
    ExponentialBirths,
    NormalBirths,
    UniformBirths,
)
from eqsim.laws.threshold import Gamma, ThresholdLaw, panels_above
from eqsim.master import annealed, quenched
from eqsim.master.quenched import Moments, beyond, different_steps, kappa_of
from eqsim.model.reduced import Reduced
from eqsim.numerics.panels import ClenshawCurtis, Panels, refined
from eqsim.numerics.quadrature import gauss_legendre
from eqsim.numerics.tables import Array

METHOD = "joint kinetic equation, births stretched"
PUBLISHED = "published master equation, births R(x)"

_LEVELS = np.array(
    [
        -36.0,
        -24.0,
        -16.0,
        -10.0,
        -6.0,
        -3.0,
        -1.5,
        -0.5,
        0.25,
        1.0,
        1.75,
        2.5,
        3.25,
        4.0,
    ]
)  # of ln Lambda
# The distance of levels beyond these, where 1/p is followed.
_STEP = 5.0
# Hazards at the threshold's full rate, next to the threshold, where panels end.
_LAYER = np.array([0.3, 1.5, 4.0, 10.0, 25.0, 50.0])
# Order of the rule, and of a coarser one that tells the error.
_ORDER = 16
_COARSE = 12
# By how much levels are shifted with the coarser rule.
_SHIFT = 0.3

# The first panels of thresholds, in ln(-ln J_c/J_c(bound)).
_FIRST = np.array(
    [-35.0, -20.0, -12.0, -7.0, -4.0, -2.0, -0.5, 0.75, 1.75, 2.75, 3.75, 5.0, 6.2]
)
_RARER = np.array(
    [0.0, 0.3, 1.0, 3.0, 8.0, 20.0, 45.0]
)  # -ln J_c beyond that of births
# The relative error that ends refinement over thresholds.
_CONVERGED = 2e-12
# The narrowest panel of thresholds.
_NARROWEST = 1e-5
# Panels of thresholds at most.
_MOST_PANELS = 400
# -ln J_c of the strongest contact that is asked for.
_RAREST = 510.0
# Thresholds that are solved for at once, to bound memory.
_AT_ONCE = 300
# The least relative error that is quoted.
_ROUNDING = 1e-11
# Share of the work's parts that its error is measured by where they cancel.
_CANCELLED = 1e-2

# -ln J_c where panels of the stretches of annealed contacts end.
_LAW = np.array([1e-4, 0.02, 0.3, 1.0, 2.5, 6.0, 15.0, 40.0, 120.0, 300.0, 550.0])
# Where a panel is split.
_PIECES = np.array([0.0, 0.1, 0.5, 0.9, 1.0])
# The relative error that ends refinement over stretches.
_RESOLVED = 2e-12
# The shortest panel, relative to its distance from 0.
_SHORTEST = 1e-14
# Panels of stretches at most.
_MOST_STRETCHES = 1200
# Where panels of normal births end, in standard deviations, and of exponential ones, in
# means.
_SCALES = np.array(
    [-8.3, -6.5, -5.0, -3.5, -2.5, -1.5, -0.7, 0.0, 0.7, 1.5, 2.5, 3.5, 5.0, 6.5, 8.3]
)
_DECAYS = np.array([0.0, 0.25, 0.7, 1.5, 3.0, 5.0, 8.0, 12.0, 18.0, 26.0, 36.0])


class _Rule(NamedTuple):
    """A rule like `ClenshawCurtis`, of any order; `cumulative` times values are the
    integrals from -1 to each node."""

    nodes: Array
    weights: Array
    cumulative: Array


# Two orders are used. A rule takes 0.25 ms, and a solve of 20 ms asks for twenty.
@functools.lru_cache(maxsize=4)
def _rule(order: int) -> _Rule:
    nodes = -np.cos(math.pi * np.arange(order + 1) / order)
    back = np.linalg.inv(chebyshev.chebvander(nodes, order))
    cumulative = chebyshev.chebval(nodes, chebyshev.chebint(back, lbnd=-1)).T
    return _Rule(nodes, cumulative[-1], cumulative)


def births_of(contacts: Reduced) -> BirthLaw:
    """R in units of `law.scale`, or of fractions."""
    return contacts.newborn.reduced(contacts.law.scale)


def mean_birth(contacts: Reduced) -> float:
    """E[y], in units of `law.scale`."""
    per = (
        contacts.law.mean / contacts.law.scale
        if contacts.newborn.of == "threshold"
        else 1.0
    )
    return births_of(contacts).mean * per


def marks(law: BirthLaw) -> Array:
    """Where panels of births end."""
    if isinstance(law, UniformBirths):
        return np.array([law.low, law.high])
    if isinstance(law, ExponentialBirths):
        return law.mean * _DECAYS
    if isinstance(law, NormalBirths):
        return law.mean + law.std * _SCALES
    return np.array([law.stretch])


def _density(births: BirthLaw, y: Array, middle: Array) -> Array:
    """R(y) on panels around `middle`, none of which a jump of R is inside; at their
    ends y may be rounded across it."""
    low, high = births.range
    return np.where(
        (middle > low) & (middle < high), births.pdf(np.clip(y, low, high)), 0.0
    )


def method(contacts: Reduced) -> str:
    """The equation that is solved."""
    return PUBLISHED if contacts.one_sided else METHOD


def stationary(contacts: Reduced) -> Moments:
    """Moments of the lives of contacts born stretched. Raises InputError for annealed
    contacts of more than 1000 different thresholds."""
    mean, error = _swept(contacts) if contacts.one_sided else _over_thresholds(contacts)
    square = (
        (mean[2], error[2]) if error[2] < mean[2] else (None, 0.0)
    )  # of broad laws nothing may be known
    return Moments(mean[0], mean[1], error[0], error[1], mean_birth(contacts), *square)


def _scales(mean: Array) -> Array:
    """Scales of errors of travel, work and square: the work may vanish though its parts
    do not."""
    return np.abs(
        [
            mean[0],
            np.abs(mean[1]) + _CANCELLED * math.sqrt(abs(mean[0] * mean[2])),
            mean[2],
        ]
    )


def _solved(rate: Array, sources: Array, order: int) -> Array:
    """Solutions of f' = sources - rate f on panels, primes per unit of a panel's own
    variable from -1 to 1.

    Parameters
    ----------
    rate : ndarray, shape (panels, nodes)
    sources : ndarray, shape (panels, nodes, 3)

    Returns
    -------
    ndarray, shape (panels, nodes, 4)
        Those that begin at 0, and the one that begins at 1 without sources.
    """
    rule = _rule(order)
    matrix = np.eye(order + 1) + rule.cumulative * rate[:, None, :]
    right = np.concatenate(
        (rule.cumulative @ sources, np.ones((*rate.shape, 1))), axis=2
    )
    return np.asarray(np.linalg.solve(matrix, right))


# -----------------------------------------------------------------------------------------------
# for each threshold


class Hazard(NamedTuple):
    """Hazard of a contact of threshold xi before it reaches the threshold.

    Attributes
    ----------
    rate : callable
        From gap = xi - |x|, total = xi + |x|, xi and kappa, arrays that broadcast, to
        the hazard per unit displacement.
    levels : callable
        From xi, kappa, shape (n,), and a shift of levels to |x| where panels end, shape
        (n, any).
    layer : callable
        From xi, shape (n,), to gaps where they end, shape (n, any).
    """

    rate: Callable[[Array, Array, Array, Array], Array]
    levels: Callable[[Array, Array, float], Array]
    layer: Callable[[Array], Array]


def hazard_of(contacts: Reduced) -> Hazard:
    """Own attempts, or pooled ones."""
    barrier = contacts.barrier
    if not barrier.thermal:
        nothing = np.empty(0)
        return Hazard(
            lambda gap, *_: 0.0 * gap,
            lambda xi, *_: np.broadcast_to(nothing, (xi.size, 0)),
            lambda xi: np.broadcast_to(nothing, (xi.size, 0)),
        )
    if contacts.annealed:
        return _pooled(contacts)

    def rate(gap: Array, total: Array, xi: Array, kappa: Array) -> Array:
        with np.errstate(divide="ignore"):
            return np.exp(
                barrier.log_w + barrier.log_attempt(gap, total, xi, barrier.b * kappa)
            )

    def levels(xi: Array, kappa: Array, shift: float) -> Array:
        most = (
            float(np.log(barrier.whole_hazard(xi, kappa)).max())
            if barrier.log_w < 5.0
            else barrier.log_w + 4.0
        )
        more = np.arange(_LEVELS[-1] + _STEP, most, _STEP)
        at = np.concatenate((_LEVELS, more)) + shift
        return barrier.stretch_at(at, xi, barrier.b * kappa)

    def layer(xi: Array) -> Array:
        low, high = (
            np.full((xi.size, _LAYER.size), -600.0),
            np.zeros((xi.size, _LAYER.size)),
        )
        for _ in range(25):
            middle = 0.5 * (low + high)
            gap = xi[:, None] * np.exp(middle)
            far = np.log(gap) + barrier.log_w + barrier.log_prefactor(
                gap, xi[:, None]
            ) > np.log(_LAYER)
            low, high = np.where(far, low, middle), np.where(far, middle, high)
        return xi[:, None] * np.exp(high)

    return Hazard(rate, levels, layer)


class PooledPolynomials:
    """(omega/v) h(x) of annealed contacts at x >= 0 as Chebyshev polynomials, and its
    integral."""

    def __init__(self, contacts: Reduced) -> None:
        self._steps = different_steps(contacts) if contacts.law.steps.size else None
        self._s = contacts
        if self._steps is not None:
            edges = np.append(0.0, self._steps[0])
        else:
            top = (
                np.asarray(contacts.law.inverse_survival(_LAW[:-1]))
                / contacts.law.scale
            )
            least, greatest = (
                edge / contacts.law.scale for edge in contacts.law.support
            )
            edges = np.unique(
                np.concatenate(
                    ([0.0, least], top, contacts.law.kinks / contacts.law.scale)
                )
            )
            edges = edges[edges <= min(greatest, top[-1])]

        def evaluate(left: Array, right: Array, _: Array) -> Array:
            x = left[:, None] + 0.5 * (right - left)[:, None] * (
                1.0 + ClenshawCurtis.nodes
            )
            return self.exact(x.ravel(), left, right).reshape(x.shape).T

        def judge(panels: Panels) -> tuple[Array, None]:
            rough = np.abs(ClenshawCurtis.tail.T @ panels.values).sum(axis=0) * (
                panels.right - panels.left
            )
            total = (
                ClenshawCurtis.weights @ panels.values * (panels.right - panels.left)
            ).cumsum()
            # what counts is how well hazards are known, of all before it and of a life
            seen = np.minimum(_RESOLVED * np.maximum(total, 1.0), 1e-9)
            return (rough > np.maximum(seen, _RESOLVED * total[-1] * 1e-3)) & (
                panels.right - panels.left > 1e-13 * panels.right
            ), None

        p, _ = refined(evaluate, judge, edges, pieces=_PIECES, most=_MOST_STRETCHES)
        self.edges = np.append(p.left, p.right[-1])
        self._half = 0.5 * (p.right - p.left)
        self._coefficients = ClenshawCurtis.coefficients @ p.values
        self._sums = np.append(
            0.0, (ClenshawCurtis.weights @ p.values * self._half).cumsum()
        )
        self._integrals = chebyshev.chebint(self._coefficients, lbnd=-1) * self._half

    def exact(
        self, x: Array, left: Array | None = None, right: Array | None = None
    ) -> Array:
        """h at x >= 0, shape (n,); of a discrete law between its steps."""
        if self._steps is None:
            return annealed.successful_attempts(self._s, x)
        middle = (
            x
            if left is None or right is None
            else np.repeat(0.5 * (left + right), x.size // left.size)
        )
        total, barrier = np.zeros(x.size), self._s.barrier
        with np.errstate(divide="ignore"):
            for xi, share, kappa in zip(*self._steps, strict=True):
                on = middle < xi
                gap = np.maximum(xi - x[on], 0.0)
                total[on] += share * np.exp(
                    barrier.log_w
                    + barrier.log_attempt(gap, xi + x[on], xi, barrier.b * kappa)
                )
        return total

    def _at(self, x: Array) -> tuple[Array, Array]:
        panel = np.clip(
            np.searchsorted(self.edges, x, side="right") - 1, 0, self._half.size - 1
        )
        return panel, np.clip(
            (x - self.edges[panel]) / self._half[panel] - 1.0, -1.0, 1.0
        )

    def __call__(self, x: Array) -> Array:
        """h at x >= 0 of any shape."""
        panel, t = self._at(np.ravel(x))
        found = chebyshev.chebval(t, self._coefficients[:, panel], tensor=False)
        return np.where(
            np.ravel(x) > self.edges[-1], 0.0, np.maximum(found, 0.0)
        ).reshape(np.shape(x))

    def integral(self, x: Array) -> Array:
        """(omega/v) G at x >= 0 of any shape."""
        panel, t = self._at(np.ravel(x))
        return (
            self._sums[panel]
            + chebyshev.chebval(t, self._integrals[:, panel], tensor=False)
        ).reshape(np.shape(x))


# It takes 1 to 10 ms, and a transient asks for it 60 times; ensembles are solved one
# after another.
@functools.lru_cache(maxsize=8)
def pooled_polynomials(contacts: Reduced) -> PooledPolynomials:
    """Pooled rate of an ensemble, remembered."""
    return PooledPolynomials(contacts)


def _pooled(contacts: Reduced) -> Hazard:
    pooled = pooled_polynomials(contacts)
    grid = np.unique(
        np.concatenate((pooled.edges, np.linspace(0.0, pooled.edges[-1], 2000)))
    )
    passed = pooled.integral(grid)

    def levels(xi: Array, kappa: Array, shift: float) -> Array:
        at = np.exp(
            np.append(
                _LEVELS,
                np.arange(
                    _LEVELS[-1] + _STEP, max(math.log(passed[-1] + 1e-300), 5.0), _STEP
                ),
            )
            + shift
        )
        inner = np.concatenate((np.interp(at, passed, grid), pooled.edges))
        return np.broadcast_to(inner, (xi.size, inner.size))

    def layer(xi: Array) -> Array:
        return np.minimum(_LAYER / np.maximum(pooled(xi), 1e-200)[:, None], xi[:, None])

    return Hazard(
        lambda gap, total, xi, kappa: pooled(0.5 * (total - gap)), levels, layer
    )


def _turned(x: Array, xi: Array) -> Array:
    """phi of stretches x in x = xi cos(2 phi)."""
    return np.arcsin(np.sqrt(np.clip((xi - x) / (2.0 * xi), 0.0, 1.0)))


def lives(
    contacts: Reduced, hazard: Hazard, xi: Array, gap: Array, *, fine: bool = True
) -> Array:
    """Travel, work and square of contacts of thresholds xi, shape (n,), averaged over
    births that know them.

    Parameters
    ----------
    gap : ndarray, shape (n,)
        xi - |y| of identical births; of others it does not count, and means are over
        R(y)/J_c(|y|) for given births.
    fine : bool
        Whether not to use the coarser rule, on other panels.

    Returns
    -------
    ndarray, shape (3, n)
    """
    law, order = births_of(contacts), _ORDER if fine else _COARSE
    shift = 0.0 if fine else _SHIFT
    kappa, per = kappa_of(contacts, xi), xi[:, None]
    at = marks(law) * (per if contacts.newborn.of == "threshold" else np.ones_like(per))
    level = hazard.levels(xi, kappa, shift)
    alone = isinstance(law, DeltaBirths)
    if isinstance(
        law, DeltaBirths
    ):  # one of the two distances is known without cancellation
        half = np.sqrt(gap / (2.0 * xi))
        end = np.arcsin(half) if law.stretch >= 0 else np.arccos(half)
        inside = [level, -level]
    else:
        end = _turned(np.maximum(at[:, 0], -xi), xi)
        inside = [level, -level, at]
        if contacts.newborn.of == "length":
            inside += [part + 0.0 * per for part in _steep(contacts)]
    phi = [_turned(part, per) for part in inside]
    phi += [
        np.arcsin(np.sqrt(np.minimum(hazard.layer(xi) / (2.0 * per), 1.0))),
        np.full((xi.size, 1), 0.25 * math.pi),
    ]
    edges = np.sort(
        np.minimum(
            np.concatenate((*phi, np.zeros_like(per), end[:, None]), axis=1),
            end[:, None],
        ),
        axis=1,
    )
    found = np.empty((3, xi.size))
    for start in range(0, xi.size, _AT_ONCE):
        part = slice(start, start + _AT_ONCE)
        found[:, part] = _marched(
            contacts,
            hazard,
            xi[part],
            kappa[part],
            edges[part],
            None if alone else law,
            order,
        )
    return found


def _steep(contacts: Reduced) -> list[Array]:
    """Where 1/J_c(|y|) has risen, or jumps."""
    if contacts.law.steps.size:
        at = np.unique(contacts.law.steps) / contacts.law.scale
    else:
        rare = np.asarray(
            contacts.law.inverse_survival(
                np.array([1.0, 3.0, 7.0, 14.0, 28.0, 60.0, 120.0, 250.0])
            )
        )
        ends = [edge for edge in contacts.law.support if 0.0 < edge < math.inf]
        at = np.concatenate((rare, contacts.law.breakpoints, ends)) / contacts.law.scale
    return [at, -at]


def _marched(
    contacts: Reduced,
    hazard: Hazard,
    xi: Array,
    kappa: Array,
    edges: Array,
    births: BirthLaw | None,
    order: int,
) -> Array:
    """`lives` on panels with these `edges` in phi."""
    rule = _rule(order)
    row, column = np.nonzero(np.diff(edges, axis=1) > 1e-15 * edges[:, 1:])
    half = 0.5 * (edges[row, column + 1] - edges[row, column])[:, None]
    phi = edges[row, column][:, None] + half * (1.0 + rule.nodes)
    own, k = xi[row, None], kappa[row, None]
    above, below = 2.0 * own * np.sin(phi) ** 2, 2.0 * own * np.cos(phi) ** 2
    x = own * np.cos(2.0 * phi)
    pace = half * 2.0 * own * np.sin(2.0 * phi)  # dq, q = xi - x
    rate = pace * hazard.rate(
        np.minimum(above, below), np.maximum(above, below), own, k
    )
    rate[~np.isfinite(rate)] = 0.0
    force = k * x
    solved = _solved(
        rate,
        pace[..., None] * np.stack((np.ones_like(x), force, force**2), axis=2),
        order,
    )
    weights = None
    if births is not None:
        middle = x.mean(axis=1, keepdims=True)
        if contacts.newborn.of == "threshold":
            weights = _density(births, x / own, middle / own) / own
        else:
            at_all = (
                middle if contacts.law.steps.size else x
            )  # J_c of a discrete law jumps between panels only
            weights = _density(births, x, middle) / np.maximum(
                contacts.law.sf(np.abs(at_all) * contacts.law.scale), 1e-300
            )
        weights = weights * pace * rule.weights
    at, total = np.zeros((xi.size, 3)), np.zeros((xi.size, 3))
    for i in range(edges.shape[1] - 1):
        now = np.flatnonzero(column == i)
        who = row[now]
        values = solved[now, :, :3] + solved[now, :, 3:] * at[who, None, :]
        at[who] = values[:, -1]
        if weights is not None:
            total[who] += (weights[now, :, None] * values).sum(axis=1)
    return np.asarray((at if weights is None else total).T)


def _over_thresholds(contacts: Reduced) -> tuple[Array, Array]:
    """Travel, work and square of contacts with thresholds of their own, and errors,
    both of shape (3,)."""
    law, births, hazard = contacts.law, births_of(contacts), hazard_of(contacts)
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
            lives(contacts, hazard, xi, gap_of(xi), fine=fine) @ share
            for fine in (True, False)
        )
        return mean, np.abs(mean - coarse) + _ROUNDING * _scales(mean)

    origin = rank(law, bound)

    def terms(left: Array, right: Array, fine: bool) -> Array:
        half = 0.5 * (right - left)[:, None]
        e = np.exp(left[:, None] + half * (1.0 + ClenshawCurtis.nodes))
        xi = np.asarray(law.inverse_survival(origin + e.ravel())) / law.scale
        gap = gap_of(xi)
        if bound > 0.0:
            gap = _gaps(contacts, bound, gap, e.ravel())
            xi = bound + gap
        good = (xi > 0) & (gap > 0)
        found = np.zeros((3, xi.size))
        found[:, good] = lives(contacts, hazard, xi[good], gap[good], fine=fine)
        return found.reshape(3, *e.shape) * (half * e * np.exp(-e))

    def evaluate(left: Array, right: Array, _: Array) -> Array:
        fine = terms(left, right, True)
        return np.array(
            [
                fine @ ClenshawCurtis.weights,
                np.abs(fine @ ClenshawCurtis.tail).sum(axis=2),
            ]
        )

    def judge(panels: Panels) -> tuple[Array, Array]:
        mean = panels.values[0].sum(axis=1)
        rough = (panels.values[1] > _CONVERGED * _scales(mean)[:, None]).any(axis=0)
        return rough & (panels.right - panels.left > _NARROWEST), mean

    p, mean = refined(
        evaluate, judge, _first_ranks(contacts, births, origin), most=_MOST_PANELS
    )
    coarse = (terms(p.left, p.right, False) @ ClenshawCurtis.weights).sum(axis=1)
    error = p.values[1].sum(axis=1) + np.abs(mean - coarse) + _ROUNDING * _scales(mean)
    rarest = beyond(contacts) * math.exp(min(origin, 460.0))
    rest, missed = _squares_beyond(contacts, hazard, origin, gap_of)
    mean[2] += rest
    return mean, error + np.array([rarest[0], rarest[1], missed])


def _squares_beyond(
    contacts: Reduced, hazard: Hazard, origin: float, gap_of: Callable[[Array], Array]
) -> tuple[float, float]:
    """Contribution of lives to the mean square beyond the last panel, and a bound on
    its error: as they fall with e before it. Nothing where there is no such mean."""
    law, last = contacts.law, min(math.exp(_FIRST[-1]), _RAREST - origin)
    if law.support[1] < math.inf:
        return 0.0, 0.0
    e = last - np.array([50.0, 25.0, 0.0])
    xi = np.asarray(law.inverse_survival(origin + e)) / law.scale
    with np.errstate(divide="ignore"):
        log_terms = np.log(lives(contacts, hazard, xi, gap_of(xi))[2]) - e
    before, decay = -np.diff(log_terms) / 25.0
    if log_terms[-1] == -math.inf or not min(before, decay) > 1e-9:
        return 0.0, 0.0
    rest = math.exp(log_terms[-1]) / decay
    return rest, rest * (
        abs(decay - before) / 25.0 / decay**2 + 1e-12 / decay
    )  # as in `threshold.means_above`


def rank(law: ThresholdLaw, x: float) -> float:
    """-ln J_c(x), x in units of the scale; infinite where no threshold is above."""
    low, above = (
        float(law.cdf(max(x, 0.0) * law.scale)),
        float(law.sf(max(x, 0.0) * law.scale)),
    )
    if low < 0.5:
        return -math.log1p(-low)
    return -math.log(above) if above > 0.0 else math.inf


def _gaps(contacts: Reduced, bound: float, gap: Array, e: Array) -> Array:
    """xi - bound where -ln J_c(xi)/J_c(bound) = e, small ones without cancellation."""
    near = (gap < 0.1 * bound) & (e < 0.1)
    if not near.any():
        return gap
    nodes, weights = gauss_legendre(5)
    scale = contacts.law.scale
    share = float(contacts.law.sf(bound * scale)) * -np.expm1(-e[near])
    g = share / max(float(contacts.law.pdf(bound * scale)) * scale, 1e-300)
    g = np.where(gap[near] > 0.3 * g, np.minimum(gap[near], 3.0 * g), g)
    for _ in range(4):
        density = (
            contacts.law.pdf((bound + 0.5 * g[:, None] * (1.0 + nodes)) * scale)
            * scale
            @ (0.5 * weights)
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            g = np.where(density > 0, share / density, g)
    better = np.isfinite(g) & (np.abs(g - gap[near]) < 1e-6 * bound)
    gap = gap.copy()
    gap[near] = np.where(better, g, gap[near])
    return gap


def _first_ranks(contacts: Reduced, births: BirthLaw, origin: float) -> Array:
    """Ends of the first panels in ln(-ln J_c/J_c(bound))."""
    low = (
        _FIRST[0] - max(contacts.barrier.log_w, 0.0)
        if contacts.barrier.thermal
        else _FIRST[0]
    )
    found = [_FIRST, np.arange(low, _FIRST[0], 12.0)]
    inner = [
        rank(contacts.law, float(x))
        for x in contacts.law.breakpoints / contacts.law.scale
    ]
    if not isinstance(births, DeltaBirths) and contacts.newborn.of == "length":
        kinks = births.range if isinstance(births, UniformBirths) else marks(births)
        for y in kinks:
            inner += list(min(rank(contacts.law, abs(float(y))), 465.0) + _RARER)
    at = np.array(inner) - origin
    with np.errstate(divide="ignore", invalid="ignore"):
        found.append(np.log(at[np.isfinite(at) & (at > 0)]))
    edges = np.unique(np.concatenate(found))
    top = min(_FIRST[-1], math.log(_RAREST - origin))
    edges = np.append(edges[(edges >= low) & (edges < top - 1e-3)], top)
    return edges[np.append(True, np.diff(edges) > 1e-9)]


# ------------------------------------------------------------------------------------------------------
# in one sweep


def stiffness_of_survivors(contacts: Reduced, x: Array) -> tuple[Array, Array]:
    """E[kappa | xi > x] and E[kappa^2 | xi > x] at x > 0, shape (n,), of a smooth law."""
    if contacts.stiffness == "uniform":
        return np.ones_like(x), np.ones_like(x)
    law = contacts.law
    if isinstance(law, Gamma):
        shape, u = law.n + 1.0, x**2
        J = special.gammaincc(shape, u)
        mean, square = (
            special.gammaincc(shape + p, u) / J * special.poch(shape, p)
            for p in (0.5, 1.0)
        )
        return mean / contacts.rms, square / contacts.rms**2
    nodes, weights = special.roots_legendre(12)
    edges = panels_above(law, x, quenched.weakest(law) + np.zeros((x.size, 1)))
    half = 0.5 * np.diff(edges, axis=1)[:, :, None]
    kappa = kappa_of(contacts, edges[:, :-1, None] + half * (1.0 + nodes))
    terms = half * weights * law.pdf(kappa * contacts.rms * law.scale)
    terms = np.where((half > 0) & np.isfinite(terms), terms, 0.0)
    total = terms.sum(axis=(1, 2))
    own = kappa_of(contacts, x)  # where hardly a threshold is above
    with np.errstate(divide="ignore", invalid="ignore"):
        mean, square = (
            (terms * kappa**power).sum(axis=(1, 2)) / total for power in (1, 2)
        )
        return np.where(total > 0, mean, own), np.where(total > 0, square, own**2)


def _swept(contacts: Reduced) -> tuple[Array, Array]:
    """Travel, work and square of contacts of the published master equation, and errors,
    both of shape (3,)."""
    law, births = contacts.law, births_of(contacts)
    steps = different_steps(contacts) if law.steps.size else None
    pooled = (
        PooledPolynomials(contacts)
        if steps is not None and contacts.barrier.thermal
        else None
    )

    def solve(left: Array, right: Array, order: int, *, finer: bool = False) -> Array:
        rule = _rule(order)
        half = 0.5 * (right - left)[:, None]
        x = right[:, None] - half * (1.0 + rule.nodes)
        size, up = np.abs(x), np.broadcast_to(left[:, None] >= 0.0, x.shape)
        rate, mean, square = np.zeros_like(x), np.ones_like(x), np.ones_like(x)
        flat = size.ravel()
        if pooled is not None:
            rate += pooled.exact(flat, *np.sort(np.abs([left, right]), axis=0)).reshape(
                x.shape
            )
        elif contacts.barrier.thermal:
            rate += annealed.successful_attempts(contacts, flat, finer=finer).reshape(
                x.shape
            )
        if steps is None:
            with np.errstate(divide="ignore", invalid="ignore"):
                own = law.pdf(flat * law.scale) * law.scale / law.sf(flat * law.scale)
            rate += np.where(
                up, np.where(np.isfinite(own), own, 0.0).reshape(x.shape), 0.0
            )
            survivors = stiffness_of_survivors(contacts, np.where(up, x, 0.0).ravel())
            mean, square = (part.reshape(x.shape) for part in survivors)
        elif contacts.stiffness == "sqrt":
            xi, share, kappa = steps
            above = np.searchsorted(
                xi, np.maximum(0.5 * (left + right), 0.0), side="right"
            )
            tails = [
                np.append(np.cumsum((share * kappa**p)[::-1])[::-1], 0.0)[above]
                for p in range(3)
            ]
            mean, square = (
                np.broadcast_to((tails[p] / tails[0])[:, None], x.shape) for p in (1, 2)
            )
        sources = np.stack((np.ones_like(x), mean * x, square * x**2), axis=2)
        return np.concatenate(
            (
                _solved(half * rate, half[..., None] * sources, order),
                (half * rate)[..., None],
            ),
            axis=2,
        )

    def combined(panels: Panels, values: Array) -> Array:
        """Solutions at nodes, shape (panels, nodes, 3)."""
        found = np.empty((*values.shape[:2], 3))
        at = np.zeros(3)
        for i in range(panels.left.size - 1, -1, -1):
            if steps is not None:
                at = at * _passing(contacts, float(panels.right[i]))
            found[i] = values[i, :, :3] + values[i, :, 3:4] * at
            at = found[i, -1]
        return found

    def weighed(panels: Panels, solution: Array, order: int) -> tuple[Array, Array]:
        """Means over births, and the integrand of each panel at its nodes times half
        the width."""
        if isinstance(births, DeltaBirths):
            return solution[0, -1], np.zeros((*solution.shape[:2], 3))
        rule, half = _rule(order), 0.5 * (panels.right - panels.left)[:, None]
        middle = panels.left[:, None] + half
        integrand = (_density(births, middle - half * rule.nodes, middle) * half)[
            ..., None
        ] * solution
        return (rule.weights @ integrand).sum(axis=0), integrand

    def evaluate(left: Array, right: Array, _: Array) -> Array:
        return np.moveaxis(solve(left, right, _ORDER), 0, -1)

    def judge(panels: Panels) -> tuple[Array, tuple[Array, Array]]:
        found = combined(panels, np.moveaxis(panels.values, -1, 0))
        mean, integrand = weighed(panels, found, _ORDER)
        tail = np.abs(ClenshawCurtis.tail.T @ found).sum(axis=1)
        L, size = (
            np.abs(found[..., 0]).max(axis=1),
            np.maximum(np.abs(panels.left), np.abs(panels.right)),
        )
        most = (
            L[:, None]
            * np.array(
                [np.ones_like(size), np.maximum(size, L), np.maximum(size, L) ** 2]
            ).T
        )
        missed = np.abs(ClenshawCurtis.tail.T @ integrand).sum(axis=1)
        most = np.maximum(most, _scales(mean))  # what is missed fades downwards
        rough = (tail > _RESOLVED * most).any(axis=1) | (
            missed > _RESOLVED * _scales(mean)
        ).any(axis=1)
        return rough & (panels.right - panels.left > _SHORTEST * size), (
            mean,
            missed.sum(axis=0),
        )

    p, (mean, missed) = refined(
        evaluate,
        judge,
        _first_stretches(contacts, births),
        pieces=_PIECES,
        most=_MOST_STRETCHES,
    )
    other = solve(p.left, p.right, _COARSE, finer=True)
    coarse, _ = weighed(p, combined(p, other), _COARSE)
    return mean, missed + np.abs(mean - coarse) + _ROUNDING * _scales(mean)


def _passing(contacts: Reduced, x: float) -> float:
    """The factor by which moments of the rest of life fall just below a stretch x,
    where contacts of a discrete law may break."""
    if x <= 0.0:
        return 1.0
    steps = contacts.law.steps / contacts.law.scale
    left, right = (
        np.searchsorted(steps, x * (1.0 - 1e-13)),
        np.searchsorted(steps, x * (1.0 + 1e-13)),
    )
    return (
        float(steps.size - right) / float(steps.size - left)
        if left < steps.size
        else 1.0
    )


def _first_stretches(contacts: Reduced, births: BirthLaw) -> Array:
    """Ends of the first panels, from the lowest birth up to where nothing survives."""
    law = contacts.law
    if law.steps.size:
        up = np.unique(law.steps) / law.scale
        top = float(up[-1])
    else:
        up = np.append(law.inverse_survival(_LAW), law.breakpoints) / law.scale
        up = up[(up > 0) & np.isfinite(up)]
        top = min(float(up.max()), law.support[1] / law.scale)
        up = np.append(up, max(law.support[0] / law.scale, 0.0))
    at = marks(births)
    low = float(at[0])
    sides = np.concatenate((up, -up, at, [0.0, top]))
    sides = sides[(sides >= low) & (sides <= top)]
    return np.unique(sides)
