"""Series in time from CSV files: clocks that start anywhere, gaps and duplicates, and
block means of more rows than are needed.

Over a block that is straight (a line in time) a mean loses nothing. Whether 2^m rows are
straight is judged by means q of their quarters: (q_1 - q_2 - q_3 + q_4)/2 and
(-q_1 + 3 q_2 - 3 q_3 + q_4)/sqrt(20) vanish for a line, and both have the standard error
of a quarter. Rows whose stretches of 4, 8, ... 2^m are all straight within 5 of these
form blocks of a quarter of that, so that a curvature c of the whole moves the mean of a
block by c/24, less than 5/24 of its standard error (derived).
"""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from eqsim.errors import InputError, shown
from eqsim.io import csv
from eqsim.numerics.tables import Array

# Standard errors of a quarter within which a stretch is straight: of a million rows one
# is not by chance.
_STRAIGHT = 5.0
# A segment has so many stretches at least, of four blocks each.
_LEAST_STRETCHES = 16
# Growth of what a line has none of, from a stretch to one twice as long, from which on it
# is no scatter: that of correlated errors grows by sqrt(2) at most, a curve fourfold.
_CURVED = 2.0
# Rows that lines are told from, at least: three stretches of 4, of which a corner is in
# one, so that the median of their scatter is that of straight ones.
LEAST_ROWS = 12
# Error of a row at least, over the range of all.
_ROUNDING = 1e-9
# Normal quantile of 3/4: median over standard deviation of absolute values.
_MEDIAN = 0.6745


class Series(NamedTuple):
    """Instants, columns of numbers, shape (instants, columns), the lines that they stand
    in, and what was done to their rows, in words."""

    t: Array
    values: Array
    lines: Array
    said: list[str]


def read_series(
    sheet: csv.Sheet,
    names: Sequence[str],
    start: str | float | None = None,
    error: str | None = None,
    *,
    strict: bool = False,
    progress: Callable[[int, float], None] = lambda done, total: None,
) -> Series:
    """The columns of a file, of which the first is the time: from `start` on, the time
    that becomes 0, or "first row". Rows of the same time are merged, and standard
    errors, in the column `error`, become those of the mean; if `strict`, equal times and
    gaps are refused. Raises InputError with the line."""
    if isinstance(start, str) and start != "first row":
        cure = f'start = {shown(start)}: must be a time or "first row"'
        raise InputError(f"{sheet.field}: {cure}")
    every = [*names, *([] if error is None else [error])]
    found = csv.numbers(sheet, every, strict=strict, progress=progress)
    if not found.lines.size:
        empty = f"has {found.gaps} rows, all with gaps" if found.gaps else "is empty"
        raise InputError(f"{sheet.field}: {empty}")
    t, said = found.values[:, 0], [sheet.said]
    used = (sheet.columns[sheet.index(name)] for name in every)
    said.append(f"columns {', '.join(used)}")
    if (back := np.flatnonzero(np.diff(t) < (1e-300 if strict else 0.0))).size:
        here, before = t[back[0] + 1], t[back[0]]
        where = f"{sheet.field}, line {found.lines[back[0] + 1]}"
        given = f"{where}: {names[0]} = {here:.12g}"
        raise InputError(f"{given}: must be later than {before:.12g} before it")
    if found.gaps:
        said.append(f"{found.gaps} rows with gaps left out")
    rows = found.values
    if error is not None:
        if (wrong := np.flatnonzero(rows[:, -1] < 0)).size:
            given = f"{error} = {rows[wrong[0], -1]:g}: must be >= 0"
            raise InputError(f"{sheet.field}, line {found.lines[wrong[0]]}: {given}")
        rows[:, -1] **= 2
    first = np.flatnonzero(np.diff(t, prepend=-math.inf) > 0)
    merged = np.diff(first, append=t.size)
    rows, lines = np.add.reduceat(rows, first) / merged[:, None], found.lines[first]
    if error is not None:
        rows[:, -1] = np.sqrt(rows[:, -1] / merged)
    if first.size < t.size:
        said.append(f"{t.size - first.size} rows merged with others of the same time")
    if start is not None:
        begin = found.first if isinstance(start, str) else start
        rows[:, 0] -= begin
        said.append(f"{names[0]} = {begin:.12g} is 0")
        kept = rows[:, 0] >= 0.0
        if not kept.all():
            said.append(f"{np.sum(~kept)} rows before the start left out")
        rows, lines = rows[kept], lines[kept]
    if not len(rows) or rows[0, 0] < 0:
        cure = 'give the time that is 0 as start, or start = "first row"'
        raise InputError(f"{sheet.field}: begins before time 0; {cure}")
    return Series(rows[:, 0], rows[:, 1:], lines, said)


class Blocks(NamedTuple):
    """Blocks of neighbouring rows: the first row of each, how many there are, the
    standard error of their mean by scatter, and whether its rows are straight."""

    first: Array
    rows: Array
    error: Array
    straight: Array


class RowErrors(NamedTuple):
    """Standard errors of rows, zeros if they are not known, and that part of the error
    of a block's mean which does not depend on the number of its rows."""

    rows: Array
    noise: float = 0.0


def blocks_of(
    y: Array, segment: Array, errors: RowErrors, given: Array | None = None
) -> Blocks:
    """Blocks of rows `y` in segments (their numbers, in order): `given` by their
    numbers, or as long as nothing is smeared."""
    ends = [0, *(np.flatnonzero(np.diff(segment)) + 1), y.size]
    parts = []
    for a, b in pairwise(ends):
        known = errors._replace(rows=errors.rows[a:b])
        numbers = None if given is None else given[a:b]
        part = _blocks_of_segment(y[a:b], known, numbers)
        parts.append(part._replace(first=part.first + a))
    return Blocks(*map(np.concatenate, zip(*parts, strict=True)))


def _blocks_of_segment(y: Array, known: RowErrors, given: Array | None) -> Blocks:
    """The blocks of a segment. Scatter is taken from stretches that are longer than its
    correlation, where it is largest, and falls with the root of the rows from there."""
    level, straight, errors = np.zeros(y.size, int), np.ones(y.size // 2, bool), []
    least = _LEAST_STRETCHES if given is None else 1
    longest = int(math.log2(max(y.size // least, 4)))
    contrasts = [_contrasts(y, m) for m in range(2, longest + 1)]
    scatter = [
        float(np.median(np.abs(c))) / _MEDIAN if c.size else 0.0 for c in contrasts
    ]
    grows = [b > _CURVED * a for a, b in pairwise(scatter)]
    top = int(np.argmax(scatter[: grows.index(True) + 1 if True in grows else None]))
    row = _row_scatter(y, top + 2) if top else scatter[0]
    unseen = max(float(np.median(known.rows)) ** 2 - row**2, 0.0)
    for index, both in enumerate(contrasts):
        m, count = index + 2, both.shape[1]
        fall = 2.0 ** (-0.5 * max(index - top, 0))
        usual = scatter[min(index, top)] * fall
        if not usual and count:  # most rows are equal
            usual = float(np.sqrt(np.mean(both**2)))
        most = _STRAIGHT * math.sqrt(usual**2 + unseen + known.noise**2)
        straight = straight[0 : 2 * count : 2] & straight[1 : 2 * count : 2]
        straight &= np.all(np.abs(both) <= most, axis=0)
        shifted = _contrasts(y[1 << m - 1 :], m)  # a jump may be near an end
        between = np.all(np.abs(shifted) <= most, axis=0)
        straight[: between.size] &= between
        straight[1 : between.size + 1] &= between[: count - 1]
        level[: count << m][np.repeat(straight, 1 << m)] = m
        accepted = both[:, straight & np.all(np.abs(both) <= _STRAIGHT * usual, axis=0)]
        seen = float(np.sqrt(np.mean(accepted**2))) if accepted.size >= 16 else 0.0
        errors.append(row if index < top else max(usual, seen))
    wide = np.left_shift(1, np.maximum(level - 2, 0))
    starts = np.arange(y.size) % wide == 0
    if given is not None:
        starts = np.diff(given, prepend=given[0] - 1) != 0
    first = np.flatnonzero(starts)
    rows = np.diff(first, append=y.size)
    usable = np.minimum(np.log2(rows).astype(int), len(errors) - 1)
    error = np.maximum.accumulate(errors[::-1])[::-1][usable]
    error = np.sqrt(error**2 * 2.0**usable / rows + unseen)
    return Blocks(first, rows, error, np.minimum.reduceat(wide, first) >= rows)


def _row_scatter(y: Array, m: int) -> float:
    """The usual scatter of rows about a line through 2^m of them."""
    rows = y[: y.size >> m << m].reshape(-1, 1 << m)
    x = np.arange(1 << m) - 0.5 * ((1 << m) - 1)
    off = rows - rows.mean(1)[:, None] - np.outer(rows @ x, x) / (x @ x)
    return float(np.median(np.sqrt(np.mean(off**2, axis=1)))) if len(rows) else 0.0


def _contrasts(y: Array, m: int) -> Array:
    """Contrasts, of which a line has none, shape (2, stretches of 2^m rows)."""
    count = y.size >> m
    quarters = y[: count << m].reshape(count, 4, -1) if count else np.empty((0, 4, 1))
    shapes = np.array(
        [[0.5, -0.5, -0.5, 0.5], np.array([-1, 3, -3, 1]) / math.sqrt(20)]
    )
    return np.asarray(shapes @ quarters.mean(axis=2).T)


class Lines(NamedTuple):
    """Straight lines one after the other: where they begin and end, and their slopes."""

    knots: Array
    slopes: Array


def broken_line(t: Array, y: Array) -> Lines:
    """The lines that noisy rows follow. A slope within 3 standard errors of 0 is 0."""
    blocks = blocks_of(y, np.zeros(y.size, int), RowErrors(np.zeros(y.size)))
    x, value = means(t, blocks), means(y, blocks)
    weight = 1.0 / np.maximum(blocks.error, _ROUNDING * (np.ptp(y) or 1.0))

    def line(a: int, b: int) -> tuple[Array, Array]:
        """Coefficients of the best line through block means, and their covariance."""
        weights = weight[a:b]
        return np.polyfit(x[a:b], value[a:b], 1, w=weights, cov="unscaled")

    cuts = [0]
    for end in range(3, x.size):
        here = slice(cuts[-1], end)
        best, _ = line(cuts[-1], end)
        off = (value[here] - np.polyval(best, x[here])) * weight[here]
        if end - cuts[-1] > 2 and np.abs(off).max() > _STRAIGHT:
            cuts.append(end - 1)
    lines = [line(a, b) for a, b in pairwise([*cuts, x.size])]
    slopes = [best[0] * (abs(best[0]) > 3.0 * cov[0, 0] ** 0.5) for best, cov in lines]
    knots = [t[0]]
    for cut, ((one, _), (other, _)) in zip(cuts[1:], pairwise(lines), strict=True):
        low, high = knots[-1], x[min(cut + 1, x.size - 1)]
        cross = (one[1] - other[1]) / (other[0] - one[0])
        knots.append(cross if low < cross < high else 0.5 * (x[cut - 1] + x[cut]))
    return Lines(np.array([*knots, t[-1]]), np.array(slopes))


def means(x: Array, blocks: Blocks) -> Array:
    """Means over blocks."""
    return np.asarray(np.add.reduceat(x, blocks.first) / blocks.rows)
