"""Transients from a fresh start and stationary fluctuations, by the renewal equation (derived).

All contacts start pinned and unstretched. With S(x) the probability that a life outlasts x and m(x) = x k1(x) the mean
force of a life at x, k1(x) = E[k_i/k; x_b > x], births B and breaks Gamma per contact and unit displacement obey

    Gamma = -dS/dX + B * (-dS/dx),     B = Gamma * (law of v delay)
    pinned = S + B * S,     friction = m + B * m + (eta v/k)(1 - pinned)

with * the convolution over [0, X] (renewal form of Q5a, Q5aG and Q6 of Braun and Peyrard, 2011). Births are spread
evenly over each cell of a uniform grid and every integral over S and m is exact, so that lives much shorter than a
cell are no trouble; the scheme is of second order, of first where most lives are shorter than a cell. Two grids give
the result, extrapolated as of second order, and their difference an error that covers either: with an error e of the
coarser grid e/3 is left at first order, and the difference is e/2.

But contacts that started together may stay in step for many cycles: identical ones always, and all whose lives are
short beside a fixed delay. Harmonic k of their births keeps a share |phi(k)|^m after m cycles, phi(k) = E[exp(i k x_b)]
(derived), of which births spread over cells h lose what has k h sqrt(m) > 1. The cells are made short enough for what
is in step, and where they cannot be the share that may still be in step is part of the error.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import fft, ndimage, signal
from scipy.interpolate import CubicSpline

from eqsim.errors import InputError, require_integer, require_number
from eqsim.estimate import known
from eqsim.laws.aging import Langevin, PooledThresholds, Unaged
from eqsim.laws.delay import Exponential, Fixed
from eqsim.laws.threshold import Gamma
from eqsim.master import fokker_planck, quenched
from eqsim.master.steady import reference, settled, solver
from eqsim.model.drive import Drive, require_drive
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import Reduced
from eqsim.numerics.tables import Array

Integral = Callable[[Array], Array]

_CELL, _LEAST_CELLS, _MOST_CELLS = 0.02, 500, 10_000  # of the coarser grid; a cell in units of the typical threshold
_FINEST, _FINER = 160_000, 4  # cells where contacts stay in step, reached by this factor
_BLURRED, _RESOLVED = 1.5, 0.3  # k h sqrt(m) that two grids still tell; the share in step beyond it that they may miss
_STEP = 0.015  # in ln x, of the life's profile, whose splines are then good to 2e-8
_BROKEN, _MOST_ROUNDS = 0.02, 8  # most that may break in such a step, reached by so many rounds of splits in four
_SPLINE, _SMOOTH = 3e-8, 1e-9
_KINKED_SPLINE = 1e-6  # of laws whose density may have kinks
_COARSE_SPLINE = 3e-6  # of the steps that the Fokker-Planck equation takes
_AROUND, _WRAPPED = 6, 1e-13  # length of the circle in transients, and what of the next turn remains


@dataclass(frozen=True)
class Transient:
    """Exact means from a fresh start: `X` (length), `force` = <F>/(N k) (length), `pinned`, `breaks` Gamma per contact
    and unit displacement, each of shape (points,), and error estimates of the first two."""

    X: Array
    force: Array
    pinned: Array
    breaks: Array
    force_error: Array
    pinned_error: Array


class Profile:
    """A life in the mean: S(x), k1 = E[k_i/k; x_b > x], k2 = E[(k_i/k)^2; x_b > x], and their integrals from 0."""

    def __init__(self, s: Reduced, grid: Array) -> None:
        """`grid` holds every x that will be asked for; only discrete laws, with their jumps, need to know."""
        self.reduced, self.error = s, _SPLINE if isinstance(s.law, (Gamma, PooledThresholds)) else _KINKED_SPLINE
        self.steps = s.law.steps.size > 0
        if self.steps:
            self.x = np.unique(np.append(quenched.panels_between_steps(s), grid[grid > 0]))
            nodes, weights = np.polynomial.legendre.leggauss(6)
            edge = np.append(0.0, self.x)
            half = 0.5 * np.diff(edge)[:, None]
            inner = edge[:-1, None] + half * (1 + nodes)
            values = self._solve(inner.ravel()).reshape(3, *inner.shape)
            self._sums = [(values * inner**power * half * weights).sum(axis=2).cumsum(axis=1) for power in range(3)]
            self.survive = self._solve(self.x)[0]
            self._judge()
            return
        rarest = float(s.law.exceeded_by(quenched.rarest_that_counts(s.barrier)))
        top = math.log(rarest / s.law.scale * max(1.0, s.aging.final))
        # from where hardly a contact has broken: no rate exceeds omega
        first = -max(math.log(1e15), s.barrier.log_w + math.log(1e7))
        log_x = np.arange(top, first, -_STEP)[::-1]
        values = self._solve(np.exp(log_x))
        for _ in range(_MOST_ROUNDS):
            sudden = np.abs(np.diff(values[0])) > _BROKEN
            if not sudden.any():
                break
            inner = log_x[:-1][sudden, None] + np.diff(log_x)[sudden, None] * np.array([0.25, 0.5, 0.75])
            log_x = np.sort(np.append(log_x, inner))
            values = self._solve(np.exp(log_x))
        self.x, self.survive = np.exp(log_x), values[0]
        self._values = CubicSpline(log_x, values, axis=1)
        start = self.x[0] ** np.arange(1, 4)[:, None, None] / np.arange(1, 4)[:, None, None] * values[:, :1]
        powers = [CubicSpline(log_x, values * self.x**power, axis=1).antiderivative() for power in (1, 2, 3)]
        self._integrals = [lambda at, p=p, c=c: p(at) - p(log_x[:1]) + c for p, c in zip(powers, start, strict=True)]
        self._judge()

    def _judge(self) -> None:
        """C and work by another quadrature: what this one misses is part of the error."""
        exact = solver(self.reduced).stationary(self.reduced)
        stretch, work = (float(self.integral(np.array([1e90]), power)[power, 0]) for power in (0, 1))
        stretch_error = (abs(stretch - exact.stretch) + exact.stretch_error) / exact.stretch
        self.error = max(self.error, stretch_error, (abs(work - exact.work) + exact.work_error) / exact.work)

    def _solve(self, x: Array) -> Array:
        s = self.reduced
        if not s.annealed and isinstance(s.aging, Langevin):
            self.error = float(fokker_planck.survival(s).errors[0].max()) + _COARSE_SPLINE
        means = solver(s).survivors
        if self.steps or s.annealed or not isinstance(s.aging, Unaged):
            return means(s, x)
        return quenched.interpolated(lambda x: means(s, x), x, _SMOOTH)

    @property
    def strongest(self) -> float:
        """The greatest m = x k1."""
        return float((self.x * self.at(self.x)[1]).max())

    def at(self, x: Array) -> Array:
        """S, k1, k2 at x > 0, shape (3, n)."""
        if self.steps:
            return np.asarray(self._solve(x))
        return np.asarray(np.where(x < self.x[-1], self._values(np.log(np.clip(x, self.x[0], self.x[-1]))), 0.0))

    def integral(self, x: Array, power: int) -> Array:
        """int_0^x y^power (S, k1, k2) dy, shape (3, n)."""
        if self.steps:
            index = np.searchsorted(self.x, np.minimum(x, self.x[-1]))
            return np.where(x > 0, self._sums[power][:, np.minimum(index, self.x.size - 1)], 0.0)
        inside = np.clip(x, self.x[0], self.x[-1])
        start = self._values(np.log(self.x[:1])) * x ** (power + 1) / (power + 1)
        return np.asarray(np.where(x >= self.x[0], self._integrals[power](np.log(inside)), start))


def _steady(ensemble: Ensemble, drive: Drive, points: int) -> Transient:
    """A stationary start: nothing changes."""
    exact = reference(ensemble, drive)
    level = np.ones(points)
    breaks = known(exact.pinned) / known(exact.break_stretch)
    return Transient(
        X=np.linspace(0.0, drive.over(ensemble), points),
        force=known(exact.friction) * level,
        pinned=known(exact.pinned) * level,
        breaks=breaks * level,
        force_error=(exact.friction.stderr or 0.0) * level,
        pinned_error=(exact.pinned.stderr or 0.0) * level,
    )


class _Means(NamedTuple):
    force: Array
    pinned: Array
    breaks: Array


def transient(ensemble: Ensemble, drive: Drive, points: int = 2001) -> Transient:
    """F(X), pinned(X) and Gamma(X) at `points` equidistant X, from a fresh or a stationary start. Raises InputError."""
    require_drive(drive)
    require_integer("points", points, 2, 10**8)
    if drive.start == "stationary":
        return _steady(ensemble, drive, points)
    s = settled(ensemble, drive.velocity).reduced
    unit = s.law.scale
    distance = drive.over(ensemble) / unit
    require_number("distance / threshold", distance, least=1e-100, most=1e100)
    profile, fine, in_step, around = grid_of(s, distance, points)
    cells = in_step.size - 1
    # what the mean may be while all are in step
    loudest = max(profile.strongest, s.drag if s.delay.mean else 0.0), 1.0 if s.delay.mean else 0.0
    solved = [means_of(profile, fine[::step], s) for step in (2, 1)]
    X = np.linspace(0.0, distance, points)
    found, errors = {}, {}
    for name, loud in zip(_Means._fields, (*loudest, 0.0), strict=True):
        coarse, better = (np.asarray(getattr(means, name)) for means in solved)
        if name == "breaks":  # of cells; a pair of fine ones is a coarse one
            centres = fine[1::2]
            found[name] = np.interp(X, centres, np.maximum((better[0::2] + better[1::2]) / 2, 0.0))
            continue
        best = (4 * better[::2] - coarse) / 3
        # the difference may vanish by chance where the error does not
        error = ndimage.maximum_filter1d(np.abs(better[::2] - coarse), cells // 20) + profile.error * np.abs(best)
        if profile.steps:  # equal thresholds break together: near a jump the truth is somewhere between neighbours
            near = ndimage.maximum_filter1d(coarse, 5) - ndimage.minimum_filter1d(coarse, 5)
            # jumps that cells blur, in twice as many steps of half the length, differ by 0.083 of their height
            error += np.maximum(near, 8 * ndimage.maximum_filter1d(np.abs(better[::2] - coarse), around))
        error += max(float(np.ptp(best)), loud) * in_step
        if points - 1 > cells:
            error += _between(best)
        found[name] = np.interp(X, fine[::2], best)
        errors[name] = np.interp(X, fine[::2], error)
    return Transient(
        X=X * unit,
        force=found["force"] * unit,
        pinned=found["pinned"],
        breaks=found["breaks"] / unit,
        force_error=errors["force"] * unit,
        pinned_error=errors["pinned"],
    )


def _between(values: Array) -> Array:
    """A bound of what straight lines between equidistant values miss: their curvature eightfold."""
    return np.asarray(ndimage.maximum_filter1d(np.pad(np.abs(np.diff(values, 2)), 1, "edge"), 3))


class Cells(NamedTuple):
    """A life and the edges `x` of the finer grid, every second one of which is of the coarser; what share of the
    contacts may be in step (cells + 1,) at edges of the coarser grid in a way that neither grid can tell; and over how
    many of these edges it may blur the jumps of a discrete law."""

    profile: Profile
    x: Array
    in_step: Array
    around: int


def grid_of(s: Reduced, distance: float, points: int) -> Cells:
    """Cells that resolve what has to be resolved on the way, as far as possible."""
    discrete = s.law.steps.size > 0
    least = min(max(distance / _CELL, _LEAST_CELLS), _MOST_CELLS)
    # every threshold of a discrete law takes time in every cell
    finest = _FINEST // (4 * np.unique(s.law.steps).size) if discrete else _FINEST
    profile = None if discrete else Profile(s, np.empty(0))
    while True:
        cells = int(least)
        if points - 1 <= max(finest, _MOST_CELLS):
            cells = (points - 1) * max(1, round(cells / (points - 1)))
        fine = distance / (2 * cells) * np.arange(2 * cells + 1)
        lives = profile or Profile(s, fine)
        in_step, around = _in_step(lives, s, fine[::2])
        if in_step.max() <= _RESOLVED:
            return Cells(lives, fine, np.zeros(cells + 1), around)
        least *= _FINER
        if least > finest:
            return Cells(lives, fine, in_step, around)


def _in_step(profile: Profile, s: Reduced, x: Array) -> tuple[Array, int]:
    """The share of contacts that may be in step at each edge `x` of a grid that blurs it, and `Cells.around`."""
    h = x[1]
    broken = -np.diff(profile.survive, prepend=1.0)
    quick, slow = (float(profile.x[np.argmax(profile.survive <= share)]) for share in (0.75, 0.25))
    cycle = s.delay.mean + slow
    k = np.geomspace(2 * math.pi / cycle, max(100.0 / quick, 200.0 / cycle), 400 if profile.steps else 50)
    many = broken > 1e-8
    broken, width = broken[many], np.diff(profile.x, prepend=0.0)[many]
    phase = np.outer(k, profile.x[many] - 0.5 * width)
    # lives that last for many waves are out of step
    seen = (np.outer(k, width) < 1.0) | profile.steps
    together = np.abs(np.where(seen, np.exp(1j * phase), 0.0) @ broken)
    together *= s.delay.coherence(k)
    together = np.minimum(np.maximum.accumulate(together[::-1])[::-1], 1.0)
    m = np.maximum(x / cycle, 1.0)
    at = np.searchsorted(k, _BLURRED / (h * np.sqrt(m)))
    share = together[np.minimum(at, k.size - 1)] ** m
    share[0] = 0.0
    around = 2 + math.ceil(4 * math.sqrt(x[-1] / (6 * (s.delay.mean + quick)))) if profile.steps else 0
    if profile.steps and around * h < min(quick, s.delay.mean or quick):
        share[:] = 0.0  # what is in step is longer than the grid blurs it
    return share, 2 * around + 1


def means_of(profile: Profile, x: Array, s: Reduced) -> _Means:
    """Force and pinned at the edges `x` of a uniform grid of cells, breaks in each cell per unit displacement.

    By generating functions: with w of the chance to be still detached, d = 1 - (1 - z) w of births after a break, and D
    of survival, breaks (w + d D) is that of 1 - S, as every contact is either pinned or detached (derived). They are
    taken on a circle |z| < 1 where hardly anything comes around.
    """
    cells, h = x.size - 1, x[1]
    survive, stiff, _ = np.concatenate(([[1.0], [profile.at(x[1:2] * 1e-9)[1, 0]], [0.0]], profile.at(x[1:])), axis=1)
    size = fft.next_fast_len(_AROUND * cells, real=True)
    damping = _WRAPPED ** (np.arange(cells) / size)

    def transform(part: Array) -> Array:
        return np.asarray(fft.rfft(part * damping, size))

    def back(product: Array) -> Array:
        return np.asarray(fft.irfft(product, size)[:cells] / damping)

    alive, work = (transform(np.diff(profile.integral(x, power)[power]) / h) for power in (0, 1))
    waiting = transform(s.delay.waiting(h, cells))
    z = _WRAPPED ** (1.0 / size) * np.exp(-2j * math.pi / size * np.arange(waiting.size))
    reborn = 1.0 - (1.0 - z) * waiting
    breaks = transform(1.0 - survive[1:]) / (waiting + reborn * alive)
    detached = np.append(0.0, back(waiting * breaks))
    force = x * stiff + np.append(0.0, back(reborn * breaks * work))
    return _Means(force + s.drag * detached, 1.0 - detached, back(breaks) / h)


@dataclass(frozen=True)
class Fluctuations:
    """Stationary fluctuations of F for independent contacts: `lag` (length), and N times the autocovariance of
    F/(N k) (length squared) at these lags; at lag 0 it is N times the variance."""

    lag: Array
    covariance: Array
    error: Array


def fluctuations(ensemble: Ensemble, drive: Drive, points: int = 101) -> Fluctuations:
    """Stationary variance and autocovariance of F at `points` lags from 0 to the drive's distance. Raises InputError.

    A contact found at stretch x (density E[S]/(C + v<tau>)) either survives the lag, or breaks after y and begins anew
    with the transient of a contact that has just broken; one found detached begins with the rest of its delay. What
    the stiffness was a while ago is not known where it follows an aging threshold: refused.
    """
    require_integer("points", points, 2, 10**6)
    require_drive(drive)
    distance = drive.over(ensemble)
    s = settled(ensemble, drive.velocity).reduced
    if not isinstance(s.aging, Unaged) and s.stiffness == "sqrt":
        raise InputError('stiffness_law = "sqrt": fluctuations of aging quenched contacts need "uniform"')
    unit = s.law.scale
    exact = reference(ensemble, drive)
    cycle = known(exact.break_stretch) / unit + s.delay.mean
    mean, pinned = known(exact.friction) / unit, known(exact.pinned)
    profile, fine, in_step, _ = grid_of(s, distance / unit, points)
    solved = []
    for step in (2, 1):
        x = fine[::step]
        h = x[1]
        means = means_of(profile, x, s)
        # int_x^inf y^power (S, k1, k2) dy
        rest = [profile.integral(np.array([1e90]), power) - profile.integral(x, power) for power in range(3)]
        # int_x^inf y (y - x) k2 dy of those that survive, and int_x^inf (y - x) k1 dy, whose decrease weighs breaks by
        # the force they had at the beginning
        surviving = rest[2][2] - x * rest[1][2]
        carried = rest[1][1] - x * rest[0][1]
        breaks = (carried[:-1] - carried[1:]) / cycle  # in each cell, times force
        after, detached = _reborn(means.force, x, s)
        back = np.append(0.0, signal.fftconvolve(breaks, np.diff(after) / h)[: x.size - 1])
        waiting = s.drag * (1.0 - pinned) * detached
        solved.append((surviving / cycle + back + waiting - mean**2)[:: 3 - step])
    best = (4 * solved[1] - solved[0]) / 3
    # kinks, which jumps of a discrete law make, are of lower order
    missed = ndimage.maximum_filter1d(np.abs(solved[1] - solved[0]), in_step.size // 20)
    error = missed * (3 if profile.steps else 1) + (profile.error + in_step) * np.abs(best).max()
    if points - 1 > in_step.size - 1:
        error += _between(best)
    lag = np.linspace(0.0, distance, points)
    found, errors = (np.interp(lag / unit, fine[::2], part) * unit**2 for part in (best, error))
    return Fluctuations(lag, found, errors)


def _reborn(fresh: Array, x: Array, s: Reduced) -> tuple[Array, Array]:
    """Integral of the mean force from a break on, and mean force of a contact found detached, from the mean force
    `fresh` of one just pinned."""
    total = CubicSpline(x, fresh).antiderivative()
    if s.delay.mean == 0:
        return total(x), np.zeros_like(x)
    return _REBORN[type(s.delay)](fresh, x, total, s.delay.mean, s.drag)


def _after_fixed(fresh: Array, x: Array, total: Integral, delay: float, drag: float) -> tuple[Array, Array]:
    """`_reborn` of contacts that wait as long as each other."""
    late = total(np.maximum(x - delay, 0.0))
    return drag * np.minimum(x, delay) + late, drag * np.maximum(1.0 - x / delay, 0.0) + (total(x) - late) / delay


def _after_exponential(fresh: Array, x: Array, total: Integral, delay: float, drag: float) -> tuple[Array, Array]:
    """`_reborn` of contacts that attach at random."""
    # y' = (fresh - y)/delay, the mean force of those already pinned again, with fresh linear in each cell
    ratio = x[1] / delay
    keep, first = math.exp(-ratio), -math.expm1(-ratio)
    slope = 1.0 - first / ratio
    y = signal.lfilter([1.0], [1.0, -keep], np.append(0.0, (first - slope) * fresh[:-1] + slope * fresh[1:]))
    fading = np.exp(-x / delay)
    return drag * delay * (1.0 - fading) + total(x) - delay * y, drag * fading + y


_REBORN = {Fixed: _after_fixed, Exponential: _after_exponential}
