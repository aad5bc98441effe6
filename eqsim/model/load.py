"""Normal load that changes along a programme: contacts in proportion to it (derived).

Contacts that a growing load adds are born unstressed, and those that a falling one takes
away are any, which take their force with them. So the force is linear in populations
born at the start and wherever the load grows, each thinned alike by every fall,

    F(t)/(N k) = sum_j w_j(t) F_j(t),    w_j(t) = a_j prod_(falls since) L_after/L_before,

with N the contacts at the start, F_j the force per contact of those added at t_j and a_j
their number over N. While a load grows at a rate, contacts are added at instants of the
record, by the trapezoidal rule.
"""

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any, NamedTuple

import numpy as np

from eqsim.model.drive import Grid, Programme, Segment
from eqsim.model.mixture import summed
from eqsim.numerics.tables import Array

_MOST_BIRTHS = 16  # instants at which a load that grows at a rate adds contacts


class Births(NamedTuple):
    """Contacts that are born together, at the start or where the load grows; arrays
    (points,)."""

    programme: Programme  # from then on, at a constant load
    since: int  # the first instant of the whole record at which they are there
    weight: Array  # their number over that of all at the start
    coarse: Array  # the same, if they were added at half as many instants


def births_of(programme: Programme, points: int) -> tuple[Grid, list[Births]]:
    """The instants of a record, and all contacts along it."""
    grid = programme.grid(points)
    sizes = np.bincount(grid.segment)
    sizes[0] -= 1
    ends = np.cumsum(sizes)
    plain = []
    for segment, size in zip(programme.segments, sizes, strict=True):
        even = segment.load_rate and 0.0  # equidistant instants remain so
        plain.append(replace(segment, points=int(size), load=None, load_rate=even))
    left, load = np.ones(grid.t.size), 1.0
    # segment, instant in it, numbers along the record over what is left of earlier
    # contacts then
    added: list[tuple[int, int, Array, Array]] = []
    for index, segment in enumerate(programme.segments):
        first, last = ends[index] - sizes[index] + 1, ends[index]
        before, load = load, segment.load or load
        left[first:] *= min(load / before, 1.0)
        level, more = float(left[first]), np.full(left.size, max(load - before, 0.0))
        added.append((index, 0, more / level, more / level))
        elapsed = grid.t[first - 1 : last + 1] - grid.t[first - 1]
        change = (segment.load_rate or 0.0) * elapsed
        if change[-1] < 0.0:
            left[first : last + 1] *= 1.0 + change[1:] / load
            left[last + 1 :] *= 1.0 + change[-1] / load
        elif change[-1] > 0.0:
            pieces = 2 * max(1, min(_MOST_BIRTHS, int(sizes[index])) // 2)
            parts = np.linspace(0, sizes[index], pieces + 1)
            nodes = np.unique(np.round(parts).astype(int))
            grown = np.full(left.size, change[-1])
            grown[: last + 1] = np.append(np.zeros(first), change[1:])
            every = _trapezoid(change[nodes], grown) / level
            half = np.zeros_like(every)
            half[::2] = _trapezoid(change[nodes[::2]], grown) / level
            added += zip([index] * nodes.size, nodes.tolist(), every, half, strict=True)
        load += float(change[-1])
    start = replace(programme, segments=tuple(plain))
    found = [Births(start, 0, left, left)]
    for index, node, fine, coarse in added:
        rest = (*_cut(plain[index], node), *plain[index + 1 :])
        if rest and fine.any():
            since = int(ends[index] - sizes[index]) + node + 1
            weights = (
                left * x * (np.arange(left.size) >= since) for x in (fine, coarse)
            )
            found.append(Births(Programme(rest), since, *weights))
    return grid, found


def _trapezoid(nodes: Array, x: Array) -> Array:
    """Weights of values at nodes, of which the last ones are 0 at x, in their integral
    from the first node to x, arrays (points,): shape (nodes, points)."""
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


def under_load(births: Sequence[Births], results: Sequence[Any]) -> Any:
    """Sum results over births. The error of the force has a third of what changes if
    contacts are added at half as many instants, in quadrature with standard errors.
    Contacts that a fall of the load takes away are simulated, with less weight; without
    them the forces of replicas scatter more, by the root of what they were over what is
    left of them."""
    whole = [_padded(*pair) for pair in zip(births, results, strict=True)]
    kinds, coarse = (
        [_Share(weight, weight / sum(weights)) for weight in weights]
        for weights in ([b.weight for b in births], [b.coarse for b in births])
    )
    found = summed(kinds, whole)
    missed = np.abs(found.force - summed(coarse, whole).force) / 3.0
    if hasattr(found, "force_error"):
        return replace(found, force_error=found.force_error + missed)
    fewer = [_Share(np.sqrt(x.weight * x.weight.max()), x.share) for x in kinds]
    return replace(
        found,
        force_stderr=np.hypot(found.force_stderr, missed),
        force_replica_std=summed(fewer, whole).force_replica_std,
    )


class _Share(NamedTuple):
    """Factors by which `mixture.summed` multiplies results, arrays (points,)."""

    weight: Array
    share: Array


def _padded(births: Births, result: Any) -> Any:
    """A result of contacts born along a record, with zeros before they are there."""
    points, padded = births.weight.size - births.since, {}
    for field in fields(result):
        x = getattr(result, field.name)
        if isinstance(x, np.ndarray):
            before = np.zeros((*x.shape[:-1], births.since))
            there = x[..., x.shape[-1] - points :]
            padded[field.name] = np.concatenate((before, there), axis=-1)
    return replace(result, **padded)
