"""Brute force for a few contacts and a slider that a stage pulls through a spring, one
event after another.

The slider has neither mass nor damping: at every moment the spring balances the
contacts, N kappa (Y - X) = sum of k_i (X - X_birth), and after a break it slides at
once to where they balance again; contacts whose thresholds it passes on the way break
in the order in which it passes them. While the stage holds, nothing moves between two
events, all rates are constant, and the next event is drawn as it is (Gillespie, 1976).
While it moves, stretches grow between two events, and attempts are drawn at the largest
rates of a short window and accepted with the ratio of the rate to that (thinning). No
hazard is integrated, no step in time is taken, and nothing is shared with eqsim.

Many replicas are followed at once, as rows of arrays (replicas, contacts).
"""

from typing import NamedTuple

import numpy as np


class Sled(NamedTuple):
    """A slider on `count` contacts behind a spring. Thresholds are such that xi^2 ~
    Gamma(n + 1); k = omega = 1.

    `wrong` names a deliberate mistake: "frozen" breaks no contact by heat while the
    stage holds, "pinned slider" keeps the slider where it is after a break, "crowd"
    moves it by the mean over 10^4 times as many contacts, "unordered" lets contacts
    hold on whose thresholds a slip passes.
    """

    count: int
    stiffness: float  # kappa of the spring, over N k
    preload: float = 0.0  # stretch of the spring at t = 0
    segments: tuple = ((0.0, 100.0),)  # velocity and time of the stage
    kT: float = 0.1
    n: float = 1.0
    sqrt: bool = False  # k_i = xi/sqrt(n + 1) instead of 1
    stiff: bool = False  # the stiff barrier instead of the soft one
    annealed: bool = False  # thermal attempts draw a new threshold each
    delay: float = 0.0
    exponential: bool = False  # delays instead of fixed ones
    wrong: str = ""


class Found(NamedTuple):
    """Displacement, force over N k and pinned share, arrays (instants, replicas);
    breaks, array (replicas,)."""

    X: np.ndarray
    force: np.ndarray
    pinned: np.ndarray
    breaks: np.ndarray


_WINDOW = 0.05  # by how much stretches may grow while rates are bounded; any value gives the same law


class Rows(NamedTuple):
    """The state of all replicas: thresholds, stiffness, position at birth, whether
    pinned, and when pinned again, arrays (replicas, contacts); displacement of the
    slider and breaks so far, arrays (replicas,)."""

    xi: np.ndarray
    k: np.ndarray
    born: np.ndarray
    held: np.ndarray
    wakes: np.ndarray
    X: np.ndarray
    breaks: np.ndarray


def thresholds(sled, rng, size):
    """Thresholds of newborn contacts."""
    return np.sqrt(rng.gamma(sled.n + 1.0, size=size))


def stiffness(sled, xi):
    """Stiffness of contacts of these thresholds."""
    return xi / np.sqrt(sled.n + 1.0) if sled.sqrt else np.ones_like(xi)


def success(sled, xi, k, stretch):
    """Probability that a thermal attempt breaks contacts of these thresholds and
    stretches (>= 0)."""
    gap = np.clip(1.0 - stretch / xi, 0.0, 1.0)
    a = k * xi**2 / (2.0 * sled.kT)
    if sled.stiff:
        return np.sqrt(gap) * np.exp(-a * gap**1.5)
    return np.exp(-a * gap * (1.0 + stretch / xi)) * (gap > 0.0)


def largest_success(sled, xi, k, low, high):
    """The largest of these probabilities for stretches from `low` to `high`."""
    if not sled.stiff:
        return success(sled, xi, k, np.minimum(high, xi * (1.0 - 1e-12)))
    # where sqrt(u) exp(-a u^1.5) is greatest
    top = xi * (1.0 - (2.0 * sled.kT / (3.0 * k * xi**2)) ** (2.0 / 3.0))
    return success(sled, xi, k, np.clip(top, low, np.minimum(high, xi)))


def pin(sled, rng, rows, row, contact):
    """Pin contacts anew, unstretched, where the slider is."""
    xi = thresholds(sled, rng, row.size)
    rows.xi[row, contact], rows.k[row, contact] = xi, stiffness(sled, xi)
    rows.born[row, contact], rows.held[row, contact] = rows.X[row], True
    rows.wakes[row, contact] = np.inf


def let_go(sled, rng, rows, row, contact, t):
    """Break contacts at times `t`; without a delay they are pinned again at once."""
    rows.breaks[row] += 1
    if sled.delay == 0.0:
        pin(sled, rng, rows, row, contact)
        return
    rows.held[row, contact] = False
    wait = rng.exponential(sled.delay, row.size) if sled.exponential else sled.delay
    rows.wakes[row, contact] = t + wait


def balance(sled, rows, row, Y):
    """Where the slider is in balance, unless contacts break on the way."""
    k = np.where(rows.held[row], rows.k[row], 0.0)
    if sled.wrong == "crowd":
        share = 1e-4
        resting = (sled.stiffness * Y + (k * rows.born[row]).mean(1)) / (
            sled.stiffness + k.mean(1)
        )
        return rows.X[row] + share * (resting - rows.X[row])
    spring = sled.count * sled.stiffness
    return (spring * Y + (k * rows.born[row]).sum(1)) / (spring + k.sum(1))


def slide(sled, rng, rows, row, Y, t):
    """Let the slider of some replicas slide, at times `t`, until the spring and the
    contacts balance."""
    if sled.wrong == "pinned slider":
        return
    while row.size:
        rest = balance(sled, rows, row, Y)
        sign = np.where(rest >= rows.X[row], 1.0, -1.0)
        # where the slider passes each threshold, ahead of where it is
        ahead = sign[:, None] * (rows.born[row] - rows.X[row][:, None]) + rows.xi[row]
        ahead = np.where(rows.held[row], np.maximum(ahead, 0.0), np.inf)
        contact = ahead.argmin(1)
        nearest = ahead[np.arange(row.size), contact]
        breaks = nearest < np.abs(rest - rows.X[row])
        if sled.wrong == "unordered":
            breaks[:] = False
        rows.X[row] = np.where(breaks, rows.X[row] + sign * nearest, rest)
        row, contact, Y, t = row[breaks], contact[breaks], Y[breaks], t[breaks]
        let_go(sled, rng, rows, row, contact, t)


def simulate(sled, instants, replicas, rng):
    """Follow `replicas` sliders from a fresh start, all contacts pinned and
    unstretched; look at ascending times."""
    ends = np.cumsum([time for _, time in sled.segments])
    shape = (replicas, sled.count)
    rows = Rows(
        *np.zeros((3, *shape)), np.ones(shape, bool), np.full(shape, np.inf), np.zeros(replicas),
        np.zeros(replicas, np.int64),
    )  # fmt: skip
    everyone = np.arange(replicas)
    pin(sled, rng, rows, *np.divmod(np.arange(replicas * sled.count), sled.count))
    slide(
        sled, rng, rows, everyone, np.full(replicas, sled.preload), np.zeros(replicas)
    )
    records = np.zeros((3, len(instants), replicas))
    begin, Y = 0.0, sled.preload
    at = 0
    for (velocity, _), end in zip(sled.segments, ends, strict=True):
        while at < len(instants) and instants[at] <= end:
            advance(sled, rng, rows, velocity, Y, begin, instants[at])
            Y += velocity * (instants[at] - begin)
            begin = instants[at]
            pull = np.where(rows.held, rows.k * (rows.X[:, None] - rows.born), 0.0)
            records[:, at] = rows.X, pull.mean(1), rows.held.mean(1)
            at += 1
        if begin < end:
            advance(sled, rng, rows, velocity, Y, begin, end)
            Y += velocity * (end - begin)
            begin = end
    return Found(*records, rows.breaks)


def advance(sled, rng, rows, velocity, Y, begin, end):
    """Follow all replicas from `begin`, when the stage is at `Y`, to `end`, while the
    stage moves at `velocity`."""
    t = np.full(rows.X.size, float(begin))
    row = np.arange(rows.X.size)
    while row.size:
        held, X = rows.held[row], rows.X[row]
        speed = np.zeros(row.size)
        if velocity and sled.wrong != "pinned slider":
            spring = sled.count * sled.stiffness
            speed = (
                velocity * spring / (spring + np.where(held, rows.k[row], 0.0).sum(1))
            )
        now = t[row]
        with np.errstate(divide="ignore"):
            until = np.minimum(end, now + _WINDOW / np.abs(speed))
        stretch = X[:, None] - rows.born[row]
        later = stretch + (speed * (until - now))[:, None]
        low, high = (
            np.minimum(np.abs(stretch), np.abs(later)),
            np.maximum(np.abs(stretch), np.abs(later)),
        )
        if sled.annealed:
            bound = np.ones_like(stretch)
        elif velocity:
            low = np.where(stretch * later < 0.0, 0.0, low)
            bound = largest_success(sled, rows.xi[row], rows.k[row], low, high)
        else:
            bound = success(sled, rows.xi[row], rows.k[row], np.abs(stretch))
        bound = np.where(held, bound, 0.0)
        if sled.wrong == "frozen" and not velocity:
            bound[:] = 0.0
        total = bound.cumsum(1)
        with np.errstate(divide="ignore"):
            attempt = now + rng.exponential(size=row.size) / total[:, -1]
        # mechanical breaks of contacts that are pulled farther
        with np.errstate(divide="ignore", invalid="ignore"):
            way = np.sign(velocity) * (rows.born[row] - X[:, None]) + rows.xi[row]
            passes = now[:, None] + np.maximum(way, 0.0) / np.abs(speed)[:, None]
        passes = np.where(held & (speed != 0.0)[:, None], passes, np.inf)
        wakes = rows.wakes[row]
        times = np.stack((until, attempt, passes.min(1), wakes.min(1)))
        which = times.argmin(0)
        t[row] = times.min(0)
        rows.X[row] = X + speed * (t[row] - now)
        # attempts
        some = np.flatnonzero(which == 1)
        contact = (
            rng.random(some.size)[:, None] * total[some, -1:] >= total[some]
        ).sum(1)
        contact = np.minimum(contact, sled.count - 1)
        tried = row[some]
        x = np.abs(rows.X[tried] - rows.born[tried, contact])
        xi = (
            thresholds(sled, rng, some.size)
            if sled.annealed
            else rows.xi[tried, contact]
        )
        chance = np.where(x < xi, success(sled, xi, stiffness(sled, xi), x), 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            accepted = rng.random(some.size) * bound[some, contact] < chance
        broken, which_broke = [tried[accepted]], [contact[accepted]]
        # thresholds that are passed
        some = np.flatnonzero(which == 2)
        broken.append(row[some])
        which_broke.append(passes[some].argmin(1))
        broken, which_broke = np.concatenate(broken), np.concatenate(which_broke)
        let_go(sled, rng, rows, broken, which_broke, t[broken])
        slide(sled, rng, rows, broken, Y + velocity * (t[broken] - begin), t[broken])
        # contacts that are pinned again
        some = np.flatnonzero(which == 3)
        pin(sled, rng, rows, row[some], wakes[some].argmin(1))
        row = row[t[row] < end]
