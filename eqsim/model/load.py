"""Normal load that changes along a programme: contacts in proportion to it (derived).

Contacts that a growing load adds are born unstressed, and those that a falling one takes
away are any, which take their force with them. So the force is linear in populations
born at the start and wherever the load grows, each thinned alike by every fall,

    F(t)/(N k) = sum_j w_j(t) F_j(t),    w_j(t) = a_j prod_(falls since) L_after/L_before,

with N the contacts at the start, F_j the force per contact of those added at t_j and a_j
their number over N. Contacts that a ramp adds, while the load grows at a rate, are as
far along after the same time, whenever they came. So while it lasts those of its
beginning tell the exact mean, an integral over their record. What comes later, and a
simulation, take contacts that are added at instants of the ramp, by the trapezoidal
rule.
"""

import math
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any, NamedTuple

import numpy as np
from scipy import integrate

from eqsim.model.drive import Programme, Segment
from eqsim.model.mixture import summed
from eqsim.numerics.quadrature import largest_nearby
from eqsim.numerics.tables import Array

# The shortest piece of a ramp of exact means over the ramp, at its end, and others over
# the time after them until it ends.
_SHORTEST, _PIECE_PER_AGE = 1e-3, 0.25
# Fewest instants of a ramp at which exact means of its first contacts are known.
_RESPONSE = 4000
# Instants of the record whose largest error each of them has.
_NEARBY = 9


class Added(NamedTuple):
    """Contacts that are born together, at the start or where the load grows; arrays
    (points,)."""

    programme: Programme  # from then on, at a constant load
    since: int  # the first instant of the whole record at which they are there
    weight: Array  # their number over that of all at the start
    coarse: Array  # the same, if they were added at half as many instants
    steps: int = 0  # intervals of their own record until the ramp ends
    parts: int = 1  # of these in one of the whole record
    evenly: bool = False  # until the ramp ends they stand for all it has added


def births_of(
    programme: Programme, points: int, pieces: Sequence[float] | None = None
) -> tuple[Array, list[Added]]:
    """The load along a record, and all contacts along it. Ramps of each segment have so
    many `pieces`; None: for exact means."""
    grid = programme.grid(points)
    sizes = np.bincount(grid.segment)
    sizes[0] -= 1
    ends = np.cumsum(sizes)
    plain = []
    for segment, size in zip(programme.segments, sizes, strict=True):
        even = segment.load_rate and 0.0  # equidistant instants remain so
        plain.append(replace(segment, points=int(size), load=None, load_rate=even))
    left, whole, load = np.ones(grid.t.size), np.ones(grid.t.size), 1.0
    start = replace(programme, segments=tuple(plain))
    born = [Added(start, 0, left, left)]
    for index, segment in enumerate(programme.segments):
        first, last = ends[index] - sizes[index] + 1, ends[index]
        before, load = load, segment.load or load
        left[first:] *= min(load / before, 1.0)
        level, more = float(left[first]), np.full(left.size, max(load - before, 0.0))
        if more.any():
            weight = more / level
            rest = Programme(tuple(plain[index:]))
            born.append(Added(rest, int(first), weight, weight))
        elapsed = grid.t[first - 1 : last + 1] - grid.t[first - 1]
        change = (segment.load_rate or 0.0) * elapsed
        if change[-1] < 0.0:
            left[first : last + 1] *= 1.0 + change[1:] / load
            left[last + 1 :] *= 1.0 + change[-1] / load
        elif change[-1] > 0.0:
            size = int(sizes[index])
            nodes, parts = _pieces(size, pieces[index] if pieces else None)
            steps = size * parts
            grown = np.full(left.size, change[-1])
            grown[: last + 1] = np.append(np.zeros(first), change[1:])
            marks = nodes * (change[-1] / steps)
            every = _trapezoid(marks, grown) / level
            half = np.zeros_like(every)
            half[::2] = _trapezoid(marks[::2], grown) / level
            for rule in () if pieces else (every, half):
                rule[:, first : last + 1] = 0.0
                rule[0, first : last + 1] = change[1:] / level
            fine = replace(plain[index], points=steps)
            for node, weight, coarse in zip(nodes.tolist(), every, half, strict=True):
                tail = (*_cut(fine, node), *plain[index + 1 :])
                since = int(first) + node // parts
                if tail and weight[since:].any():
                    evenly = not pieces and node == 0
                    own = steps - node, parts, evenly
                    born.append(Added(Programme(tail), since, weight, coarse, *own))
        load += float(change[-1])
        whole[first : last + 1] = load - change[-1] + change[1:]
        whole[last + 1 :] = load
    present = np.arange(left.size)
    for index, births in enumerate(born[1:], 1):
        thinned = left * (present >= births.since)
        weight, coarse = births.weight * thinned, births.coarse * thinned
        born[index] = births._replace(weight=weight, coarse=coarse)
    return whole, born


def _pieces(size: int, pieces: float | None) -> tuple[Array, int]:
    """Divide a ramp, each of the `size` intervals of whose record has the same parts:
    edges of its pieces, in parts, and the number of parts in an interval."""
    if pieces:
        even = 2 * math.ceil(0.5 * pieces)
        parts = math.ceil(even / size)
        return np.round(np.linspace(0, size * parts, even + 1)).astype(int), parts
    parts = 2 * math.ceil(_RESPONSE / (2 * size))
    steps, ages = size * parts, [0.0, _SHORTEST]
    while ages[-1] < 1.0 or len(ages) % 2 == 0:
        ages.append(ages[-1] + max(_SHORTEST, _PIECE_PER_AGE * ages[-1]))
    before = np.round(np.array(ages) * (steps / ages[-1])).astype(int)
    return steps - before[::-1], parts


def _trapezoid(nodes: Array, x: Array) -> Array:
    """Weights of values at nodes, in their integral from the first node to x, where
    they are 0, shape (nodes, points)."""
    steps = np.diff(nodes)
    behind = np.clip(x - nodes[:, None], 0.0, np.append(steps, 0.0)[:, None])
    return np.asarray(0.5 * (np.append(0.0, steps)[:, None] + behind))


def _cut(segment: Segment, node: int) -> list[Segment]:
    """Find the rest of a segment after one of its equidistant instants, if anything."""
    points = (segment.points or 0) - node
    if points <= 0:
        return []
    share = points / (points + node)
    if segment.distance:
        return [replace(segment, points=points, distance=segment.distance * share)]
    return [replace(segment, points=points, time=segment.duration * share)]


def under_load(load: Array, born: Sequence[Added], results: Sequence[Any]) -> Any:
    """Sum results over births under a `load`. Errors include what changes if contacts
    are added at half as many instants: the largest change nearby of exact means, in
    quadrature with standard errors what noise does not explain. Contacts that a fall of
    the load takes away are simulated, with less weight; without them the forces of
    replicas scatter more, by the root of what they were over what is left of them."""
    whole = [_padded(*pair) for pair in zip(born, results, strict=True)]
    total = summed([_Share(x.weight, x.weight / load) for x in born], whole)
    change = [x.weight - x.coarse for x in born]
    missed = summed([_Share(x, x / load) for x in change], whole)
    # those that have come since the last birth have not moved
    newest = 1.0 - sum(x.weight for x in born) / load
    added = sum(change) / load
    changes = {"pinned": total.pinned + newest}
    for name, value in (("force", missed.force), ("pinned", missed.pinned - added)):
        if hasattr(total, name + "_error"):
            kind = name + "_error"
            error = getattr(total, kind) + largest_nearby(value, _NEARBY)
        else:
            kind = name + "_stderr"
            square = np.maximum(value**2 - getattr(missed, kind) ** 2, 0.0)
            error = np.hypot(getattr(total, kind), np.sqrt(square))
        changes[kind] = error
    if hasattr(total, "force_replica_std"):
        roots = [np.sqrt(x.weight * x.weight.max()) for x in born]
        fewer = [_Share(root, root / load) for root in roots]
        changes["force_replica_std"] = summed(fewer, whole).force_replica_std
    return replace(total, **changes)


class _Share(NamedTuple):
    """Factors by which `mixture.summed` multiplies results, arrays (points,)."""

    weight: Array
    share: Array


def _padded(births: Added, result: Any) -> Any:
    """A result of contacts born along a record at its instants, with zeros before they
    are there."""
    points, padded = births.weight.size - births.since, dict[str, Array]()
    steps, errors = births.steps, dict[str, Array]()
    for field in fields(result):
        x = getattr(result, field.name)
        if not isinstance(x, np.ndarray):
            continue
        along = x[..., : steps + 1]
        if births.evenly:
            along, errors[field.name + "_error"] = _mean_so_far(along)
        along = along[..., steps % births.parts :: births.parts]
        x = np.concatenate((along, x[..., steps + 1 :]), axis=-1)
        before = np.zeros((*x.shape[:-1], births.since), x.dtype)
        there = x[..., x.shape[-1] - points :]
        padded[field.name] = np.concatenate((before, there), axis=-1)
    for name in errors.keys() & padded.keys():
        there = errors[name][births.parts :: births.parts]
        padded[name][births.since : births.since + there.size] += there
    return replace(result, **padded)


def _mean_so_far(x: Array) -> tuple[Array, Array]:
    """Mean of x from the first of equidistant instants to each, and the largest error
    nearby: what changes with every other instant alone."""
    parts = np.arange(1.0, x.size)
    fine = np.append(x[0], integrate.cumulative_trapezoid(x) / parts)
    coarse = np.append(x[0], 2.0 * integrate.cumulative_trapezoid(x[::2]) / parts[1::2])
    error = np.repeat(largest_nearby(coarse - fine[::2], _NEARBY), 2)[: x.size]
    return fine, error
