"""Thresholds that fluctuate while their contact is pinned (rule `langevin` of
`laws.aging`), followed to first passage.

A step of any length draws the threshold from its exact transition, so steps only have
to be short where something can happen in between: next to the stretch that comes up to
meet the threshold, and where the thermal rate counts. Far from both a step is so long
that it ends at least 1/STEP standard deviations away from them; close by it is never
shorter than what moves the threshold by a fraction STEP/4 of itself, or the barrier by
3 STEP in units of kT, and by more where a break is unlikely. In a step

    passage    a Brownian bridge with the same end points meets the stretch with probability exp(-2 g0 g1/(2 D_v h)),
               g the distance between threshold and stretch, at a time of inverse
               Gaussian law: exact for a constant drift, and the drift varies little in
               so short a step, but next to 0, where thresholds of few dimensions (n <
               1/2) dive and the bridge is that of a Bessel process (`touching`)
    heat       Simpson's rule, with the rate in the middle averaged over the spread of the process's bridge

The stretch of a path is never negative: it grows as the slider moves and stays in a
hold; where the slider has turned it goes back to 0, as in a mirror (`stride`). Stiff
barriers take half of STEP, and so does heat where the stretch does not grow and the
same rates last for long. The error in averages is second order in STEP; at the default
it is below 1e-3 unless contacts relax many times while they break rarely: `step_error`.

Each part of a step is a scalar function without library calls: `walk` puts them
together for one path, `walk_all` for many side by side, a loop for each part, which the
compiler vectorises. What happens once a life, or to few paths at a time (`conclude`),
is done for one path after the other.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from eqsim.engine.bessel import touching
from eqsim.engine.contacts import Contacts
from eqsim.engine.deviates import (
    chi_square,
    normals_of,
    pairs_of,
    random_step,
    times_uniforms,
    try_chi_square,
)
from eqsim.laws.aging import Langevin
from eqsim.laws.barrier.base import height, path_step, prefactor, slopes, thermal
from eqsim.laws.stiffness import Springs, kappa
from eqsim.numerics.compiled import routine
from eqsim.numerics.streams import Key, midpoints
from eqsim.numerics.tables import Array
from eqsim.numerics.vector_math import exp, exp_less_one, log

STEP = 0.35  # the default accuracy of steps
STEP_ERROR = 1e-3  # what they may cost then, relative; falls as the square of STEP
WALKERS = 64  # paths that advance side by side
# heat counts where the hazard from here to the threshold is above exp(-7)
_MOST_QUIET = 7.0
_SCATTERS = 0.03  # hazard of a step from which on its scatter counts
# ln of a factor on the chance to touch, up to which first order will do
_FIRST_ORDER = 0.05
_MISSED_ORDERS = 0.4  # bound on what first order misses beyond


class Pinned(NamedTuple):
    """Laws of a step: those of `Contacts` without tables, which would keep loops from
    vectorising; and how the stretch `moves` as time goes on: 1, 0 in a hold, -1 on the
    way back to 0."""

    barrier: Any
    springs: Springs
    aging: Langevin
    moves: float


class Path(NamedTuple):
    """A pinned contact between steps: its stream of random numbers and the next `draw`
    of it, threshold, stretch, and what its exponential clock has left."""

    key: Key
    contact: int
    life: Any
    draw: Any
    xi: float
    x: float
    left: float


class Rates(NamedTuple):
    """Thermal rates at the beginning, half-way and at the end of a step, and the slope
    of E with the threshold."""

    first: float
    between: float
    last: float
    slope: float


class Halfway(NamedTuple):
    """Threshold half-way through a step, and its spread."""

    threshold: float
    spread: float


class Bridge(NamedTuple):
    """Gap between threshold and stretch at the beginning of a step, and `ahead` at its
    end; the `variance` gathered in it; the stretch where straight paths `touch`; and
    ln of the factors by which the drift away from 0 (`swerve`) and towards it (`pull`)
    change the chance to touch, to first order in the variance."""

    gap: float
    ahead: float
    variance: float
    touch: float
    swerve: float
    pull: float


def step_error(law: Langevin, step: float = STEP, time: float | None = None) -> float:
    """About the largest relative error of averages by steps of that accuracy. It grows
    with D/(v x_*f), the relaxations while the slider moves by x_*f, as more of the few
    passages fall between two steps (measured against the Fokker-Planck equation: mean
    lives 0.4, 1.7 and 3.8 % too long at 1e3, 1e4 and 1e5, n = 1, T = 0). Where
    thresholds grow, x_*i takes the place of x_*f, which is safe; and in a hold its
    `time` that in which the slider moves so far."""
    scale = min(1.0, math.sqrt(law.final2))
    relaxed = 0.5 * variance_rate(law) * (scale if time is None else time) / scale**2
    growth = max(1.0, 1.4 * (relaxed / 100.0) ** 0.55)
    return STEP_ERROR * growth * (step / STEP) ** 2


@routine(inline=True)
def variance_rate(law: Langevin) -> float:
    """2 D_v, the variance that a threshold gathers per unit of displacement."""
    return 0.5 * law.alpha * law.final2


@routine(inline=True)
def pinned(c: Contacts, moves: float) -> Pinned:
    """Laws of steps in which the stretch `moves`."""
    return Pinned(c.barrier, c.springs, c.aging, moves)


# ---- the physics of a step ----


@routine(inline=True)
def reaches(distance: float, spread: float, speed: float) -> float:
    """Solve speed h + spread sqrt(h) = distance for h."""
    both = spread + math.sqrt(spread * spread + 4.0 * speed * distance)
    return (2.0 * distance / both) * (2.0 * distance / both)


@routine(inline=True)
def heat(c: Pinned, xi: float, x: float) -> float:
    """Thermal rate per displacement at stretch `x` of a contact of threshold `xi`, or x
    if that is more."""
    xi = max(xi, x)
    barrier = height(c.barrier, xi, x, c.barrier.b * kappa(c.springs, xi))
    return exp(c.barrier.log_w - barrier) * prefactor(c.barrier, xi, x)


@routine(inline=True)
def halfway(c: Pinned, xi: float, along: float, end: float, lost: float) -> Halfway:
    """Half-way through a step from `xi` to `end`, of which `along` is the component
    along the start: the bridge of the (2n+2)-dimensional process, which pulls back
    within a relaxation time."""
    kept = 1.0 - lost
    spread2 = 0.5 * c.aging.final2 * lost / (1.0 + kept)
    square = xi * xi + 2.0 * xi * along + end * end
    square = square * kept / ((1.0 + kept) * (1.0 + kept))
    mean = math.sqrt(square + (2.0 * c.aging.shape + 1.0) * spread2)
    return Halfway(mean, math.sqrt(spread2))


@routine(inline=True)
def pace(
    c: Pinned, xi: float, x: float, left: float, most: float, step: float
) -> tuple[Any, Any, Any]:
    """Longest step from threshold `xi` and stretch `x`, at most `most`; the thermal
    rate now, and the slope of E with the threshold."""
    careful = c.moves <= 0.0 and thermal(c.barrier)
    step = path_step(c.barrier) * step * (0.5 if careful else 1.0)
    alpha, final2 = c.aging.alpha, c.aging.final2
    rate2 = variance_rate(c.aging)
    sigma = math.sqrt(rate2)
    gap = max(xi - x, 1e-16 * xi)  # rounding may leave nothing
    drift = rate2 * (xi / final2 - (c.aging.shape + 0.5) / xi)
    drift = max(drift, 0.0)
    speed = abs(c.moves) + drift
    far = reaches(gap, sigma / step, speed)
    least = reaches(0.25 * step * xi, sigma, speed)
    h = min(max(far, least), most)
    h = most if c.moves == 0.0 and x == 0.0 else h  # no threshold comes down to 0
    if not thermal(c.barrier):
        return h, 0.0, 0.0
    k0 = kappa(c.springs, xi)
    a = c.barrier.b * k0
    barrier, rate = height(c.barrier, xi, x, a), heat(c, xi, x)
    slope, most_slope, share = slopes(c.barrier, xi, x, k0, c.springs.slope)
    # how thresholds move the barrier
    sigma, speed = sigma * max(share, 1e-100), abs(c.moves) + share * drift
    while_here = gap if c.moves > 0.0 else max(gap, most)
    # -ln of the hazard over a travel as long as the gap
    quiet = max(barrier - c.barrier.log_w - log(while_here), 0.0)
    slight = step * (1.0 + 0.5 * quiet)
    far = reaches(max(quiet - _MOST_QUIET, 0.0) / most_slope, sigma / step, speed)
    least = reaches(3.0 * step * (1.0 + 0.5 * quiet) / most_slope, sigma, speed)
    least = min(least, slight / alpha)
    h = min(h, max(far, least))
    # steps long beyond the end of the clock would place a break inaccurately
    return (2.0 * left / rate if rate * h > 2.0 * left else h), rate, slope


@routine(inline=True)
def move(
    c: Pinned, xi: float, h: float, normal: float, square: float
) -> tuple[float, float, float]:
    """The threshold after a step: its component along the start, itself, and the lost
    part of the correlation."""
    lost = -exp_less_one(max(-0.5 * c.aging.alpha * h, -700.0))
    s2 = 0.5 * c.aging.final2 * lost * (2.0 - lost)
    along = xi * (1.0 - lost) + math.sqrt(s2) * normal
    return along, math.sqrt(along * along + s2 * square), lost


@routine(inline=True)
def bridge_of(c: Pinned, xi: float, x: float, h: float, end: float) -> Bridge:
    """The bridge of a step whose ends are beyond the stretch."""
    gap, ahead, final2, n = xi - x, end - x - c.moves * h, c.aging.final2, c.aging.shape
    both, variance = gap + ahead, variance_rate(c.aging) * h
    t = gap / both
    touch = x + t * (c.moves * h)
    swerve = variance * (gap * ahead / both) * (0.25 - n * n) / (xi * touch * end)
    dip = 2.0 * gap * ahead / both  # how far straight paths are below the direct one
    moment = xi * (2.0 - t) + end * (1.0 + t) - dip
    pull = 0.5 * variance * dip * moment / (3.0 * final2 * final2)
    return Bridge(gap, ahead, variance, touch, swerve, pull)


@routine(inline=True)
def meets(c: Pinned, xi: float, x: float, h: float, end: float, passage: float) -> bool:
    """True if a threshold that went from `xi` to `end` has met the stretch in between;
    `passage` is a uniform. Some of these passages are yet to be `confirmed`. The chance
    is that of a Brownian bridge kept away from 0, corrected for how the drift differs,
    to first order, on a path that touches and on one that does not."""
    gap, ahead, variance, touch, swerve, pull = bridge_of(c, xi, x, h, end)
    if ahead <= 0.0:
        return True
    if 2.0 * gap * ahead >= 40.0 * variance:
        return False
    # a bound, which a process of 2n + 2 < 3 dimensions has next to 0
    if c.aging.shape < 0.5 and swerve > _FIRST_ORDER:
        most = (0.5 - c.aging.shape) * log(xi * end / (touch * touch))
        swerve = min(swerve, most) + _MISSED_ORDERS
    per = -2.0 / variance
    zero = exp(xi * end * per)
    return passage * (1.0 - zero) < (exp(gap * ahead * per) - zero) * exp(swerve + pull)


@routine
def confirmed(
    c: Pinned, xi: float, x: float, h: float, end: float, passage: float
) -> bool:
    """True if a passage of `meets` holds: for n < 1/2 next to 0, where first order
    fails, by `touching`."""
    gap, ahead, variance, touch, swerve, pull = bridge_of(c, xi, x, h, end)
    n = c.aging.shape
    if n >= 0.5 or ahead <= 0.0 or swerve <= _FIRST_ORDER:
        return True
    chance = touching(n, touch + gap, touch + ahead, touch, variance)
    return passage < chance * math.exp(pull)


@routine(inline=True)
def heats(
    c: Pinned, middle: Halfway, x: float, h: float, end: float
) -> tuple[float, float]:
    """Thermal rates half-way, averaged over the bridge, and at the end."""
    xi, spread = middle
    slid = c.moves * h
    half = x + 0.5 * slid
    mean = 0.5 * (heat(c, xi + spread, half) + heat(c, xi - spread, half))
    return mean, heat(c, end, x + slid)


@routine(inline=True)
def work_of(
    c: Pinned, xi: float, x: float, h: float, end: float, middle: float, broke: bool
) -> float:
    """Work done over k in a step, by Simpson's rule for the force; in one that was cut
    short the stiffness goes straight."""
    k0, k1 = kappa(c.springs, xi), kappa(c.springs, end)
    k01 = 0.5 * (k0 + k1) if broke else kappa(c.springs, middle)
    slid = c.moves * h
    return slid * (k0 * x + 4.0 * k01 * (x + 0.5 * slid) + k1 * (x + slid)) / 6.0


@routine(inline=True)
def hazard_of_step(h: float, rate: float, between: float, last: float) -> float:
    """Hazard of a step, by Simpson's rule."""
    return h * (rate + 4.0 * between + last) / 6.0


@routine
def meeting(c: Pinned, path: Path, h: float, end: float) -> tuple[Any, Any, Any]:
    """Draw when in a step the threshold has met the stretch (Michael, Schucany and
    Haas, 1976). Returns the length of the step until then, the common value of both,
    and the next draw."""
    a, b, d, _ = midpoints(path.key, path.contact, path.life, path.draw)
    z, _ = normals_of(a, b)
    x, gap = path.x, path.xi - path.x
    mean = gap / max(abs(end - x - c.moves * h), 1e-300)
    y = mean * z * z / (gap * gap / (variance_rate(c.aging) * h))
    # the smaller root, without cancellation
    ratio = mean * 2.0 / (2.0 + y + math.sqrt(y * (4.0 + y)))
    if d > mean / (mean + ratio):
        ratio = mean * (mean / ratio)
    h = h * ratio / (1.0 + ratio) if ratio < 1e15 else h
    return h, x + c.moves * h, path.draw + 1


@routine
def burn(
    c: Pinned, path: Path, h: float, end: float, rates: Rates
) -> tuple[Any, Any, Any, Any, Any]:
    """Break a contact by heat in a step, if its clock runs out. Returns whether it
    does, the length of the step until then, the threshold at its end, the hazard spent
    and the next draw."""
    rate, between, last, slope = rates
    draw, xi, left = path.draw, path.xi, path.left
    spent, scatter = hazard_of_step(h, rate, between, last), 0.0
    # the average over bridges has a spread of its own, which keeps some contacts pinned
    if spent > _SCATTERS:
        a, b, _, _ = midpoints(path.key, path.contact, path.life, draw)
        draw += 1
        z, _ = normals_of(a, b)
        scatter = slope * math.sqrt(variance_rate(c.aging) * h / 12.0)
        scatter = scatter if scatter < 1.0 else 0.0
        factor = exp(scatter * (z - 0.5 * scatter))
        rate, between, last = rate * factor, between * factor, last * factor
        spent *= factor
    if spent < left:
        return False, h, end, spent, draw
    # where: Newton for the integral of the parabola through the three rates
    bend, curve = 4.0 * between - 3.0 * rate - last, 2.0 * (rate - 2.0 * between + last)
    part = left / spent
    for _ in range(8):
        here = max(rate + part * (bend + part * curve), 1e-3 * spent / h)
        done = h * part * (rate + part * (0.5 * bend + part * curve / 3.0))
        part = min(max(part + (left - done) / (h * here), 0.0), 1.0)
    # bridges scatter differently before the end: what that does to the mean part, to
    # first order in scatter^2 (derived)
    shift = scatter * scatter * (6.0 * part * (1.0 - part) - 1.0)
    part = min(part * (1.0 + shift), 1.0)
    return True, part * h, xi + part * (end - xi), left, draw


@routine(inline=True)
def conclude(
    c: Pinned, path: Path, h: float, end: float, met: bool, passage: float, rates: Rates
) -> tuple[Any, Any, Any, Any, Any]:
    """End a step in which the threshold has met the stretch, if that is `confirmed`, or
    heat may break the contact. Returns whether it breaks, the length of the step until
    then, the threshold at its end, the hazard spent and the next draw."""
    broke = met and confirmed(c, path.xi, path.x, h, end, passage)
    draw, spent = path.draw, 0.0
    if broke:
        h, end, draw = meeting(c, path, h, end)
    if thermal(c.barrier):
        xi, x = path.xi, path.x
        if broke:
            spread = 0.5 * math.sqrt(variance_rate(c.aging) * h)
            half, last = heats(c, Halfway(0.5 * (xi + end), spread), x, h, end)
            rates = Rates(rates.first, half, last, rates.slope)
        now = moved(path, draw, xi, x, path.left)
        burnt, h, end, spent, draw = burn(c, now, h, end, rates)
        broke = broke or burnt
    return broke, h, end, spent, draw


# ---- one path, or many ----


@routine(inline=True)
def moved(path: Path, draw: int, xi: float, x: float, left: float) -> Path:
    """A path after a step."""
    return Path(path.key, path.contact, path.life, draw, xi, x, left)


@routine(inline=True)
def walk(c: Pinned, path: Path, most: float, step: float) -> tuple[Any, Any, Any, Any]:
    """One step, at most `most` long. Returns whether the contact broke, its path from
    there, the length of the step, and the work done over k where the stiffness varies.
    """
    xi, x, left = path.xi, path.x, path.left
    h, rate, slope = pace(c, xi, x, left, most, step)
    normal, square, passage, draw = random_step(
        path.key, path.contact, path.life, path.draw, c.aging.shape
    )
    along, end, lost = move(c, xi, h, normal, square)
    met, middle = meets(c, xi, x, h, end, passage), halfway(c, xi, along, end, lost)
    between, last = heats(c, middle, x, h, end) if thermal(c.barrier) else (0.0, 0.0)
    rates, now = Rates(rate, between, last, slope), moved(path, draw, xi, x, left)
    broke, h, end, spent, draw = conclude(c, now, h, end, met, passage, rates)
    varies = c.springs.slope > 0.0
    work = work_of(c, xi, x, h, end, middle.threshold, broke) if varies else 0.0
    return broke, moved(path, draw, end, x + c.moves * h, left - spent), h, work


@routine(inline=True)
def stride(
    c: Pinned, path: Path, most: float, step: float
) -> tuple[Any, Any, Any, Any]:
    """`walk` of a stretch of either sign, in the direction of motion; a step ends where
    that is 0."""
    back = path.x < 0.0
    side = -1.0 if back else 1.0
    most = min(most, -path.x) if back and c.moves > 0.0 else most
    mirrored = Pinned(c.barrier, c.springs, c.aging, side * c.moves)
    there = moved(path, path.draw, path.xi, side * path.x, path.left)
    broke, path, h, work = walk(mirrored, there, most, step)
    return broke, moved(path, path.draw, path.xi, side * path.x, path.left), h, work


@routine
def follow(
    c: Pinned, path: Path, length: float, step: float
) -> tuple[Any, Any, Any, Any]:
    """Follow a path for a `length` of time at most. Returns whether the contact breaks,
    its path there or at the end, the time until then, and the work done over k where
    the stiffness varies."""
    broke, elapsed, total = False, 0.0, 0.0
    while not broke and elapsed < length:
        broke, path, h, work = stride(c, path, length - elapsed, step)
        elapsed += h
        total += work
    return broke, path, elapsed, total


class Paths(NamedTuple):
    """Lives to be followed, arrays (n,): contact and number of each life, threshold at
    birth and clock at breaking; and results: stretch at breaking, and int (k_i/k) x dx
    until then."""

    contact: Array
    number: Array
    threshold: Array
    clock: Array
    travel: Array
    work: Array


class Walkers(NamedTuple):
    """Paths that advance side by side, arrays (WALKERS,)."""

    number: Array  # which of the `Paths` each is, -1 if none
    contact: Array
    life: Array
    draw: Array
    xi: Array  # threshold
    x: Array  # stretch
    left: Array  # rest of the clock
    work: Array  # so far
    h: Array  # the step, as in `walk`, up to `spent`
    rate: Array
    slope: Array
    along: Array
    end: Array
    lost: Array
    between: Array
    last: Array
    spent: Array
    normal: Array  # deviates of the step, up to `u`
    square: Array
    passage: Array
    u: Array
    broke: Array
    special: Array  # numbers of lanes that need `conclude`

    @classmethod
    def empty(cls) -> "Walkers":
        """Walkers without paths."""
        whole, real = np.zeros((5, WALKERS), np.int64), np.zeros((17, WALKERS))
        return cls._make((*whole[:4], *real, np.zeros(WALKERS, np.bool_), whole[4]))


@routine
def draw_steps(key: Key, shape: float, w: Walkers, count: int) -> None:
    """Fill the deviates of `random_step` for many paths."""
    contact, life, draw = w.contact, w.life, w.draw
    normal, square, passage, u = w.normal, w.square, w.passage, w.u
    for i in range(count):
        drawn = midpoints(key, contact[i], life[i], draw[i])
        normal[i], square[i], u[i], passage[i] = drawn
        draw[i] += 1
    for i in range(count):
        normal[i], square[i] = normals_of(normal[i], square[i])
    pairs = pairs_of(shape)
    if pairs < 0:
        for i in range(count):
            square[i] = try_chi_square(key, contact[i], life[i], draw[i], shape, u[i])
            draw[i] += 1
        for i in range(count):
            while square[i] == 0.0:
                square[i] = try_chi_square(
                    key, contact[i], life[i], draw[i], shape, u[i]
                )
                draw[i] += 1
        return
    for done in range(1, pairs, 4):
        for i in range(count):
            u[i] = times_uniforms(key, contact[i], life[i], draw[i], u[i], pairs - done)
            draw[i] += 1
    for i in range(count):
        square[i] = chi_square(shape, square[i], u[i])


@routine
def begin_paths(
    w: Walkers, paths: Paths, lanes: int, count: int, begun: int, laws: Pinned
) -> tuple[int, int]:
    """Store the ends of broken paths among the first `count` of `w.special`, and begin
    others in their lanes. Returns the number of lanes in use, and of paths begun."""
    for j in range(count - 1, -1, -1):  # backwards, so that no broken path fills a gap
        i = w.special[j]
        if not w.broke[i]:
            continue
        done = w.number[i]
        if done >= 0:
            paths.travel[done] = w.x[i]
            work = 0.5 * laws.springs.constant * w.x[i] * w.x[i]
            paths.work[done] = w.work[i] if laws.springs.slope > 0.0 else work
        if begun < paths.threshold.size:
            w.number[i] = begun
            w.contact[i] = paths.contact[begun]
            w.life[i] = paths.number[begun]
            w.draw[i] = 0
            w.xi[i] = paths.threshold[begun]
            w.x[i] = 0.0
            w.left[i] = paths.clock[begun]
            w.work[i] = 0.0
            begun += 1
        else:
            lanes -= 1
            for whole in (w.number, w.contact, w.life, w.draw):
                whole[i] = whole[lanes]
            for real in (w.xi, w.x, w.left, w.work):
                real[i] = real[lanes]
    return lanes, begun


@routine
def walk_all(c: Pinned, key: Key, step: float, paths: Paths, w: Walkers) -> None:
    """Follow lives from birth to breaking, the same bits as by `follow`. Paths advance
    side by side, one loop for each part of a step, and where one has ended the next
    begins."""
    xi, x, left, work, h, rate, slope = w.xi, w.x, w.left, w.work, w.h, w.rate, w.slope
    along, end, lost, between, last = w.along, w.end, w.lost, w.between, w.last
    spent, passage, broke, special = w.spent, w.passage, w.broke, w.special
    lanes = min(WALKERS, paths.threshold.size)
    for i in range(WALKERS):
        w.number[i] = -1
        broke[i] = True  # so that `begin_paths` fills the lane
        special[i] = i
        spent[i] = 0.0
    begun, count = 0, lanes
    while True:
        lanes, begun = begin_paths(w, paths, lanes, count, begun, c)
        if lanes == 0:
            return

        for i in range(lanes):
            h[i], rate[i], slope[i] = pace(c, xi[i], x[i], left[i], math.inf, step)
        draw_steps(key, c.aging.shape, w, lanes)
        for i in range(lanes):
            along[i], end[i], lost[i] = move(c, xi[i], h[i], w.normal[i], w.square[i])
        for i in range(lanes):
            broke[i] = meets(c, xi[i], x[i], h[i], end[i], passage[i])
        if thermal(c.barrier):
            for i in range(lanes):
                middle = halfway(c, xi[i], along[i], end[i], lost[i])
                between[i], last[i] = heats(c, middle, x[i], h[i], end[i])
            for i in range(lanes):
                spent[i] = hazard_of_step(h[i], rate[i], between[i], last[i])

        count = 0
        for i in range(lanes):
            special[count] = i
            count += broke[i] or spent[i] > _SCATTERS or spent[i] >= left[i]
        for j in range(count):
            i = special[j]
            path = Path(key, w.contact[i], w.life[i], w.draw[i], xi[i], x[i], left[i])
            rates = Rates(rate[i], between[i], last[i], slope[i])
            step_end = conclude(c, path, h[i], end[i], broke[i], passage[i], rates)
            broke[i], h[i], end[i], spent[i], w.draw[i] = step_end

        for i in range(lanes if c.springs.slope > 0.0 else 0):
            middle = halfway(c, xi[i], along[i], end[i], lost[i])
            work[i] += work_of(c, xi[i], x[i], h[i], end[i], middle.threshold, broke[i])
        for i in range(lanes):
            x[i] += h[i]
            xi[i] = end[i]
            left[i] -= spent[i]
