"""Readings of records: slips, forces and peaks of segments, velocity steps."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from eqsim.engine.records import SegmentRecord, Slip, VelocityStep
from eqsim.estimate import Estimate, known, mean_of
from eqsim.model.drive import Grid, Programme
from eqsim.numerics.tables import Array


def slips_of(
    t: Array, X: Array, spring: Array, least: float, fastest: float
) -> list[Slip]:
    """The slips in a record, arrays (points,), forwards and backwards: the force of the
    spring falls by `least` or more before it rises by as much, or the mirror image of
    that, and the slider goes more than twice as fast as the stage at its `fastest`
    meanwhile. One that the record begins or ends in is marked."""
    slips = _falls(t, X, spring, least, fastest)
    for slip in _falls(t, -X, -spring, least, fastest):
        slips.append(replace(slip, X=-slip.X, distance=-slip.distance))
    return sorted(slips, key=lambda slip: slip.t)


def _falls(
    t: Array, X: Array, spring: Array, least: float, fastest: float
) -> list[Slip]:
    """`slips_of` forwards."""
    found: list[Slip] = []
    # where the force is largest, and, once it has fallen, least
    high, low = 0, -1
    for i in range(t.size + 1):
        done = i == t.size
        if low < 0:
            if not done and spring[i] > spring[high]:
                high = i
            elif not done and spring[high] - spring[i] > least:
                low = i
        elif not done and spring[i] < spring[low]:
            low = i
        elif done or spring[i] - spring[low] > least:
            time, distance = float(t[low] - t[high]), float(X[low] - X[high])
            if distance > 2.0 * fastest * time:
                half = 0.5 * (spring[high] + spring[low])
                j = high + 1 + int(np.argmax(spring[high + 1 : low + 1] <= half))
                share = (spring[j - 1] - half) / (spring[j - 1] - spring[j])
                middle, x = (y[j - 1] + share * (y[j] - y[j - 1]) for y in (t, X))
                drop, ended = float(spring[high] - spring[low]), low < t.size - 1
                at = float(middle), float(x)
                found.append(Slip(*at, drop, time, distance, 0, high > 0, ended))
            high, low = min(i, t.size - 1), -1
    return found


_ROUNDING = 1e-14  # of a sum of forces, over its terms


class Forces(NamedTuple):
    """Force along a grid, of which segments are summarised, arrays (points,)."""

    force: Array  # <F>/(N k) (length)
    stderr: Array  # its standard error
    parts: Array | None = None  # (parts, points), of equal, independent parts, if known
    missed: Array | None = None  # what these have in common of the error
    unmet: Array | None = None  # change by one more contact that breaks, if any can

    def within(self, here: Array) -> "Forces":
        """The force at some instants."""
        force, stderr, parts, missed, unmet = self
        parts = None if parts is None else parts[:, here]
        missed = None if missed is None else missed[here]
        unmet = None if unmet is None else unmet[here]
        return Forces(force[here], stderr[here], parts, missed, unmet)

    def change(self, *terms: tuple[int, float], more: float = 0.0) -> Estimate:
        """A sum of forces at instants times weights, with its standard error, `more` in
        quadrature. It is 0 where it is no more than rounding. Parts in which no contact
        broke between the instants tell it no better than to one that did."""
        points, weights = zip(*terms, strict=True)
        index, place = np.unique(points, return_inverse=True)
        weight = np.bincount(place, weights)
        value, n = float(self.force[index] @ weight), self.force.size
        if self.parts is None:
            error = float(np.linalg.norm(weight * self.stderr[index]))
            found = Estimate(value, math.hypot(error, more), n)
        else:
            known = mean_of(self.parts[:, index] @ weight, n, len(self.parts) - 1)
            if self.missed is not None:
                more = math.hypot(more, *weight * self.missed[index])
            scatter = known.stderr or 0.0
            if self.unmet is not None:
                scatter = max(scatter, np.min(np.abs(weight) * self.unmet[index]))
            error = math.hypot(scatter, more)
            found = replace(known, value=value, stderr=error)
        rounding = _ROUNDING * float(np.abs(self.force[index]) @ np.abs(weight))
        if max(abs(value), found.stderr or 0.0) <= rounding:
            return replace(found, value=0.0, stderr=0.0)
        return found

    def apart(self, point: int) -> Array:
        """Standard errors of the differences from the force at a point, (points,); its
        own error if that of differences is not known."""
        if self.parts is None:
            return np.full(self.force.size, self.stderr[point])
        scatter = np.std(self.parts - self.parts[:, [point]], axis=0, ddof=1)
        error = scatter / math.sqrt(len(self.parts))
        return error if self.missed is None else np.hypot(error, self.missed)


def shown_by(
    programme: Programme,
    grid: Grid,
    forces: Forces,
    reliable: bool = True,
    X_stderr: Array | None = None,
) -> tuple[SegmentRecord, ...]:
    """Summarise the segments of a programme from the force at the instants of `grid`,
    whose displacements are those of the slider, with errors `X_stderr` (points,) if they
    are found behind a spring."""
    found: list[SegmentRecord] = []
    before = programme.velocity if programme.start == "stationary" else None
    # of a hold: velocity before it, and the instant at which it begins
    paused: tuple[float, int] | None = None
    for index, segment in enumerate(programme.segments):
        here = np.flatnonzero(grid.segment == index)
        here = here if index == 0 else np.append(here[0] - 1, here)
        along = grid.X[here] if segment.velocity else grid.t[here]
        along = np.abs(along - along[0])
        part = forces.within(here)
        ratio = segment.velocity / before if before else 0.0
        stepped = ratio > 0 and ratio != 1
        rising = math.copysign(1.0, (ratio - 1) * segment.velocity) if stepped else 0
        resumed = paused is not None and paused[0] * segment.velocity > 0
        if resumed:
            rising = math.copysign(1.0, segment.velocity)
        peak, at = extreme(along, part, rising)
        top = int(np.argmin(np.abs(along - known(at))))
        if X_stderr is not None and segment.velocity:
            spread = X_stderr[here[top]], X_stderr[here[0]]
            at = replace(at, stderr=math.hypot(at.stderr or 0.0, *spread))
        last = here.size - 1
        shown = {
            "end": Estimate(float(part.force[-1]), float(part.stderr[-1]), here.size),
            "peak": peak,
            "at": at,
        }
        if not segment.velocity and before:
            paused = before, int(here[0])
            sign = math.copysign(1.0, before)
            shown["relaxation"] = part.change((0, sign), (last, -sign))
        elif resumed and paused:
            begun, off = paused[1], known(peak) - float(part.force[top])
            for name, other in (("healing", begun), ("drop", int(here[-1]))):
                high, low = (int(here[top]), rising), (other, -rising)
                change = forces.change(high, low, more=off)
                shown[name] = replace(change, value=known(change) + rising * off)
        step = velocity_step(along, part, (peak, at), ratio) if stepped else None
        # the largest of many noisy values on a plateau is too large
        vague = ("healing", "drop") if 4.0 * (at.stderr or 0.0) > along[-1] else ()
        shown = {
            name: replace(e, reliable=reliable and name not in vague)
            for name, e in shown.items()
        }
        t, X = float(grid.t[here[-1]]), float(grid.X[here[-1]])
        found.append(SegmentRecord(segment.velocity, t, X, step=step, **shown))
        before = segment.velocity
        paused = paused if not segment.velocity else None
    return tuple(found)


def extreme(
    x: Array, forces: Forces, direction: float = 0
) -> tuple[Estimate, Estimate]:
    """Estimate the force that differs most from the first one, in a `direction` (1 or
    -1) if given, and the `x` where it is; arrays (points,). The largest of many values
    with errors is biased. So the vertex of a parabola is fitted to all values within
    the error of the largest; the difference of the two is part of the error. If the
    vertex lies beyond these values, the largest value is returned. The error of the
    place is half the range in which the force cannot be told from the largest value."""
    force, stderr = forces.force, forces.stderr
    change = direction * (force - force[0]) if direction else np.abs(force - force[0])
    top = int(np.argmax(change))
    below = np.abs(force - force[top])
    same = x[below <= 2.0 * forces.apart(top)]
    near = (below <= 2.0 * stderr[top]) & (x >= same.min()) & (x <= same.max())
    left, right = top, top
    while left > 0 and near[left - 1]:
        left -= 1
    while right + 1 < force.size and near[right + 1]:
        right += 1
    n = force.size
    best, place = float(force[top]), float(x[top])
    # on a plateau the place may be anywhere
    cells = float(x[min(top + 1, n - 1)] - x[max(top - 1, 0)])
    spread = max(0.5 * float(np.ptp(same)), 0.5 * cells)
    half, plateau = 0.5 * (x[right] - x[left]), slice(left, right + 1)
    apart = np.count_nonzero(np.diff(x[plateau]) > 1e-9 * half)  # not where x stalls
    if apart >= 4 and 0 < top < n - 1:
        a, b, c = np.polyfit((x[plateau] - place) / half, force[plateau], 2)
        vertex = -0.5 * b / a if a else np.inf
        within = x[left] <= place + vertex * half <= x[right]
        if a * (force[top] - force[0]) < 0 and within:
            best, place = float(c - 0.25 * b * b / a), place + float(vertex * half)
    error = float(np.hypot(stderr[top], force[top] - best))
    return Estimate(best, error, n), Estimate(place, spread, n)


def velocity_step(
    x: Array, forces: Forces, extremum: tuple[Estimate, Estimate], ratio: float
) -> VelocityStep:
    """Read off a step of velocity by a factor `ratio`: from the force against
    displacement since, arrays (points,), and its `extreme`."""
    peak, at = extremum
    force, n, log_ratio = forces.force, forces.force.size, np.log(ratio)
    last, top = n - 1, known(peak)
    first = int(np.argmin(np.abs(x - known(at))))
    off = top - float(force[first])

    def effect(begin: int, end: int, *, of_peak: float) -> Estimate:
        """Force at `end` less that at `begin`, one of which is the peak."""
        change = forces.change((end, 1.0), (begin, -1.0), more=of_peak * off)
        value = (known(change) + of_peak * off) / log_ratio
        error = (change.stderr or 0.0) / abs(log_ratio)
        return replace(change, value=float(value), stderr=float(error))

    left = np.abs(force[first:] - force[-1]) - abs(top - force[-1]) / np.e
    below = int(np.argmax(left <= 0.0))
    memory = Estimate(None, None, n, reliable=False)
    j = first + below
    if below > 0 and x[j] > x[j - 1]:  # a motion that X resolves
        slope = (left[below - 1] - left[below]) / (x[j] - x[j - 1])
        place = x[j] + left[below] / slope
        # noise between neighbours makes any slope
        wide = max(first, j - max(1, below // 4))
        steep = abs(force[j] - force[wide]) / (x[j] - x[wide])
        level = (first, -1.0 / np.e), (last, 1.0 / np.e - 1.0)
        missed = forces.change((j, 1.0), *level, more=off / np.e)
        error = (missed.stderr or 0.0) / steep if steep > 0 else np.inf
        # a range of two errors to either side is told of the place of the peak
        error = math.hypot(error, 0.5 * (at.stderr or 0.0))
        memory = Estimate(float(place - x[first]), float(error), n, missed.dof)
    return VelocityStep(
        direct=effect(0, first, of_peak=1.0),
        evolution=effect(last, first, of_peak=1.0),
        memory=memory,
        a_minus_b=effect(0, last, of_peak=0.0),
    )
