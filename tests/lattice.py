"""Contacts on a lattice, a plain twin of the references along programmes and behind a
stage.

Thresholds and displacements are multiples of a length h, so that contacts break
mechanically at instants of the lattice alone. Atoms stay where they are; of a density
what lies between two even multiples is put on the odd one between, which is of second
order, also next to jumps and kinks if these are at even multiples. Heat breaks contacts
in the middle of a step; births of these are half at its beginning and half at its end.
Cohorts are the births of an instant, one by one: nothing is joined, interpolated or
extrapolated, and nothing here comes from the package but laws of thresholds.
"""

from typing import NamedTuple

import numpy as np


class Law(NamedTuple):
    """Shares of thresholds j h, j = 0, 1, ..., and their k_i/k."""

    share: np.ndarray
    kappa: np.ndarray


class Leg(NamedTuple):
    """Steps of one lattice unit in a direction (0 in a hold), and how long each takes."""

    direction: int
    steps: int
    dt: float


class History(NamedTuple):
    """At instants of the lattice: times, displacements, the force just before and after
    the contacts break whose turn it is, pinned share and mean square of the force,
    arrays (instants,)."""

    t: np.ndarray
    X: np.ndarray
    before: np.ndarray
    force: np.ndarray
    pinned: np.ndarray
    square: np.ndarray


def lattice_law(law, h, longest, sqrt=False):
    """`Law` of an eqsim law of thresholds, up to a length; what is beyond never breaks."""
    count = 2 * (round(longest / h) // 2) + 2
    if law.steps.size:
        place = np.round(law.steps / h).astype(int)
        assert np.allclose(place * h, law.steps, rtol=1e-9, atol=0)
        share = np.bincount(np.minimum(place, count), minlength=count + 1) / place.size
        xi = np.arange(count + 1) * h
        xi[-1] = law.steps[place >= count].mean() if np.any(place >= count) else xi[-1]
    else:
        share, xi = np.zeros(count + 2), np.arange(count + 2) * h
        share[1::2] = np.diff(law.cdf(xi[::2]), append=1.0)
        if sqrt and share[-1] > 0.0:  # the mean of those beyond, from that of all
            xi[-1] = (law.mean - share[:-1] @ xi[:-1]) / share[-1]
    kappa = xi / law.rms if sqrt else np.ones(xi.size)
    return Law(share, kappa)


def history(law, h, legs, rate=None, delay=0.0, exponential=False):
    """March along legs from a fresh start. `rate(x)` is that of thermal breaking at
    stretch x, of all contacts alike, or for each threshold, shape (x, thresholds)."""
    steps = sum(leg.steps for leg in legs)
    dts = np.concatenate([np.full(leg.steps, leg.dt) for leg in legs])
    t = np.append(0.0, np.cumsum(dts))
    moves = np.concatenate([np.full(leg.steps, leg.direction) for leg in legs])
    n = np.append(0, np.cumsum(moves))
    each = rate is not None and np.ndim(rate(np.zeros(1))) == 2
    thresholds = law.share.size
    by_kappa = law.share * law.kappa ** np.arange(3)[:, None]
    # of those > j h
    above = np.array(
        [np.append(part[::-1].cumsum()[::-1][1:], 0.0) for part in by_kappa]
    )
    # births times thermal survival
    alive = np.zeros((steps + 1, thresholds if each else 1))
    alive[0] = 1.0
    greatest = np.zeros(steps + 1, int)
    due = np.zeros(steps + 2)  # births that wait, by instant
    found = History(t, n * h, *np.zeros((4, steps + 1)))
    found.pinned[0] = 1.0
    detached = 0.0

    def pinned(rows, reach, p):
        if each:
            return (alive[rows] * (np.arange(thresholds) > reach[:, None])) @ by_kappa[
                p
            ]
        return alive[rows, 0] * above[p][np.minimum(reach, thresholds - 1)]

    def break_at(m, share):  # contacts break at an instant, and are born again
        nonlocal detached
        if delay == 0.0:
            alive[m] += share
        elif exponential:
            detached += share
        else:
            when = t[m] + delay
            j = min(np.searchsorted(t, when * (1 - 1e-12)), steps + 1)
            if j <= steps:
                part = (t[j] - when) / (t[j] - t[j - 1])
                due[j] += share * (1.0 - part)
                due[j - 1] += share * part

    for m in range(steps):
        rows = slice(0, m + 1)
        dt, x = dts[m], n[m + 1] - n[: m + 1]
        if rate is not None:
            lost = pinned(rows, greatest[rows], 0).sum()
            hazard = rate(0.5 * h * np.abs(n[m] + n[m + 1] - 2 * n[: m + 1])) * dt
            alive[rows] *= np.exp(-(hazard if each else hazard[:, None]))
            lost -= pinned(rows, greatest[rows], 0).sum()
            break_at(m, 0.5 * lost)
            break_at(m + 1, 0.5 * lost)
        if exponential and delay:
            born = detached * -np.expm1(-dt / delay)
            detached -= born
            alive[m] += 0.5 * born
            alive[m + 1] += 0.5 * born
        elif delay:
            alive[m + 1] += due[m + 1]
        reach = np.maximum(greatest[rows], np.abs(x))
        old = pinned(rows, greatest[rows], 0).sum()
        found.before[m + 1] = h * (x * pinned(rows, greatest[rows], 1)).sum()
        greatest[rows] = reach
        left = pinned(rows, reach, 0)
        break_at(m + 1, old - left.sum())
        found.force[m + 1] = h * (x * pinned(rows, reach, 1)).sum()
        found.square[m + 1] = h * h * (x * x * pinned(rows, reach, 2)).sum()
        found.pinned[m + 1] = (
            left.sum() + pinned(slice(m + 1, m + 2), np.zeros(1, int), 0)[0]
        )
    return found
