"""Quenched contacts that heat breaks, along a drive in segments: a kernel of `master.programme`.

Births are followed from the edges of steps on, and thresholds from nodes: of a contact born at an edge with the
threshold of a node the integrated hazard z is known. Between two edges and two nodes, in a cell of births and a stratum
of thresholds, births are spread evenly and ln z is a plane, so that what heat has left is a second difference of

    W(y) = int_{-oo}^y du int_{-oo}^u (1 - exp(-e^w)) dw = sum_n (-1)^(n+1) e^(n y)/(n^2 n!)

over the corners (derived). Breaking may thus be as sharp as it likes, and neither cells nor strata need be narrow.
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
    Growth,
    Path,
    advance_all,
    begin,
    due_births,
    empty,
    grown_by,
    mean_exponential,
    noted,
    observe,
    with_room,
)
from eqsim.numerics.compiled import routine
from eqsim.numerics.tables import Array
from eqsim.numerics.vector_math import exp

_GONE, _NONE, _ALL = 1e-15, -36.0, 3.6  # pinned shares that do not count; ln z where as few are broken, and left
_MOST, _UNSEEN = 1e12, 640.0  # z up to which it is followed, and -ln of what it grows by in a step that is nothing
_FIRST, _LAST, _PER_UNIT = -40.0, 6.0, 64  # ln z below which nothing is broken and above which all are; of the table
_FLAT = 0.03  # differences of ln z that are taken for larger: misses 1e-5 of what is about to break
_AT_ONCE = 1e-11  # share of the whole time between births of about the same age
_STRAIGHT = 0.01  # by how much E may be off the straight line of a step; halves of it come in from half of that on
_PARTS = 12  # of the births of a step where thresholds grow


class Strata(NamedTuple):
    """Classes of contacts by threshold at birth, ascending: the edges, arrays (strata,); the shares of births, and
    these times E[k_i/k] and E[(k_i/k)^2], of each and of it and all above, shape (3, strata); the thresholds of nodes,
    shape (nodes,), and which of these are at the edges, arrays (strata,)."""

    left: Array
    right: Array
    share: Array
    above: Array
    nodes: Array
    low: Array
    high: Array


class Fronts(NamedTuple):
    """What is known of contacts: strata, laws, and the table of W."""

    strata: Strata
    growth: Growth
    barrier: Any
    springs: Springs
    delay: Waits
    table: Array


# columns of a cell: its older edge in X and t, the greatest |x|/g so far of contacts born there; births, their mean X;
# what is pinned, E[k_i/k; pinned], E[(k_i/k)^2; pinned]
_X, _T, _Y, _B, _XM, _S, _K1, _K2 = range(8)


class Cells(NamedTuple):
    """All cells, shape (rows, columns above), z at their older edges, shape (rows, nodes), and the rows in use, from
    the oldest on, and then the others; and scratch, shape (4, nodes)."""

    cells: Array
    z: Array
    order: Array
    scratch: Array


@functools.cache
def table_of_w() -> Array:
    """W and its slope at y = _FIRST, ..., _LAST, shape (knots, 2)."""
    y = np.linspace(_FIRST, _LAST, int((_LAST - _FIRST) * _PER_UNIT) + 1)
    nodes, weights = np.polynomial.legendre.leggauss(8)

    def slope(y: Array) -> Array:  # Ein(e^y)
        z = np.exp(y)
        small = z * (1.0 - z / 4.0 * (1.0 - z * 2.0 / 9.0 * (1.0 - z * 3.0 / 16.0)))
        return np.asarray(np.where(y < -6.0, small, y + np.euler_gamma + special.exp1(z)))

    half = 0.5 / _PER_UNIT
    parts = half * (weights * slope((y[:-1, None] + half) + half * nodes)).sum(axis=1)
    return np.ascontiguousarray(np.stack((np.append(0.0, np.cumsum(parts)) + math.exp(_FIRST), slope(y)), axis=1))


@routine(inline=True)
def _w(table: Array, y: float) -> float:
    """W; beyond the table its slope goes on as y + gamma."""
    at = (min(y, _LAST) - _FIRST) * _PER_UNIT
    if at <= 0.0:
        return 0.0
    i = min(int(at), table.shape[0] - 2)
    u, h = at - i, 1.0 / _PER_UNIT
    f0, d0, f1, d1 = table[i, 0], table[i, 1] * h, table[i + 1, 0], table[i + 1, 1] * h
    w = f0 + u * (d0 + u * (3.0 * (f1 - f0) - 2.0 * d0 - d1 + u * (2.0 * (f0 - f1) + d0 + d1)))
    beyond = y - min(y, _LAST)
    return w + beyond * (table[table.shape[0] - 1, 1] + 0.5 * beyond)


@routine
def _broken(table: Array, middle: float, by_threshold: float, by_birth: float) -> float:
    """Mean of 1 - exp(-z) over a cell and a stratum with ln z = `middle` in the middle, and its differences."""
    p, q = max(abs(by_threshold), _FLAT), max(abs(by_birth), _FLAT)
    outer, inner = 0.5 * (p + q), 0.5 * (p - q)
    four = _w(table, middle + outer) - _w(table, middle + inner) - _w(table, middle - inner) + _w(table, middle - outer)
    return min(max(four / (p * q), 0.0), 1.0)


@routine
def _thermal(c: Fronts, z: Array, ages: tuple[float, float], xs: tuple[float, float], dt: float) -> None:
    """Add to z of all nodes what it grows by in a step: ages and stretches of the contacts at its beginning and end."""
    g0, g1, x0, x1 = grown_by(c.growth, ages[0]), grown_by(c.growth, ages[1]), abs(xs[0]), abs(xs[1])
    gm, xm, s, b = 0.5 * (g0 + g1), 0.5 * abs(xs[0] + xs[1]), c.strata, c.barrier.b
    limit = c.barrier.log_w + math.log(dt) + _UNSEEN
    for k in range(z.size):
        if z[k] > _MOST:
            continue
        xi, stiff = s.nodes[k], kappa(c.springs, s.nodes[k])
        a0, a1 = b * stiff, b * stiff
        if c.growth.varies:
            a0, a1 = b * kappa(c.springs, xi * g0), b * kappa(c.springs, xi * g1)
        low, high = height(c.barrier, xi * g0, x0, a0), height(c.barrier, xi * g1, x1, a1)
        if min(low, high) > limit:  # stronger contacts are safer
            break
        middle = height(c.barrier, xi * gm, xm, 0.5 * (a0 + a1))
        p = dt * prefactor(c.barrier, max(xi * gm, xm), xm)
        halves, log_w = min(max(2.0 * abs(middle - 0.5 * (low + high)) / _STRAIGHT - 1.0, 0.0), 1.0), c.barrier.log_w
        if halves < 1.0:
            z[k] += p * (1.0 - halves) * mean_exponential(low - log_w, high - log_w)
        if halves > 0.0:
            both = mean_exponential(low - log_w, middle - log_w) + mean_exponential(middle - log_w, high - log_w)
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
    return 1.0 if high <= left and high < right else max(right - high, 0.0) / (right - left) if right > left else 0.0


@routine
def _weigh(c: Fronts, cell: Array, high_y: float, y: Array, newer: Array, g: float) -> None:
    """What of a cell is pinned, with ln z at its older and newer edge, and the greatest |x|/g at the newer."""
    s, n, k1, k2 = c.strata, 0.0, 0.0, 0.0
    low, high = min(cell[_Y], high_y), max(cell[_Y], high_y)
    for k in range(s.left.size):
        if s.right[k] <= low and s.left[k] < high:
            continue
        i, j = s.low[k], s.high[k]
        least, most = min(y[j], newer[j]), max(y[i], newer[i])  # stronger contacts are safer
        if least > _ALL:
            continue
        left = 1.0
        if most > _NONE:
            middle = 0.25 * (y[i] + y[j] + newer[i] + newer[j])
            by_threshold, by_birth = (
                0.5 * (y[j] + newer[j] - y[i] - newer[i]),
                0.5 * (newer[i] + newer[j] - y[i] - y[j]),
            )
            left = 1.0 - _broken(c.table, middle, by_threshold, by_birth)
        elif s.left[k] >= high:  # none of the stronger either
            n, k1, k2 = n + s.above[0, k], k1 + s.above[1, k], k2 + s.above[2, k]
            break
        left *= _unbroken(s.left[k], s.right[k], low, high)
        n, k1, k2 = n + left * s.share[0, k], k1 + left * s.share[1, k], k2 + left * s.share[2, k]
    if c.growth.varies:
        k1, k2 = k1 * g, k2 * g * g
    cell[_S], cell[_K1], cell[_K2] = cell[_B] * n, cell[_B] * k1, cell[_B] * k2


@routine
def _bear(c: Fronts, cell: Array, z: Array, scratch: Array, dt: float) -> None:
    """The births of a step, as if there were one, at its end: z of those at its beginning, which grows evenly in each
    of a number of parts by age, and what is pinned. Where thresholds grow, a part is twice as long as that before."""
    x, parts = 2.0 * abs(cell[_XM] - cell[_X]), _PARTS if c.growth.values.size else 1
    n, u1, u2 = (
        scratch[0],
        scratch[1],
        scratch[2],
    )  # of those left at nodes E[1], E[u] and E[u^2], u the age over dt
    for k in range(z.size):
        z[k], n[k], u1[k], u2[k] = 0.0, 0.0, 0.0, 0.0
    u = 0.0
    for part in range(parts):
        after = 0.5 ** (parts - 1 - part)
        width = after - u
        _copy(z, scratch[3])
        _thermal(c, z, (u * dt, after * dt), (u * x, after * x), width * dt)
        for k in range(z.size):
            before = scratch[3, k]
            if before > 700.0:
                continue
            y = min(z[k] - before, 700.0)
            # mean survival in the part, and where in it those left are, in the mean and in the mean square
            here, rest = exp(-before) * mean_exponential(0.0, y) * width, 1.0 / (exp(y) - 1.0) if y > 0.02 else 0.0
            v1 = 1.0 / y - rest if y > 0.02 else 0.5 - y / 12.0
            v2 = 2.0 / y**2 - (1.0 + 2.0 / y) * rest if y > 0.02 else 1.0 / 3.0 - y / 12.0
            n[k] += here
            u1[k] += here * (u + width * v1)
            u2[k] += here * (u * u + 2.0 * u * width * v1 + width * width * v2)
        u = after
    s, g = c.strata, grown_by(c.growth, 0.5 * dt) if c.growth.varies else 1.0
    cell[_Y] = x / grown_by(c.growth, dt)
    cell[_S], cell[_K1], cell[_K2] = 0.0, 0.0, 0.0
    for k in range(s.left.size):
        i, j = s.low[k], s.high[k]
        left = 0.5 * _unbroken(s.left[k], s.right[k], 0.0, cell[_Y])
        cell[_S] += left * s.share[0, k] * (n[i] + n[j])
        cell[_K1] += left * s.share[1, k] * 2.0 * g * (u1[i] + u1[j])  # as if all were at the middle, and spread evenly
        cell[_K2] += left * s.share[2, k] * 3.0 * g * g * (u2[i] + u2[j])


@routine
def _alike(c: Fronts, path: Path, one: Array, two: Array, newer: tuple[float, float, float], now: float) -> bool:
    """Whether two cells may be joined: of the same direction and about as dense in X, and together not too wide in X,
    as thresholds have grown, in |x|/g and in time per age; `newer` is the newer edge, X, t and |x|/g."""
    if newer[1] - one[_T] > path.share * (now - newer[1]) + _AT_ONCE or abs(one[_Y] - newer[2]) > path.width:
        return False
    if abs(newer[0] - one[_X]) > path.width * grown_by(c.growth, now - newer[1]):
        return False
    first, second = (two[_X] - one[_X]) * two[_B], (newer[0] - two[_X]) * one[_B]
    return not (first * second < 0.0 or abs(first) > 2.0 * abs(second) or abs(second) > 2.0 * abs(first))


@routine
def _join(one: Array, two: Array, newer: float) -> None:
    """Join a cell to the one before; `newer` is the newer edge in X."""
    both = one[_B] + two[_B]
    one[_XM] = (one[_B] * one[_XM] + two[_B] * two[_XM]) / both if both > 0.0 else 0.5 * (one[_X] + newer)
    for column in (_B, _S, _K1, _K2):
        one[column] += two[column]


@routine
def _rows(p: Cells, rows: int) -> Cells:
    """A copy that has so many rows."""
    cells, z = np.zeros((rows, p.cells.shape[1])), np.zeros((rows, p.z.shape[1]))
    order = np.zeros(rows, np.int64)
    for i in range(rows):
        order[i] = i
    for i in range(p.order.size):
        order[i] = p.order[i]
        for column in range(cells.shape[1]):
            cells[i, column] = p.cells[i, column]
        for k in range(z.shape[1]):
            z[i, k] = p.z[i, k]
    return Cells(cells, z, order, p.scratch)


@with_room.register(Cells)
def _with_room(p: Cells, rows: int) -> Cells:
    return _rows(p, rows)


@empty.register(Fronts)
def _empty(c: Fronts, rows: int) -> Cells:
    nodes = c.strata.nodes.size
    return _rows(Cells(np.zeros((0, 8)), np.zeros((0, nodes)), np.zeros(0, np.int64), np.zeros((4, nodes))), rows)


@routine
def _placed(cell: Array, edge: tuple[float, float], newer: tuple[float, float]) -> None:
    """The births between two edges, (t, X) each."""
    cell[_T], cell[_X], cell[_Y], cell[_B], cell[_XM] = edge[0], edge[1], 0.0, 1.0, 0.5 * (edge[1] + newer[1])


@begin.register(Fronts)
def _begin(c: Fronts, path: Path, p: Cells) -> tuple[int, float]:
    return _begun(c, path, p)


@routine
def _begun(c: Fronts, path: Path, p: Cells) -> tuple[int, float]:
    y, newer, one = p.scratch[0], p.scratch[1], p.cells
    if path.cohorts == 0:
        _placed(one[0], (0.0, 0.0), (0.0, 0.0))
        _logarithms(p.z[0], y)
        _weigh(c, one[0], 0.0, y, y, grown_by(c.growth, 0.0))
        return 1, 0.0
    dt, width, cycle, count = path.width / path.velocity, path.width, c.delay.mean, 0
    for i in range(path.cohorts):
        _placed(one[i], (-(i + 1) * dt, -(i + 1) * width), (-i * dt, -i * width))
        if i == 0:
            _bear(c, one[0], p.z[0], p.scratch, dt)
            _logarithms(p.z[0], newer)
        else:
            _copy(p.z[i - 1], p.z[i])
            _thermal(c, p.z[i], (i * dt, (i + 1) * dt), (i * width, (i + 1) * width), dt)
            one[i, _Y] = max(one[i - 1, _Y], (i + 1) * width / grown_by(c.growth, (i + 1) * dt))
            _logarithms(p.z[i], y)
            _weigh(c, one[i], one[i - 1, _Y], y, newer, grown_by(c.growth, (i + 0.5) * dt))
            _copy(y, newer)
        cycle += one[i, _S] * dt
        count += 1
        if one[i, _S] < _GONE and not path.choices.given:
            break
    for i in range(count):
        _scale(one[i], dt / cycle)
        p.order[i] = count - 1 - i
    return count, 1.0 / cycle


@routine(inline=True)
def _scale(cell: Array, births: float) -> None:
    """Make a cell of one contact one of `births`."""
    for column in (_B, _S, _K1, _K2):
        cell[column] *= births


@advance_all.register(Fronts)
def _advance_all(c: Fronts, path: Path, p: Cells, found: Array, m: int, before: tuple[int, float]) -> int:
    return _advanced(c, path, p, found, m, before)


@routine
def _advanced(c: Fronts, path: Path, p: Cells, found: Array, m: int, before: tuple[int, float]) -> int:
    (count, rate), pinned = before, 0.0
    t0, X0, t1, X1 = path.t[m - 1], path.X[m - 1], path.t[m], path.X[m]
    dt, y, newer, new = t1 - t0, p.scratch[0], p.scratch[1], p.order[count]
    _placed(p.cells[new], (t0, X0), (t1, X1))
    _bear(c, p.cells[new], p.z[new], p.scratch, dt)
    _logarithms(p.z[new], newer)
    high, after = p.cells[new, _Y], t0
    for i in range(count - 1, -1, -1):
        cell, z = p.cells[p.order[i]], p.z[p.order[i]]
        _thermal(c, z, (t0 - cell[_T], t1 - cell[_T]), (X0 - cell[_X], X1 - cell[_X]), dt)
        cell[_Y] = max(cell[_Y], abs(X1 - cell[_X]) / grown_by(c.growth, t1 - cell[_T]))
        _logarithms(z, y)
        _weigh(c, cell, high, y, newer, grown_by(c.growth, t1 - 0.5 * (cell[_T] + after)))
        _copy(y, newer)
        high, after = cell[_Y], cell[_T]
        pinned += cell[_S]
    due, later = due_births(c.delay, path.t, found, m, rate)
    broken = 1.0 - p.cells[new, _S]
    breaks = (found[1, m - 1] - pinned + due * broken) / (dt - later * broken)
    _scale(p.cells[new], due + breaks * later)
    found[3, m] = found[3, m - 1] + breaks * dt
    kept = 0
    for i in range(count + 1):  # drop cells that are gone, and join those that hardly differ
        j, fate, edge = p.order[i], KEPT, (X1, t1, 0.0)
        if i < count:
            after_it = p.cells[p.order[i + 1]]
            edge = (after_it[_X], after_it[_T], after_it[_Y])
        one, older = p.cells[j], p.cells[p.order[max(kept - 1, 0)]]
        if path.choices.given:
            fate = path.choices.fates[path.choices.first[m] + i]
        elif kept == 0 and one[_S] < _GONE and i < count:
            fate = DROPPED
        elif kept > 0 and _alike(c, path, older, one, edge, t1):
            fate = JOINED
        noted(path.choices, m, i, fate)
        if fate == JOINED:
            _join(older, one, edge[0])
        if fate == KEPT:
            p.order[i], p.order[kept] = p.order[kept], j
            kept += 1
    return kept


@observe.register(Cells)
def _observe(p: Cells, count: int, X: float, found: Array, m: int) -> float:
    stiffness, newer = 0.0, X
    for i in range(count - 1, -1, -1):
        cell = p.cells[p.order[i]]
        x, width = X - cell[_XM], newer - cell[_X]
        found[0, m] += x * cell[_K1]
        found[1, m] += cell[_S]
        stiffness += cell[_K1]
        found[2, m] += (x * x + width * width / 12.0) * cell[_K2]
        newer = cell[_X]
    return stiffness
