"""Transients from a fresh start and stationary fluctuations, by the renewal equation
(derived).

All contacts start pinned, as newborn ones. With S(x) the probability that a life
outlasts a travel x, and m(x) the mean force of a life there, E[(k_i/k)(y + x); l > x]
of births at y, births B and breaks Gamma per contact and unit displacement obey

    Gamma = -dS/dX + B * (-dS/dx),     B = Gamma * (law of v delay)
    pinned = S + B * S,     friction = m + B * m + (eta v/k)(1 - pinned)

with * the convolution over [0, X] (renewal form of Q5a, Q5aG and Q6 of Braun and
Peyrard, 2011). Births are spread evenly over each cell of a uniform grid and every
integral over S and m is exact, so that lives much shorter than a cell are no trouble;
the scheme is of second order, of first where most lives are shorter than a cell. Two
grids give the result, extrapolated as of second order, and their difference an error
that covers either: with an error e of the coarser grid e/3 is left at first order, and
the difference is e/2.

But contacts that started together may stay in step for many cycles: identical ones
always, and all whose lives are short beside a fixed delay. Harmonic k of their births
keeps a share |phi(k)|^m after m cycles, phi(k) = E[exp(i k x_b)] (derived), of which
births spread over cells h lose what has k h sqrt(m) > 1. The cells are made short
enough for what is in step, and where they cannot be the share that may still be in step
is part of the error.
"""

import math
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np
from scipy import fft
from scipy.interpolate import CubicSpline

from eqsim.errors import InputError, require_integer, require_number
from eqsim.estimate import known
from eqsim.laws.delay import Exponential, Fixed
from eqsim.master import programme, slider
from eqsim.master.profile import Profile, profile_of
from eqsim.master.quenched import integrals_beyond
from eqsim.master.steady import reference, settled
from eqsim.model.drive import Drive, Programme, require_drive
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import Reduced
from eqsim.numerics.quadrature import extrapolated, largest_nearby
from eqsim.numerics.tables import Array
from eqsim.results import Drawn, Result

# A cell of the coarser grid in units of the typical threshold.
_CELL = 0.02
# Fewest and most cells of the coarser grid.
_LEAST_CELLS = 500
_MOST_CELLS = 10_000
# Cells where contacts stay in step, reached by the factor `_FINER`.
_FINEST = 160_000
_FINER = 4
# k h sqrt(m) that two grids still tell.
_BLURRED = 1.5
# The share in step beyond it that they may miss.
_RESOLVED = 0.3
# Length of the circle in transients.
_AROUND = 6
# What remains of the next turn of it.
_WRAPPED = 1e-13
# A stretch beyond any.
_EVERYTHING = np.array([1e90])


@dataclass(frozen=True, repr=False)
class Transient(Result):
    """Exact means over independent contacts on the way, arrays of shape (points,).

    Attributes
    ----------
    X, t : ndarray
        Displacement (length) and time.
    force, force_error : ndarray
        <F>/(N k) and its error estimate (length).
    pinned, pinned_error : ndarray
        Fraction of pinned contacts and its error estimate.
    breaks : ndarray
        Gamma, breaks per contact and unit displacement (1/length); along a programme,
        which may hold, per unit time (1/time), and in the mean over a step of the
        solver.
    force_variance, force_variance_error : ndarray or None
        Variance over contacts of the force of one over k (length^2), and its error
        estimate; None if not asked for, where contacts stay in step for longer than the
        grids can tell, or where a stationary one is infinite.
    stage, X_error : ndarray or None
        Of a slider that a stage pulls, in mean field: displacement of the stage's end
        of the spring, and the error estimate of X, which is found with it (length).
    """

    drawn: ClassVar[Drawn] = Drawn(
        "X", "force", "force_error", "displacement  X", "mean friction force  <F>/(N k)"
    )
    X: Array
    force: Array
    pinned: Array
    breaks: Array
    force_error: Array
    pinned_error: Array
    t: Array
    force_variance: Array | None = None
    force_variance_error: Array | None = None
    stage: Array | None = None
    X_error: Array | None = None


def transient(
    ensemble: Ensemble,
    drive: Drive | Programme,
    points: int = 2001,
    *,
    variance: bool = False,
) -> Transient:
    """Solve for the exact means of a run by the renewal equation.

    Force is F/(N k), a length. The equation is the renewal form of eqs. (1), (3) and (4)
    of Braun and Peyrard (2011) (derived), along a programme in two times
    (`master.programme`), and of a slider that a stage pulls in mean field
    (`master.slider`), where X is found, not given. Coupled blocks are refused.

    Parameters
    ----------
    ensemble : Ensemble
    drive : Drive or Programme
        A fresh start gives the transient; at constant velocity a stationary one gives
        the steady values. Velocities are length/time, distances lengths.
    points : int
        Number of equidistant displacements from 0 to the drive's distance; along a
        programme that of `Programme.grid`.
    variance : bool
        Whether to solve for the variance of forces, too.

    Returns
    -------
    Transient

    Raises
    ------
    InputError
        For arguments out of range; along a programme for annealed contacts that age,
        the rule "langevin", contacts born stretched, and more steps than can be solved
        for.

    Examples
    --------
    >>> from eqsim import Drive, Ensemble, transient
    >>> transient(Ensemble(), Drive(0.1, distance=3.0), points=4).force.round(4).tolist()
    [0.0, 0.8579, 0.8727, 0.8897]
    """
    require_integer("points", points, 2, 10**8)
    if isinstance(drive, Programme):
        return _along(ensemble, drive, points, variance)
    require_drive(drive)
    s, unit = settled(ensemble, drive.velocity), ensemble.thresholds.scale
    distance = drive.over(ensemble) / unit
    require_number("distance / threshold", distance, least=1e-100, most=1e100)
    if drive.start == "stationary":
        return _steady(ensemble, drive, points, variance)
    cells = cells_of(s, distance, points)
    solved = [means_of(cells.profile, cells.x[::step], s) for step in (2, 1)]
    X, edges = np.linspace(0.0, distance, points), cells.x[::2]
    # up to which the mean may rise while all are in step
    strongest = np.maximum.accumulate(np.abs(from_birth(cells.profile, s, edges, 1)))
    delayed, means = s.delay.mean > 0, []
    loudest_of = np.maximum(strongest, s.drag * delayed), 1.0 * delayed
    for coarse, better, loudest in zip(
        *(way[:2] for way in solved), loudest_of, strict=True
    ):
        best, error = _with_error(coarse, better[::2], cells, loudest)
        if points > edges.size:
            error += _between_edges(best)
        means += [np.interp(X, edges, best), np.interp(X, edges, error)]
    force, force_error, pinned, pinned_error = means
    pairs = solved[1].breaks  # of cells; a pair of fine ones is a coarse one
    pairs = np.maximum((pairs[0::2] + pairs[1::2]) / 2, 0.0)
    breaks = np.interp(X, cells.x[1::2], pairs)
    found = Transient(
        X=X * unit,
        force=force * unit,
        pinned=pinned,
        breaks=breaks / unit,
        force_error=force_error * unit,
        pinned_error=pinned_error,
        t=X * unit / drive.velocity,
    )
    if not variance or cells.in_step.any():
        return found
    squares, error = (np.interp(X, edges, part) for part in _squares(cells, s, solved))
    return replace(
        found,
        force_variance=(squares - force**2) * unit**2,
        force_variance_error=(error + 2 * force * force_error) * unit**2,
    )


def _along(
    ensemble: Ensemble, drive: Programme, points: int, variance: bool
) -> Transient:
    """Along a programme."""
    grid, pulled = drive.grid(points), None
    if drive.stage:
        pulled = slider.pulled_of(ensemble, drive, grid)
    means = pulled.means if pulled else programme.means_of(ensemble, drive, grid)
    found = Transient(pulled.X if pulled else grid.X, *means[:5], grid.t)
    if pulled:
        found = replace(found, stage=pulled.stage, X_error=pulled.X_error)
    if not variance:
        return found
    spread, error = means.variance, means.variance_error
    return replace(found, force_variance=spread, force_variance_error=error)


def _steady(ensemble: Ensemble, drive: Drive, points: int, variance: bool) -> Transient:
    """A stationary start: nothing changes."""
    exact, level = reference(ensemble, drive, variance=variance), np.ones(points)
    X, pinned = np.linspace(0.0, drive.over(ensemble), points), known(exact.pinned)
    found = Transient(
        X=X,
        force=known(exact.friction) * level,
        pinned=pinned * level,
        breaks=pinned / known(exact.travel) * level,
        force_error=(exact.friction.stderr or 0.0) * level,
        pinned_error=(exact.pinned.stderr or 0.0) * level,
        t=X / drive.velocity,
    )
    spread = exact.force_variance
    if not variance or spread.value is None or spread.diverges:
        return found
    error = (spread.stderr or 0.0) * level
    return replace(
        found, force_variance=spread.value * level, force_variance_error=error
    )


class Cells(NamedTuple):
    """A life and the edges `x` of the finer grid, every second one of which is of the
    coarser; what share of the contacts may be in step (cells + 1,) at edges of the
    coarser grid in a way that neither grid can tell; and over how many of these edges
    it may blur the jumps of a discrete law."""

    profile: Profile
    x: Array
    in_step: Array
    around: int


def cells_of(contacts: Reduced, distance: float, points: int) -> Cells:
    """Cells that resolve what has to be resolved on the way, as far as possible."""
    discrete = contacts.law.steps.size > 0
    least = min(max(distance / _CELL, _LEAST_CELLS), _MOST_CELLS)
    finest = _FINEST
    if discrete:  # every threshold takes time in every cell
        finest //= 4 * np.unique(contacts.law.steps).size
    smooth = None if discrete and not contacts.newborn.active else profile_of(contacts)
    while True:
        cells = int(least)
        if points - 1 <= max(finest, _MOST_CELLS):
            cells = (points - 1) * max(1, round(cells / (points - 1)))
        fine = distance / (2 * cells) * np.arange(2 * cells + 1)
        profile = smooth or profile_of(contacts, fine)
        in_step, around = _in_step(profile, contacts, fine[::2])
        least *= _FINER
        if in_step.max() <= _RESOLVED or least > finest:
            return Cells(profile, fine, in_step * (in_step.max() > _RESOLVED), around)


def middle_half(profile: Profile) -> tuple[float, float]:
    """Travels between which half of all lives end."""
    quick, slow = (np.argmax(profile.survive <= share) for share in (0.75, 0.25))
    return float(profile.x[quick]), float(profile.x[slow])


def _in_step(profile: Profile, contacts: Reduced, x: Array) -> tuple[Array, int]:
    """The share of contacts that may be in step at each edge `x` of a grid that blurs
    it, and `Cells.around`."""
    h = x[1]
    broken = -np.diff(profile.survive, prepend=1.0)
    quick, slow = middle_half(profile)
    cycle = contacts.delay.mean + slow
    highest, count = max(100.0 / quick, 200.0 / cycle), 400 if profile.jumps else 50
    k = np.geomspace(2 * math.pi / cycle, highest, count)
    many = broken > 1e-8
    broken, width = broken[many], np.diff(profile.x, prepend=0.0)[many]
    phase = np.outer(k, profile.x[many] - 0.5 * width)
    # lives that last for many waves are out of step
    seen = (np.outer(k, width) < 1.0) | profile.jumps
    together = np.abs(np.where(seen, np.exp(1j * phase), 0.0) @ broken)
    together *= contacts.delay.coherence(k)
    together = np.minimum(np.maximum.accumulate(together[::-1])[::-1], 1.0)
    m = np.maximum(x / cycle, 1.0)
    at = np.searchsorted(k, _BLURRED / (h * np.sqrt(m)))
    share = together[np.minimum(at, k.size - 1)] ** m
    share[0] = 0.0
    around, delay = 0, contacts.delay.mean
    if profile.jumps:
        around = 2 + math.ceil(4 * math.sqrt(x[-1] / (6 * (delay + quick))))
        if around * h < min(quick, delay or quick):
            share[:] = 0.0  # what is in step is longer than the grid blurs it
    return share, 2 * around + 1


def from_birth(profile: Profile, contacts: Reduced, x: Array, power: int) -> Array:
    """E[(k_i/k)^p (y + x)^p; l > x], p = `power`, at edges `x` from 0, where it is 0
    without births y."""
    found = profile.at(np.append(x[1] * 1e-9, x[1:]), power)[power]
    found[0] *= contacts.newborn.active
    return found


class _Means(NamedTuple):
    """Force and pinned at the edges of a uniform grid of cells, breaks in each cell per
    unit displacement."""

    force: Array
    pinned: Array
    breaks: Array


def means_of(profile: Profile, x: Array, contacts: Reduced) -> _Means:
    """Solve the renewal equation on a uniform grid of edges `x` from 0.

    By generating functions: with w of the chance to be still detached, d = 1 - (1 - z)
    w of births after a break, and D of survival, breaks (w + d D) is that of 1 - S, as
    every contact is either pinned or detached (derived). They are taken on a circle |z|
    < 1 where hardly anything comes around.
    """
    cells, h = x.size - 1, x[1]
    survive = np.append(1.0, profile.at(x[1:])[0])
    first = from_birth(profile, contacts, x, 1)
    size = fft.next_fast_len(_AROUND * cells, real=True)
    damping = _WRAPPED ** (np.arange(cells) / size)

    def transform(part: Array) -> Array:
        return np.asarray(fft.rfft(part * damping, size))

    def back(product: Array) -> Array:
        return np.asarray(fft.irfft(product, size)[:cells] / damping)

    means = [np.diff(profile.integral(x, power)[power]) / h for power in (0, 1)]
    alive, work = map(transform, means)
    waiting = transform(contacts.delay.waiting(h, cells))
    turns = np.exp(-2j * math.pi / size * np.arange(waiting.size))
    z = _WRAPPED ** (1.0 / size) * turns
    reborn = 1.0 - (1.0 - z) * waiting
    breaks = transform(1.0 - survive[1:]) / (waiting + reborn * alive)
    detached = np.append(0.0, back(waiting * breaks))
    force = first + np.append(0.0, back(reborn * breaks * work))
    return _Means(force + contacts.drag * detached, 1.0 - detached, back(breaks) / h)


def _squares(
    cells: Cells, contacts: Reduced, solved: list[_Means]
) -> tuple[Array, Array]:
    """Mean square of the force of a contact at the edges of the coarser grid, and its
    error: as the mean force, with E[(k_i/k)^2 (y + x)^2; l > x] in the place of m
    (derived)."""
    found, profile = [], cells.profile
    for step, means in zip((2, 1), solved, strict=True):
        x = cells.x[::step]
        births = means.breaks + np.diff(means.pinned) / x[1]
        first = from_birth(profile, contacts, x, 2)
        later = convolved(births, np.diff(profile.integral(x, 2)[2]))[: x.size - 1]
        waiting = contacts.drag**2 * (1.0 - means.pinned)
        found.append((first + np.append(0.0, later) + waiting)[:: 3 - step])
    best, missed = _without_cells(*found)
    error = missed + profile.error * np.abs(best)
    return best, error + _beside_jumps(found[0]) if profile.jumps else error


def _without_cells(coarse: Array, better: Array) -> tuple[Array, Array]:
    """The value of no cell width from those at the same edges of two grids, and what
    the coarser one missed, nearby too."""
    missed = largest_nearby(better - coarse, (coarse.size - 1) // 20)
    return extrapolated(coarse, better), missed


def _with_error(
    coarse: Array, better: Array, cells: Cells, loudest: Array | float
) -> tuple[Array, Array]:
    """A mean that may be as great as `loudest` while all contacts are in step, and its
    error.

    Errors of a life are passed on by its births, so that they scale with the largest
    mean so far.
    """
    best, missed = _without_cells(coarse, better)
    error = missed + cells.profile.error * np.maximum.accumulate(np.abs(best))
    if cells.profile.jumps:
        # jumps that cells blur, in twice as many steps of half the length, differ by
        # 0.083 of their height
        blurred = 8 * largest_nearby(better - coarse, cells.around)
        error += np.maximum(_beside_jumps(coarse), blurred)
    return best, error + np.maximum(np.ptp(best), loudest) * cells.in_step


def _beside_jumps(values: Array) -> Array:
    """Bound how much a jump nearby changes `values`, where equal thresholds break
    together: the truth is somewhere between both sides. Of the steady rise between
    jumps nothing counts, as it is known."""
    return largest_nearby(np.pad(np.diff(values, 2), 1, "edge"), 5)


def _between_edges(values: Array) -> Array:
    """A bound of what straight lines between equidistant values miss: their curvature
    eightfold."""
    return largest_nearby(np.pad(np.diff(values, 2), 1, "edge"), 3)


@dataclass(frozen=True, repr=False)
class Fluctuations(Result):
    """Stationary fluctuations of F for independent contacts, arrays of shape (points,).

    Attributes
    ----------
    lag : ndarray
        Displacement between two looks at the force (length).
    covariance, error : ndarray
        N times the autocovariance of F/(N k) at these lags, that is the variance at lag
        0, and its error estimate (length^2).
    """

    drawn: ClassVar[Drawn] = Drawn(
        "lag", "covariance", "error", "lag in displacement", "Cov(F, F')/(N k^2)"
    )
    lag: Array
    covariance: Array
    error: Array


def fluctuations(ensemble: Ensemble, drive: Drive, points: int = 101) -> Fluctuations:
    """Solve for the stationary variance and autocovariance of the force, N times those
    of F/(N k) for N contacts of stiffness k (derived).

    A contact found at stretch x (density E[S]/(C + v<tau>)) either survives the lag, or
    breaks after y and begins anew with the transient of a contact that has just broken;
    one found detached begins with the rest of its delay. What the stiffness was a while
    ago is not known where it follows an aging threshold: refused.

    Parameters
    ----------
    ensemble : Ensemble
    drive : Drive
        Constant velocity (length/time), without stage and blocks. Lags go up to its
        distance (length); by default five mean cycles of a run file.
    points : int
        Number of equidistant lags from 0.

    Returns
    -------
    Fluctuations

    Raises
    ------
    InputError
        For arguments out of range, for quenched contacts of the sqrt law whose
        stiffness follows aging thresholds, and where the variance is infinite, as the
        autocovariance is then at any lag.

    Examples
    --------
    >>> from eqsim import Drive, Ensemble, fluctuations
    >>> found = fluctuations(Ensemble(), Drive(0.1, distance=2.0), points=3)
    >>> found.covariance.round(4).tolist()  # at lags 0, 1 and 2
    [0.6771, 0.0504, 0.0111]
    """
    require_drive(drive)
    require_integer("points", points, 2, 10**6)
    s, unit = settled(ensemble, drive.velocity), ensemble.thresholds.scale
    distance = drive.over(ensemble)
    if s.aging.stiffens and s.stiffness == "sqrt":
        raise InputError(
            'stiffness_law = "sqrt": fluctuations of aging quenched contacts need "uniform"'
        )
    if ensemble.divergence:
        raise InputError(f"fluctuations: {ensemble.divergence}")
    exact = reference(ensemble, drive, variance=True)
    if exact.force_variance.value is None:
        raise InputError(
            "fluctuations: the variance is not known of contacts born stretched whose law is this broad"
        )
    cycle = known(exact.travel) / unit + s.delay.mean
    mean, pinned = known(exact.friction) / unit, known(exact.pinned)
    cells = cells_of(s, distance / unit, points)
    profile, solved = cells.profile, []
    beyond, missed_beyond = _beyond(profile, s)
    for step in (2, 1):
        x = cells.x[::step]
        means = means_of(profile, x, s)
        # int_x^inf y^power (S, k1, k2) dy
        totals = [
            profile.integral(_EVERYTHING, power) + beyond[power][:, None]
            for power in range(3)
        ]
        rest = [
            total - profile.integral(x, power) for power, total in enumerate(totals)
        ]
        # int_x^inf y (y - x) k2 dy of those that survive, and int_x^inf (y - x) k1 dy,
        # whose decrease weighs breaks by the force they had at the beginning
        surviving = rest[2][2] - x * rest[1][2]
        carried = rest[1][1] - x * rest[0][1]
        breaks = (carried[:-1] - carried[1:]) / cycle  # in each cell, times force
        after, detached = _reborn(means.force, x, s)
        back = np.append(0.0, convolved(breaks, np.diff(after) / x[1])[: x.size - 1])
        waiting = s.drag * (1.0 - pinned) * detached
        solved.append((surviving / cycle + back + waiting - mean**2)[:: 3 - step])
    best, missed = _without_cells(*solved)
    # kinks, which jumps of a discrete law make, are of lower order
    error = missed * (3 if profile.jumps else 1)
    # of a variance little is left where contacts hardly differ, but errors of a profile
    # are those of mean squares
    error += (profile.error + cells.in_step) * (np.abs(best).max() + mean**2)
    error += missed_beyond[2, 2] / cycle
    # by another quadrature, as far as there is one
    error += abs(best[0] - known(exact.force_variance) / unit**2)
    if points > best.size:
        error += _between_edges(best)
    lag = np.linspace(0.0, distance, points)
    x = cells.x[::2]
    columns = [np.interp(lag / unit, x, part) * unit**2 for part in (best, error)]
    return Fluctuations(lag, *columns)


def _beyond(profile: Profile, contacts: Reduced) -> tuple[Array, Array]:
    """`integrals_beyond` the end of a profile; nothing of contacts born stretched,
    whose profile has the difference from moments of whole lives in its error."""
    if contacts.newborn.active:
        return np.zeros((3, 3)), np.zeros((3, 3))
    return integrals_beyond(contacts, float(profile.x[-1]), float(profile.survive[-1]))


def convolved(a: Array, b: Array) -> Array:
    """The convolution of two sequences."""
    length = a.size + b.size - 1
    size = fft.next_fast_len(length, real=True)
    return np.asarray(fft.irfft(fft.rfft(a, size) * fft.rfft(b, size), size)[:length])


def _reborn(fresh: Array, x: Array, contacts: Reduced) -> tuple[Array, Array]:
    """Integral of the mean force from a break on, and mean force of a contact found
    detached, from the mean force `fresh` of one just pinned."""
    total = CubicSpline(x, fresh).antiderivative()
    if contacts.delay.mean == 0:
        return total(x), np.zeros_like(x)
    reborn = _REBORN[type(contacts.delay)]
    return reborn(fresh, x, total, contacts.delay.mean, contacts.drag)


def _after_fixed(
    fresh: Array, x: Array, total: Any, delay: float, drag: float
) -> tuple[Array, Array]:
    """`_reborn` after delays of the same length; `total` is the integral of `fresh`."""
    late = total(np.maximum(x - delay, 0.0))
    left = np.maximum(1.0 - x / delay, 0.0)
    force = drag * left + (total(x) - late) / delay
    return drag * np.minimum(x, delay) + late, force


def _after_exponential(
    fresh: Array, x: Array, total: Any, delay: float, drag: float
) -> tuple[Array, Array]:
    """`_reborn` after exponential delays."""
    from scipy.signal import lfilter  # takes long to import

    # y' = (fresh - y)/delay, the mean force of those already pinned again, with fresh
    # linear in each cell
    ratio = x[1] / delay
    keep, first = math.exp(-ratio), -math.expm1(-ratio)
    slope = 1.0 - first / ratio
    gained = (first - slope) * fresh[:-1] + slope * fresh[1:]
    y = lfilter([1.0], [1.0, -keep], np.append(0.0, gained))
    fading = np.exp(-x / delay)
    return drag * delay * (1.0 - fading) + total(x) - delay * y, drag * fading + y


_REBORN = {Fixed: _after_fixed, Exponential: _after_exponential}
