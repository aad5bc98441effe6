"""The exact means of a drive in segments, by the renewal equation in two times
(derived).

Of the contacts born at time s a share S(t|s) is still pinned at t, with the mean force
m(t|s) = (X(t) - X(s)) E[k_i/k; pinned]. Births B and breaks Gamma per contact and unit
time obey

    pinned(t) = S_0(t) + int_0^t B(s) S(t|s) ds,      friction = m_0(t) + int_0^t B(s) m(t|s) ds + (eta v/k)(1 - pinned)
    without delay pinned = 1;      fixed delay: B(t) = Gamma(t - tau);      exponential delay: B = (1 - pinned)/tau

A contact of threshold xi at birth, whose threshold has grown to xi g(age), breaks
mechanically where |x| = xi g, so that the law of thresholds itself says how many have,
given the greatest |x|/g so far; and thermally at the rate of `laws.barrier` for |x| and
its threshold, which is integrated over a step as if the barrier were linear in time.
Births are spread evenly over steps, and thresholds divided into strata
(`master.cohorts`). Where heat breaks no contact, and of annealed contacts, all that
were born together share one hazard and the law of thresholds does the rest.

Lengths are in units of the law's scale, and time in units of the whole programme. Three
grids, each with twice the steps and strata of the one before, give the result,
extrapolated as of second order, and its error.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy import integrate, special
from scipy.interpolate import Akima1DInterpolator

from eqsim.errors import InputError
from eqsim.laws.aging import Unaged
from eqsim.laws.aging.base import stiffness_varies
from eqsim.laws.delay import Fixed
from eqsim.laws.threshold import NO_STEPS, ThresholdLaw
from eqsim.master.annealed import successful_attempts
from eqsim.master.cohorts import (
    NO_CHOICES,
    Choices,
    Growth,
    History,
    Path,
    Pool,
    Pooled,
    march,
)
from eqsim.master.fronts import Fronts, Strata, table_of_w
from eqsim.master.quenched import different_steps, kappa_of
from eqsim.master.sharp import Corners, Sharp, levels_of, sharp_instants
from eqsim.model.drive import Grid, Programme
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import Reduced, drag_of, legs, reduced
from eqsim.numerics.quadrature import (
    extrapolated,
    gauss_legendre,
    largest_nearby,
    normal_exponent,
)
from eqsim.numerics.tables import Array
from eqsim.numerics.threads import NEVER, ThreadPool

# Displacement in a step of the coarsest grid, in units of the width of the law or of a
# threshold.
_PATH = 0.05
# A step of the coarsest grid over the time since the velocity changed.
_GROWTH = 0.15
# The first step of the coarsest grid over the shortest time of the contacts.
_FIRST = 0.1
# Strata of the coarsest grid.
_STRATA = 96
# Cells of the tables of the coarsest grid.
_CELLS = 1000
# Steps of a march at most, to bound time and memory.
MOST_STEPS = 200_000
# Cohorts of a stationary start at most, in steps of the coarsest grid.
_MOST_COHORTS = 5000
# The range of thresholds, in normal deviates on either side.
_SIGMA = 8.2
# By how much strata crowd in the middle, where they are 1.8 times narrower.
_CROWD = 2.0
# Time in which contacts that break or are born at an instant do so, over the longest
# step.
_INSTANT = 1e-7
# The same over the whole time: more than rounding, and less than what could be seen.
_LEAST_INSTANT = 1e-11
_LONGEST_INSTANT = 1e-9
# Where steps end before and after an infinite rate, over the longest step.
_GRADED = 2.0 ** -np.arange(1.0, 11.0)
# Delays after a change of velocity that steps end at.
_KINKS = 6
# Share of a threshold that it has to grow by before it counts.
_GROWN = 0.02
# Share by which the velocity changes where steps begin anew.
_CHANGED = 0.5
# Ages in the table of growth, and the decades that they span.
_AGES = 20_000
_DECADES = 16
# The least error in units of the largest in a programme.
_CARRIED = 0.1
# Share of contacts that may break, below which their thresholds do not set steps.
_RARE = 0.01
# Contacts of which a typical threshold is the mean.
_RANKS = 64
# What tables and rounding miss, over the largest value.
_RESOLVED = 2e-6


def _cells(law: ThresholdLaw, cells: int) -> tuple[Array, Array, Array]:
    """Edges of cells of a law, shape (edges,), nodes in them, shape (edges - 1, nodes),
    and their shares of births. Kinks of the law are edges, both ends of a gap too: the
    cell between them has no share."""
    even = _SIGMA / math.sinh(_CROWD) * np.sinh(np.linspace(-_CROWD, _CROWD, cells + 1))

    def threshold(z: Array) -> Array:
        return np.asarray(law.inverse_survival(normal_exponent(z))) / law.scale

    kinks = law.kinks if law.kinks.size <= cells else NO_STEPS
    with np.errstate(divide="ignore"):
        low, high = special.ndtri(np.array([law.cdf(kinks), law.sf(kinks)], float))
    place = np.where(low < 0.0, low, -high)
    inside = np.abs(place) < _SIGMA
    z = np.append(even, place[inside])
    edge = np.append(threshold(even), kinks[inside] / law.scale)
    order = np.lexsort((edge, z))
    z, edge = z[order], np.maximum.accumulate(edge[order])
    inner, weights = gauss_legendre(4).between(z[:-1], z[1:])
    share = weights * np.exp(-0.5 * inner**2)
    return edge, threshold(inner), share / share.sum()


def _strata(contacts: Reduced, strata: int) -> tuple[Array, Strata]:
    """Nodes and strata of quenched contacts; of a discrete law its thresholds, or groups of them
    where there are many."""
    powers, index = np.arange(3)[:, None], np.arange(strata)
    if contacts.law.steps.size:
        xi, share, stiff = different_steps(contacts)
        groups = np.linspace(0, xi.size, min(strata, xi.size) + 1).astype(int)
        first = np.unique(groups)[:-1]
        parts = np.add.reduceat(share * stiff**powers, first, axis=1)
        nodes = np.add.reduceat(share * xi, first) / parts[0]
        low = high = index[: nodes.size]
        left, right = xi[first], xi[np.append(first[1:], xi.size) - 1]
    else:
        nodes, inner, share = _cells(contacts.law, strata)
        index = np.arange(share.shape[0])
        parts = (share * kappa_of(contacts, inner) ** powers[:, None]).sum(axis=2)
        low, high, left, right = index, index + 1, nodes[:-1], nodes[1:]
    above = _totals_from(parts)[:, :-1].copy()
    return nodes, Strata(left, right, parts, above, low, high)


def _pool(contacts: Reduced, cells: int) -> Pool:
    """Tables of contacts that heat does not break, or all at the same rate."""
    powers = np.arange(3)[:, None]
    if contacts.law.steps.size:
        xi, share, stiff = different_steps(contacts)
        between = np.linspace(0.0, xi[-1], cells)
        y = np.sort(np.concatenate((between, xi, xi)))
        twice = (np.diff(y, prepend=-1.0) == 0) | (np.diff(y, append=math.inf) == 0)
        y = y[~np.isin(y, xi) | twice]
        before = np.diff(y, append=math.inf) == 0  # just below a threshold
        index = np.searchsorted(xi, y, side="right") - before
        above = _totals_from(share * stiff**powers)[:, index]
        rate = np.zeros(y.size)
        barrier, contributing = contacts.barrier, xi.size if contacts.annealed else 0
        for i in range(contributing):
            last = np.searchsorted(y, xi[i]) + 1
            log_rate = barrier.log_rate(y[:last], xi[i], barrier.b * stiff[i])
            rate[:last] += share[i] * np.exp(barrier.log_w + log_rate)
    else:
        edge, inner, share = _cells(contacts.law, cells)
        y = np.append(0.0, edge)
        part = (share * kappa_of(contacts, inner) ** powers[:, None]).sum(axis=2)
        above = _totals_from(part)
        above = np.concatenate((above[:, :1], above), axis=1)
        annealed = contacts.annealed
        rate = successful_attempts(contacts, y) if annealed else np.zeros(y.size)
    total = integrate.cumulative_trapezoid(above, y, axis=1, initial=0.0)
    with np.errstate(divide="ignore"):
        return Pool(y, above, total, np.maximum(np.log(rate), -1e4))


def _totals_from(shares: Array) -> Array:
    """The sums of each share and all after it, and 0 at the end."""
    totals = shares[:, ::-1].cumsum(axis=1)[:, ::-1]
    return np.append(totals, np.zeros((shares.shape[0], 1)), axis=1)


def _growth_of(contacts: Reduced, age: float) -> Growth:
    """How thresholds grow up to an age."""
    aging = contacts.aging
    if isinstance(aging, Unaged):
        return Growth(1.0, 1.0, 1.0, NO_STEPS, False)
    ages = np.geomspace(age * 10.0**-_DECADES, age, _AGES)
    newborn, values = float(aging.growth_at(np.zeros(1))[0]), aging.growth_at(ages)
    per_ratio = (_AGES - 1) / (_DECADES * math.log(10.0))
    varies = bool(stiffness_varies(aging, contacts.springs))
    return Growth(float(ages[0]), per_ratio, newborn, values, varies)


class Course(NamedTuple):
    """A programme in units of the law's scale and of its whole time: ends of segments,
    velocities, and the velocity of the stationary state before, 0 of a fresh start."""

    ends: Array
    velocity: Array
    before: float

    def at(self, t: Array) -> Array:
        """X at times t."""
        X = np.cumsum(np.diff(self.ends, prepend=0.0) * self.velocity)
        return np.interp(t, np.append(0.0, self.ends), np.append(0.0, X))


class Edges(NamedTuple):
    """Times of edges of steps of the coarsest grid, array (edges,), and of those
    between which means are smooth."""

    t: Array
    smooth: Array


def _edges(
    course: Course, width: float, quickest: float, tau: float, sharp: list[Sharp]
) -> Edges:
    """Steps that end at ends of segments, whole delays after these, and sharp instants;
    many contacts that are born or break at one instant do so in a step of next to no
    time before it."""
    fastest, instant = np.abs(course.velocity).max(), _LEAST_INSTANT
    if fastest:
        instant = min(max(_INSTANT * width / fastest, instant), _LONGEST_INSTANT)
    atoms = np.array([s.t for s in sharp if s.order < 0.0])
    smooth = np.concatenate((course.ends, [s.t for s in sharp], atoms - instant))
    steep = np.array([s.t for s in sharp if s.order == -0.5])
    same = _LEAST_INSTANT / 2
    marks: list[float] = []
    t, last, since, kinks = [0.0], course.before, 0.0, np.empty(0)
    for end, velocity in zip(course.ends, course.velocity, strict=True):
        changed = abs(velocity - last) > _CHANGED * max(abs(velocity), abs(last))
        if changed or t[-1] == 0.0:
            since, after = 0.0, t[-1] + tau * np.arange(1, _KINKS + 1)
            kinks = np.append(kinks[kinks > t[-1]], after)
            kinks = np.unique(np.round(kinks, 11))  # rounding makes no step
        last = velocity
        longest = min(width / abs(velocity), 1.0) if velocity else 1.0
        begins = np.append(kinks, atoms)
        graded = np.add.outer(steep, longest * np.append(_GRADED, -_GRADED)).ravel()
        # these are moved to what is sharp, never the other way
        inexact = np.append(graded, kinks)
        apart = np.abs(inexact[:, None] - smooth).min(axis=1) > _LEAST_INSTANT
        inner = np.sort(np.append(inexact[apart], smooth))
        inner = inner[(inner > t[-1] + same) & (inner < end - same)]
        inner = inner[np.diff(inner, prepend=-1.0) > same]
        for mark in np.append(inner, end):
            begin, elapsed = t[-1], [0.0]
            if np.abs(begins - begin).min(initial=1.0) < same:
                since = 0.0
            while elapsed[-1] < (mark - begin) * (1.0 - 1e-9):
                step = max(_FIRST * quickest, _GROWTH * (since + elapsed[-1]))
                elapsed.append(elapsed[-1] + min(step, longest))
                if len(t) + len(elapsed) > MOST_STEPS:
                    raise InputError(
                        f"programme: takes more than {MOST_STEPS} steps of the renewal equation"
                    )
            since += mark - begin
            stretched = np.array(elapsed[1:]) * ((mark - begin) / elapsed[-1])
            t += (begin + stretched).tolist()
            t[-1] = float(mark)
            if np.abs(np.append(smooth, kinks) - mark).min() < same:
                marks.append(t[-1])
    return Edges(np.array(t), np.array(marks))


def course_of(ensemble: Ensemble, programme: Programme) -> tuple[Reduced, Course]:
    """Dimensionless contacts, and what happens to them. Raises InputError."""
    if ensemble.self_consistent:
        raise InputError(
            "aging: that of annealed contacts is defined at constant velocity only, not along a programme"
        )
    if ensemble.fluctuates:
        raise InputError('rule = "langevin": has no reference along a programme')
    if ensemble.newborn.active:
        law = ensemble.newborn.law
        raise InputError(
            f'newborn.law = "{law}": contacts born stretched have no reference along a programme or with a stage'
        )
    unit = ensemble.thresholds.scale
    time = sum(segment.duration for segment in programme.segments)
    velocity = np.array([segment.velocity for segment in programme.segments])
    before = (programme.start == "stationary" and programme.velocity) or 0.0
    legs(ensemble, programme)  # refuses what is out of range
    ends = np.cumsum([segment.duration for segment in programme.segments]) / time
    return reduced(ensemble, unit / time), Course(
        ends, velocity * (time / unit), before * (time / unit)
    )


class Numerics(NamedTuple):
    """How finely an ensemble is resolved: a typical threshold, the longest displacement
    in a step of the coarsest grid, the longest life in a stationary state at velocity
    `before`, and how thresholds grow."""

    ensemble: Reduced
    typical: float
    width: float
    life: float
    before: float
    growth: Growth

    def contacts(self, fine: float) -> Pooled | Fronts:
        """For kernels, `fine` times as many strata or cells."""
        ensemble, delay = self.ensemble, self.ensemble.delay.for_kernels()
        if not ensemble.barrier.thermal or ensemble.annealed:
            pool = _pool(ensemble, round(fine * _CELLS))
            return Pooled(pool, self.growth, delay, NO_STEPS)
        nodes, strata = _strata(ensemble, round(fine * _STRATA))
        laws = ensemble.barrier, ensemble.springs, delay
        return Fronts(nodes, strata, self.growth, *laws, table_of_w())

    def path(
        self, t: Array, X: Array, fine: float, choices: Choices = NO_CHOICES
    ) -> Path:
        """Through edges, arrays (edges,)."""
        cohorts = math.ceil(self.life / self.width * fine) if self.before else 0
        width, share = self.width / fine, _GROWTH / fine
        return Path(t, X, width, share, cohorts, self.before, choices, NEVER)


def _typical(contacts: Reduced, reach: float) -> float:
    """A threshold that sets steps after a fresh start if no contact is stretched by
    more than `reach`: thresholds beyond, such as stand for contacts that never break,
    do not count, nor does their mean if most are far less."""
    law = contacts.law
    median = float(law.inverse_survival(math.log(2.0)))
    typical = min(law.mean, 2.0 * median) / law.scale
    if typical <= reach:
        return typical
    share = float(law.cdf(reach * law.scale))
    if share < _RARE:
        return reach
    ranks = -np.log1p(-share * (np.arange(_RANKS) + 0.5) / _RANKS)
    return float(np.mean(law.inverse_survival(ranks))) / law.scale


def numerics_of(contacts: Reduced, course: Course, reach: float) -> Numerics:
    """How to resolve contacts that are stretched by no more than `reach`. Raises
    InputError for contacts whose lives are too different for a stationary start."""
    law, aging, v = contacts.law, contacts.aging, course.before
    # two standard deviations, and the strongest that counts
    exponents = np.array([0.17, 1.8, 36.0])
    low, high, strongest = np.asarray(law.inverse_survival(exponents)) / law.scale
    typical = law.mean / law.scale if v else _typical(contacts, reach)
    width = typical
    if high > low:
        width = min(max(1.5 * (high - low), 0.02 * typical), typical)
    width, life = _PATH * width, float(strongest)
    for _ in range(50 if v else 0):  # towards the root of x = xi growth(x/v)
        life = strongest * max(1.0, float(aging.growth_at(np.array([life / v]))[0]))
    if v and life > _MOST_COHORTS * width:
        raise InputError(
            "programme: contacts whose thresholds are thousands of times the width of their law still matter, and have "
            'no reference with start = "stationary"; start "fresh"'
        )
    growth = _growth_of(contacts, 1.0 + (life / v if v else 0.0))
    return Numerics(contacts, typical, width, life, v, growth)


def solve(
    contacts: Reduced, course: Course
) -> tuple[Array, list[tuple[Array, History]]]:
    """Times of kinks; and of edges, with what `march` finds there, on three grids, each
    with twice the steps of the one before."""
    reach = float(np.ptp(course.at(np.append(0.0, course.ends))))
    numerics = numerics_of(contacts, course, reach or math.inf)
    aging, delay, thermal = (
        contacts.aging,
        contacts.delay.mean,
        contacts.barrier.thermal,
    )
    ages = np.append(np.geomspace(1e-15, 1.0, 1000), 1.0)
    growth = aging.growth_at(ages) / aging.growth_at(np.zeros(1))
    grown = np.append(np.abs(growth[:-1] - 1.0) > _GROWN, True)
    quickest = min(1.0, delay or 1.0, float(ages[np.argmax(grown)]))
    if thermal:
        quickest = min(quickest, math.exp(-contacts.barrier.log_w))
    fixed, ages_change = (
        isinstance(contacts.delay, Fixed),
        not isinstance(aging, Unaged),
    )
    corners = np.append(0.0, course.ends)
    sharp = sharp_instants(
        Corners(corners, course.at(corners)),
        levels_of(contacts.law),
        aging.growth_at if ages_change else None,
        delay,
        not fixed,
        course.before == 0.0,
        bool(thermal or delay) or ages_change,
    )
    t, kinks = _edges(course, numerics.width, quickest, delay if fixed else 0.0, sharp)

    def on_grid(fine: int) -> tuple[Array, History]:
        index = np.arange(fine * (t.size - 1) + 1) / fine
        edges = np.interp(index, np.arange(t.size), t)
        path = numerics.path(edges, course.at(edges), fine)._replace(stop=threads.stop)
        return edges, march(numerics.contacts(fine), path)

    # the finest takes as long as twice the others, or more
    with ThreadPool(2) as threads:
        finest, middle, coarse = threads.map(on_grid, (4, 2, 1))
    return kinks, [coarse, middle, finest]


class Means(NamedTuple):
    """Means at the instants of a programme's grid, and their errors, arrays (points,);
    lengths in the user's unit, breaks per contact and unit time."""

    force: Array
    pinned: Array
    breaks: Array
    force_error: Array
    pinned_error: Array
    variance: Array
    variance_error: Array


def with_drag(
    values: Array,
    errors: Array,
    drag: Array,
    unit: float,
    breaks: Array,
    drag_error: Array | float = 0.0,
) -> Means:
    """Means with the viscous force `drag` of each detached contact, which may miss the
    mean force by `drag_error`, from the force, the pinned share and the variance without
    it, shape (3, points), and their errors; lengths in units of `unit`."""
    force, pinned, spread = values
    detached = 1.0 - pinned
    total = force + drag * detached
    error = errors[0] + np.abs(drag) * errors[1] + drag_error
    variance = spread + drag * detached * (drag * pinned - 2.0 * force)
    variance_error = errors[2] + drag**2 * errors[1] + 2.0 * np.abs(total) * error
    squares = variance * unit**2, variance_error * unit**2
    return Means(total * unit, pinned, breaks, error * unit, errors[1], *squares)


def means_of(ensemble: Ensemble, programme: Programme, grid: Grid) -> Means:
    """Solve the renewal equation along a programme (derived).

    Parameters
    ----------
    ensemble : Ensemble
    programme : Programme
    grid : Grid
        The instants asked for.

    Returns
    -------
    Means

    Raises
    ------
    InputError
        For what has no reference along a programme, and programmes that take too many
        steps.
    """
    contacts, course = course_of(ensemble, programme)
    unit, time = ensemble.thresholds.scale, grid.t[-1]
    kinks, solved = solve(contacts, course)
    at, (edges, found) = np.minimum(grid.t / time, 1.0), solved[-1]
    smooth = np.searchsorted(edges, kinks) if contacts.law.steps.size else None
    grids = [np.array(found[:3]) for _, found in solved]
    best, errors = _without_steps(edges, grids, smooth)
    # a variance, which between edges is nearer to a straight line
    best[2] -= best[0] ** 2
    values, breaks = np.zeros((3, at.size)), np.zeros(at.size)
    first, here = 0, 0
    for kink in kinks:  # smooth up to the next
        last = np.searchsorted(edges, kink)
        there = np.searchsorted(at, kink * (1.0 + 1e-12), side="right")
        if there > here:
            piece = slice(first, last + 1)
            t, smooth_means = edges[piece], best[:, piece]
            inside = np.clip(at[here:there], t[0], t[-1])
            interpolate = Akima1DInterpolator(t, smooth_means, axis=1)
            values[:, here:there] = interpolate(inside)
            errors[:, piece] += _between_steps(t, smooth_means)
            rate = np.diff(found.breaks[piece]) / np.diff(t)
            breaks[here:there] = np.interp(inside, 0.5 * (t[1:] + t[:-1]), rate)
        first, here = last, there
    missed = np.array([np.interp(at, edges, error) for error in errors])
    drag = drag_of(ensemble, unit / time) * course.velocity[grid.segment]
    return with_drag(values, missed, drag, unit, breaks / time)


def _between_steps(t: Array, values: Array) -> Array:
    """A bound on what interpolation between times misses, at these, shape (means,
    times): what one between every other of them misses at the rest, nearby too."""
    rough = Akima1DInterpolator(t[::2], values[:, ::2], axis=1)(t)
    return largest_nearby(rough - values, 5)


def _without_steps(
    edges: Array, grids: list[Array], jumps: Array | None
) -> tuple[Array, Array]:
    """The values of no step at all at the edges of the finest of three grids, and their
    errors, shape (means, edges). A discrete law `jumps`, at most at these edges.

    The error is twice by how much an extrapolation from the two coarser grids is
    different, nearby too: were the scheme of first order, the finer one would miss half
    as much (derived).
    """
    rough, coarse, fine = grids
    once, twice = (
        extrapolated(rough, coarse[:, ::2]),
        extrapolated(coarse, fine[:, ::2]),
    )
    index = np.arange(fine.shape[1])
    missed = 2.0 * largest_nearby(twice[:, ::2] - once, 5 + rough.shape[1] // 20)
    missed = np.maximum(missed, _CARRIED * missed.max(axis=1, keepdims=True))
    best, errors = np.zeros_like(fine), np.zeros_like(fine)
    share = np.diff(edges)[:-1] / (edges[2:] - edges[:-2])
    for j in range(fine.shape[0]):
        change = twice[j] - fine[j, ::2]
        best[j] = fine[j] + np.interp(index / 2, index[: change.size], change)
        errors[j] = np.interp(index / 4, index[: rough.shape[1]], missed[j])
        errors[j] += _RESOLVED * np.abs(best[j]).max()
        # equal thresholds that break together within a step, other than at known instants
        if jumps is not None:
            straight = best[j, :-2] + (best[j, 2:] - best[j, :-2]) * share
            bent = np.pad(2.0 * (best[j, 1:-1] - straight), 1)
            bent[jumps] = 0.0
            errors[j] += largest_nearby(bent, 9)
    return best, errors
