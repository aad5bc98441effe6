"""Contacts one by one along a drive in segments, by thinning: no hazard is integrated,
nothing is shared with eqsim.

A pinned contact makes attempts at random times, omega per unit time, each of which
breaks it with the probability r of its barrier for the stretch |x| that it has then; it
breaks in any case when |x| first reaches its threshold.
"""

from typing import NamedTuple

import numpy as np


class Script(NamedTuple):
    """What is simulated: thresholds xi^2 ~ Gamma(n + 1), k = omega = 1; segments
    (velocity, time). `wrong` is a deliberate mistake: "signed" forgets that |x| counts,
    not x; "still" that contacts break in holds, too."""

    segments: tuple
    kT: float = 0.1
    n: float = 1.0
    sqrt: bool = False
    stiff: bool = False
    annealed: bool = False
    delay: float = 0.0
    exponential: bool = False
    eta: float = 0.0
    wrong: str = ""


def simulate(script, times, contacts, rng):
    """Force and pinned of each contact at ascending `times`, shape (times, contacts)."""
    ends = np.cumsum([0.0] + [time for _, time in script.segments])
    corners = np.cumsum([0.0] + [velocity * time for velocity, time in script.segments])
    velocity = np.array([velocity for velocity, _ in script.segments])

    def at(t):
        return np.interp(t, ends, corners)

    def thresholds(size):
        return np.sqrt(rng.gamma(script.n + 1.0, size=size))

    def stiffness(xi):
        return xi / np.sqrt(script.n + 1.0) if script.sqrt else np.ones_like(xi)

    def mechanical(t, xi):
        """When contacts born at t break if heat does not break them."""
        born, found = at(t), np.full(t.size, np.inf)
        for j, v in enumerate(velocity):
            x0 = at(np.maximum(t, ends[j])) - born
            for target in (xi, -xi) if script.wrong != "signed" else (xi,):
                with np.errstate(divide="ignore", invalid="ignore"):
                    when = np.maximum(t, ends[j]) + (target - x0) / v
                hit = (
                    (when >= np.maximum(t, ends[j]))
                    & (when <= ends[j + 1])
                    & (t < ends[j + 1])
                    & (v * target > 0)
                )
                found = np.where(hit, np.minimum(found, when), found)
        return found

    def chance(xi, x, t):
        x = np.maximum(x, 0.0) if script.wrong == "signed" else np.abs(x)
        if script.annealed:
            xi = thresholds(x.size)
        part = np.maximum(1.0 - x / xi, 0.0)
        a = stiffness(xi) * xi**2 / (2.0 * script.kT)
        height = a * part**1.5 if script.stiff else a * part * (1.0 + x / xi)
        r = np.exp(-height) * (np.sqrt(part) if script.stiff else 1.0) * (part > 0)
        if script.wrong == "still":
            r = r * (
                velocity[np.minimum(np.searchsorted(ends, t) - 1, velocity.size - 1)]
                != 0
            )
        return r

    force, pinned = np.zeros((len(times), contacts)), np.zeros((len(times), contacts))
    who = np.arange(contacts)
    born, now, xi = np.zeros(contacts), np.zeros(contacts), thresholds(contacts)
    last = mechanical(born, xi)
    while who.size:
        attempt = now + rng.exponential(size=who.size)
        heat = (attempt < last) & (
            rng.random(who.size) < chance(xi, at(attempt) - at(born), attempt)
        )
        now = np.minimum(attempt, last)
        broken = heat | (attempt >= last)
        over = np.minimum(now, ends[-1] + 1.0)
        done = broken | (now > ends[-1])
        for m, t in enumerate(times):
            here = done & (born <= t) & (t < over)
            pinned[m, who[here]] = 1.0
            force[m, who[here]] = (stiffness(xi) * (at(t) - at(born)))[here]
        wait = (
            rng.exponential(script.delay, who.size)
            if script.exponential
            else np.full(who.size, script.delay)
        )
        born = np.where(broken, now + wait, born)
        now = np.where(broken, born, now)
        xi = np.where(broken, thresholds(who.size), xi)
        alive = now < ends[-1]
        new = np.where(broken & alive)[0]
        last[new] = mechanical(born[new], xi[new])
        who, born, now, xi, last = (part[alive] for part in (who, born, now, xi, last))
    drag = (
        script.eta
        * velocity[
            np.minimum(np.searchsorted(ends, times) - 1, velocity.size - 1).clip(0)
        ]
    )
    return force + drag[:, None] * (1.0 - pinned), pinned
