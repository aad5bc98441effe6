"""Exact means along a programme, a drive in segments, by the renewal equation in two
times (derived).

Of the contacts born at time s a share S(t|s) is still pinned at t, with the mean force
m(t|s) = (X(t) - X(s)) E[k_i/k; pinned]. Births B and breaks Gamma per contact and unit
time obey

    pinned(t) = S_0(t) + int_0^t B(s) S(t|s) ds
    friction = m_0(t) + int_0^t B(s) m(t|s) ds + (eta v/k)(1 - pinned)
    fixed delay: B(t) = Gamma(t - tau);    exponential delay: B = (1 - pinned)/tau

A threshold xi at birth grows to xi g(age), and the contact breaks mechanically where
|x| = xi g: the law of thresholds and the greatest |x|/g so far give the share that has.
It breaks thermally at the rate of `laws.barrier`, integrated over a step as if the
barrier were linear in time. Births are spread evenly over steps. Thresholds are divided
into strata (`master.fronts`), unless contacts born together share one hazard, as they
do without heat and if annealed (`master.cohorts`).

Lengths are in units of the law's scale, and time in units of the whole programme. Three
grids, each with twice the steps and strata of the one before, give the result,
extrapolated as of second order, and its error.
"""

import math
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np
from scipy import integrate, special
from scipy.interpolate import Akima1DInterpolator

from eqsim.errors import InputError
from eqsim.estimate import Estimate, known
from eqsim.laws.aging import Unaged
from eqsim.laws.aging.base import stiffness_varies
from eqsim.laws.barrier import Mechanical
from eqsim.laws.delay import Fixed
from eqsim.laws.no_thresholds import NoThresholds, has_jumps
from eqsim.laws.threshold import NO_STEPS, ThresholdLaw
from eqsim.laws.viscosity import Viscosity
from eqsim.master.annealed import successful_attempts
from eqsim.master.cohorts import (
    NO_CHOICES,
    Choices,
    CohortPath,
    Growth,
    History,
    LawTables,
    PooledContacts,
    march,
)
from eqsim.master.fronts import Fronts, Strata, table_of_w
from eqsim.master.idle import IDLE, means_missed, shift_by_heat
from eqsim.master.quenched import different_steps, kappa_of
from eqsim.master.sharp import Corners, Sharp, levels_of, sharp_instants
from eqsim.master.steady import reference
from eqsim.model.drive import Drive, Grid, Programme
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
from eqsim.results import Drawn, Result

# Displacement in a step of the coarsest grid, in units of the width of the law or of a
# threshold.
STEP_PER_WIDTH = 0.05
# A step of the coarsest grid over the time since the velocity changed.
STEP_PER_AGE = 0.15
# The first step of the coarsest grid over the shortest time of the contacts.
FIRST_STEP = 0.1
# Strata of the coarsest grid.
STRATA = 96
# Cells of the tables of the coarsest grid.
TABLE_CELLS = 1000
# How far interpolation of ln(rate) may be off in one of n cells, times n^2.
_OFF_IN_CELL = 10.0
# How often a cell is halved at most.
_MOST_HALVINGS = 20
# ln of a rate that stands for none.
_NO_RATE = -1e4
# Steps of a march at most, to bound time and memory.
MOST_STEPS = 200_000
# Most cohorts of a stationary start, in steps of the coarsest grid.
_MOST_COHORTS = 5000
# Width of cohorts of a stationary start of the coarsest grid, over lives that heat ends.
_WIDTH_PER_LIFE = 0.2
# Edge of the finest of three grids at the end of the first step of the coarsest.
_FIRST_STEP_OF_FINEST = 4
# The range of thresholds, in normal deviates on either side.
_DEVIATES = 8.2
# Argument of sinh at the last stratum: those in the middle are 1.8 times narrower.
_CROWDING = 2.0
# Duration of the births or breaks of an instant, over the longest step.
_INSTANT_PER_STEP = 1e-7
# The least such duration over the whole time: more than rounding.
_LEAST_INSTANT = 1e-11
# The longest over the whole time: less than could be seen.
_LONGEST_INSTANT = 1e-9
# Ends of steps before and after an infinite rate, over the longest step.
_GRADED = 2.0 ** -np.arange(1.0, 11.0)
# Multiples of a fixed delay after a change of velocity at which steps end.
_KINKS = 6
# Relative growth of thresholds that the first step resolves.
_LEAST_GROWTH = 0.02
# Relative change of velocity after which steps are short again.
_CHANGED = 0.5
# The least error over the largest along the programme.
_CARRIED = 0.1
# Share of contacts that may break, below which their thresholds do not set steps.
_RARE_BREAKS = 0.01
# Quantiles over which a typical threshold is the mean.
_TYPICAL_CONTACTS = 64
# Error of tables and rounding, over the largest value.
_TABLE_ERROR = 2e-6
# p of the means E[(k_i/k)^p; ...], shape (3, 1).
_STIFFNESS_POWERS = np.arange(3)[:, None]


def cells_of_law(
    law: ThresholdLaw, kinks: Array, even: Array, order: int
) -> tuple[Array, Array, Array]:
    """Edges of cells of a law, shape (edges,), thresholds at Gauss-Legendre nodes in
    the normal deviate, shape (edges - 1, order), both in units of the law's scale, and
    the nodes' shares of births. Edges are at the deviates `even` and at kinks of the
    law, both ends of a gap too: the cell between them has no share."""

    def threshold(z: Array) -> Array:
        return np.asarray(law.inverse_survival(normal_exponent(z))) / law.scale

    with np.errstate(divide="ignore"):
        low, high = special.ndtri(np.array([law.cdf(kinks), law.sf(kinks)], float))
    z = np.where(low < 0.0, low, -high)
    inside = np.abs(z) < even[-1]
    edge = np.append(threshold(even), kinks[inside] / law.scale)
    z = np.append(even, z[inside])
    order_of_edges = np.lexsort((edge, z))
    z, edge = z[order_of_edges], np.maximum.accumulate(edge[order_of_edges])
    nodes, weights = gauss_legendre(order).between(z[:-1], z[1:])
    share = weights * np.exp(-0.5 * nodes**2)
    return edge, threshold(nodes), share / share.sum()


def _rarest(contacts: Reduced) -> float:
    """Normal deviate of the strongest thresholds that are followed: rarer ones, the more
    births there may be, as weak contacts that heat breaks at once are born again until
    they are strong."""
    if contacts.annealed or not contacts.barrier.thermal:
        return _DEVIATES
    rare = special.log_ndtr(-_DEVIATES) - max(contacts.barrier.log_w, 0.0)
    return -float(special.ndtri_exp(rare))


def _cells_of(contacts: Reduced, cells: int) -> tuple[Array, Array, Array]:
    """Edges of cells of a law, shape (edges,), shares of births in them times
    (k_i/k)^p, shape (3, edges - 1), and those above each edge, shape (3, edges)."""
    law, share = contacts.law, np.linspace(-_CROWDING, _CROWDING, cells + 1)
    even = _DEVIATES / math.sinh(_CROWDING) * np.sinh(share)
    even[share > 0.0] *= _rarest(contacts) / _DEVIATES
    kinks = law.kinks if law.kinks.size <= cells else NO_STEPS
    edge, xi, share = cells_of_law(law, kinks, even, 4)
    shares = (share * kappa_of(contacts, xi) ** _STIFFNESS_POWERS[..., None]).sum(
        axis=2
    )
    return edge, shares, _totals_from(shares)


def _strata(contacts: Reduced, strata: int) -> tuple[Array, Strata]:
    """Nodes and strata of quenched contacts; of a discrete law its thresholds, or
    groups of them where there are many."""
    if contacts.law.steps.size:
        xi, share, stiff = different_steps(contacts)
        groups = np.linspace(0, xi.size, min(strata, xi.size) + 1).astype(int)
        first = np.unique(groups)[:-1]
        shares = np.add.reduceat(share * stiff**_STIFFNESS_POWERS, first, axis=1)
        nodes = np.add.reduceat(share * xi, first) / shares[0]
        above = _totals_from(shares)
        left, right = xi[first], xi[np.append(first[1:], xi.size) - 1]
    else:
        nodes, shares, above = _cells_of(contacts, strata)
        left, right = nodes[:-1], nodes[1:]
    return nodes, Strata(left, right, shares, above[:, :-1].copy())


def law_tables(contacts: Reduced, cells: int) -> LawTables:
    """Tables of contacts that heat does not break, or breaks all at the same rate."""
    if contacts.law.steps.size:
        xi, share, stiff = different_steps(contacts)
        between = np.linspace(0.0, xi[-1], cells)
        # just below and at each threshold, and beyond the last
        y = np.concatenate((np.setdiff1d(between, xi), xi, xi, xi[-1:]))
        y.sort()
        before = np.diff(y, append=math.inf) == 0
        index = np.searchsorted(xi, y, side="right") - before
        # in the order in which other tables are stored: kernels for another are others
        above = _totals_from(share * stiff**_STIFFNESS_POWERS).take(index, axis=1)
        ahead = np.where(before, np.nextafter(y, 0.0), y)
    else:
        edge, _, above = _cells_of(contacts, cells)
        y, above = np.append(0.0, edge), np.append(above[:, :1], above, axis=1)
        ahead = y
    log_rate = np.full(y.size, _NO_RATE)
    if contacts.annealed:
        log_rate = _log_rate(contacts, y, ahead)
        off = _OFF_IN_CELL / cells**2
        y, above, log_rate = _in_finer_cells(contacts, y, above, log_rate, off)
    total = integrate.cumulative_trapezoid(above, y, axis=1, initial=0.0)
    return LawTables(y, above, total, log_rate)


def _log_rate(contacts: Reduced, y: Array, above: Array) -> Array:
    """ln of the rate at which heat breaks annealed contacts at stretches y, of thresholds
    greater than `above`, all shape (n,)."""
    with np.errstate(divide="ignore"):
        return np.maximum(
            np.log(successful_attempts(contacts, y, above=above)), _NO_RATE
        )


def _in_finer_cells(
    contacts: Reduced, y: Array, above: Array, log_rate: Array, off: float
) -> tuple[Array, Array, Array]:
    """Halve cells of tables until interpolation of ln(rate) is off by no more than `off`
    where this matters: weighted with the fastest rate in the cell, up to 1, and with
    the share of thresholds that are greater. A law has cells where thresholds are, and
    a rate also changes where there are none."""
    rows = np.vstack((y, above, log_rate))
    cells = np.flatnonzero(np.diff(y) > 0.0)
    for _ in range(_MOST_HALVINGS):
        left, right = rows[:, cells], rows[:, cells + 1]
        middle = 0.5 * (left + right)
        exact = _log_rate(contacts, middle[0], middle[0])
        fastest = np.maximum(np.maximum(left[-1], right[-1]), exact)
        matters = np.exp(np.minimum(fastest, 0.0)) * left[1]
        coarse = np.abs(exact - middle[-1]) * matters > off
        middle[-1] = exact
        halved = cells[coarse]
        if not halved.size:
            break
        rows = np.insert(rows, halved + 1, middle[:, coarse], axis=1)
        first = halved + np.arange(halved.size)
        cells = np.union1d(first, first + 1)
    return rows[0].copy(), rows[1:-1].copy(), rows[-1].copy()


def _totals_from(shares: Array) -> Array:
    """Sum of each share and all after it, and 0 at the end."""
    padded = np.append(shares, np.zeros((shares.shape[0], 1)), axis=1)
    return padded[:, ::-1].cumsum(axis=1)[:, ::-1]


class Course(NamedTuple):
    """A programme in units of the law's scale and of its whole time: ends of segments,
    velocities, and the velocity of the stationary state before, 0 of a fresh start;
    and if heat is left out, by how much sooner contacts would break with it
    (`master.idle`)."""

    ends: Array
    velocity: Array
    before: float
    shift: float = 0.0

    @property
    def speeds(self) -> tuple[float, float]:
        """The mean and the greatest speed while it moves; 1 if no velocity is given."""
        speed, time = np.abs(self.velocity), np.diff(self.ends, prepend=0.0)
        if not speed.any():
            return 1.0, 1.0
        return float(speed @ time / time[speed > 0.0].sum()), float(speed.max())

    def at(self, t: Array) -> Array:
        """X at times t."""
        X = np.cumsum(np.diff(self.ends, prepend=0.0) * self.velocity)
        return np.interp(t, np.append(0.0, self.ends), np.append(0.0, X))


def _edges_of_steps(
    course: Course, width: float, quickest: float, tau: float, sharp: list[Sharp]
) -> tuple[Array, Array]:
    """Edges of steps of the coarsest grid, and kinks, the edges between which means are
    smooth: ends of segments, whole delays after these, and sharp instants. Contacts
    that are born or break at one instant do so in a very short step before it."""
    fastest, instant = np.abs(course.velocity).max(), _LEAST_INSTANT
    if fastest:
        instant = max(_INSTANT_PER_STEP * width / fastest, instant)
        instant = min(instant, _LONGEST_INSTANT)
    atoms = np.array([s.t for s in sharp if s.order < 0.0])
    smooth = np.concatenate((course.ends, [s.t for s in sharp], atoms - instant))
    steep = np.array([s.t for s in sharp if s.order == -0.5])
    same = _LEAST_INSTANT / 2
    marks: list[float] = []
    t, last, since, kinks = [0.0], course.before, 0.0, np.empty(0)
    for end, velocity in zip(course.ends, course.velocity, strict=True):
        changed = abs(velocity - last) > _CHANGED * max(abs(velocity), abs(last))
        if changed or t[-1] == 0.0:
            since, later = 0.0, t[-1] + tau * np.arange(1, _KINKS + 1)
            kinks = np.append(kinks[kinks > t[-1]], later)
            kinks = np.unique(np.round(kinks, 11))  # rounding makes no step
        last = velocity
        longest = min(width / abs(velocity), 1.0) if velocity else 1.0
        begins = np.append(kinks, atoms)
        graded = np.add.outer(steep, longest * np.append(_GRADED, -_GRADED)).ravel()
        # dropped next to sharp instants, which have to be exact
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
                step = max(FIRST_STEP * quickest, STEP_PER_AGE * (since + elapsed[-1]))
                elapsed.append(elapsed[-1] + min(step, longest))
                if len(t) + len(elapsed) > MOST_STEPS:
                    raise InputError(
                        f"programme: takes more than {MOST_STEPS} steps of the "
                        "renewal equation"
                    )
            since += mark - begin
            stretched = np.array(elapsed[1:]) * ((mark - begin) / elapsed[-1])
            t += (begin + stretched).tolist()
            t[-1] = float(mark)
            if np.abs(np.append(smooth, kinks) - mark).min() < same:
                marks.append(t[-1])
    return np.array(t), np.array(marks)


def course_of(ensemble: Ensemble, programme: Programme) -> tuple[Reduced, Course]:
    """Dimensionless contacts, and the programme in their units, without heat where that
    changes next to nothing. Raises InputError for contacts that have no reference along
    one."""
    if ensemble.self_consistent:
        raise InputError(
            "aging: that of annealed contacts is defined at constant velocity only, "
            "not along a programme"
        )
    if programme.loaded:
        raise InputError("drive.programme: a load that changes is not allowed here")
    if ensemble.fluctuates:
        raise InputError('rule = "langevin": has no reference along a programme')
    if ensemble.newborn.active:
        law = ensemble.newborn.law
        raise InputError(
            f'newborn.law = "{law}": contacts born stretched have no reference along '
            "a programme or with a stage"
        )
    unit = ensemble.thresholds.scale
    time = sum(segment.duration for segment in programme.segments)
    velocity = np.array([segment.velocity for segment in programme.segments])
    before = programme.velocity_before
    speed = legs(ensemble, programme)[0].pace
    delay = ensemble.delay.at(ensemble.thermal.kT, speed)
    ensemble = replace(ensemble, delay=delay)
    ends = np.cumsum([segment.duration for segment in programme.segments]) / time
    contacts = reduced(ensemble, unit / time)
    course = Course(ends, velocity * (time / unit), before * (time / unit))
    if programme.forced or programme.motor:
        return contacts, course
    way = float(np.abs(course.velocity) @ np.diff(ends, prepend=0.0))
    if programme.stage is not None:  # a mass may overshoot
        way = 2.0 * (way + abs(programme.stage.preload or 0.0) / unit)
    shift = shift_by_heat(contacts, way)
    moving = np.abs(course.velocity[course.velocity != 0.0])
    if contacts.delay.mean and moving.size:
        shift *= float(moving.max() / moving.min())
    if shift > IDLE * contacts.law.mean / contacts.law.scale:
        return contacts, course
    return contacts._replace(barrier=Mechanical()), course._replace(shift=shift)


def heat_is_idle(ensemble: Ensemble, drive: Drive | Programme) -> bool:
    """True if heat could break contacts, and is left out along a programme, whatever
    its load. Raises InputError as `course_of` does."""
    if not isinstance(drive, Programme):
        return False
    even = tuple(replace(each, load=None, load_rate=None) for each in drive.segments)
    drive = replace(drive, segments=even)
    kinds = [kind.contacts for kind in ensemble.kinds]
    return all(course_of(contacts, drive)[1].shift > 0.0 for contacts in kinds)


class Numerics(NamedTuple):
    """Contacts along a course, and how to resolve them: a typical threshold, the
    largest displacement in a step of the coarsest grid; the longest life and the width
    of cohorts, both in displacement, in the stationary state before, and whether these
    resolve the life of a median threshold."""

    ensemble: Reduced
    course: Course
    typical: float
    width: float
    life: float
    first_width: float
    resolves_lives: bool

    def contacts(self, fine: float) -> PooledContacts | Fronts:
        """Contacts for kernels, with `fine` times the strata or cells of the coarsest
        grid."""
        ensemble, delay = self.ensemble, self.ensemble.delay.for_kernels()
        aging = ensemble.aging
        stiffens = bool(stiffness_varies(aging, ensemble.springs))
        growth = Growth(aging, not isinstance(aging, Unaged), stiffens)
        if not ensemble.barrier.thermal or ensemble.annealed:
            tables = law_tables(ensemble, round(fine * TABLE_CELLS))
            return PooledContacts(tables, growth, delay, NO_STEPS)
        nodes, strata = _strata(ensemble, round(fine * STRATA))
        laws = ensemble.barrier, ensemble.springs, delay
        return Fronts(nodes, strata, growth, *laws, table_of_w())

    def path(
        self, t: Array, X: Array, fine: float, choices: Choices = NO_CHOICES
    ) -> CohortPath:
        """Path for kernels, through edges t, X of steps, arrays (edges,)."""
        width, before = self.width / fine, self.course.before
        first, share = self.first_width / fine, STEP_PER_AGE / fine
        cohorts = math.ceil(self.life / first) if before else 0
        return CohortPath(t, X, width, share, cohorts, first, before, choices, NEVER)


def _typical(contacts: Reduced, reach: float) -> float:
    """A threshold that sets steps after a fresh start, where no contact is stretched by
    more than `reach`. Thresholds beyond do not count, as they may stand for contacts
    that never break; nor does the mean if most thresholds are far less."""
    law = contacts.law
    median = float(law.inverse_survival(math.log(2.0)))
    typical = min(law.mean, 2.0 * median) / law.scale
    if typical <= reach:
        return typical
    share = float(law.cdf(reach * law.scale))
    if share < _RARE_BREAKS:
        return reach
    ranks = (np.arange(_TYPICAL_CONTACTS) + 0.5) / _TYPICAL_CONTACTS
    return float(np.mean(law.inverse_survival(-np.log1p(-share * ranks)))) / law.scale


def outlived(contacts: Reduced, speed: float, rank: float = math.log(2.0)) -> Array:
    """Stretches that 1/e and e^-36 of contacts without delay outlive at a speed, shape
    (2,), if none or the threshold that e^-`rank` exceed, the median, is in the way."""
    law, barrier = contacts.law, contacts.barrier
    xi = np.array([float(law.inverse_survival(rank)) / law.scale])
    a = barrier.b * kappa_of(contacts, xi)
    levels = np.log([speed, 36.0 * speed])
    return np.minimum(barrier.stretch_at(levels, xi, a)[0], xi)


def _lift(contacts: Reduced, fastest: float) -> float:
    """ln of how far the rate at which heat breaks contacts rises beyond that of
    attempts, as it does where force alone decides."""
    barrier = contacts.barrier
    if not barrier.by_force:
        return 0.0
    last = outlived(contacts, fastest)[-1:]
    return max(float(barrier.log_rate(last, last, barrier.b)[0]), 0.0)


def numerics_of(contacts: Reduced, course: Course, reach: float) -> Numerics:
    """Resolution of contacts that are stretched by no more than `reach`. Raises
    InputError for contacts whose lives are too different for a stationary start."""
    law, aging, v = contacts.law, contacts.aging, course.before
    # -ln of the survival one standard deviation below and above the median, and of the
    # strongest threshold that counts
    exponents = np.array([0.17, 1.8, 36.0])
    low, high, strongest = np.asarray(law.inverse_survival(exponents)) / law.scale
    typical = law.mean / law.scale if v else _typical(contacts, reach)
    if isinstance(law, NoThresholds):
        mean, fastest = course.speeds
        strongest = outlived(contacts, v or fastest)[1]
        typical = min(outlived(contacts, mean)[0], reach)
    width = typical
    if high > low:
        width = min(max(1.5 * (high - low), 0.02 * typical), typical)
    width, life = STEP_PER_WIDTH * width, float(strongest)
    for _ in range(50 if v else 0):  # towards the root of x = xi growth(x/v)
        life = strongest * max(1.0, float(aging.growth_at(np.array([life / v]))[0]))
    if v and life > _MOST_COHORTS * width:
        raise InputError(
            "programme: thresholds of hundreds of widths of their law matter, and have "
            'no reference with start = "stationary"; use start = "fresh"'
        )
    first = short = width
    if v and contacts.barrier.thermal:
        # heat may break contacts long before they are stretched by a step
        short = float(outlived(contacts, v)[0])
        if isinstance(aging, Unaged):
            life = min(life, float(outlived(contacts, v, 36.0)[1]))
        first = max(min(width, _WIDTH_PER_LIFE * short), life / _MOST_COHORTS)
    return Numerics(contacts, course, typical, width, life, first, first <= short)


class Marches(NamedTuple):
    """Times of kinks and of the edges of the finest of three grids, each with twice the
    steps of the one before; the means on all; and the resolution."""

    kinks: Array
    edges: Array
    means: list[History]
    numerics: Numerics


def solve(contacts: Reduced, course: Course) -> Marches:
    """Solve on three grids."""
    corners = np.append(0.0, course.ends)
    X = course.at(corners)
    numerics = numerics_of(contacts, course, float(np.ptp(X)) or math.inf)
    aging, delay, thermal = contacts.aging, contacts.delay, contacts.barrier.thermal
    ages = np.append(np.geomspace(1e-15, 1.0, 1000), 1.0)
    growth = aging.growth_at(ages) / aging.growth_at(np.zeros(1))
    grown = np.append(np.abs(growth[:-1] - 1.0) > _LEAST_GROWTH, True)
    quickest = min(1.0, delay.mean or 1.0, float(ages[np.argmax(grown)]))
    if thermal:
        lift = _lift(contacts, course.speeds[1])
        attempt = math.exp(-contacts.barrier.log_w - lift)
        quickest = min(quickest, max(attempt, _LEAST_INSTANT))
    fixed, changes = isinstance(delay, Fixed), not isinstance(aging, Unaged)
    sharp = sharp_instants(
        Corners(corners, X),
        levels_of(contacts.law),
        aging.growth_at if changes else None,
        delay.mean,
        not fixed,
        course.before == 0.0,
        bool(thermal or delay.mean) or changes,
    )
    tau = delay.mean if fixed and delay.mean < math.inf else 0.0
    t, kinks = _edges_of_steps(course, numerics.width, quickest, tau, sharp)

    def edges_of(fine: int) -> Array:
        index = np.arange(fine * (t.size - 1) + 1) / fine
        return np.interp(index, np.arange(t.size), t)

    def on_grid(fine: int) -> History:
        edges = edges_of(fine)
        path = numerics.path(edges, course.at(edges), fine)._replace(stop=threads.stop)
        return march(numerics.contacts(fine), path)

    # the finest takes as long as twice the others, or more
    with ThreadPool(2) as threads:
        finest, middle, coarse = threads.map(on_grid, (4, 2, 1))
    return Marches(kinks, edges_of(4), [coarse, middle, finest], numerics)


@dataclass(frozen=True, repr=False)
class Transient(Result):
    """Exact means over independent contacts along a drive, arrays of shape (points,).

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
        estimate; None if not asked for, if contacts stay in step for longer than the
        grids resolve, or if the stationary variance is infinite.
    stage, X_error : ndarray or None
        Of a slider that is pulled, in mean field: displacement of the stage's end of
        the spring, and the error estimate of X (length), which is found with it and is
        not a number once a slider under a force has let go.
    lifetime : Estimate or None
        When it lets go (time), if it does.
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
    lifetime: Estimate | None = None


def with_drag(
    grid: Grid,
    values: Array,
    errors: Array,
    drag: Array,
    drag_error: Array | float,
    unit: float,
    breaks: Array,
) -> Transient:
    """Add the viscous force `drag` of each detached contact, which may miss the mean
    force by `drag_error`, to the force, the pinned share and the variance without it,
    `values`, shape (3, points); `errors` are those of the force, the pinned share and
    the mean square. Lengths are in units of `unit`."""
    force, pinned, spread = values
    detached = 1.0 - pinned
    total = force + drag * detached
    error = errors[0] + np.abs(drag) * errors[1] + drag_error
    variance = spread + drag * detached * (drag * pinned - 2.0 * force)
    variance_error = errors[2] + drag**2 * errors[1] + 2.0 * np.abs(total) * error
    variance_error += 2.0 * np.abs(drag) * detached * drag_error
    return Transient(
        X=grid.X,
        force=total * unit,
        pinned=pinned,
        breaks=breaks,
        force_error=error * unit,
        pinned_error=errors[1],
        t=grid.t,
        force_variance=variance * unit**2,
        force_variance_error=variance_error * unit**2,
    )


def means_along(ensemble: Ensemble, programme: Programme, grid: Grid) -> Transient:
    """Solve the renewal equation along a programme at the instants of a grid (derived).
    Raises InputError for what has no reference along a programme, and programmes that
    take too many steps."""
    contacts, course = course_of(ensemble, programme)
    unit, time = ensemble.thresholds.scale, grid.t[-1]
    kinks, edges, solved, numerics = solve(contacts, course)
    t, finest = np.minimum(grid.t / time, 1.0), solved[-1]
    jumps = np.searchsorted(edges, kinks) if has_jumps(contacts.law) else None
    grids = [np.array(history[:3]) for history in solved]
    best, errors = _extrapolated_means(edges, grids, jumps)
    if course.before:
        known_there = [0]
        if not numerics.resolves_lives:
            known_there.append(_FIRST_STEP_OF_FINEST)
        missed = _missed_at_first(ensemble, programme, best[:, known_there])
        errors += missed[:, None]
    # the variance is interpolated: it is nearer to linear than the mean square
    best[2] -= best[0] ** 2
    values, breaks = np.zeros((3, t.size)), np.zeros(t.size)
    first, begin = 0, 0
    for kink in kinks:  # means are smooth up to the next
        last = np.searchsorted(edges, kink)
        end = np.searchsorted(t, kink * (1.0 + 1e-12), side="right")
        if end > begin:
            piece = slice(first, last + 1)
            x, means = edges[piece], best[:, piece]
            inside = np.clip(t[begin:end], x[0], x[-1])
            values[:, begin:end] = Akima1DInterpolator(x, means, axis=1)(inside)
            # a bound: the error of interpolation between every other edge at the rest
            rough = Akima1DInterpolator(x[::2], means[:, ::2], axis=1)(x)
            errors[:, piece] += largest_nearby(rough - means, 5)
            rate = np.diff(finest.breaks[piece]) / np.diff(x)
            breaks[begin:end] = np.interp(inside, 0.5 * (x[1:] + x[:-1]), rate)
        first, begin = last, end
    if course.shift:
        X, seen = course.at(edges), np.diff(edges) > 2.0 * _LONGEST_INSTANT
        errors += means_missed(
            contacts, course.shift, course.ends.size,
            np.diff(finest.breaks)[seen], np.diff(X)[seen],
        )  # fmt: skip
    missed = np.array([np.interp(t, edges, error) for error in errors])
    if course.shift and jumps is not None:
        # with heat contacts break just before an instant that is asked for
        inner = jumps[(jumps > 0) & (jumps < edges.size - 1)]
        there = np.abs(t - edges[inner, None]) < 2.0 * _LONGEST_INSTANT
        missed += np.abs(best[:, inner + 1] - best[:, inner - 1]) @ there
    moving = [drag_of(ensemble, g.pace) * g.sign for g in legs(ensemble, programme)]
    drag = np.array(moving)[grid.segment]
    return with_drag(grid, values, missed, drag, 0.0, unit, breaks / time)


def _missed_at_first(ensemble: Ensemble, programme: Programme, first: Array) -> Array:
    """Largest errors of the means `first`, shape (3, instants), force without drag,
    pinned share and mean square at the beginning, and next to it, where they are still
    those of the stationary state before: large where lives are far shorter than
    steps."""
    bare = replace(ensemble, eta=0.0, viscosity=Viscosity())
    exact = reference(bare, Drive(abs(programme.velocity or 0.0)))
    force = np.abs(first[0]) - known(exact.friction) / ensemble.thresholds.scale
    force, pinned = np.abs(force), np.abs(first[1] - known(exact.pinned))
    square = 2.0 * first[2] * force / np.maximum(np.abs(first[0]), 1e-300)
    return np.array([force, pinned, square]).max(axis=1)


def _extrapolated_means(
    edges: Array, grids: list[Array], jumps: Array | None
) -> tuple[Array, Array]:
    """Values extrapolated to vanishing steps at the edges of the finest of three grids,
    and their errors, shape (means, edges). `jumps`: indices of edges at which the means
    of a discrete law may jump; None for other laws.

    The error is twice the largest difference nearby from an extrapolation of the two
    coarser grids: were the scheme of first order, the finer one would miss half as much
    (derived).
    """
    rough, coarse, fine = grids
    once = extrapolated(rough, coarse[:, ::2])
    twice = extrapolated(coarse, fine[:, ::2])
    missed = 2.0 * largest_nearby(twice[:, ::2] - once, 5 + rough.shape[1] // 20)
    missed = np.maximum(missed, _CARRIED * missed.max(axis=1, keepdims=True))
    index = np.arange(fine.shape[1])

    def on_finest(values: Array, ratio: int) -> Array:
        rows = [np.interp(index, index[::ratio], row) for row in values]
        return np.array(rows)

    best = fine + on_finest(twice - fine[:, ::2], 2)
    errors = on_finest(missed, 4)
    errors += _TABLE_ERROR * np.abs(best).max(axis=1, keepdims=True)
    # equal thresholds that break together within a step, at an instant not in `jumps`
    if jumps is not None:
        share = np.diff(edges)[:-1] / (edges[2:] - edges[:-2])
        straight = best[:, :-2] + (best[:, 2:] - best[:, :-2]) * share
        bent = np.zeros_like(best)
        bent[:, 1:-1] = 2.0 * (best[:, 1:-1] - straight)
        bent[:, jumps] = 0.0
        errors += largest_nearby(bent, 9)
    return best, errors
