"""A life in the mean: who survives to a stretch, how stiff these contacts are, and integrals over both."""

import math
from typing import Protocol

import numpy as np
from numpy.polynomial import chebyshev
from scipy.interpolate import CubicSpline

from eqsim.laws.aging import Langevin, PooledThresholds
from eqsim.laws.newborn import DeltaBirths
from eqsim.laws.threshold import Gamma
from eqsim.master import fokker_planck, newborn, newborn_lives, quenched
from eqsim.master.solvers import solver
from eqsim.model.reduced import Reduced
from eqsim.numerics.panels import ClenshawCurtis, Panels, refined
from eqsim.numerics.tables import Array

_STEP = 0.015  # in ln x, of the profile, whose splines are then good to 2e-8
_BROKEN, _MOST_ROUNDS = 0.02, 8  # most that may break in such a step, reached by so many rounds of splits in four
_SPLINE, _KINKED_SPLINE = 3e-8, 1e-6  # what splines miss, of laws whose density may have kinks
_COARSE_SPLINE = 3e-6  # at the steps that the Fokker-Planck equation takes
_LONGEST_PANEL, _NARROWEST, _SMOOTH, _MOST_PANELS = 2.0, 1e-3, 1e-8, 250  # of contacts born stretched
_WITHIN = 1.0 - 1e-9  # of a panel: not across a jump


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
        """E[z^power kappa^j; l > x] at travels x > 0 from birth, z the stretch there (x of contacts born unstretched),
        power and j = 0, 1, 2, shape (3, n): with power 0 S, k1 and k2, with power 1 and j = 1 the mean force m."""

    def integral(self, x: Array, power: int) -> Array:
        """The integral of that from 0 to x, shape (3, n)."""


def profile_of(s: Reduced, x: Array | None = None) -> Profile:
    """The profile of contacts.

    Parameters
    ----------
    s : Reduced
    x : ndarray, optional
        Every stretch at which integrals will be asked for; only discrete laws, with their jumps, need to know.

    Raises
    ------
    InputError
        Where a solver refuses the contacts.
    """
    profile: Profile
    if s.newborn.active:
        profile = _Stretched(s)
    else:
        profile = _Steps(s, np.empty(0) if x is None else x) if s.law.steps.size else _Smooth(s)
    # C and work by another quadrature: what this one misses is part of the error
    exact = solver(s).stationary(s)
    stretch, work = (float(profile.integral(np.array([1e90]), power)[power, 0]) for power in (0, 1))
    stretch_error = (abs(stretch - exact.stretch) + exact.stretch_error) / exact.stretch
    size, square_error = abs(exact.work), 0.0
    if exact.square is not None:
        size = max(size, 1e-3 * math.sqrt(exact.stretch * exact.square))
        square = float(profile.integral(np.array([1e90]), 2)[2, 0])
        square_error = (abs(square - exact.square) + exact.square_error) / exact.square
    work_error = (abs(work - exact.work) + exact.work_error) / size
    profile.error = max(profile.error, stretch_error, work_error, square_error)
    return profile


class _Steps:
    """Of a discrete law: Gauss-Legendre panels between jumps."""

    jumps, error = True, _KINKED_SPLINE

    def __init__(self, s: Reduced, x: Array) -> None:
        self._reduced, self.x = s, np.unique(np.append(quenched.panels_between_steps(s), x[x > 0]))
        nodes, weights = np.polynomial.legendre.leggauss(6)
        edge = np.append(0.0, self.x)
        half = 0.5 * np.diff(edge)[:, None]
        inner = edge[:-1, None] + half * (1 + nodes)
        values = self.at(inner.ravel()).reshape(3, *inner.shape)
        self._sums = [(values * inner**power * half * weights).sum(axis=2).cumsum(axis=1) for power in range(3)]
        self.survive = self.at(self.x)[0]

    def at(self, x: Array, power: int = 0) -> Array:
        return solver(self._reduced).survivors(self._reduced, x) * x**power

    def integral(self, x: Array, power: int) -> Array:
        index = np.searchsorted(self.x, np.minimum(x, self.x[-1]))
        return np.where(x > 0, self._sums[power][:, np.minimum(index, self.x.size - 1)], 0.0)


class _Smooth:
    """Of a smooth law: splines in ln x."""

    jumps = False

    def __init__(self, s: Reduced) -> None:
        means = solver(s).survivors
        self.error = _SPLINE if isinstance(s.law, (Gamma, PooledThresholds)) else _KINKED_SPLINE
        if isinstance(s.aging, Langevin):
            self.error = float(fokker_planck.survival(s).errors[0].max()) + _COARSE_SPLINE
        rarest = float(s.law.inverse_survival(quenched.rarest_that_counts(s.barrier)))
        top = math.log(s.aging.bracket(rarest / s.law.scale)[1])
        # from where hardly a contact has broken: no rate exceeds omega
        first = -max(math.log(1e15), s.barrier.log_w + math.log(1e7))
        log_x = np.arange(top, first, -_STEP)[::-1]
        values = means(s, np.exp(log_x))
        for _ in range(_MOST_ROUNDS):
            sudden = np.abs(np.diff(values[0])) > _BROKEN
            if not sudden.any():
                break
            inner = log_x[:-1][sudden, None] + np.diff(log_x)[sudden, None] * np.array([0.25, 0.5, 0.75])
            log_x = np.sort(np.append(log_x, inner))
            values = means(s, np.exp(log_x))
        self.x, self.survive = np.exp(log_x), values[0]
        self._values = CubicSpline(log_x, values, axis=1)
        self._totals = [CubicSpline(log_x, values * self.x**power, axis=1).antiderivative() for power in (1, 2, 3)]

    def at(self, x: Array, power: int = 0) -> Array:
        values = self._values(np.log(np.clip(x, self.x[0], self.x[-1])))
        return np.asarray(np.where(x < self.x[-1], values, 0.0) * x**power)

    def integral(self, x: Array, power: int) -> Array:
        total, first = self._totals[power], np.log(self.x[:1])
        before = self._values(first) * np.minimum(x, self.x[0]) ** (power + 1) / (power + 1)  # S and k hardly change
        return np.asarray(total(np.log(np.clip(x, self.x[0], self.x[-1]))) - total(first) + before)


class _Stretched:
    """Of contacts born stretched: Chebyshev panels in ln x that end where S has jumps and kinks."""

    def __init__(self, s: Reduced) -> None:
        self.jumps = s.law.steps.size > 0 and isinstance(newborn.births_of(s), DeltaBirths)
        top, kinks = newborn_lives.longest(s), newborn_lives.kinks(s)
        first = -max(math.log(1e15), (s.barrier.log_w if s.barrier.thermal else 0.0) + math.log(1e7))
        last = math.log(top)
        inner = np.log(kinks)
        edges = np.arange(last, first + last, -_LONGEST_PANEL)[::-1]
        edges = np.unique(np.concatenate((edges, inner[(inner > edges[0]) & (inner < last)])))

        def evaluate(left: Array, right: Array, _: Array) -> Array:
            nodes = ClenshawCurtis.nodes[:, None] * _WITHIN
            t = np.exp(0.5 * (left + right) + 0.5 * (right - left) * nodes)
            values = newborn_lives.survivors(s, t.ravel()).reshape(9, *t.shape)
            return np.concatenate((values, values * t))

        def judge(p: Panels) -> tuple[Array, None]:
            most = np.abs(p.values).max(axis=(1, 2))[:, None]
            rough = np.abs(np.tensordot(ClenshawCurtis.tail.T, p.values, (1, 1))).sum(axis=0)
            return (rough > _SMOOTH * most).any(axis=0) & (p.right - p.left > _NARROWEST), None

        p, _ = refined(evaluate, judge, edges, most=_MOST_PANELS)
        self._edges = np.append(p.left, p.right[-1])
        self._half = 0.5 * (p.right - p.left)
        values, moments = np.split(np.tensordot(ClenshawCurtis.coefficients, p.values, (1, 1)), 2, axis=1)
        self._values = values
        self._integrals = chebyshev.chebint(moments, lbnd=-1, axis=0) * self._half
        panel = self._integrals.sum(axis=0)
        self._sums = np.concatenate((np.zeros((9, 1)), panel.cumsum(axis=1)), axis=1)
        self._first = math.exp(self._edges[0])
        self._start = p.values[:9, 0, 0]
        nodes = 0.5 * (p.left + p.right) + self._half * ClenshawCurtis.nodes[:, None] * _WITHIN
        self.x = np.exp(nodes.T.ravel())
        self.survive = np.minimum.accumulate(np.clip(p.values[0].T.ravel(), 0.0, 1.0))
        missed = np.abs(np.tensordot(ClenshawCurtis.tail.T, p.values[9:], (1, 1))).sum(axis=0) * self._half
        total = np.abs(self._sums[:, -1])
        of = np.array([0, 4, 8])  # S, mean force, its square
        self.error = float((missed.sum(axis=1)[of] / np.maximum(total[of], 1e-3 * total[0])).max())
        self.error += _SMOOTH if isinstance(s.law, Gamma) or self.jumps else _KINKED_SPLINE

    def _at(self, x: Array) -> tuple[Array, Array]:
        log_x = np.log(np.clip(x, self._first, math.exp(self._edges[-1])))
        panel = np.clip(np.searchsorted(self._edges, log_x, side="right") - 1, 0, self._half.size - 1)
        return panel, np.clip((log_x - self._edges[panel]) / self._half[panel] - 1.0, -1.0, 1.0)

    def at(self, x: Array, power: int = 0) -> Array:
        panel, t = self._at(x)
        found = chebyshev.chebval(t, self._values[:, 3 * power : 3 * power + 3, panel], tensor=False)
        return np.asarray(np.where(x < math.exp(self._edges[-1]), found, 0.0))

    def integral(self, x: Array, power: int) -> Array:
        panel, t = self._at(x)
        part = slice(3 * power, 3 * power + 3)
        inside = chebyshev.chebval(t, self._integrals[:, part, panel], tensor=False)
        before = self._start[part, None] * np.minimum(x, self._first)
        return np.asarray(self._sums[part, panel] + inside + before)
