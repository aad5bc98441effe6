"""Transients from a fresh start and stationary fluctuations, by the renewal equation
(derived).

All contacts start pinned, as newborn ones. S(x) is the probability that the travel l of
a life exceeds x, and m(x) = E[(k_i/k)(y + x); l > x] its mean force there, y being the
stretch at birth. Births B and breaks Gamma per contact and unit displacement obey

    Gamma = -dS/dX + B * (-dS/dx),     B = Gamma * (law of v delay)
    pinned = S + B * S,     friction = m + B * m + (eta v/k)(1 - pinned)

with * the convolution over [0, X] (renewal form of Q5a, Q5aG and Q6 of Braun and
Peyrard, 2011). Births are spread evenly over each cell of a uniform grid and every
integral over S and m is exact. The scheme is of second order, of first where most
lives are shorter than a cell. Two grids give the result, extrapolated as of second
order, and their difference an error that covers either order.

Contacts that started together may stay in step for many cycles: identical ones, and all
whose lives are short beside a fixed delay. Harmonic k of their births keeps a share
|phi(k)|^m after m cycles, phi(k) = E[exp(i k x_b)] (derived), but not on a grid of
cells h if k h sqrt(m) > 1. Cells are short enough to keep all that matters; where they
cannot be, the share that may still be in step is part of the error.
"""

import math
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np
from scipy import fft
from scipy.interpolate import CubicSpline

from eqsim.errors import InputError, require_integer, require_number
from eqsim.estimate import known
from eqsim.laws.delay import Exponential, Fixed
from eqsim.laws.no_thresholds import has_jumps
from eqsim.master import programme, slider
from eqsim.master.profile import Profile
from eqsim.master.programme import Transient
from eqsim.master.steady import reference, settled
from eqsim.model.drive import Drive, Programme, over_distance, require_drive
from eqsim.model.ensemble import Ensemble
from eqsim.model.load import births_of, under_load
from eqsim.model.mixture import summed
from eqsim.model.reduced import Reduced
from eqsim.numerics.quadrature import extrapolated, largest_nearby
from eqsim.numerics.tables import Array
from eqsim.results import Drawn, Result

# A cell of the coarser grid in units of the typical threshold.
_CELL_PER_THRESHOLD = 0.02
# Fewest cells of the coarser grid.
_LEAST_CELLS = 500
# Most cells of the coarser grid.
_MOST_CELLS = 10_000
# Parts of a cell over which the force that stretched births carry is straight.
_PARTS_OF_CELL = 8
# What falls late over all, below which that is rounding.
_ROUNDED = 1e-11
# Most cells where contacts stay in step.
_FINEST = 160_000
# Factor from one number of cells that is tried to the next.
_FINER = 4
# k h sqrt(m) up to which the difference of two grids shows what they miss.
_BLURRED = 1.5
# Share in step beyond it that they may miss.
_MISSED_IN_STEP = 0.3
# Wave numbers that are tried, from that of a cycle to those of the quickest lives.
_WAVES = 50
# Wave numbers beyond these, up to those that cells blur at once.
_FINER_WAVES = 100
# The largest of these over the least that cells blur at once.
_BLURRED_RANGE = 10.0
# Length of the circle of the Fourier transform, in transients.
_CIRCLE = 6
# Factor by which values are damped over one turn of the circle.
_WRAPPED = 1e-13
# A stretch beyond all.
_EVERYTHING = np.array([1e90])


def transient(
    ensemble: Ensemble,
    drive: Drive | Programme,
    points: int = 2001,
    *,
    variance: bool = False,
) -> Transient:
    """Solve for the exact means of a run by the renewal equation.

    Force is F/(N k), a length. The equation is the renewal form of eqs. (1), (3) and
    (4) of Braun and Peyrard (2011) (derived), along a programme in two times
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
    >>> transient(Ensemble(), Drive(0.1, 3.0), points=4).force.round(4).tolist()
    [0.0, 0.8579, 0.8727, 0.8897]
    """
    require_integer("points", points, 2, 10**8)
    pulled = isinstance(drive, Programme) and drive.pulled
    if ensemble.populations and not pulled:
        way, kinds = over_distance(drive, ensemble), ensemble.kinds
        each = [transient(x.contacts, way, points, variance=variance) for x in kinds]
        mixed: Transient = summed(kinds, each)
        return mixed
    if isinstance(drive, Programme) and drive.loaded:
        load, born = births_of(drive, points)
        each = [transient(ensemble, births.programme, points) for births in born]
        loaded: Transient = under_load(load, born, each)
        return loaded
    if isinstance(drive, Programme):
        grid = drive.grid(points)
        solve = slider.pulled_of if drive.pulled else programme.means_along
        means = solve(ensemble, drive, grid)
        if variance:
            return means
        return replace(means, force_variance=None, force_variance_error=None)
    require_drive(drive)
    spread: tuple[Array | None, Array | None] = (None, None)
    s, unit = settled(ensemble, drive.velocity), ensemble.thresholds.scale
    distance = drive.over(ensemble) / unit
    require_number("distance / threshold", distance, least=1e-30, most=1e100)
    if drive.start == "stationary":
        return _level(ensemble, drive, points, variance)
    cells = cells_of(s, distance, points)
    solved = [renewal_of(cells.profile, cells.x[::step], s) for step in (2, 1)]
    X, edges = np.linspace(0.0, distance, points), cells.x[::2]
    # the largest means of contacts that are all in step
    strongest = np.maximum.accumulate(np.abs(from_birth(cells.profile, s, edges, 1)))
    detached = float(s.delay.mean > 0)
    in_unison = np.maximum(strongest, s.drag * detached), np.full(edges.size, detached)
    coarse, fine = (np.array((means.force, means.pinned)) for means in solved)
    best, error = _with_error(coarse, fine[:, ::2], cells, in_unison)
    if points > edges.size:
        error += _bend(best, 3)
    force, pinned, force_error, pinned_error = _interpolated(X, edges, *best, *error)
    pairs = solved[1].breaks  # of cells; a pair of fine ones is a coarse one
    pairs = np.maximum((pairs[0::2] + pairs[1::2]) / 2, 0.0)
    breaks = np.interp(X, cells.x[1::2], pairs)
    if variance and not cells.in_step.any():
        square, missed = _interpolated(X, edges, *_squares(cells, s, solved))
        missed += 2 * force * force_error
        spread = (square - force**2) * unit**2, missed * unit**2
    if not s.newborn.active:  # all start pinned and unstretched
        for known_at_first in (force_error, pinned_error, spread[1]):
            if known_at_first is not None:
                known_at_first[0] = 0.0
    return Transient(
        X=X * unit,
        force=force * unit,
        pinned=pinned,
        breaks=breaks / unit,
        force_error=force_error * unit,
        pinned_error=pinned_error,
        t=X * unit / drive.velocity,
        force_variance=spread[0],
        force_variance_error=spread[1],
    )


def _interpolated(X: Array, x: Array, *rows: Array) -> list[Array]:
    """Values at points X on straight lines between those at x."""
    return [np.interp(X, x, row) for row in rows]


def _level(ensemble: Ensemble, drive: Drive, points: int, variance: bool) -> Transient:
    """Constant means of a stationary start."""
    ensemble.require_steady_state(drive.velocity)
    exact, level = reference(ensemble, drive, variance=variance), np.ones(points)
    X, pinned = np.linspace(0.0, drive.over(ensemble), points), known(exact.pinned)
    square, error = exact.force_variance, exact.force_variance.stderr or 0.0
    seen = variance and square.value is not None and not square.diverges
    return Transient(
        X=X,
        force=known(exact.friction) * level,
        pinned=pinned * level,
        breaks=pinned / known(exact.travel) * level,
        force_error=(exact.friction.stderr or 0.0) * level,
        pinned_error=(exact.pinned.stderr or 0.0) * level,
        t=X / drive.velocity,
        force_variance=known(square) * level if seen else None,
        force_variance_error=error * level if seen else None,
    )


class Cells(NamedTuple):
    """Profile of a life; edges `x` of the finer grid, every second one of which belongs
    to the coarser; at edges of the coarser grid, (cells + 1,), the share of contacts
    that may be in step without either grid showing it; and over how many of these edges
    the jumps of a discrete law may be blurred."""

    profile: Profile
    x: Array
    in_step: Array
    around: int


def cells_of(contacts: Reduced, distance: float, points: int) -> Cells:
    """Cells that resolve the lives of contacts, and those in step as far as
    possible."""
    discrete = has_jumps(contacts.law)
    least = min(max(distance / _CELL_PER_THRESHOLD, _LEAST_CELLS), _MOST_CELLS)
    finest = _FINEST
    if discrete:  # any cells blur jumps, and more of them take time
        finest //= 4 * np.unique(contacts.law.steps).size
    profile = Profile(contacts)
    while True:
        cells = int(least)
        if points - 1 <= max(finest, _MOST_CELLS):
            cells = (points - 1) * max(1, round(cells / (points - 1)))
        fine = distance / (2 * cells) * np.arange(2 * cells + 1)
        in_step, around = _in_step(profile, contacts, fine[::2])
        least *= _FINER
        resolved = in_step.max() <= _MISSED_IN_STEP
        if resolved or least > finest:
            return Cells(profile, fine, in_step * (not resolved), around)


def middle_half(profile: Profile) -> tuple[float, float]:
    """Travels between which half of all lives end."""
    quick, slow = (np.argmax(profile.survive <= share) for share in (0.75, 0.25))
    return float(profile.x[quick]), float(profile.x[slow])


def _in_step(profile: Profile, contacts: Reduced, x: Array) -> tuple[Array, int]:
    """Share of contacts that may be in step at each edge `x` of a grid that blurs them,
    and `Cells.around`."""
    h, delay = x[1], min(contacts.delay.mean, x[-1])  # longer ones are alike
    quick, slow = middle_half(profile)
    cycle = delay + slow
    count = 400 if profile.jumps else _WAVES
    highest = max(100.0 / quick, 200.0 / cycle)
    k = np.geomspace(2 * math.pi / cycle, highest, count)
    finest = _BLURRED_RANGE * _BLURRED / h
    if finest > highest and not profile.jumps:
        # lives that scatter by less than the shortest wave so far are in step with it
        k = np.append(k, np.geomspace(highest, finest, _FINER_WAVES)[1:])
    broken = -np.diff(profile.survive, prepend=1.0)
    many = broken > 1e-8
    width = np.diff(profile.x, prepend=0.0)[many]
    phase = np.outer(k, profile.x[many] - 0.5 * width)
    # lives that last for many waves are out of step
    seen = (np.outer(k, width) < 1.0) | profile.jumps
    together = np.abs(np.where(seen, np.exp(1j * phase), 0.0) @ broken[many])
    together *= contacts.delay.coherence(k)
    together = np.minimum(np.maximum.accumulate(together[::-1])[::-1], 1.0)
    cycles = np.maximum(x / cycle, 1.0)
    blurred = np.searchsorted(k, _BLURRED / (h * np.sqrt(cycles)))
    share = together[np.minimum(blurred, k.size - 1)] ** cycles
    share[0], around = 0.0, 0
    if profile.jumps:
        around = 2 + math.ceil(4 * math.sqrt(x[-1] / (6 * (delay + quick))))
        if around * h < min(quick, delay or quick):
            share[:] = 0.0  # lives are longer than the blur
    return share, 2 * around + 1


def from_birth(profile: Profile, contacts: Reduced, x: Array, power: int) -> Array:
    """E[(k_i/k)^p (y + x)^p; l > x], p = `power`, at edges `x` from 0, where it is 0
    unless contacts are born stretched, by y."""
    means = profile.at(np.append(x[1] * 1e-9, x[1:]), power)[power]
    means[0] *= contacts.newborn.active
    return means


class Renewal(NamedTuple):
    """Force and pinned at the edges of a uniform grid of cells h, breaks and births in
    each cell per unit displacement."""

    force: Array
    pinned: Array
    breaks: Array
    births: Array


def renewal_of(profile: Profile, x: Array, contacts: Reduced) -> Renewal:
    """Solve the renewal equation on a uniform grid of edges `x` from 0.

    With generating functions w of the probability to be still detached, d = 1 - (1 - z)
    w of births after a break, and D of survival, that of the breaks times (w + d D) is
    that of 1 - S, as every contact is either pinned or detached (derived). They are
    taken on a circle |z| < 1, where hardly anything wraps around.
    """
    cells, h = x.size - 1, x[1]
    means = [np.diff(profile.integral(x, power)[power]) / h for power in (0, 1)]
    survive = _in_place(np.append(1.0, profile.at(x[1:])[0]), means[0])
    size = fft.next_fast_len(_CIRCLE * cells, real=True)
    damping = _WRAPPED ** (np.arange(cells) / size)

    def transform(values: Array) -> Array:
        return np.asarray(fft.rfft(values * damping, size))

    def back(product: Array) -> Array:
        return np.asarray(fft.irfft(product, size)[:cells] / damping)

    alive, work = map(transform, means)
    waiting = transform(contacts.delay.waiting(h, cells))
    turns = np.exp(-2j * math.pi / size * np.arange(waiting.size))
    z = _WRAPPED ** (1.0 / size) * turns
    reborn = 1.0 - (1.0 - z) * waiting
    breaks = transform(1.0 - survive[1:]) / (waiting + reborn * alive)
    detached = np.append(0.0, back(waiting * breaks))
    force = from_birth(profile, contacts, x, 1)
    force += np.append(0.0, back(reborn * breaks * work)) + contacts.drag * detached
    per_length = back(breaks) / h
    births = per_length - np.diff(detached) / h
    return Renewal(force, 1.0 - detached, per_length, births)


def _in_place(falling: Array, means: Array) -> Array:
    """Values at edges of cells, changed so that what falls within cells, if it is spread
    evenly over each, falls where it does in the mean: what falls late in one is in part
    counted in the next. `means` are those of the values over cells."""
    late = means - 0.5 * (falling[:-1] + falling[1:])
    late[np.abs(late) < _ROUNDED * np.abs(falling).max()] = 0.0
    falling = falling.copy()
    falling[1:] += np.maximum(late, 0.0)
    falling[1:-1] += np.minimum(late[1:], 0.0)
    return falling


def after(events: Array, response: Array) -> Array:
    """Convolution, at edges of cells, of the `events` in each cell with the `response`
    to an event so many cells later."""
    size = fft.next_fast_len(2 * events.size - 1, real=True)
    product = fft.rfft(events, size) * fft.rfft(response, size)
    return np.append(0.0, fft.irfft(product, size)[: events.size])


def _squares(
    cells: Cells, contacts: Reduced, solved: list[Renewal]
) -> tuple[Array, Array]:
    """Mean square of the force of a contact at the edges of the coarser grid, and its
    error. It obeys the equation of the mean force with E[(k_i/k)^2 (y + x)^2; l > x] in
    the place of m (derived)."""
    squares, profile = [], cells.profile
    for step, renewal in zip((2, 1), solved, strict=True):
        x = cells.x[::step]
        first = from_birth(profile, contacts, x, 2)
        later = after(renewal.births, np.diff(profile.integral(x, 2)[2]))
        waiting = contacts.drag**2 * (1.0 - renewal.pinned)
        squares.append((first + later + waiting)[:: 3 - step])
    best, missed = _without_cells(*squares)
    error = missed + profile.error * np.abs(best)
    return best, error + _bend(squares[0], 5) if profile.jumps else error


def _without_cells(coarse: Array, better: Array) -> tuple[Array, Array]:
    """Values extrapolated to vanishing cells from those at the same edges of two grids,
    and the largest difference of the grids nearby."""
    missed = largest_nearby(better - coarse, (coarse.shape[-1] - 1) // 20)
    return extrapolated(coarse, better), missed


def _with_error(
    coarse: Array, better: Array, cells: Cells, in_unison: tuple[Array, Array]
) -> tuple[Array, Array]:
    """Means, shape (means, edges), and their errors; `in_unison` are the largest means
    of contacts that are all in step.

    Errors of a life are passed on by its births, so that they scale with the largest
    mean so far.
    """
    best, missed = _without_cells(coarse, better)
    largest = np.maximum.accumulate(np.abs(best), axis=1)
    error = missed + cells.profile.error * largest
    if cells.profile.jumps:
        # jumps that cells blur, in twice as many steps of half the length, differ by
        # 0.083 of their height
        blurred = 8 * largest_nearby(better - coarse, cells.around)
        error += np.maximum(_bend(coarse, 5), blurred)
    height = np.maximum(np.ptp(best, axis=1, keepdims=True), in_unison)
    return best, error + height * cells.in_step


def _bend(values: Array, points: int) -> Array:
    """Largest second difference nearby, along the last axis. Where equal thresholds
    break together it is the height of the jump, without the steady rise between jumps,
    and the truth lies between both sides. For smooth values it is eight times the error
    of straight lines between them."""
    bends = np.diff(values, 2)
    ends = (bends[..., :1], bends, bends[..., -1:])
    return largest_nearby(np.concatenate(ends, axis=-1), points)


@dataclass(frozen=True, repr=False)
class Fluctuations(Result):
    """Stationary fluctuations of F for independent contacts, arrays of shape (points,).

    Attributes
    ----------
    lag : ndarray
        Displacement between two values of the force (length).
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
    one found detached begins with the rest of its delay. A stiffness that follows an
    aging threshold is refused, as its past is not known.

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
    >>> result = fluctuations(Ensemble(), Drive(0.1, distance=2.0), points=3)
    >>> result.covariance.round(4).tolist()  # at lags 0, 1 and 2
    [0.6771, 0.0504, 0.0111]
    """
    require_drive(drive)
    ensemble.require_steady_state(drive.velocity)
    require_integer("points", points, 2, 10**6)
    if ensemble.populations:
        way, kinds = over_distance(drive, ensemble), ensemble.kinds
        each = [fluctuations(kind.contacts, way, points) for kind in kinds]
        mixed: Fluctuations = summed(kinds, each)
        return mixed
    s, unit = settled(ensemble, drive.velocity), ensemble.thresholds.scale
    distance = drive.over(ensemble)
    if s.aging.stiffens and s.stiffness == "sqrt":
        raise InputError(
            'stiffness_law = "sqrt": fluctuations of aging quenched contacts need '
            '"uniform"'
        )
    if ensemble.divergence:
        raise InputError(f"fluctuations: {ensemble.divergence}")
    exact = reference(ensemble, drive, variance=True)
    if exact.force_variance.value is None:
        raise InputError(
            "fluctuations: the variance of contacts born stretched is not known for a "
            "law this broad"
        )
    cycle = known(exact.travel) / unit + s.delay.mean
    mean, pinned = known(exact.friction) / unit, known(exact.pinned)
    cells = cells_of(s, distance / unit, points)
    profile, solved = cells.profile, []
    # int_0^inf y^power (S, k1, k2) dy, k1 and k2 being E[(k_i/k)^p; l > y], p = 1, 2
    panels = [profile.integral(_EVERYTHING, power)[:, 0] for power in range(3)]
    total = profile.beyond + panels
    if not np.isfinite(total).all():
        raise InputError(
            "fluctuations: bonds too strong to be followed make the variance of forces; "
            "their rate must be larger"
        )
    for step in (2, 1):
        x = cells.x[::step]
        # int_x^inf y^power (S, k1, k2) dy
        rest = [
            total[power][:, None] - profile.integral(x, power) for power in range(3)
        ]
        # int_x^inf y (y - x) k2 dy of those that survive, and int_x^inf (y - x) k1 dy,
        # whose decrease weighs breaks by the force they had at the beginning
        surviving = rest[2][2] - x * rest[1][2]
        carried = rest[1][1] - x * rest[0][1]
        if s.newborn.active:
            within = _means_in_parts(total, profile, x)
        else:  # in closed form
            further = 0.5 * (rest[2][1] - 2.0 * x * rest[1][1] + x**2 * rest[0][1])
            within = (further[:-1] - further[1:]) / x[1]
        carried = _in_place(carried, within)
        breaks = (carried[:-1] - carried[1:]) / cycle  # in each cell, times force
        late, detached = _reborn(renewal_of(profile, x, s).force, x, s, profile)
        back = after(breaks, np.diff(late)) / x[1]
        waiting = s.drag * (1.0 - pinned) * detached
        solved.append((surviving / cycle + back + waiting - mean**2)[:: 3 - step])
    best, missed = _without_cells(*solved)
    # at kinks, which jumps of a discrete law make, the order is lower
    error = missed * (3 if profile.jumps else 1)
    # errors of a profile are those of mean squares, and may exceed a variance where
    # contacts hardly differ
    error += (profile.error + cells.in_step) * (np.abs(best).max() + mean**2)
    error += profile.missed_beyond[2, 2] / cycle
    error += 2.0 * abs(mean) * (exact.friction.stderr or 0.0) / unit
    # difference from the variance by another quadrature
    error += abs(best[0] - known(exact.force_variance) / unit**2)
    if points > best.size:
        error += _bend(best, 3)
    lag = np.linspace(0.0, distance, points)
    values, errors = _interpolated(lag / unit, cells.x[::2], best, error)
    return Fluctuations(lag, values * unit**2, errors * unit**2)


def _means_in_parts(total: Array, profile: Profile, x: Array) -> Array:
    """Means over cells of int_x^inf (z - x) k1 dx, z the stretch of contacts born
    stretched, from trapezia over the parts of each; `total` are the whole integrals."""
    inner = np.linspace(0.0, x[-1], _PARTS_OF_CELL * (x.size - 1) + 1)
    pinned, force = (
        total[power][1] - profile.integral(inner, power)[1] for power in (0, 1)
    )
    carried = force - inner * pinned
    parts = 0.5 * (carried[:-1] + carried[1:])
    return np.asarray(parts.reshape(-1, _PARTS_OF_CELL).mean(axis=1))


def _reborn(
    fresh: Array, x: Array, contacts: Reduced, profile: Profile
) -> tuple[Array, Array]:
    """Integral of the mean force from a break on, and mean force of a contact found
    detached, at edges `x`, from the mean force `fresh` of a contact pinned at 0."""
    drag, delay = contacts.drag, contacts.delay.mean
    # the force of the first life may jump
    later = CubicSpline(x, fresh - from_birth(profile, contacts, x, 1)).antiderivative()

    def total(at: Array) -> Array:
        return np.asarray(profile.integral(at, 1)[1] + later(at))

    if delay == 0.0:
        return total(x), np.zeros_like(x)
    if isinstance(contacts.delay, Fixed):
        late = total(np.maximum(x - delay, 0.0))
        force = drag * np.maximum(1.0 - x / delay, 0.0) + (total(x) - late) / delay
        return drag * np.minimum(x, delay) + late, force
    means = np.diff(total(x)) / x[1]
    if not isinstance(contacts.delay, Exponential):
        # y: fresh * P(delay > x)
        left = contacts.delay.rest(x)
        y = after(means, -np.diff(left))
        return drag * (delay - left) + total(x) - y, (drag * left + y) / delay
    # y' = (fresh - y)/delay, the mean force of those already pinned again, with fresh
    # linear in each cell about its mean
    ratio = x[1] / delay
    newest, fading = -math.expm1(-ratio), np.exp(-x / delay)
    slope = 1.0 - newest / ratio
    gained = newest * means + (slope - 0.5 * newest) * np.diff(fresh)
    y = after(gained, fading[:-1])
    return drag * delay * (1.0 - fading) + total(x) - delay * y, drag * fading + y
