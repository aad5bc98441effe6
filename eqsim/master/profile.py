"""A life in the mean: its moments by the solver of the contacts, how many survive to a
stretch, how stiff these are, and integrals over both."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev

from eqsim.laws.aging import Langevin, Unaged
from eqsim.laws.newborn import DeltaBirths
from eqsim.laws.no_thresholds import has_jumps
from eqsim.master.annealed import annealed_moments
from eqsim.master.flow import moments_along_paths
from eqsim.master.fokker_planck import fluctuating_moments, survival_of_fluctuating
from eqsim.master.newborn import law_of_births, stretched_moments
from eqsim.master.quenched import (
    LifeMoments,
    ends,
    integrals_beyond,
    quenched_moments,
    rarest_that_counts,
)
from eqsim.master.survivors import kinks_of_survival, longest_travel, survivor_moments
from eqsim.model.reduced import Reduced
from eqsim.numerics.panels import ClenshawCurtis, Panels, refined
from eqsim.numerics.tables import Array

# Coefficients of the highest two Chebyshev polynomials, over the largest value, at
# which panels are not split further.
_SMOOTH = 1e-8
# The same of a discrete law, where only powers of stretches change between jumps.
_EVEN = 1e-12
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
# Panels beyond those between kinks after which none is split any more, where a solver's
# noise keeps coefficients from falling.
_MOST_LIFE_PANELS = 600
# Nodes of a panel lie within it, not across a jump.
_WITHIN = 1.0 - 1e-7


def moments_of(every: Sequence[Reduced], *, square: bool = False) -> LifeMoments:
    """Moments of lives at each of `every`, which differ in velocity only; with the mean
    square of force where lives are known in closed form. Raises InputError."""
    contacts, solve = every[0], moments_along_paths
    if contacts.newborn.active:
        solve = stretched_moments
    elif contacts.annealed:
        return annealed_moments(every)
    elif isinstance(contacts.aging, Unaged):
        return quenched_moments(every, square=square)
    elif isinstance(contacts.aging, Langevin):
        solve = fluctuating_moments
    return LifeMoments(*np.transpose([solve(s) for s in every]))


def _first_edges(contacts: Reduced) -> Array:
    """Ascending ln x, at the kinks of survival besides: from where hardly a contact has
    broken, as no rate exceeds omega, to where hardly a contact is left."""
    law, barrier = contacts.law, contacts.barrier
    if contacts.newborn.active:
        top, kinks = longest_travel(contacts), kinks_of_survival(contacts)
    else:
        rarest = float(law.inverse_survival(rarest_that_counts(barrier))) / law.scale
        kinks = ends(contacts, law.kinks / law.scale)
        top = kinks[-1] if has_jumps(law) else contacts.aging.bracket(rarest)[1]
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


class Profile:
    """A life in the mean, lengths in units of the law's scale: Chebyshev polynomials in
    ln x on panels that end at kinks and jumps of survival, and are split until they
    resolve it. Raises InputError where a solver refuses the contacts.

    Attributes
    ----------
    x, survive : ndarray, shape (n,)
        Ascending travels that resolve S, and S there.
    error : float
        Relative, of what the methods return.
    jumps : bool
        Whether S has jumps, as thresholds are discrete.
    beyond, missed_beyond : ndarray, shape (3, 3)
        What `integral`, which ends with the last panel, lacks at infinity, for powers
        and j from 0 to 2, and its error. 0 of contacts born stretched, of which
        `error` holds it.
    """

    def __init__(self, contacts: Reduced) -> None:
        self._stretched = contacts.newborn.active
        self.jumps = has_jumps(contacts.law) and (
            not self._stretched or isinstance(law_of_births(contacts), DeltaBirths)
        )
        fluctuating = isinstance(contacts.aging, Langevin)
        smooth = _COARSE_SPLINE if fluctuating else _SMOOTH
        if self.jumps and contacts.aging.closed and not contacts.barrier.thermal:
            smooth = _EVEN
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

        edges = _first_edges(contacts)
        most = edges.size + _MOST_LIFE_PANELS
        p, _ = refined(evaluate, judge, edges, most=most)
        self._edges = np.append(p.left, p.right[-1])
        self._half = 0.5 * (p.right - p.left)
        coefficients = np.tensordot(ClenshawCurtis.coefficients, p.values, (1, 1))
        self._values, moments = np.split(coefficients, 2, axis=1)
        integrals = chebyshev.chebint(moments, lbnd=-1.0 / _WITHIN, axis=0)
        self._integrals = integrals * (self._half * _WITHIN)
        sums = chebyshev.chebval(1.0 / _WITHIN, self._integrals).cumsum(axis=1)
        self._sums = np.concatenate((np.zeros((9, 1)), sums), axis=1)
        self._first, self._last = math.exp(p.left[0]), math.exp(p.right[-1])
        self._start = p.values[:9, 0, 0]
        self.x = np.exp((0.5 * (p.left + p.right) + self._half * nodes).T.ravel())
        survive = np.clip(p.values[0].T.ravel(), 0.0, 1.0)
        if self.jumps:  # none is left at the end of the last panel
            self.x, survive = np.append(self.x, self._last), np.append(survive, 0.0)
        self.survive = np.minimum.accumulate(survive)
        missed = np.abs(np.tensordot(tail, p.values[9:], (1, 1))).sum(axis=0)
        total = np.abs(self._sums[:, -1])
        least = np.maximum(total, 1e-3 * total[0])
        # of S, of the mean force, of the mean square of the force
        worst = ((missed @ self._half) / least)[[0, 4, 8]].max()
        self.error = float(worst) + smooth
        if fluctuating:
            errors = survival_of_fluctuating(contacts).errors
            self.error += float(errors[0].max())
        self.beyond, self.missed_beyond = np.zeros((2, 3, 3))
        if not self._stretched:
            last = float(self.x[-1]), float(self.survive[-1])
            self.beyond, self.missed_beyond = integrals_beyond(contacts, *last)
        # moments by another quadrature: what this one misses is part of the error
        exact, beyond_all = moments_of([contacts]), np.array([1e90])
        ours = [
            self.integral(beyond_all, power)[power] + self.beyond[power, power]
            for power in range(3)
        ]
        unsure = np.diag(self.missed_beyond)
        # work may vanish though its parts do not; the square is not always known
        work = np.fmax(np.abs(exact.work), 1e-3 * np.sqrt(exact.stretch * exact.square))
        stretch_error = exact.stretch_error + unsure[0]
        work_error = exact.work_error + unsure[1]
        square_error = exact.square_error + unsure[2]
        misses = [
            (np.abs(ours[0] - exact.stretch) + stretch_error) / exact.stretch,
            (np.abs(ours[1] - exact.work) + work_error) / work,
            (np.abs(ours[2] - exact.square) + square_error) / exact.square,
        ]
        # at some travels it may miss more than in the mean over them
        self.error = max(self.error, _WORST * float(np.nanmax(misses)))

    def _evaluated(self, coefficients: Array, x: Array) -> tuple[Array, Array]:
        """Polynomials with `coefficients` (17, 3, panels) at x, shape (3, n), and the
        panels that x are in."""
        log_x = np.log(np.clip(x, self._first, self._last))
        panel = np.searchsorted(self._edges, log_x, side="right") - 1
        panel = np.clip(panel, 0, self._half.size - 1)
        t = (log_x - self._edges[panel]) / self._half[panel] - 1.0
        t = np.clip(t, -1.0, 1.0) / _WITHIN
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
            coefficients[:-1] = chebyshev.chebder(part) / (self._half * _WITHIN)
            per_log_x, panel = self._evaluated(coefficients, x)
            found.append(np.where(x < self._last, per_log_x / x, 0.0))
        return Slope(found[0], np.abs(found[1]), 2.0 * self._half[panel])

    def at(self, x: Array, power: int = 0) -> Array:
        """E[z^power kappa^j; l > x] at travels x > 0 from birth, z the stretch there (x
        of contacts born unstretched), power and j = 0, 1, 2, shape (3, n): with power 0
        S, k1 and k2, with power 1 and j = 1 the mean force m."""
        found, _ = self._evaluated(self._values[:, 3 * power : 3 * power + 3], x)
        return np.asarray(
            np.where(x < self._last, found, 0.0) * self._shorter(x, power)
        )

    def integral(self, x: Array, power: int) -> Array:
        """The integral of that from 0 to x, shape (3, n)."""
        rows = slice(3 * power, 3 * power + 3)
        inside, panel = self._evaluated(self._integrals[:, rows], x)
        before = self._start[rows, None] * np.minimum(x, self._first)
        if not self._stretched:
            before = before / (power + 1.0) * self._shorter(x, power)
        return np.asarray(self._sums[rows, panel] + inside + before)

    def _shorter(self, x: Array, power: int) -> Array:
        """Factor of z^power of contacts born unstretched, before all panels."""
        shorter = np.minimum(x / self._first, 1.0) ** power
        return np.ones_like(x) if self._stretched else np.asarray(shorter)
