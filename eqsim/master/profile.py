"""A life in the mean: who survives to a stretch, how stiff these contacts are, and
integrals over both."""

import math
from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
from numpy.polynomial import chebyshev

from eqsim.laws.aging import Langevin, Unaged
from eqsim.laws.newborn import DeltaBirths
from eqsim.master import (
    annealed,
    flow,
    fokker_planck,
    newborn,
    newborn_lives,
    quenched,
)
from eqsim.master.solvers import solver
from eqsim.model.reduced import Reduced
from eqsim.numerics.panels import ClenshawCurtis, Panels, refined
from eqsim.numerics.quadrature import gauss_legendre
from eqsim.numerics.tables import Array

# Relative error of the panels that Gauss-Legendre nodes integrate between the jumps of
# a discrete law.
_BETWEEN_JUMPS = 1e-6
# Relative error of sums of powers of a discrete law's thresholds.
_ROUNDED = 1e-12
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
_NARROWEST = 1e-9
# Panels beyond which none is split any more, where a solver's noise keeps coefficients
# from falling.
_MOST_PANELS = 600
# Nodes of a panel lie within it, not across a jump.
_WITHIN = 1.0 - 1e-9
_POWERS = np.arange(3)[:, None, None]

# Travels x > 0, shape (n,), to E[z^i kappa^j; l > x], i and j from 0 to 2, shape (3, 3,
# n).
_Means = Callable[[Array], Array]


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
    s : Reduced
    x : ndarray, optional
        Every stretch at which integrals will be asked for; only discrete laws, with
        their jumps, need to know.

    Raises
    ------
    InputError
        Where a solver refuses the contacts.
    """
    stepped = contacts.law.steps.size > 0 and not contacts.newborn.active
    profile: Profile = (
        _Steps(contacts, np.empty(0) if x is None else x)
        if stepped
        else SmoothLife(contacts)
    )
    # C and work by another quadrature: what this one misses is part of the error
    exact = solver(contacts).stationary(contacts)
    stretch, work = (
        float(profile.integral(np.array([1e90]), power)[power, 0]) for power in (0, 1)
    )
    stretch_error = (abs(stretch - exact.stretch) + exact.stretch_error) / exact.stretch
    size, square_error = abs(exact.work), 0.0
    if exact.square is not None:
        size = max(size, 1e-3 * math.sqrt(exact.stretch * exact.square))
        square = float(profile.integral(np.array([1e90]), 2)[2, 0])
        square_error = (abs(square - exact.square) + exact.square_error) / exact.square
    work_error = (abs(work - exact.work) + exact.work_error) / size
    # at some travels it may miss more than in the mean over them
    profile.error = max(
        profile.error, _WORST * max(stretch_error, work_error, square_error)
    )
    return profile


class _Steps:
    """A life of a discrete law: Gauss-Legendre panels between jumps."""

    jumps = True

    def __init__(self, contacts: Reduced, x: Array) -> None:
        # without heat and aging nothing changes between jumps
        exact = isinstance(contacts.aging, Unaged) and not contacts.barrier.thermal
        self.error = _ROUNDED if exact else _BETWEEN_JUMPS
        self._reduced, self.x = (
            contacts,
            np.unique(np.append(quenched.panels_between_steps(contacts), x[x > 0])),
        )
        nodes, weights = gauss_legendre(6)
        edge = np.append(0.0, self.x)
        half = 0.5 * np.diff(edge)[:, None]
        inner = edge[:-1, None] + half * (1 + nodes)
        values = self.at(inner.ravel()).reshape(3, *inner.shape)
        self._sums = [
            (values * inner**power * half * weights).sum(axis=2).cumsum(axis=1)
            for power in range(3)
        ]
        self.survive = self.at(self.x)[0]

    def at(self, x: Array, power: int = 0) -> Array:
        contacts = self._reduced
        survivors = annealed.survivors if contacts.annealed else _quenched(contacts)
        return np.asarray(survivors(contacts, x) * x**power)

    def integral(self, x: Array, power: int) -> Array:
        index = np.searchsorted(self.x, np.minimum(x, self.x[-1]))
        return np.where(
            x > 0, self._sums[power][:, np.minimum(index, self.x.size - 1)], 0.0
        )


def _means_of(contacts: Reduced) -> _Means:
    if contacts.newborn.active:
        return lambda x: newborn_lives.survivors(contacts, x)
    if contacts.annealed:
        return lambda x: newborn_lives.published(contacts, np.zeros(x.size), x)
    if isinstance(contacts.aging, Langevin):
        return lambda x: x**_POWERS * fokker_planck.survivors(contacts, x)
    survivors = _quenched(contacts)
    return lambda x: x**_POWERS * survivors(contacts, x)


def _quenched(contacts: Reduced) -> Callable[[Reduced, Array], Array]:
    unaged = isinstance(contacts.aging, Unaged)
    return quenched.survivors_at if unaged else flow.survivors


def _first_edges(contacts: Reduced) -> Array:
    """Ascending ln x, at the kinks of survival besides: from where hardly a contact has
    broken, as no rate exceeds omega, to where hardly a contact is left."""
    if contacts.newborn.active:
        top, kinks = newborn_lives.longest(contacts), newborn_lives.kinks(contacts)
    else:
        rarest = float(
            contacts.law.inverse_survival(quenched.rarest_that_counts(contacts.barrier))
        )
        top, kinks = (
            contacts.aging.bracket(rarest / contacts.law.scale)[1],
            quenched.ends(contacts, contacts.law.kinks / contacts.law.scale),
        )
    last, inner = math.log(top), np.log(kinks)
    first = -max(
        math.log(1e15),
        (contacts.barrier.log_w if contacts.barrier.thermal else 0.0) + math.log(1e7),
    )
    edges = np.arange(last, min(first, last - _LONGEST_PANEL), -_LONGEST_PANEL)[::-1]
    return np.unique(
        np.concatenate((edges, inner[(inner > edges[0]) & (inner < last)]))
    )


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
            and contacts.law.steps.size > 0
            and isinstance(newborn.births_of(contacts), DeltaBirths)
        )
        fluctuating = isinstance(contacts.aging, Langevin)
        smooth = _COARSE_SPLINE if fluctuating else _SMOOTH
        means = _means_of(contacts)

        def evaluate(left: Array, right: Array, _: Array) -> Array:
            nodes = ClenshawCurtis.nodes[:, None] * _WITHIN
            x = np.exp(0.5 * (left + right) + 0.5 * (right - left) * nodes)
            values = means(x.ravel()).reshape(9, *x.shape)
            return np.concatenate((values, values * x))

        def judge(panels: Panels) -> tuple[Array, None]:
            most = np.abs(panels.values).max(axis=(1, 2))[:, None]
            rough = np.abs(
                np.tensordot(ClenshawCurtis.tail.T, panels.values, (1, 1))
            ).sum(axis=0)
            return (rough > smooth * most).any(axis=0) & (
                panels.right - panels.left > _NARROWEST
            ), None

        p, _ = refined(evaluate, judge, _first_edges(contacts), most=_MOST_PANELS)
        self._edges = np.append(p.left, p.right[-1])
        self._half = 0.5 * (p.right - p.left)
        values, moments = np.split(
            np.tensordot(ClenshawCurtis.coefficients, p.values, (1, 1)), 2, axis=1
        )
        self._values = values
        self._integrals = chebyshev.chebint(moments, lbnd=-1, axis=0) * self._half
        self._sums = np.concatenate(
            (np.zeros((9, 1)), self._integrals.sum(axis=0).cumsum(axis=1)), axis=1
        )
        self._first = math.exp(self._edges[0])
        self._start = p.values[:9, 0, 0]
        nodes = (
            0.5 * (p.left + p.right)
            + self._half * ClenshawCurtis.nodes[:, None] * _WITHIN
        )
        self.x = np.exp(nodes.T.ravel())
        self.survive = np.minimum.accumulate(np.clip(p.values[0].T.ravel(), 0.0, 1.0))
        missed = (
            np.abs(np.tensordot(ClenshawCurtis.tail.T, p.values[9:], (1, 1))).sum(
                axis=0
            )
            * self._half
        )
        total = np.abs(self._sums[:, -1])
        squares = np.array(
            [0, 4, 8]
        )  # of S, of the mean force, of the mean square of the force
        self.error = (
            float(
                (
                    missed.sum(axis=1)[squares]
                    / np.maximum(total[squares], 1e-3 * total[0])
                ).max()
            )
            + smooth
        )
        if fluctuating:
            self.error += float(fokker_planck.survival(contacts).errors[0].max())

    def _evaluated(self, coefficients: Array, x: Array) -> tuple[Array, Array]:
        """Polynomials with `coefficients` (17, 3, panels) at x, shape (3, n), and the
        panels that x are in."""
        log_x = np.log(np.clip(x, self._first, math.exp(self._edges[-1])))
        panel = np.clip(
            np.searchsorted(self._edges, log_x, side="right") - 1,
            0,
            self._half.size - 1,
        )
        t = np.clip((log_x - self._edges[panel]) / self._half[panel] - 1.0, -1.0, 1.0)
        order = np.argsort(panel, kind="stable")
        powers = chebyshev.chebvander(t[order], coefficients.shape[0] - 1)
        ends = np.searchsorted(panel[order], np.arange(self._half.size + 1))
        found = np.empty((x.size, 3))
        for i in np.flatnonzero(np.diff(ends)):
            rows = slice(ends[i], ends[i + 1])
            found[order[rows]] = powers[rows] @ coefficients[:, :, i]
        return found.T, panel

    def slope(self, x: Array, power: int = 0) -> Slope:
        """Derivatives of `at` with respect to x > 0, at a kink that of the panel to its
        right."""
        values = self._values[:, 3 * power : 3 * power + 3]
        highest = np.where(
            np.arange(values.shape[0])[:, None, None] >= values.shape[0] - 2,
            values,
            0.0,
        )
        derivatives = []
        for part in (values, highest):
            coefficients = np.zeros_like(values)
            coefficients[:-1] = chebyshev.chebder(part, axis=0) / self._half
            found, panel = self._evaluated(coefficients, x)
            derivatives.append(np.where(x < math.exp(self._edges[-1]), found / x, 0.0))
        return Slope(derivatives[0], np.abs(derivatives[1]), 2.0 * self._half[panel])

    def at(self, x: Array, power: int = 0) -> Array:
        found, _ = self._evaluated(self._values[:, 3 * power : 3 * power + 3], x)
        return np.asarray(np.where(x < math.exp(self._edges[-1]), found, 0.0))

    def integral(self, x: Array, power: int) -> Array:
        rows = slice(3 * power, 3 * power + 3)
        inside, panel = self._evaluated(self._integrals[:, rows], x)
        before = self._start[rows, None] * np.minimum(x, self._first)
        return np.asarray(self._sums[rows, panel] + inside + before)
