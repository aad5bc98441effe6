"""Quenched contacts that heat breaks, along a drive in segments: a kernel of
`master.programme`.

Births are followed from the edges of steps on, and thresholds from nodes: of a contact
born at an edge with the threshold of a node the integrated hazard z is known. Between
two edges and two nodes, in a cell of births and a stratum of thresholds, births are
spread evenly and ln z is a plane, so that what heat has left is a second difference of

    W(y) = int_{-oo}^y du int_{-oo}^u (1 - exp(-e^w)) dw = sum_n (-1)^(n+1) e^(n y)/(n^2
    n!)

over the corners (derived). Breaking may thus be as sharp as it likes, and neither cells
nor strata need be narrow.
"""

import functools
import math
from typing import Any, NamedTuple

import numpy as np
from scipy import special

from eqsim.laws.barrier.base import height, prefactor
from eqsim.laws.delay import Waits
from eqsim.laws.stiffness import Springs, kappa
from eqsim.master.cohorts import (
    DROPPED,
    JOINED,
    KEPT,
    NEGLIGIBLE_SHARE,
    Growth,
    History,
    Path,
    Row,
    advance_all,
    ages_of_survivors,
    begin,
    births_in,
    densities_alike,
    empty,
    grown_by,
    mean_exponential,
    noted,
    numbered,
    observe,
    with_room,
)
from eqsim.numerics.compiled import routine
from eqsim.numerics.tables import Array
from eqsim.numerics.vector_math import exp

# ln z below which heat has broken next to nothing of a cell and a stratum: exp(-36) =
# 2e-16.
_NONE_BROKEN = -36.0
# ln z above which it has left next to nothing: exp(-exp(3.6)) = 1e-16.
_ALL_BROKEN = 3.6
# z up to which it is followed.
_LARGEST_Z = 1e12
# -ln of what z grows by in a step that counts as nothing.
_UNSEEN = 640.0
# The table of W: ln z where it begins, which is 0 there, and where it ends, and knots
# per unit of ln z.
_FIRST = -40.0
_LAST = 6.0
_PER_UNIT = 64
# Differences of ln z that are taken for larger ones, which misses 1e-5 of what is about
# to break.
_FLAT = 0.03
# Share of the whole time between births of about the same age.
_AT_ONCE = 1e-11
# By how much E may be off the straight line of a step; halves of the step come in from
# half of that on.
_STRAIGHT = 0.01
# Parts of the births of a step where thresholds grow.
_PARTS = 12


class Strata(NamedTuple):
    """Classes of contacts by threshold at birth, ascending: the edges, arrays
    (strata,); the shares of births, and these times E[k_i/k] and E[(k_i/k)^2], of each
    and of it and all above, shape (3, strata); the thresholds of nodes, shape (nodes,),
    and which of these are at the edges, arrays (strata,)."""

    left: Array
    right: Array
    share: Array
    above: Array
    nodes: Array
    low: Array
    high: Array


class Fronts(NamedTuple):
    """Contacts for kernels: strata, laws, and the table of W."""

    strata: Strata
    growth: Growth
    barrier: Any
    springs: Springs
    delay: Waits
    table: Array


# A cell: the births between two edges of steps. `X` and `t` are those of its older
# edge, and `weakest` the greatest |x|/g so far of contacts born there; `X_mean` is the
# mean over its `births`; the others are as in `master.cohorts.COHORT`.
_FIELDS = "X t weakest births X_mean pinned stiffness stiffness2"
CELL = np.dtype([(field, np.float64) for field in _FIELDS.split()], align=True)


class Edge(NamedTuple):
    """Where births end: time, displacement, and the greatest |x|/g so far of contacts
    born there."""

    t: float
    X: float
    weakest: float


class Scratch(NamedTuple):
    """For each node, arrays (nodes,): ln z at the older and the newer edge of a cell;
    and of births, the share that is left, its age and square age, and z of a part of
    them before."""

    older: Array
    newer: Array
    share: Array
    age: Array
    age2: Array
    before: Array


class Cells(NamedTuple):
    """All cells, an array (rows,) of CELL; z at their older edges, shape (rows, nodes);
    and the rows in use, from the oldest on, and then the others."""

    cells: Array
    z: Array
    order: Array
    scratch: Scratch


# It has no parameters, and takes 1.3 ms: a third of a short solve.
@functools.cache
def table_of_w() -> Array:
    """W and its slope at y = _FIRST, ..., _LAST, shape (knots, 2)."""
    y = np.linspace(_FIRST, _LAST, int((_LAST - _FIRST) * _PER_UNIT) + 1)
    nodes, weights = np.polynomial.legendre.leggauss(8)

    def slope(y: Array) -> Array:  # Ein(e^y)
        z = np.exp(y)
        small = z * (1.0 - z / 4.0 * (1.0 - z * 2.0 / 9.0 * (1.0 - z * 3.0 / 16.0)))
        return np.asarray(
            np.where(y < -6.0, small, y + np.euler_gamma + special.exp1(z))
        )

    half = 0.5 / _PER_UNIT
    parts = half * (weights * slope((y[:-1, None] + half) + half * nodes)).sum(axis=1)
    return np.ascontiguousarray(
        np.stack(
            (np.append(0.0, np.cumsum(parts)) + math.exp(_FIRST), slope(y)), axis=1
        )
    )


@routine(inline=True)
def _w(table: Array, y: float) -> float:
    """W; beyond the table its slope goes on as y + gamma."""
    steps = (min(y, _LAST) - _FIRST) * _PER_UNIT
    if steps <= 0.0:
        return 0.0
    i = min(int(steps), table.shape[0] - 2)
    u, h = steps - i, 1.0 / _PER_UNIT
    f0, d0, f1, d1 = table[i, 0], table[i, 1] * h, table[i + 1, 0], table[i + 1, 1] * h
    w = f0 + u * (
        d0 + u * (3.0 * (f1 - f0) - 2.0 * d0 - d1 + u * (2.0 * (f0 - f1) + d0 + d1))
    )
    beyond = y - min(y, _LAST)
    return w + beyond * (table[table.shape[0] - 1, 1] + 0.5 * beyond)


@routine
def _broken(table: Array, middle: float, by_threshold: float, by_birth: float) -> float:
    """Mean of 1 - exp(-z) over a cell and a stratum with ln z = `middle` in the middle,
    and its differences."""
    p, q = max(abs(by_threshold), _FLAT), max(abs(by_birth), _FLAT)
    outer, inner = 0.5 * (p + q), 0.5 * (p - q)
    four = (
        _w(table, middle + outer)
        - _w(table, middle + inner)
        - _w(table, middle - inner)
        + _w(table, middle - outer)
    )
    return min(max(four / (p * q), 0.0), 1.0)


@routine
def _thermal(
    contacts: Fronts,
    z: Array,
    age0: float,
    age1: float,
    x0: float,
    x1: float,
    dt: float,
) -> None:
    """Add to z of all nodes what it grows by in a step `dt` between two ages and
    stretches of the contacts."""
    g0, g1 = grown_by(contacts.growth, age0), grown_by(contacts.growth, age1)
    gm, xm = 0.5 * (g0 + g1), 0.5 * abs(x0 + x1)
    x0, x1 = abs(x0), abs(x1)
    strata, b, log_w = contacts.strata, contacts.barrier.b, contacts.barrier.log_w
    limit = log_w + math.log(dt) + _UNSEEN
    for k in range(z.size):
        if z[k] > _LARGEST_Z:
            continue
        xi, stiff = strata.nodes[k], kappa(contacts.springs, strata.nodes[k])
        a0, a1 = b * stiff, b * stiff
        if contacts.growth.varies:
            a0, a1 = (
                b * kappa(contacts.springs, xi * g0),
                b * kappa(contacts.springs, xi * g1),
            )
        low, high = (
            height(contacts.barrier, xi * g0, x0, a0),
            height(contacts.barrier, xi * g1, x1, a1),
        )
        if min(low, high) > limit:  # stronger contacts are safer
            break
        middle = height(contacts.barrier, xi * gm, xm, 0.5 * (a0 + a1))
        p = dt * prefactor(contacts.barrier, max(xi * gm, xm), xm)
        halves = min(
            max(2.0 * abs(middle - 0.5 * (low + high)) / _STRAIGHT - 1.0, 0.0), 1.0
        )
        if halves < 1.0:
            z[k] += p * (1.0 - halves) * mean_exponential(low - log_w, high - log_w)
        if halves > 0.0:
            both = mean_exponential(low - log_w, middle - log_w) + mean_exponential(
                middle - log_w, high - log_w
            )
            z[k] += 0.5 * p * halves * both


@routine(inline=True)
def _copy(values: Array, to: Array) -> None:
    for k in range(values.size):
        to[k] = values[k]


@routine(inline=True)
def _logarithms(z: Array, y: Array) -> None:
    for k in range(z.size):
        y[k] = math.log(max(z[k], 1e-300))


@routine(inline=True)
def _below(left: float, right: float, y: float) -> float:
    """int_0^y of the share of a stratum above y."""
    if y <= left:
        return y
    if y >= right:
        return 0.5 * (left + right)
    return y - 0.5 * (y - left) ** 2 / (right - left)


@routine(inline=True)
def _unbroken(left: float, right: float, low: float, high: float) -> float:
    """Share of a stratum above y, in the mean over low < y < high."""
    if high - low > 1e-9 * high:
        return (_below(left, right, high) - _below(left, right, low)) / (high - low)
    return (
        1.0
        if high <= left and high < right
        else max(right - high, 0.0) / (right - left)
        if right > left
        else 0.0
    )


@routine
def _weigh(
    contacts: Fronts, cell: Row, weakest: float, older: Array, newer: Array, g: float
) -> None:
    """Find what of a cell is pinned, with ln z at its older and newer edge, and the
    greatest |x|/g so far at the newer one, `weakest`."""
    strata, pinned, stiffness, stiffness2 = contacts.strata, 0.0, 0.0, 0.0
    low, high = min(cell.weakest, weakest), max(cell.weakest, weakest)
    for k in range(strata.left.size):
        if strata.right[k] <= low and strata.left[k] < high:
            continue
        weak0, strong0 = older[strata.low[k]], older[strata.high[k]]
        weak1, strong1 = newer[strata.low[k]], newer[strata.high[k]]
        least, most = (
            min(strong0, strong1),
            max(weak0, weak1),
        )  # stronger contacts are safer
        if least > _ALL_BROKEN:
            continue
        left = 1.0
        if most > _NONE_BROKEN:
            middle = 0.25 * (weak0 + strong0 + weak1 + strong1)
            by_threshold = 0.5 * (strong0 + strong1 - weak0 - weak1)
            by_birth = 0.5 * (weak1 + strong1 - weak0 - strong0)
            left = 1.0 - _broken(contacts.table, middle, by_threshold, by_birth)
        elif strata.left[k] >= high:  # none of the stronger either
            pinned += strata.above[0, k]
            stiffness += strata.above[1, k]
            stiffness2 += strata.above[2, k]
            break
        left *= _unbroken(strata.left[k], strata.right[k], low, high)
        pinned += left * strata.share[0, k]
        stiffness += left * strata.share[1, k]
        stiffness2 += left * strata.share[2, k]
    if contacts.growth.varies:
        stiffness, stiffness2 = stiffness * g, stiffness2 * g * g
    cell.pinned = cell.births * pinned
    cell.stiffness = cell.births * stiffness
    cell.stiffness2 = cell.births * stiffness2


@routine
def _bear(contacts: Fronts, cell: Row, z: Array, scratch: Scratch, dt: float) -> None:
    """Treat the births of a step as one birth at its end: find z of those at its
    beginning, which grows evenly in each of a number of parts by age, and what is
    pinned. Where thresholds grow, a part is twice as long as that before."""
    x, parts = (
        2.0 * abs(cell.X_mean - cell.X),
        _PARTS if contacts.growth.values.size else 1,
    )
    share, age, age2 = (
        scratch.share,
        scratch.age,
        scratch.age2,
    )  # E[1], E[u], E[u^2] of those left, u the age over dt
    for k in range(z.size):
        z[k], share[k], age[k], age2[k] = 0.0, 0.0, 0.0, 0.0
    u = 0.0
    for part in range(parts):
        after = 0.5 ** (parts - 1 - part)
        width = after - u
        _copy(z, scratch.before)
        _thermal(contacts, z, u * dt, after * dt, u * x, after * x, width * dt)
        for k in range(z.size):
            before = scratch.before[k]
            if before > 700.0:
                continue
            left = ages_of_survivors(min(z[k] - before, 700.0))
            here = exp(-before) * left.share * width
            share[k] += here
            age[k] += here * (u + width * left.age)
            age2[k] += here * (
                u * u + 2.0 * u * width * left.age + width * width * left.age2
            )
        u = after
    strata, g = (
        contacts.strata,
        grown_by(contacts.growth, 0.5 * dt) if contacts.growth.varies else 1.0,
    )
    cell.weakest = x / grown_by(contacts.growth, dt)
    cell.pinned, cell.stiffness, cell.stiffness2 = 0.0, 0.0, 0.0
    for k in range(strata.left.size):
        i, j = strata.low[k], strata.high[k]
        unbroken = 0.5 * _unbroken(strata.left[k], strata.right[k], 0.0, cell.weakest)
        cell.pinned += unbroken * strata.share[0, k] * (share[i] + share[j])
        # as if all were at the middle, and spread evenly
        cell.stiffness += unbroken * strata.share[1, k] * 2.0 * g * (age[i] + age[j])
        cell.stiffness2 += (
            unbroken * strata.share[2, k] * 3.0 * g * g * (age2[i] + age2[j])
        )


@routine
def _alike(
    contacts: Fronts, path: Path, older: Row, newer: Row, edge: Edge, now: float
) -> bool:
    """Whether two cells may be joined, the newer of which ends at `edge`: of the same
    direction and about as dense in X, and together not too wide in X, as thresholds
    have grown, in |x|/g and in time per age."""
    if (
        edge.t - older.t > path.share * (now - edge.t) + _AT_ONCE
        or abs(older.weakest - edge.weakest) > path.width
    ):
        return False
    if abs(edge.X - older.X) > path.width * grown_by(contacts.growth, now - edge.t):
        return False
    return densities_alike(
        (newer.X - older.X) * newer.births, (edge.X - newer.X) * older.births
    )


@routine
def _join(older: Row, newer: Row, X: float) -> None:
    """Join a cell, which ends at `X`, to the one before."""
    both = older.births + newer.births
    mean = (
        (older.births * older.X_mean + newer.births * newer.X_mean) / both
        if both > 0.0
        else 0.5 * (older.X + X)
    )
    older.X_mean = mean
    older.births += newer.births
    older.pinned += newer.pinned
    older.stiffness += newer.stiffness
    older.stiffness2 += newer.stiffness2


@with_room.register(Cells)
def _with_room(population: Cells, rows: int) -> Cells:
    cells, z, order = (
        np.zeros(rows, CELL),
        np.zeros((rows, population.z.shape[1])),
        numbered(rows),
    )
    for i in range(population.order.size):
        order[i] = population.order[i]
        cells[i] = population.cells[i]
        _copy(population.z[i], z[i])
    return Cells(cells, z, order, population.scratch)


@empty.register(Fronts)
def _empty(contacts: Fronts, rows: int) -> Cells:
    nodes = contacts.strata.nodes.size
    scratch = Scratch(
        np.zeros(nodes),
        np.zeros(nodes),
        np.zeros(nodes),
        np.zeros(nodes),
        np.zeros(nodes),
        np.zeros(nodes),
    )
    return Cells(np.zeros(rows, CELL), np.zeros((rows, nodes)), numbered(rows), scratch)


@routine
def _place(cell: Row, t: float, X: float, newer_X: float) -> None:
    """Begin a cell at an edge."""
    cell.t = t
    cell.X = X
    cell.weakest = 0.0
    cell.births = 1.0
    cell.X_mean = 0.5 * (X + newer_X)


@begin.register(Fronts)
def _begin(contacts: Fronts, path: Path, population: Cells) -> tuple[int, float]:
    older, newer = population.scratch.older, population.scratch.newer
    if path.cohorts == 0:
        _place(population.cells[0], 0.0, 0.0, 0.0)
        _logarithms(population.z[0], older)
        _weigh(
            contacts,
            population.cells[0],
            0.0,
            older,
            older,
            grown_by(contacts.growth, 0.0),
        )
        return 1, 0.0
    dt, width, cycle, count = (
        path.width / path.velocity,
        path.width,
        contacts.delay.mean,
        0,
    )
    for i in range(path.cohorts):
        cell = population.cells[i]
        _place(cell, -(i + 1) * dt, -(i + 1) * width, -i * width)
        if i == 0:
            _bear(contacts, cell, population.z[0], population.scratch, dt)
            _logarithms(population.z[0], newer)
        else:
            weakest = population.cells[i - 1].weakest
            _copy(population.z[i - 1], population.z[i])
            _thermal(
                contacts,
                population.z[i],
                i * dt,
                (i + 1) * dt,
                i * width,
                (i + 1) * width,
                dt,
            )
            cell.weakest = max(
                weakest, (i + 1) * width / grown_by(contacts.growth, (i + 1) * dt)
            )
            _logarithms(population.z[i], older)
            _weigh(
                contacts,
                cell,
                weakest,
                older,
                newer,
                grown_by(contacts.growth, (i + 0.5) * dt),
            )
            _copy(older, newer)
        cycle += cell.pinned * dt
        count += 1
        if cell.pinned < NEGLIGIBLE_SHARE and not path.choices.given:
            break
    for i in range(count):
        _scale(population.cells[i], dt / cycle)
        population.order[i] = count - 1 - i
    return count, 1.0 / cycle


@routine(inline=True)
def _scale(cell: Row, births: float) -> None:
    """Make a cell of one contact one of `births`."""
    cell.births *= births
    cell.pinned *= births
    cell.stiffness *= births
    cell.stiffness2 *= births


@advance_all.register(Fronts)
def _advance_all(
    contacts: Fronts,
    path: Path,
    population: Cells,
    history: History,
    m: int,
    count: int,
    rate: float,
) -> int:
    t0, X0, t1, X1 = path.t[m - 1], path.X[m - 1], path.t[m], path.X[m]
    dt, older, newer = t1 - t0, population.scratch.older, population.scratch.newer
    row, pinned = population.order[count], 0.0
    new = population.cells[row]
    _place(new, t0, X0, X1)
    _bear(contacts, new, population.z[row], population.scratch, dt)
    _logarithms(population.z[row], newer)
    weakest, newer_t = new.weakest, t0
    for i in range(count - 1, -1, -1):
        cell, z = (
            population.cells[population.order[i]],
            population.z[population.order[i]],
        )
        _thermal(contacts, z, t0 - cell.t, t1 - cell.t, X0 - cell.X, X1 - cell.X, dt)
        cell.weakest = max(
            cell.weakest, abs(X1 - cell.X) / grown_by(contacts.growth, t1 - cell.t)
        )
        _logarithms(z, older)
        _weigh(
            contacts,
            cell,
            weakest,
            older,
            newer,
            grown_by(contacts.growth, t1 - 0.5 * (cell.t + newer_t)),
        )
        _copy(older, newer)
        weakest, newer_t = cell.weakest, cell.t
        pinned += cell.pinned
    _scale(new, births_in(contacts.delay, path, history, m, rate, pinned, new.pinned))
    kept = 0
    for i in range(
        count + 1
    ):  # drop cells that are gone, and join those that hardly differ
        j, fate, edge = population.order[i], KEPT, Edge(t1, X1, 0.0)
        if i < count:
            after = population.cells[population.order[i + 1]]
            edge = Edge(after.t, after.X, after.weakest)
        cell, before = (
            population.cells[j],
            population.cells[population.order[max(kept - 1, 0)]],
        )
        if path.choices.given:
            fate = path.choices.fates[path.choices.first[m] + i]
        elif kept == 0 and cell.pinned < NEGLIGIBLE_SHARE and i < count:
            fate = DROPPED
        elif kept > 0 and _alike(contacts, path, before, cell, edge, t1):
            fate = JOINED
        noted(path.choices, m, i, fate)
        if fate == JOINED:
            _join(before, cell, edge.X)
        if fate == KEPT:
            population.order[i], population.order[kept] = population.order[kept], j
            kept += 1
    return kept


@observe.register(Cells)
def _observe(
    population: Cells, count: int, X: float, history: History, m: int
) -> float:
    stiffness, newer = 0.0, X
    for i in range(count - 1, -1, -1):
        cell = population.cells[population.order[i]]
        x, width = X - cell.X_mean, newer - cell.X
        history.force[m] += x * cell.stiffness
        history.pinned[m] += cell.pinned
        stiffness += cell.stiffness
        history.square[m] += (x * x + width * width / 12.0) * cell.stiffness2
        newer = cell.X
    return stiffness
