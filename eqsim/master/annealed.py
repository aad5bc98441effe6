"""Annealed contacts: the published master equation (Braun and Peyrard, 2011),
stationary, at many velocities at once.

With J_c(x) = P(xi > x) and Delta U(x) = (omega/v) G(x), G the integral of the pooled
rate h (temper11, temper12 are H = (omega/v) h), the stationary density of stretches is
Q(x) = E_P(x)/C with E_P = J_c exp(-Delta U) (Q11a, nt13) and

    C = int_0^inf E_P dx,        friction * C = int_0^inf x exp(-Delta U) E[k_i/k; xi > x] dx        (no delay),

where k_i = k gives nt13 and the sqrt law, beyond the paper, uses the threshold drawn at
birth (derived). Velocity enters only through omega/v: laws and pooled rates are
evaluated once for all velocities, on panels that are split until the highest Chebyshev
coefficients of the hazard, times the life that is left, and of the integrands are
negligible at each of them.

Births of contacts that age, of the law P_c of star1, are a mixture of gamma laws of
scales x_*(s), s ~ Exp(1) (`laws.aging.pooled`). What depends on the scale is a
polynomial in its logarithm, or, for rates of bonds, the exponential of one; the weights
of its nodes depend on the mean stretch at breaking C, the root of
C = int J_c exp(-Delta U) dx (derived), which is found on the same panels.
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import chebyshev

from eqsim.errors import InputError
from eqsim.laws.aging.base import scale2
from eqsim.laws.barrier.pooled import pooled_rate
from eqsim.laws.threshold import Gamma, ThresholdLaw
from eqsim.master.quenched import (
    LifeMoments,
    beyond,
    different_steps,
)
from eqsim.model.reduced import Reduced
from eqsim.numerics.panels import ClenshawCurtis, Panels, refined
from eqsim.numerics.quadrature import gauss_legendre
from eqsim.numerics.roots import bisected
from eqsim.numerics.tables import Array

# Different thresholds of a discrete law at most, to bound time.
_MOST_THRESHOLDS = 1000

# -ln J_c where the first panels in x end.
_MARKS = np.array([1e-4, 0.02, 0.3, 1.0, 2.5, 6.0, 15.0, 40.0, 120.0, 500.0])
# The factor by which the first of them rise.
_RISE_IN_X = 16.0
# Where a panel is split: crowded, as the trouble is mostly at its left end.
_SPLIT_IN_X = np.array([0.0, 0.12, 0.5, 1.0])
# The relative error that ends refinement, and its like for a mixture.
_RESOLVED_IN_X = 2e-12
_RESOLVED_MIXTURE = 1e-10
# E up to which a layer below a threshold is a panel of its own at first.
_LAYER = 8.0
# The hazard that no contact outlives, and what may be missed of one that some do.
_NONE_LEFT = 50.0
_MOST_MISSED = 1e-7
# The narrowest panel, relative to its right end.
_NARROWEST_IN_X = 1e-14
# Panels at most, and more of them for each threshold of a discrete law.
_MOST_IN_X = 1500
_MORE_PER_STEP = 40
# The least relative error that is quoted.
_LEAST_ERROR = 1e-11

# Nodes of a mixture in ln x_*, at least and per e-fold.
_FEWEST_NODES = 10
_PER_FOLD = 13.0
# ln s of the trapezoidal rule over mean pinned times s, and its weights.
_LOG_S = np.arange(-28.0, math.log(700.0), 0.1)
_SHARE_OF_S = np.exp(_LOG_S - np.exp(_LOG_S))
_SHARE_OF_S /= _SHARE_OF_S.sum()
# A rate below which a polynomial of its logarithm is not trusted.
_LEAST_RATE = 1e-290
# A life over the mean, beyond which the exponential law of star1 has nothing.
_LONGEST_LIFE = 40.0
# The relative step towards the fixed point C that ends the search.
_SETTLED_C = 1e-12
# Most steps of the secant rule, and halvings where they do not meet.
_MOST_SECANTS = 30
_HALVINGS = 50
# The relative change of C whose effect on C tells how errors grow.
_CHANGE_OF_C = 1e-4


class Ageing(NamedTuple):
    """Thresholds that age: 4 D x_*/(v x_*f^2) at each velocity, and x_*f/x_*."""

    alpha: Array
    final: float

    def log_squares(self, stretch: Array, lives: Array) -> Array:
        """ln (x_*/x_*i)^2 after so many mean lives at each velocity, given C, shape
        (velocities, lives)."""
        decay = (self.alpha * stretch)[:, None] * lives
        return np.asarray(np.log(scale2(self.final**2, decay)))


def annealed_moments(
    every: Sequence[Reduced], ageing: Ageing | None = None
) -> LifeMoments:
    """Moments of lives of annealed contacts at each of `every`, which differ in
    velocity only. Raises InputError for a discrete law of more than 1000 thresholds."""
    steps = np.unique(every[0].law.steps)
    if steps.size > _MOST_THRESHOLDS:
        raise InputError(
            f"thresholds: {steps.size} different values; the annealed reference takes "
            f"at most {_MOST_THRESHOLDS}"
        )
    never = np.zeros(len(every))
    born = _Solution(every, Ageing(never, 1.0), never)
    found = born.moments()
    if ageing is None or not ageing.alpha.any():
        return LifeMoments(*found)
    aged = _Solution(every, Ageing(never + math.inf, ageing.final), never)
    longest = 2.0 * np.maximum(found[0], aged.moments()[0])
    while True:
        solution = _Solution(every, ageing, longest)
        found = solution.moments()
        if np.all(solution.stretch <= longest):
            return LifeMoments(*found)
        longest = 2.0 * np.maximum(longest, solution.stretch)


class Mixture(NamedTuple):
    """Gamma laws at Chebyshev nodes of ln (x_*/x_*i)^2 from `low` to `high`, which
    represent any law in between, and the Chebyshev coefficients that values at the nodes
    have, shape (nodes, nodes); a single law if low = high."""

    laws: list[ThresholdLaw]
    low: float = 0.0
    high: float = 0.0
    coefficients: Array = np.ones((1, 1))

    def polynomials(self, log_square: Array) -> Array:
        """Chebyshev polynomials at ln (x_*/x_*i)^2, shape (...), shape (..., laws)."""
        width = self.high - self.low or 1.0
        t = (2.0 * log_square - self.low - self.high) / width
        return chebyshev.chebvander(np.clip(t, -1.0, 1.0), len(self.laws) - 1)

    def shares(self, log_square: Array) -> Array:
        """Weights by which the laws represent others, shape (..., laws)."""
        return np.asarray(self.polynomials(log_square) @ self.coefficients)

    def weights(self, ageing: Ageing, stretch: Array, lost: int = 0) -> Array:
        """Weights of the laws in star1, given C at each velocity, shape (velocities,
        laws), also without the highest `lost` coefficients."""
        if len(self.laws) == 1:
            return np.ones((stretch.size, 1))
        log_squares = ageing.log_squares(stretch, np.exp(_LOG_S))
        means = _SHARE_OF_S @ self.polynomials(log_squares)
        means[:, len(self.laws) - lost :] = 0.0
        return np.asarray(means @ self.coefficients)

    def mean_rates(
        self, rates: Array, ageing: Ageing, stretch: Array, lost: int = 0
    ) -> Array:
        """Means of rates whose logarithms are polynomials, shape (velocities, ...), of
        those of the laws, shape (laws, ...), as `weights` means other values."""
        logs = self.coefficients @ np.log(rates.reshape(len(self.laws), -1))
        logs[len(self.laws) - lost :] = 0.0
        found = [
            _SHARE_OF_S @ np.exp(self.polynomials(each) @ logs)
            for each in ageing.log_squares(stretch, np.exp(_LOG_S))
        ]
        return np.array(found).reshape(-1, *rates.shape[1:])


def mixture_of(law: Gamma, low: float, high: float, count: int) -> Mixture:
    """A mixture of so many laws that newborn thresholds of a gamma law become."""
    t = np.cos(math.pi * (np.arange(count) + 0.5) / count)
    scales = law.x_star * np.exp(0.25 * (low + high + (high - low) * t))
    laws: list[ThresholdLaw] = [Gamma(law.n, scale) for scale in scales.tolist()]
    return Mixture(laws, low, high, np.linalg.inv(chebyshev.chebvander(t, count - 1)))


def _mixture(law: ThresholdLaw, ageing: Ageing, longest: Array) -> Mixture:
    """Represent a law and what it becomes while contacts are pinned, if their mean
    travel C is at most `longest`: laws that no contact reaches may have rates so much
    larger that these drown the others'."""
    if not isinstance(law, Gamma) or not ageing.alpha.any():
        return Mixture([law])
    if ageing.final == 1.0 or np.isinf(ageing.alpha).all():
        return Mixture([Gamma(law.n, law.x_star * ageing.final)])
    grown = ageing.log_squares(longest, np.array([_LONGEST_LIFE]))
    low, high = sorted((0.0, float(max(grown[:, 0], key=abs))))
    n = math.ceil(_PER_FOLD * 0.5 * (high - low) * math.sqrt(1.0 + law.n / 2.0))
    return mixture_of(law, low, high, n + _FEWEST_NODES)


class _PanelIntegrals(NamedTuple):
    """Contributions of panels to C and to work, their errors, shapes (2, velocities, panels),
    and exp(-Delta U) where the last panel begins, shape (velocities,)."""

    parts: Array
    errors: Array
    alive: Array

    @property
    def total(self) -> Array:
        """C and work, shape (2, velocities)."""
        return np.asarray(self.parts.sum(axis=2))


def _refined(
    contacts: Reduced,
    evaluate: Callable[[Array, Array, Array], Array],
    judge: Callable[[Panels], tuple[Array, Any]],
    edges: Array,
) -> tuple[Panels, Any]:
    """Panels from 0 on that are resolved (`numerics.panels.refined`)."""
    pieces, steps = _SPLIT_IN_X, contacts.law.steps.size
    if steps:  # attempts succeed in narrow layers below each threshold
        pieces = 1.0 - pieces[::-1]
    most = _MOST_IN_X + _MORE_PER_STEP * steps
    return refined(evaluate, judge, edges, pieces=pieces, most=most)


class _Solution:
    """The equation at many velocities."""

    def __init__(
        self, every: Sequence[Reduced], ageing: Ageing, longest: Array
    ) -> None:
        log_w = [r.barrier.log_w if r.barrier.thermal else -math.inf for r in every]
        self.attempts = np.exp(log_w)[:, None, None]
        # the slowest, at which most attempts count
        self.contacts = contacts = every[int(np.argmax(log_w))]
        self.mixture = _mixture(contacts.law, ageing, longest)
        self.ageing = ageing
        self.ages, self.settled_on = len(self.mixture.laws) > 1, 0
        self.stretch = longest

    def moments(self) -> Array:
        """C, work, and their absolute errors, shape (4, velocities)."""
        edges = self.first_edges()
        p, of = _refined(self.contacts, self.evaluate, self.judge, edges)
        total = of.total
        error = of.errors.sum(axis=2) + self.missed_rate(p, of) + _LEAST_ERROR * total
        grown = np.ones(len(self.stretch))
        if self.ages:  # an error of C moves births, and these C again
            error += total * np.abs(np.log(total[0] / self.stretch))
            error += np.abs(total - self.integrals(p, self.stretch, 2).total)
            moved = self.integrals(p, self.stretch * math.exp(_CHANGE_OF_C))
            slope = np.log(moved.total[0] / total[0]) / _CHANGE_OF_C
            grown = 1.0 / np.maximum(1.0 - slope, 1e-3)
        if not isinstance(self.mixture.laws[0], Gamma):
            rarest = beyond(self.contacts)[:, None] * of.alive
            total, error = total + rarest, error + rarest
        return np.concatenate((total, grown * error))

    def weights(self, stretch: Array, lost: int = 0) -> Array:
        """Weights of the mixture's laws at each velocity, given C."""
        return self.mixture.weights(self.ageing, stretch, lost)

    def mean_rates(
        self, rates: Array, weights: Array, stretch: Array, lost: int = 0
    ) -> Array:
        """Means over births of the laws' rates h, shape (laws, ...), at each velocity,
        given C and the `weights` that follow, shape (velocities, ...)."""
        means = np.asarray(np.tensordot(weights, rates, 1))
        if self.ages and self.contacts.barrier.by_force:
            # signed weights, of off-rates that differ by many orders, leave only noise
            known = (rates > _LEAST_RATE).all(axis=0)
            means[:, known] = self.mixture.mean_rates(
                rates[:, known], self.ageing, stretch, lost
            )
        return means

    def rate(
        self, law: ThresholdLaw, y: Array, above: Array, *, finer: bool = False
    ) -> Array:
        """h(y) of contacts whose thresholds follow another `law`, lengths in units of
        the scale of `contacts`, whose rms threshold their stiffness is relative to;
        `above` as in `successful_attempts`."""
        contacts, barrier = self.contacts, self.contacts.barrier
        if not barrier.thermal:
            return np.zeros(y.size)
        if law.steps.size:
            attempts = successful_attempts(contacts, y, above=above)
            return attempts * math.exp(-barrier.log_w)
        unit = law.scale / contacts.law.scale
        b = barrier.in_unit(unit)
        if contacts.stiffness == "sqrt":
            b *= law.rms / contacts.law.rms
        springs, y, log_w = contacts.stiffness, y / unit, barrier.log_w
        return pooled_rate(law, springs, barrier, b, y, log_w, finer=finer)

    def evaluate(self, left: Array, right: Array, _: Array) -> Array:
        """h and J_c of each law at the nodes of panels, shape (2, laws, 17, panels)."""
        half, laws = 0.5 * (right - left), self.mixture.laws
        x = left + half * (1.0 + ClenshawCurtis.nodes[:, None])
        middle = np.broadcast_to(left + half, x.shape)
        at = x.ravel(), middle.ravel()
        rates = [self.rate(law, *at).reshape(x.shape) for law in laws]
        # J_c of a discrete law jumps between panels only
        smooth = not self.contacts.law.steps.size
        ahead = (x if smooth else middle) * self.contacts.law.scale
        return np.array([rates, [law.sf(ahead) for law in laws]])

    def integrals(
        self, panels: Panels, stretch: Array, lost: int = 0
    ) -> _PanelIntegrals:
        """C = int J_c exp(-Delta U) dx and int x exp(-Delta U) E[kappa; xi > x] dx
        (nt13; sqrt law: derived) of births that follow from `stretch`."""
        rule, h = ClenshawCurtis, 0.5 * (panels.right - panels.left)[:, None]
        x = panels.left[:, None] + h * (1.0 + rule.nodes)
        rates, survivals = panels.values
        weights = self.weights(stretch, lost)
        rate = np.swapaxes(self.mean_rates(rates, weights, stretch, lost), 1, 2)
        J = np.swapaxes(np.tensordot(weights, survivals, 1), 1, 2)
        hazard = self.attempts * np.maximum(rate, 0.0) * h
        gained = np.maximum(hazard @ rule.weights, 0.0)
        before = np.cumsum(gained, axis=1) - gained
        # where a panel is too wide for its polynomial, that may be negative
        inside = np.exp(-np.maximum(hazard @ rule.cumulative, 0.0)) * h
        alive, stiff = np.exp(-before)[:, :, None], J
        sqrt_law = self.contacts.stiffness == "sqrt"
        if sqrt_law:  # E[xi; xi > x] = x J + int_x^inf J dy
            heavy = J * h
            later = (heavy @ rule.weights)[:, ::-1].cumsum(axis=1)[:, ::-1]
            within = np.maximum(later[:, :, None] - heavy @ rule.cumulative, 0.0)
            stiff = (x * J + within) / self.contacts.rms
        integrands = np.stack((inside * J, inside * x * stiff)) * alive
        parts = integrands @ rule.weights
        errors = np.abs(integrands @ rule.tail).sum(axis=3)
        errors += np.abs(hazard @ rule.tail).sum(axis=2) * _sums_onward(parts)
        if sqrt_law:  # heavier thresholds of later panels count in all before
            lever = np.cumsum((inside * x * alive) @ rule.weights, axis=1)
            lever /= self.contacts.rms
            errors[1] += np.abs(heavy @ rule.tail).sum(axis=2) * lever
        return _PanelIntegrals(parts, errors, alive[:, -1, 0])

    def judge(self, panels: Panels) -> tuple[Array, _PanelIntegrals]:
        """Find panels that are too rough at any velocity, and the integrals. The fixed
        point C is found on the first panels, and again when none is too rough."""
        rough, of = self.too_rough(panels)
        new = panels.left.size != self.settled_on
        if self.ages and new and not (self.settled_on and rough.any()):
            self.settled_on = panels.left.size
            self.settle(panels)
            rough, of = self.too_rough(panels)
        return rough, of

    def too_rough(self, panels: Panels) -> tuple[Array, _PanelIntegrals]:
        """`judge` at the C that is known."""
        of = self.integrals(panels, self.stretch)
        resolved = _RESOLVED_MIXTURE if self.ages else _RESOLVED_IN_X
        rough = (of.errors > resolved * of.total[:, :, None]).any(axis=(0, 1))
        width = panels.right - panels.left
        return rough & (width > _NARROWEST_IN_X * panels.right), of

    def settle(self, panels: Panels) -> None:
        """Find the fixed point C by the secant rule at each velocity; where that jumps
        back and forth, by halving between what is known to be less and greater."""

        def excess(log_C: Array) -> Array:
            C = self.integrals(panels, np.exp(log_C)).total[0]
            return np.asarray(np.log(C) - log_C)

        old = np.log(self.stretch)
        off = excess(old)
        less, more = np.where(off > 0, old, -np.inf), np.where(off < 0, old, np.inf)
        new = old + off
        for _ in range(_MOST_SECANTS):
            fresh = excess(new)
            if np.abs(new - old).max() < _SETTLED_C:
                break
            less = np.where(fresh > 0, np.maximum(less, new), less)
            more = np.where(fresh < 0, np.minimum(more, new), more)
            with np.errstate(divide="ignore", invalid="ignore"):
                step = -fresh * (new - old) / (fresh - off)
            # where both are known to the last bit, or the secant leads away
            step = np.where(np.isfinite(step) & (np.abs(step) < 2.0), step, fresh)
            old, off, new = new, fresh, new + step
        else:
            known = np.isfinite(more - less)
            ends = np.where(known, less, new), np.where(known, more, new)
            new = bisected(lambda log_C: excess(log_C) > 0.0, *ends, _HALVINGS)[0]
        self.stretch = np.exp(new)

    def missed_rate(self, panels: Panels, of: _PanelIntegrals) -> Array:
        """Errors of C and work by those of the pooled rate, from a finer rule in the
        middle of panels; eightfold, as that may not be the worst place."""
        middle = 0.5 * (panels.left + panels.right)
        laws = self.mixture.laws
        finer = np.array([self.rate(law, middle, middle, finer=True) for law in laws])
        here = panels.values[0, :, ClenshawCurtis.nodes.size // 2]
        births = self.weights(self.stretch), self.stretch
        missed = np.abs(
            self.mean_rates(finer, *births) - self.mean_rates(here, *births)
        )
        missed *= self.attempts[:, 0] * (panels.right - panels.left)
        wrong = np.minimum(8.0 * missed, 1.0) * _sums_onward(of.parts)
        return np.asarray(wrong.sum(axis=2))

    def first_edges(self) -> Array:
        """Ends of the first panels: from the shortest lives to where no threshold is
        left."""
        law, barrier, laws = self.contacts.law, self.contacts.barrier, self.mixture.laws
        seen = _MARKS[1::2] if self.ages else _MARKS
        marks = [end.inverse_survival(seen) for end in (laws[0], laws[-1])]
        known = np.concatenate((*marks, law.breakpoints)) / law.scale
        known = known[(known > 0) & np.isfinite(known)]
        least, greatest = (edge / law.scale for edge in law.support)
        top = min(greatest, float(known.max()))
        newborn = float(self.attempts.max()) * float(
            self.rate(law, *np.zeros((2, 1)))[0]
        )
        root = math.sqrt(barrier.b) if barrier.thermal else 0.0
        first = 0.5 / (1.0 / known.min() + newborn + root)
        rising = first * _RISE_IN_X ** np.arange(
            math.ceil(math.log(top / first, _RISE_IN_X))
        )
        layers = _layers(self.contacts)
        edges = np.unique(np.concatenate(([0.0, least, top], known, layers, rising)))
        return edges[edges <= top]


def _layers(contacts: Reduced) -> Array:
    """Stretches at which layers begin, below the thresholds of a discrete law, in which
    attempts succeed: where these are narrow, no node of a wider panel is in one."""
    if not (contacts.law.steps.size and contacts.barrier.thermal):
        return np.empty(0)
    xi, _, kappa = different_steps(contacts)
    begin = xi - contacts.barrier.width(_LAYER, xi, contacts.barrier.b * kappa)
    return np.asarray(begin[begin > 0])


def _sums_onward(parts: Array) -> Array:
    """Sums over each panel and all later ones."""
    return parts[..., ::-1].cumsum(axis=-1)[..., ::-1]


def successful_attempts(
    contacts: Reduced, y: Array, *, above: Array | None = None, finer: bool = False
) -> Array:
    """(omega/v) h(y), successful attempts per unit displacement, shape (n,). Thresholds
    of a discrete law count that are greater than `above`, by default y: within a panel
    that begins or ends at one of them, its middle."""
    law, stiffness, barrier = contacts.law, contacts.stiffness, contacts.barrier
    b, log_w = barrier.b, barrier.log_w
    if not law.steps.size:
        h = pooled_rate(law, stiffness, barrier, b, y, log_w, finer=finer)
        return math.exp(log_w) * h
    total, above = np.zeros(y.size), y if above is None else above
    for xi, share, kappa in zip(*different_steps(contacts), strict=True):
        on = above < xi
        log_rate = barrier.log_rate(np.minimum(y[on], xi), xi, b * kappa)
        total[on] += share * np.exp(log_w + log_rate)
    return total


class PooledPolynomials:
    """(omega/v) h(x) of annealed contacts at x >= 0 as Chebyshev polynomials, and its
    integral (omega/v) G."""

    def __init__(self, contacts: Reduced) -> None:
        law, unit = contacts.law, contacts.law.scale
        edges = np.unique(np.concatenate(([0.0], _layers(contacts), law.steps / unit)))
        if not law.steps.size:
            top = np.asarray(law.inverse_survival(_MARKS))
            edges = np.concatenate(([0.0, law.support[0]], top, law.kinks)) / unit
            edges = np.unique(edges[edges * unit <= min(law.support[1], top[-1])])

        def evaluate(left: Array, right: Array, _: Array) -> Array:
            half = 0.5 * (right - left)
            x = left + half * (1.0 + ClenshawCurtis.nodes[:, None])
            above = np.broadcast_to(left + half, x.shape)
            rate = successful_attempts(contacts, x.ravel(), above=above.ravel())
            return rate.reshape(x.shape)

        def judge(panels: Panels) -> tuple[Array, float]:
            width = panels.right - panels.left
            rough = np.abs(ClenshawCurtis.tail.T @ panels.values).sum(axis=0) * width
            own = ClenshawCurtis.weights @ panels.values * width
            total = own.cumsum()
            # what counts is how well hazards are known, of all before it and of a life
            seen = np.minimum(_RESOLVED_IN_X * np.maximum(total, 1.0), 1e-9)
            # off-rates rise without bound beyond the stretches that bonds live to see
            most = total if contacts.barrier.by_force else total[-1] * 1e-3
            near, least = total - own < _NONE_LEFT, _RESOLVED_IN_X * most
            least = np.where(near, np.minimum(least, _MOST_MISSED), least)
            split = (rough > np.maximum(seen, least)) & (width > 1e-13 * panels.right)
            # farther on, rates so high that they are not known as well may never be
            # resolved: that must not use up the panels
            near &= split
            return (near if near.any() else split), float(rough[near].sum())

        p, missed = _refined(contacts, evaluate, judge, edges)
        if missed > _MOST_MISSED:
            raise InputError(
                f"thresholds = {law}: annealed contacts break in layers too narrow for "
                f"a reference (b = {contacts.barrier.b:g})"
            )
        self.edges = np.append(p.left, p.right[-1])
        self._half = 0.5 * (p.right - p.left)
        self._coefficients = ClenshawCurtis.coefficients @ p.values
        self._integrals = chebyshev.chebint(self._coefficients, lbnd=-1) * self._half
        passed = (ClenshawCurtis.weights @ p.values * self._half).cumsum()
        self._sums = np.append(0.0, passed)

    def _evaluated(self, coefficients: Array, x: Array) -> tuple[Array, Array]:
        """Polynomials with `coefficients` (17, panels) at x, and the panels of x."""
        panel = np.searchsorted(self.edges, x, side="right") - 1
        panel = np.clip(panel, 0, self._half.size - 1)
        t = np.clip((x - self.edges[panel]) / self._half[panel] - 1.0, -1.0, 1.0)
        return chebyshev.chebval(t, coefficients[:, panel], tensor=False), panel

    def __call__(self, x: Array) -> Array:
        """(omega/v) h at x >= 0 of any shape."""
        found, _ = self._evaluated(self._coefficients, x)
        return np.where(x > self.edges[-1], 0.0, np.maximum(found, 0.0))

    def integral(self, x: Array) -> Array:
        """(omega/v) G at x >= 0 of any shape, small or not to about as many digits."""
        found, panel = self._evaluated(self._integrals, x)
        found, first = np.asarray(self._sums[panel] + found), np.asarray(panel == 0)
        low = np.asarray(x)[first]
        nodes, weights = gauss_legendre(9).between(0.0 * low, low)
        found[first] = (weights * self(nodes)).sum(axis=-1)
        return found


# It takes 1 to 10 ms, and a transient asks for it 60 times; ensembles are solved one
# after another.
@functools.lru_cache(maxsize=8)
def pooled_polynomials(contacts: Reduced) -> PooledPolynomials:
    """Cached pooled rate of an ensemble."""
    return PooledPolynomials(contacts)
