"""A life in the mean: how many contacts survive to a stretch, how stiff these are, and
integrals over both."""

import math
from typing import NamedTuple, Protocol

import numpy as np
from numpy.polynomial import chebyshev

from eqsim.laws.aging import Langevin
from eqsim.laws.newborn import DeltaBirths
from eqsim.laws.no_thresholds import has_jumps
from eqsim.master.fokker_planck import survival_of_fluctuating
from eqsim.master.newborn import law_of_births
from eqsim.master.quenched import ends, panels_between_steps, rarest_that_counts
from eqsim.master.solvers import moments_of
from eqsim.master.survivors import kinks_of_survival, longest_travel, survivor_moments
from eqsim.model.reduced import Reduced
from eqsim.numerics.panels import ClenshawCurtis, Panels, refined
from eqsim.numerics.quadrature import gauss_legendre
from eqsim.numerics.tables import Array

# Relative error of the panels that Gauss-Legendre nodes integrate between the jumps of
# a discrete law.
_BETWEEN_JUMPS = 1e-6
# Relative error of sums of powers of a discrete law's thresholds.
_ROUNDED_SUMS = 1e-12
# Coefficients of the highest two Chebyshev polynomials, over the largest value, at
# which panels are not split further.
_SMOOTH = 1e-8
# The same for thresholds that fluctuate: splines between the steps that the
# Fokker-Planck equation takes are no better.
_COARSE_SPLINE = 3e-6
# Largest error of a life at a travel over that of its mean, as it is seen for infinite
# densities (1.2), with a margin.
_WORST = 2.0
# Longest and narrowest panels in ln x; infinite densities and unknown kinks, which need
# ever narrower ones, count for less than the narrowest.
_LONGEST_PANEL = 2.0
_NARROWEST_IN_LN_X = 1e-9
# Panels beyond which none is split any more, where a solver's noise keeps coefficients
# from falling.
_MOST_LIFE_PANELS = 600
# Nodes of a panel lie within it, not across a jump.
_WITHIN = 1.0 - 1e-9


class Profile(Protocol):
    """A life in the mean, lengths in units of the law's scale.

    Attributes
    ----------
    x, survive : ndarray, shape (n,)
        Ascending travels that resolve S, and S there.
    error : float
        Relative, of what follows.
    jumps : bool
        Whether S has jumps, as thresholds are discrete.
    """

    x: Array
    survive: Array
    error: float
    jumps: bool

    def at(self, x: Array, power: int = 0) -> Array:
        """E[z^power kappa^j; l > x] at travels x > 0 from birth, z the stretch there (x
        of contacts born unstretched), power and j = 0, 1, 2, shape (3, n): with power 0
        S, k1 and k2, with power 1 and j = 1 the mean force m."""

    def integral(self, x: Array, power: int) -> Array:
        """The integral of that from 0 to x, shape (3, n)."""


def profile_of(contacts: Reduced, x: Array | None = None) -> Profile:
    """The profile of contacts.

    Parameters
    ----------
    contacts : Reduced
    x : ndarray, optional
        Every stretch at which integrals will be asked for; only discrete laws, with
        their jumps, need to know.

    Raises
    ------
    InputError
        Where a solver refuses the contacts.
    """
    stepped = has_jumps(contacts.law) and not contacts.newborn.active
    known = np.empty(0) if x is None else x
    profile: Profile = _Steps(contacts, known) if stepped else SmoothLife(contacts)
    # moments by another quadrature: what this one misses is part of the error
    (exact,) = moments_of([contacts])
    stretch, work, square = (
        float(profile.integral(np.array([1e90]), power)[power, 0]) for power in range(3)
    )
    misses = [(abs(stretch - exact.stretch) + exact.stretch_error) / exact.stretch]
    size = abs(exact.work)
    if not math.isnan(exact.square):
        size = max(size, 1e-3 * math.sqrt(exact.stretch * exact.square))
        misses.append((abs(square - exact.square) + exact.square_error) / exact.square)
    misses.append((abs(work - exact.work) + exact.work_error) / size)
    # at some travels it may miss more than in the mean over them
    profile.error = max(profile.error, _WORST * max(misses))
    return profile


class _Steps:
    """A life of a discrete law: Gauss-Legendre panels between jumps."""

    jumps = True

    def __init__(self, contacts: Reduced, x: Array) -> None:
        # without heat and aging nothing changes between jumps
        exact = contacts.aging.closed and not contacts.barrier.thermal
        self.error = _ROUNDED_SUMS if exact else _BETWEEN_JUMPS
        self._reduced = contacts
        self.x = np.unique(np.append(panels_between_steps(contacts), x[x > 0]))
        edge = np.append(0.0, self.x)
        inner, weights = gauss_legendre(6).between(edge[:-1], edge[1:])
        values = survivor_moments(contacts, inner.ravel()).reshape(3, 3, *inner.shape)
        self._sums = (values * weights).sum(axis=3).cumsum(axis=2)
        self.survive = self.at(self.x)[0]

    def at(self, x: Array, power: int = 0) -> Array:
        return survivor_moments(self._reduced, x)[power]

    def integral(self, x: Array, power: int) -> Array:
        index = np.searchsorted(self.x, np.minimum(x, self.x[-1]))
        sums = self._sums[power][:, np.minimum(index, self.x.size - 1)]
        return np.where(x > 0, sums, 0.0)


def _first_edges(contacts: Reduced) -> Array:
    """Ascending ln x, at the kinks of survival besides: from where hardly a contact has
    broken, as no rate exceeds omega, to where hardly a contact is left."""
    law, barrier = contacts.law, contacts.barrier
    if contacts.newborn.active:
        top, kinks = longest_travel(contacts), kinks_of_survival(contacts)
    else:
        rarest = float(law.inverse_survival(rarest_that_counts(barrier))) / law.scale
        top = contacts.aging.bracket(rarest)[1]
        kinks = ends(contacts, law.kinks / law.scale)
    last, inner = math.log(top), np.log(kinks)
    attempts = barrier.log_w if barrier.thermal else 0.0
    first = -max(math.log(1e15), attempts + math.log(1e7))
    edges = np.arange(last, min(first, last - _LONGEST_PANEL), -_LONGEST_PANEL)
    return np.union1d(edges, inner[(inner > edges[-1]) & (inner < last)])


class Slope(NamedTuple):
    """Derivatives of S, k1 and k2 (or of their products with powers of z) and what
    panels may miss of them, shape (3, n), and the widths of the panels in ln x, shape
    (n,)."""

    value: Array
    missed: Array
    width: Array


class SmoothLife:
    """The life of contacts whose survival is smooth between kinks: Chebyshev
    polynomials in ln x on panels that end at the kinks, and are split until they
    resolve it."""

    def __init__(self, contacts: Reduced) -> None:
        self.jumps = (
            contacts.newborn.active
            and has_jumps(contacts.law)
            and isinstance(law_of_births(contacts), DeltaBirths)
        )
        fluctuating = isinstance(contacts.aging, Langevin)
        smooth = _COARSE_SPLINE if fluctuating else _SMOOTH
        nodes, tail = ClenshawCurtis.nodes[:, None] * _WITHIN, ClenshawCurtis.tail.T

        def evaluate(left: Array, right: Array, _: Array) -> Array:
            x = np.exp(0.5 * (left + right) + 0.5 * (right - left) * nodes)
            values = survivor_moments(contacts, x.ravel()).reshape(9, *x.shape)
            return np.concatenate((values, values * x))

        def judge(panels: Panels) -> tuple[Array, None]:
            most = np.abs(panels.values).max(axis=(1, 2))[:, None]
            rough = np.abs(np.tensordot(tail, panels.values, (1, 1))).sum(axis=0)
            wide = panels.right - panels.left > _NARROWEST_IN_LN_X
            return (rough > smooth * most).any(axis=0) & wide, None

        p, _ = refined(evaluate, judge, _first_edges(contacts), most=_MOST_LIFE_PANELS)
        self._edges = np.append(p.left, p.right[-1])
        self._half = 0.5 * (p.right - p.left)
        coefficients = np.tensordot(ClenshawCurtis.coefficients, p.values, (1, 1))
        self._values, moments = np.split(coefficients, 2, axis=1)
        self._integrals = chebyshev.chebint(moments, lbnd=-1, axis=0) * self._half
        sums = self._integrals.sum(axis=0).cumsum(axis=1)
        self._sums = np.concatenate((np.zeros((9, 1)), sums), axis=1)
        self._first, self._last = math.exp(p.left[0]), math.exp(p.right[-1])
        self._start = p.values[:9, 0, 0]
        self.x = np.exp((0.5 * (p.left + p.right) + self._half * nodes).T.ravel())
        self.survive = np.minimum.accumulate(np.clip(p.values[0].T.ravel(), 0.0, 1.0))
        missed = np.abs(np.tensordot(tail, p.values[9:], (1, 1))).sum(axis=0)
        total = np.abs(self._sums[:, -1])
        least = np.maximum(total, 1e-3 * total[0])
        # of S, of the mean force, of the mean square of the force
        worst = ((missed @ self._half) / least)[[0, 4, 8]].max()
        self.error = float(worst) + smooth
        if fluctuating:
            errors = survival_of_fluctuating(contacts).errors
            self.error += float(errors[0].max())

    def _evaluated(self, coefficients: Array, x: Array) -> tuple[Array, Array]:
        """Polynomials with `coefficients` (17, 3, panels) at x, shape (3, n), and the
        panels that x are in."""
        log_x = np.log(np.clip(x, self._first, self._last))
        panel = np.searchsorted(self._edges, log_x, side="right") - 1
        panel = np.clip(panel, 0, self._half.size - 1)
        t = np.clip((log_x - self._edges[panel]) / self._half[panel] - 1.0, -1.0, 1.0)
        order = np.argsort(panel, kind="stable")
        powers = chebyshev.chebvander(t[order], coefficients.shape[0] - 1)
        last = np.searchsorted(panel[order], np.arange(self._half.size + 1))
        found = np.empty((x.size, 3))
        for i in np.flatnonzero(np.diff(last)):
            rows = slice(last[i], last[i + 1])
            found[order[rows]] = powers[rows] @ coefficients[:, :, i]
        return found.T, panel

    def slope(self, x: Array, power: int = 0) -> Slope:
        """Derivatives of `at` with respect to x > 0, at a kink that of the panel to its
        right."""
        values = self._values[:, 3 * power : 3 * power + 3]
        highest = values.copy()
        highest[:-2] = 0.0
        found = []
        for part in (values, highest):
            coefficients = np.zeros_like(values)
            coefficients[:-1] = chebyshev.chebder(part, axis=0) / self._half
            per_log_x, panel = self._evaluated(coefficients, x)
            found.append(np.where(x < self._last, per_log_x / x, 0.0))
        return Slope(found[0], np.abs(found[1]), 2.0 * self._half[panel])

    def at(self, x: Array, power: int = 0) -> Array:
        found, _ = self._evaluated(self._values[:, 3 * power : 3 * power + 3], x)
        return np.asarray(np.where(x < self._last, found, 0.0))

    def integral(self, x: Array, power: int) -> Array:
        rows = slice(3 * power, 3 * power + 3)
        inside, panel = self._evaluated(self._integrals[:, rows], x)
        before = self._start[rows, None] * np.minimum(x, self._first)
        return np.asarray(self._sums[rows, panel] + inside + before)
