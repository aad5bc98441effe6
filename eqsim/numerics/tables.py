"""A smooth positive function of a positive argument as one table, to about 1e-10
relative over hundreds of decades.

Quantile functions and inverse hazards have no closed form that a kernel could evaluate
quickly. Each is tabulated as a cubic Hermite polynomial in each of 64 equal cells of
every octave [2^j, 2^(j+1)): the cell is read off the bits of the argument, so a look-up
takes no logarithm and no search, and the relative cell width is the same at every
scale. For a power law y = s^p the relative error is below |p(p-1)(p-2)(p-3)| / (384 *
64^4).

Below the first octave the function is continued as a line through the origin, above the
last one as a constant; whoever builds a table chooses its octaves so that this is exact
to rounding, or never reached.

A function that jumps, or whose slope does, has cells that end there (`ranked_table`);
these are searched.
"""

from typing import Any

import numpy as np

from eqsim.numerics.compiled import routine

Array = np.ndarray[Any, np.dtype[Any]]

NO_TABLE: Array = np.empty((0, 4))
CELLS = 64
# bits of the mantissa below those that number the 64 cells of an octave
_CELL_SHIFT = 52 - 6
_FRACTION = (1 << _CELL_SHIFT) - 1
# bits of 2^52, in whose mantissa an integer is added
_UNITS = 0x4330000000000000
_BIAS = 1023 * CELLS  # of the IEEE exponent, in cells


def octave_edges(first: int, last: int) -> Array:
    """The arguments at which a table of octaves first .. last-1 (powers of 2) needs the
    function, ascending."""
    octaves = 2.0 ** np.arange(first, last)[:, None]
    return np.append(octaves * (1.0 + np.arange(CELLS) / CELLS), 2.0**last)


def octave_table(first: int, y: Array, slope: Array) -> Array:
    """Coefficients (cells + 2, 4) from values and derivatives at `octave_edges(first,
    last)`. The slopes are limited as Fritsch and Carlson prescribe, so that data that
    rise give a function that rises. Two rows come before those of the cells: the cell
    offset of the first octave, 1 over its lower edge and the number of cells, for
    `look_up`; and the line through the origin, of the argument over that edge."""
    cells = len(y) - 1
    edges = octave_edges(first, first + cells // CELLS)
    table = np.zeros((cells + 2, 4))
    table[0, :3] = first * CELLS + _BIAS, 1.0 / edges[0], cells
    table[1, 1] = y[0]
    table[2:] = ranked_table(edges, y, slope[:-1], slope[1:])
    return table


def ranked_table(edges: Array, y: Array, begins: Array, ends: Array) -> Array:
    """Coefficients (cells, 4) from values at edges that do not descend, and from the
    derivatives where each cell begins and where it ends, limited as in `octave_table`.
    Where the function jumps an edge comes twice."""
    width, rise = np.diff(edges), np.diff(y)
    limit = 3.0 * rise
    left = np.clip(begins * width, 0.0, limit)
    right = np.clip(ends * width, 0.0, limit)
    columns = y[:-1], left, 3.0 * rise - 2.0 * left - right, left + right - 2.0 * rise
    return np.stack(columns, axis=1)


@routine(inline=True)
def search(values: Array, x: float, right: bool) -> int:
    """Count ascending values below x, or at most x (`right`); `np.searchsorted` takes
    long to compile."""
    low, high = 0, values.size
    while low < high:
        middle = (low + high) // 2
        if values[middle] < x or (right and values[middle] == x):
            low = middle + 1
        else:
            high = middle
    return low


@routine(inline=True)
def hermite(t: float, y: float, rise: float, left: float, right: float) -> float:
    """Value at the share t of a cell in which a cubic polynomial begins with y and rises
    by `rise`, with the slopes `left` and `right` per cell at its ends."""
    bend = 3.0 * rise - 2.0 * left - right + t * (left + right - 2.0 * rise)
    return y + t * (left + t * bend)


@routine(inline=True)
def _cell_of(first: float, per_edge: float, cells: float, s: float) -> tuple[Any, Any]:
    """Row of the polynomial that holds at s > 0, and its argument; the first three
    arguments are those of row 0."""
    bits: Any = np.float64(s).view(np.int64)
    cell = (bits >> _CELL_SHIFT) - np.int64(first)
    fraction = np.int64(bits & _FRACTION | _UNITS).view(np.float64) - 2.0**52
    t: Any = fraction * (1.0 / (_FRACTION + 1))
    if cell < 0:
        t = s * per_edge
    if cell >= np.int64(cells):
        t = 1.0
    return min(max(cell, -1), np.int64(cells) - 1) + 2, t


@routine(inline=True)
def _polynomial(table: Array, row: int, t: float) -> float:
    """The polynomial of a row at t."""
    return table[row, 0] + t * (table[row, 1] + t * (table[row, 2] + t * table[row, 3]))


@routine(inline=True)
def look_up(table: Array, s: float) -> float:
    """The tabulated function at s > 0."""
    row, t = _cell_of(table[0, 0], table[0, 1], table[0, 2], s)
    return _polynomial(table, row, t)


@routine
def look_up_ranked(edges: Array, table: Array, s: float) -> float:
    """The function of a `ranked_table` at s; a constant beyond its edges."""
    row = min(max(search(edges, s, True) - 1, 0), edges.size - 2)
    t = (s - edges[row]) / (edges[row + 1] - edges[row])
    return _polynomial(table, row, min(max(t, 0.0), 1.0))


@routine(inline=True)
def look_up_all(table: Array, s: Array, row: Array, count: int) -> None:
    """Replace the first `count` of `s`, shape (n,), by the tabulated function there;
    `row` is scratch. Look-ups in a loop of their own leave the other one free to
    vectorise."""
    first, per_edge, cells = table[0, 0], table[0, 1], table[0, 2]
    for i in range(count):
        row[i], s[i] = _cell_of(first, per_edge, cells, s[i])
    for i in range(count):
        s[i] = _polynomial(table, row[i], s[i])
