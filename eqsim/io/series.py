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
_MOST_LEVELS = 32
# Blocks that are made of a record at most, if its scatter allows.
_MOST_BLOCKS = 2000
# Growth of what a line has none of, from a stretch to one twice as long, from which on it
# is no scatter: that of correlated errors grows by sqrt(2) at most, a curve fourfold.
_CURVED = 2.0
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


class _Stretches(NamedTuple):
    """Level m of each row, the largest for which its 2^m rows are straight; the standard
    error of the mean of 2^(m - 2) rows for m = 2, 3, ...; and the variance of rows that
    their scatter does not show."""

    level: Array
    error: Array
    unseen: float


class RowErrors(NamedTuple):
    """Standard errors of rows, zeros if they are not known, and that part of the error
    of a block's mean which does not depend on the number of its rows."""

    rows: Array
    noise: float = 0.0


def blocks_of(
    y: Array, segment: Array, errors: RowErrors, given: Array | None = None
) -> Blocks:
    """Blocks of rows `y` in segments (their numbers, in order): `given` by their
    numbers, or as long as nothing is smeared, and as few as scatter allows."""
    ends = [0, *(np.flatnonzero(np.diff(segment)) + 1), y.size]
    parts = [slice(a, b) for a, b in pairwise(ends)]
    before = y.size + 1
    for rougher in range(_MOST_LEVELS):
        known = [
            _straight(y[part], errors._replace(rows=errors.rows[part]), rougher)
            for part in parts
        ]
        wide = [np.left_shift(1, np.maximum(one.level - 2, 0)) for one in known]
        starts = np.concatenate([np.arange(w.size) % w == 0 for w in wide])
        if given is not None:
            starts[1:] = (np.diff(given) != 0) | (np.diff(segment) != 0)
        first = np.flatnonzero(starts)
        if not _MOST_BLOCKS < first.size < before:
            break
        before = first.size
    count = np.diff(first, append=y.size)
    straight = np.minimum.reduceat(np.concatenate(wide), first) >= count
    level, error = np.log2(count).astype(int), np.empty(first.size)
    inside = np.searchsorted(ends, first, "right") - 1
    for index, one in enumerate(known):
        here = inside == index
        usable = np.minimum(level[here], one.error.size - 1)
        scatter = one.error[usable] * np.sqrt(2.0**usable / count[here])
        error[here] = np.sqrt(scatter**2 + one.unseen)
    return Blocks(first, count, error, straight)


def _straight(y: Array, known: RowErrors, rougher: int) -> _Stretches:
    """The straight stretches of rows; scatter is taken from stretches that are longer
    than its correlation, or from longer ones if it must be `rougher`."""
    level, straight = np.zeros(y.size, int), np.ones(y.size // 2, bool)
    longest = max(int(math.log2(max(y.size // _LEAST_STRETCHES, 4))), 2)
    contrasts = [_contrasts(y, m) for m in range(2, longest + 1)]
    scatter = [
        float(np.median(np.abs(c))) / _MEDIAN if c.size else 0.0 for c in contrasts
    ]
    grows = [b > _CURVED * a for a, b in pairwise(scatter)]
    noise = scatter[: grows.index(True) + 1 if True in grows else None]
    trusted = min(int(np.argmax(noise)) + rougher, len(scatter) - 1)
    row = _row_scatter(y, trusted + 2) if trusted else scatter[0]
    unseen = max(float(np.median(known.rows)) ** 2 - row**2, 0.0)
    errors = list[float]()
    for index, both in enumerate(contrasts):
        m, count = index + 2, both.shape[1]
        usual = scatter[index]
        if index > trusted:
            usual = scatter[trusted] * 2.0 ** (-0.5 * (index - trusted))
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
        errors.append(max(usual, seen))
    errors[:trusted] = [row] * len(errors[:trusted])
    return _Stretches(level, np.maximum.accumulate(errors[::-1])[::-1], unseen)


def _row_scatter(y: Array, m: int) -> float:
    """The usual scatter of rows about a line through 2^m of them."""
    rows = y[: y.size >> m << m].reshape(-1, 1 << m)
    x = np.arange(1 << m) - 0.5 * ((1 << m) - 1)
    off = rows - rows.mean(1)[:, None] - np.outer(rows @ x, x) / (x @ x)
    return float(np.median(np.sqrt(np.mean(off**2, axis=1)))) if len(rows) else 0.0


def _contrasts(y: Array, m: int) -> Array:
    """What a line has none of, shape (2, stretches of 2^m rows)."""
    count = y.size >> m
    quarters = y[: count << m].reshape(count, 4, -1) if count else np.empty((0, 4, 1))
    shapes = np.array(
        [[0.5, -0.5, -0.5, 0.5], np.array([-1, 3, -3, 1]) / math.sqrt(20)]
    )
    return np.asarray(shapes @ quarters.mean(axis=2).T)


class Line(NamedTuple):
    """A straight line: its slope, the standard error of that, and its value at 0."""

    slope: float
    error: float
    level: float


def broken_line(t: Array, y: Array) -> tuple[Array, list[Line]]:
    """The lines that noisy rows follow one after the other, and the instants at which
    they begin and end. A slope within 3 standard errors of 0 is 0."""
    blocks = blocks_of(y, np.zeros(y.size, int), RowErrors(np.zeros(y.size)))
    x, value = means(t, blocks), means(y, blocks)
    error = np.maximum(blocks.error, _ROUNDING * np.ptp(y))

    def line(a: int, b: int) -> tuple[Line, float]:
        """The best line through some block means, and the largest residual."""
        weight = error[a:b] ** -2.0
        mean_x, mean_y = np.average(
            np.array([x, value])[:, a:b], axis=1, weights=weight
        )
        off = x[a:b] - mean_x
        square = float(weight @ off**2)
        slope = float(weight @ (off * value[a:b])) / square if square else 0.0
        found = Line(slope, square**-0.5 if square else 0.0, mean_y - slope * mean_x)
        residual = (value[a:b] - found.level - slope * x[a:b]) / error[a:b]
        return found, float(np.max(np.abs(residual)))

    pending, ends = [(0, x.size)], {0, x.size}
    while pending:
        a, b = pending.pop()
        if b - a > 2 and line(a, b)[1] > _STRAIGHT:
            chord = np.interp(x[a:b], x[[a, b - 1]], value[[a, b - 1]])
            middle = a + 1 + int(np.argmax(np.abs(value[a:b] - chord)[1:-1]))
            ends.add(middle)
            pending += [(a, middle), (middle, b)]
    cuts = [0]
    for end in sorted(ends)[1:-1]:  # some are not needed
        later = min(one for one in ends if one > end)
        if line(cuts[-1], later)[1] > _STRAIGHT:
            cuts.append(end)
    cuts.append(x.size)
    lines = [line(a, b)[0] for a, b in pairwise(cuts)]
    lines = [
        one._replace(slope=one.slope * (abs(one.slope) > 3 * one.error))
        for one in lines
    ]
    knots = [t[0]]
    for end, (one, other) in zip(cuts[1:-1], pairwise(lines), strict=True):
        steeper = other.slope - one.slope
        cross = (one.level - other.level) / steeper if steeper else math.inf
        low, high = x[max(end - 2, 0)], x[min(end + 1, x.size - 1)]
        knots.append(cross if low < cross < high else 0.5 * (x[end - 1] + x[end]))
    return np.array([*knots, t[-1]]), lines


def means(x: Array, blocks: Blocks) -> Array:
    """Means over blocks."""
    return np.asarray(np.add.reduceat(x, blocks.first) / blocks.rows)
