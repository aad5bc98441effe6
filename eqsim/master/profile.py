"""A life in the mean: who survives to a stretch, how stiff these contacts are, and integrals over both."""

import math
from typing import Protocol

import numpy as np
from scipy.interpolate import CubicSpline

from eqsim.laws.aging import Langevin, PooledThresholds
from eqsim.laws.threshold import Gamma
from eqsim.master import fokker_planck, quenched
from eqsim.master.solvers import solver
from eqsim.model.reduced import Reduced
from eqsim.numerics.tables import Array

_STEP = 0.015  # in ln x, of the profile, whose splines are then good to 2e-8
_BROKEN, _MOST_ROUNDS = 0.02, 8  # most that may break in such a step, reached by so many rounds of splits in four
_SPLINE, _KINKED_SPLINE = 3e-8, 1e-6  # what splines miss, of laws whose density may have kinks
_COARSE_SPLINE = 3e-6  # at the steps that the Fokker-Planck equation takes


class Profile(Protocol):
    """A life in the mean, lengths in units of the law's scale.

    Attributes
    ----------
    x, survive : ndarray, shape (n,)
        Ascending stretches that resolve S, and S there.
    error : float
        Relative, of what follows.
    jumps : bool
        Whether S has jumps, as thresholds are discrete.
    """

    x: Array
    survive: Array
    error: float
    jumps: bool

    def at(self, x: Array) -> Array:
        """S = P(x_b > x), k1 = E[k_i/k; x_b > x] and k2 = E[(k_i/k)^2; x_b > x] at x > 0, shape (3, n)."""

    def integral(self, x: Array, power: int) -> Array:
        """int_0^x y^power (S, k1, k2) dy, power = 0, 1, 2, shape (3, n)."""


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
    profile = _Steps(s, np.empty(0) if x is None else x) if s.law.steps.size else _Smooth(s)
    # C and work by another quadrature: what this one misses is part of the error
    exact = solver(s).stationary(s)
    stretch, work = (float(profile.integral(np.array([1e90]), power)[power, 0]) for power in (0, 1))
    stretch_error = (abs(stretch - exact.stretch) + exact.stretch_error) / exact.stretch
    work_error = (abs(work - exact.work) + exact.work_error) / exact.work
    profile.error = max(profile.error, stretch_error, work_error)
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

    def at(self, x: Array) -> Array:
        return solver(self._reduced).survivors(self._reduced, x)

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

    def at(self, x: Array) -> Array:
        return np.asarray(np.where(x < self.x[-1], self._values(np.log(np.clip(x, self.x[0], self.x[-1]))), 0.0))

    def integral(self, x: Array, power: int) -> Array:
        total, first = self._totals[power], np.log(self.x[:1])
        before = self._values(first) * np.minimum(x, self.x[0]) ** (power + 1) / (power + 1)  # S and k hardly change
        return np.asarray(total(np.log(np.clip(x, self.x[0], self.x[-1]))) - total(first) + before)
