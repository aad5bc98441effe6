"""Thresholds that fluctuate while their contact is pinned (rule `langevin` of `laws.aging`), followed to first passage.

A step of any length draws the threshold from its exact transition, so steps only have to be short where something can
happen in between: next to the stretch that comes up to meet the threshold, and where the thermal rate counts. Far from
both a step is so long that it ends at least 1/STEP standard deviations away from them; close by it is never shorter
than what moves the threshold by a fraction STEP/4 of itself, or the barrier by 3 STEP in units of 2 kT, and by more
where a break is unlikely. In a step

    passage    a Brownian bridge with the same end points meets the stretch with probability exp(-2 g0 g1/(2 D_v h)),
               g the distance between threshold and stretch, at a time of inverse Gaussian law: exact for a constant
               drift, and the drift varies little in so short a step
    heat       Simpson's rule, with the rate in the middle averaged over the spread of the process's bridge

Stiff barriers take half of STEP. The error in friction is second order in STEP; at the default it is below 1e-3
(`analysis/aging_steps.py`).
"""

import math
from typing import Any

import numpy as np

from eqsim.compiled import inlined, routine
from eqsim.engine.streams import Key, words
from eqsim.ensemble import Contacts
from eqsim.laws.aging import barrier_of
from eqsim.laws.stiffness import kappa
from eqsim.laws.thermal import MECHANICAL, STIFF

STEP = 0.35  # the default accuracy of steps
_UNSEEN = 7.0  # heat counts where the hazard of the way to the threshold is above exp(-7)


@inlined
def normal_of(a: float, b: float) -> float:
    """A normal deviate from two 32-bit words (Box and Muller)."""
    return math.sqrt(-2.0 * math.log((a + 0.5) * 2.0**-32)) * math.cos((b + 0.5) * (2.0**-32 * 2.0 * math.pi))


@inlined
def random_step(key: Key, contact: int, life: int, draw: int, shape: float) -> tuple[Any, Any, Any, Any]:
    """A normal deviate, a chi-square deviate of 2 shape + 1 degrees of freedom, a uniform, and the next draw."""
    a, b, d, e = words(key, contact, life, draw)
    radius, angle = math.sqrt(-2.0 * math.log((a + 0.5) * 2.0**-32)), (b + 0.5) * (2.0**-32 * 2.0 * math.pi)
    normal = radius * math.cos(angle)
    passage, product = (e + 0.5) * 2.0**-32, (d + 0.5) * 2.0**-32
    draw += 1
    freedom = 2.0 * shape + 1.0
    if freedom == math.floor(freedom) and freedom < 14.0:  # squares of normals, pairs of them from a logarithm
        pairs = int(freedom) // 2
        square = radius * radius - normal * normal if int(freedom) % 2 else 0.0  # of the sine's deviate
        if pairs == 0:
            product = 1.0
        for _ in range(pairs - 1):
            product *= (words(key, contact, life, draw)[0] + 0.5) * 2.0**-32
            draw += 1
        return normal, square - 2.0 * math.log(product), passage, draw
    # Marsaglia and Tsang (2000), for the shape 1/2 + shape >= 1/2 raised by 1 if below 1
    alpha = shape + 0.5
    lift = 1.0
    if alpha < 1.0:
        lift, alpha = product ** (1.0 / alpha), alpha + 1.0
    third = alpha - 1.0 / 3.0
    while True:
        a, b, d, e = words(key, contact, life, draw)
        draw += 1
        z = normal_of(a, b)
        cube = (1.0 + z / math.sqrt(9.0 * third)) ** 3
        if cube > 0.0 and math.log((d + 0.5) * 2.0**-32) < 0.5 * z * z + third * (1.0 - cube + math.log(cube)):
            return normal, 2.0 * third * cube * lift, passage, draw


@inlined
def reaches(room: float, spread: float, speed: float) -> float:
    """The h after which speed h + spread sqrt(h) = room."""
    root = 2.0 * room / (spread + math.sqrt(spread * spread + 4.0 * speed * room))
    return root * root


@inlined
def heat(c: Contacts, xi: float, x: float) -> float:
    """Thermal rate per displacement at stretch `x` of a contact of threshold `xi`, or x if that is more."""
    xi = max(xi, x)
    rate = math.exp(c.log_w - barrier_of(c.breaking, xi, x, c.b * kappa(c.kappa_slope, c.kappa_constant, xi)))
    return rate * math.sqrt((xi - x) / xi) if c.breaking == STIFF else rate


@inlined
def halfway(c: Contacts, xi: float, along: float, end: float, lost: float) -> tuple[float, float]:
    """Threshold half-way through a step from `xi` to `end`, of which `along` is the component along the start, and its
    spread: the bridge of the (2n+2)-dimensional process, which pulls back within a relaxation time."""
    kept = 1.0 - lost
    spread2 = 0.5 * c.final2 * lost / (1.0 + kept)
    square = (xi * xi + 2.0 * xi * along + end * end) * kept / ((1.0 + kept) * (1.0 + kept))
    return math.sqrt(square + (2.0 * c.shape + 1.0) * spread2), math.sqrt(spread2)


@inlined
def walk(
    c: Contacts, key: Key, contact: int, life: int, draw: int,
    xi: float, x: float, left: float, most: float, step: float,
) -> tuple[Any, Any, Any, Any, Any, Any]:  # fmt: skip
    """One step, at most `most` long, of a pinned contact of threshold `xi` and stretch `x`; its clock has `left` to go.

    Returns whether it broke, threshold and stretch at the end, what the clock has left, work done over k, and the next
    draw.
    """
    if c.breaking == STIFF:  # its rate falls to 0 at the stretch, like a root
        step = 0.5 * step
    variance = 0.5 * c.alpha * c.final2  # 2 D_v, per unit of displacement
    sigma, gap = math.sqrt(variance), xi - x
    drift = variance * ((c.shape + 0.5) / xi - xi / c.final2)
    speed = 1.0 + max(0.0, -drift)
    k0 = kappa(c.kappa_slope, c.kappa_constant, xi)
    h, rate, slope = reaches(gap, sigma / step, speed), 0.0, 0.0
    if gap < 0.25 * xi:  # otherwise this is shorter
        h = max(h, reaches(0.25 * step * xi, sigma, speed))
    h = min(h, most)
    if c.breaking != MECHANICAL:
        a = c.b * k0
        barrier, rate = barrier_of(c.breaking, xi, x, a), heat(c, xi, x)
        slope = 2.0 * a * xi
        if c.breaking == STIFF:
            part = math.sqrt(gap / xi)
            slope = a * xi * part * (2.0 * part * part + 1.5)
        slope += barrier * c.kappa_slope / k0
        quiet = max(barrier - c.log_w - math.log(gap), 0.0)  # -ln of the hazard of a way as long as the gap
        h = min(h, max(
            reaches((quiet - _UNSEEN) / slope, sigma / step, speed) if quiet > _UNSEEN else 0.0,
            min(reaches(3.0 * step * (1.0 + 0.5 * quiet) / slope, sigma, speed), step * (1.0 + 0.5 * quiet) / c.alpha),
        ))  # fmt: skip
        if rate * h > 2.0 * left:  # what comes long after the clock has stopped says little about when it stops
            h = 2.0 * left / rate

    normal, square, passage, draw = random_step(key, contact, life, draw, c.shape)
    lost = -math.expm1(-0.5 * c.alpha * h)
    s = math.sqrt(0.5 * c.final2 * lost * (2.0 - lost))
    along = xi * (1.0 - lost) + s * normal
    end = math.sqrt(along * along + s * s * square)
    ahead = end - x - h
    broke = ahead <= 0.0
    if not broke and 2.0 * gap * ahead < 40.0 * variance * h:
        meets, zero = math.exp(-2.0 * gap * ahead / (variance * h)), math.exp(-2.0 * xi * end / (variance * h))
        t = gap / (gap + ahead)
        y = x + t * h
        detour = t / (xi * y) + (1.0 - t) / (y * end) - 1.0 / (xi * end)
        bowl = (
            t * (xi * xi + xi * y + y * y)
            + (1.0 - t) * (y * y + y * end + end * end)
            - (xi * xi + xi * end + end * end)
        )
        weight = (c.shape * c.shape - 0.25) * detour + bowl / (3.0 * c.final2 * c.final2)
        broke = passage * (1.0 - zero) < (meets - zero) * math.exp(-0.5 * variance * h * weight)
    if broke:  # when: Michael, Schucany and Haas (1976)
        a, b, d, _ = words(key, contact, life, draw)
        draw += 1
        z = normal_of(a, b)
        mean, steep = gap / max(abs(ahead), 1e-300), gap * gap / (variance * h)
        y = mean * z * z / steep
        ratio = mean * 2.0 / (2.0 + y + math.sqrt(y * (4.0 + y)))  # the smaller root, without cancellation
        if (d + 0.5) * 2.0**-32 > mean / (mean + ratio):
            ratio = mean * (mean / ratio)
        h = h * ratio / (1.0 + ratio) if ratio < 1e15 else h
        end = x + h
    if c.breaking != MECHANICAL:
        middle, spread = 0.5 * (xi + end), 0.5 * sigma * math.sqrt(h)  # a step cut short by a passage is short
        if not broke:
            middle, spread = halfway(c, xi, along, end, lost)
        between = 0.5 * (heat(c, middle + spread, x + 0.5 * h) + heat(c, middle - spread, x + 0.5 * h))
        last = heat(c, end, x + h)
        spent = h * (rate + 4.0 * between + last) / 6.0
        if spent > 0.03:  # the average over bridges has a spread of its own, which keeps some contacts pinned
            a, b, _, _ = words(key, contact, life, draw)
            draw += 1
            z = normal_of(a, b)
            scatter = slope * sigma * math.sqrt(h / 12.0)
            factor = math.exp(scatter * (z - 0.5 * scatter)) if scatter < 1.0 else 1.0
            rate, between, last, spent = rate * factor, between * factor, last * factor, spent * factor
        if spent >= left:  # where: Newton for the integral of the parabola through the three rates
            bend, curve = 4.0 * between - 3.0 * rate - last, 2.0 * (rate - 2.0 * between + last)
            part = left / spent
            for _ in range(8):
                here = max(rate + part * (bend + part * curve), 1e-3 * spent / h)
                done = h * part * (rate + part * (0.5 * bend + part * curve / 3.0))
                part = min(max(part + (left - done) / (h * here), 0.0), 1.0)
            broke, end, h, spent = True, xi + part * (end - xi), part * h, left
        left -= spent
    work = 0.5 * k0 * h * (2.0 * x + h)
    if c.kappa_slope > 0.0:
        k1 = kappa(c.kappa_slope, c.kappa_constant, end)
        work = h * (k0 * (3.0 * x + h) + k1 * (3.0 * x + 2.0 * h)) / 6.0
        if not broke:  # Simpson's rule
            middle, _ = halfway(c, xi, along, end, lost)
            k01 = kappa(c.kappa_slope, c.kappa_constant, middle)
            work = h * (k0 * x + 4.0 * k01 * (x + 0.5 * h) + k1 * (x + h)) / 6.0
    return broke, end, x + h, left, work, draw


@routine
def langevin_life(c: Contacts, key: Key, contact: int, life: int, xi: float, clock: float, step: float) -> Any:
    """Stretch at breaking and work done over k of a contact of threshold `xi` at birth and exponential `clock`."""
    x, total, draw, broke = 0.0, 0.0, np.int64(0), False  # typed: a literal 0 would be compiled for itself
    while not broke:
        broke, xi, x, clock, work, draw = walk(c, key, contact, life, draw, xi, x, clock, math.inf, step)
        total += work
    return x, total
