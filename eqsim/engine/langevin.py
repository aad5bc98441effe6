"""Thresholds that fluctuate while their contact is pinned (rule `langevin` of
`laws.aging`), followed to first passage.

A step of any length draws the threshold from its exact transition, so steps only have
to be short where something can happen in between: next to the stretch that comes up to
meet the threshold, and where the thermal rate counts. Far from both a step is so long
that it ends at least 1/STEP standard deviations away from them; close by it is never
shorter than what moves the threshold by a fraction STEP/4 of itself, or the barrier by
3 STEP in units of 2 kT, and by more where a break is unlikely. In a step

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
together for one path, `lives` for many side by side, a loop for each part, which the
compiler vectorises. What happens once a life, or to few paths at a time (`meeting`,
`burn`), is done for one path after the other.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from eqsim.engine.contacts import Contacts
from eqsim.laws.aging import Langevin
from eqsim.laws.barrier.base import height, height_slope, path_step, prefactor, thermal
from eqsim.laws.stiffness import Springs, kappa
from eqsim.numerics.compiled import routine
from eqsim.numerics.streams import Key, midpoints
from eqsim.numerics.tables import Array
from eqsim.numerics.vector_math import exp, exp_less_one, log, quarter_sine

STEP = 0.35  # the default accuracy of steps
STEP_ERROR = 1e-3  # what they may cost then, relative; falls as the square of STEP
WALKERS = 64  # paths that advance side by side
# heat counts where the hazard from here to the threshold is above exp(-7)
_UNSEEN = 7.0
_SCATTERS = 0.03  # hazard of a step from which on its scatter counts
_FIRST_ORDER, _BOUND = (
    0.05,
    0.4,
)  # ln of a factor up to which first order will do, and that bounds what it misses


class Pinned(NamedTuple):
    """The laws of a step: those of `Contacts` without tables, which would keep loops
    from vectorising; and how the stretch `moves` as time goes on: 1, 0 in a hold, -1 on
    the way back to 0."""

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


def step_error(law: Langevin, step: float = STEP, time: float = 1.0) -> float:
    """About the largest relative error of averages by steps of that accuracy. It grows
    with D_v = D/(v x_*i), from D_v = 100 on, as more of the few passages fall between
    two steps (measured against the Fokker-Planck equation: 0.9, 2.3 and 4.7 % at D_v =
    2.5e4, 2.5e5 and 2.5e6, n = 1, T = 0). In a hold its `time` takes the place of that
    in which the slider moves by x_*i."""
    return (
        STEP_ERROR
        * max(1.0, (0.25 * law.alpha * law.final2 * time / 100.0) ** 0.42)
        * (step / STEP) ** 2
    )


@routine(inline=True)
def pinned(c: Contacts) -> Pinned:
    """The laws of steps at constant velocity."""
    return Pinned(c.barrier, c.springs, c.aging, 1.0)


# -------------------------------------------------------------------------------------------------------
# deviates


@routine(inline=True)
def normals_of(u: float, v: float) -> tuple[float, float]:
    """A normal deviate and the square of another from two uniforms (Box and Muller)."""
    square = -2.0 * log(u)
    normal = math.sqrt(square) * quarter_sine(2.0 * v - 1.0)
    return normal, max(square - normal * normal, 0.0)


@routine(inline=True)
def pairs_of(shape: float) -> int:
    """How many pairs of squares of normals there are in chi-square of 2 shape + 1
    degrees of freedom; -1 if it is drawn in another way."""
    freedom = 2.0 * shape + 1.0
    return (
        int(freedom) // 2 if freedom == math.floor(freedom) and freedom < 14.0 else -1
    )


@routine(inline=True)
def times_uniforms(
    key: Key, contact: int, life: int, draw: int, product: float, count: int
) -> float:
    """`product` times min(count, 4) further uniforms."""
    a, b, d, e = midpoints(key, contact, life, draw)
    product *= a
    if count > 1:
        product *= b
    if count > 2:
        product *= d
    return product * e if count > 3 else product


@routine(inline=True)
def chi_square(shape: float, square: float, product: float) -> float:
    """Chi-square of 2 shape + 1 degrees of freedom from the square of a normal, and the
    product of a uniform for every pair of squares."""
    pairs = pairs_of(shape)
    odd = square if 2.0 * shape + 1.0 > 2.0 * pairs else 0.0
    return odd - 2.0 * log(product) if pairs > 0 else odd


@routine(inline=True)
def try_chi_square(
    key: Key, contact: int, life: int, draw: int, shape: float, u: float
) -> float:
    """Chi-square of 2 shape + 1 degrees of freedom, or 0, which means to try again with
    another draw but the same uniform `u` (Marsaglia and Tsang, 2000, for the shape 1/2
    + shape >= 1/2, raised by 1 if below 1)."""
    half, lift = shape + 0.5, 1.0
    if half < 1.0:
        lift, half = exp(log(u) / half), half + 1.0
    third = half - 1.0 / 3.0
    a, b, d, _ = midpoints(key, contact, life, draw)
    z, _ = normals_of(a, b)
    root = max(
        1.0 + z / math.sqrt(9.0 * third), 1e-30
    )  # so small, and below 0, it is refused
    cube = root * root * root
    taken = log(d) < 0.5 * z * z + third * (1.0 - cube + log(cube))
    return 2.0 * third * cube * lift if taken else 0.0


@routine(inline=True)
def random_step(
    key: Key, contact: int, life: int, draw: int, shape: float
) -> tuple[Any, Any, Any, Any]:
    """A normal deviate, a chi-square deviate of 2 shape + 1 degrees of freedom, a
    uniform, and the next draw."""
    a, b, product, passage = midpoints(key, contact, life, draw)
    draw += 1
    normal, square = normals_of(a, b)
    pairs = pairs_of(shape)
    if pairs < 0:
        square = 0.0
        while square == 0.0:
            square = try_chi_square(key, contact, life, draw, shape, product)
            draw += 1
        return normal, square, passage, draw
    for done in range(1, pairs, 4):
        product = times_uniforms(key, contact, life, draw, product, pairs - done)
        draw += 1
    return normal, chi_square(shape, square, product), passage, draw


# ------------------------------------------------------------------------------------------
# the physics of a step


@routine(inline=True)
def reaches(distance: float, spread: float, speed: float) -> float:
    """The h after which speed h + spread sqrt(h) = distance."""
    root = (
        2.0 * distance / (spread + math.sqrt(spread * spread + 4.0 * speed * distance))
    )
    return root * root


@routine(inline=True)
def heat(c: Pinned, xi: float, x: float) -> float:
    """Thermal rate per displacement at stretch `x` of a contact of threshold `xi`, or x
    if that is more."""
    xi = max(xi, x)
    a = c.barrier.b * kappa(c.springs, xi)
    return exp(c.barrier.log_w - height(c.barrier, xi, x, a)) * prefactor(
        c.barrier, xi, x
    )


@routine(inline=True)
def halfway(
    c: Pinned, xi: float, along: float, end: float, lost: float
) -> tuple[float, float]:
    """Threshold half-way through a step from `xi` to `end`, of which `along` is the
    component along the start, and its spread: the bridge of the (2n+2)-dimensional
    process, which pulls back within a relaxation time."""
    kept = 1.0 - lost
    spread2 = 0.5 * c.aging.final2 * lost / (1.0 + kept)
    square = (
        (xi * xi + 2.0 * xi * along + end * end) * kept / ((1.0 + kept) * (1.0 + kept))
    )
    return math.sqrt(square + (2.0 * c.aging.shape + 1.0) * spread2), math.sqrt(spread2)


@routine(inline=True)
def pace(
    c: Pinned, xi: float, x: float, left: float, most: float, step: float
) -> tuple[Any, Any, Any]:
    """How long a step from threshold `xi` and stretch `x` may be, at most `most`; the
    thermal rate now, and the slope of the barrier over 2 kT with the threshold."""
    step = (
        path_step(c.barrier)
        * step
        * (1.0 if c.moves > 0.0 or not thermal(c.barrier) else 0.5)
    )
    alpha = c.aging.alpha
    variance = 0.5 * alpha * c.aging.final2  # 2 D_v, per unit of displacement
    sigma, gap = (
        math.sqrt(variance),
        max(xi - x, 1e-16 * xi),
    )  # rounding may leave nothing
    speed = abs(c.moves) + max(
        0.0, variance * (xi / c.aging.final2 - (c.aging.shape + 0.5) / xi)
    )
    h = min(
        max(reaches(gap, sigma / step, speed), reaches(0.25 * step * xi, sigma, speed)),
        most,
    )
    h = most if c.moves == 0.0 and x == 0.0 else h  # no threshold comes down to 0
    if not thermal(c.barrier):
        return h, 0.0, 0.0
    k0 = kappa(c.springs, xi)
    a = c.barrier.b * k0
    barrier, rate = height(c.barrier, xi, x, a), heat(c, xi, x)
    slope = height_slope(c.barrier, xi, x, a)
    slope += barrier * c.springs.slope / k0
    while_here = gap if c.moves > 0.0 else max(gap, most)
    quiet = max(
        barrier - c.barrier.log_w - log(while_here), 0.0
    )  # -ln of the hazard over as much as the gap
    h = min(h, max(
        reaches(max(quiet - _UNSEEN, 0.0) / slope, sigma / step, speed),
        min(reaches(3.0 * step * (1.0 + 0.5 * quiet) / slope, sigma, speed), step * (1.0 + 0.5 * quiet) / alpha),
    ))  # fmt: skip
    # what comes long after the clock has stopped says little about when it stops
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
def swerve_of(
    c: Pinned,
    variance: float,
    xi: float,
    gap: float,
    touch: float,
    ahead: float,
    end: float,
) -> float:
    """What the drift away from 0, (n + 1/2)/xi, does to ln of the chance to touch, to
    first order in `variance`."""
    return (
        variance
        * (gap * ahead / (gap + ahead))
        * (0.25 - c.aging.shape * c.aging.shape)
        / (xi * touch * end)
    )


@routine(inline=True)
def pull_of(
    c: Pinned, variance: float, xi: float, gap: float, ahead: float, end: float
) -> float:
    """What the drift towards 0 does to it."""
    both = gap + ahead
    t, dip = (
        gap / both,
        2.0 * gap * ahead / both,
    )  # where straight paths touch, and how far below the direct one
    return (
        0.5
        * variance
        * dip
        * (xi * (2.0 - t) + end * (1.0 + t) - dip)
        / (3.0 * c.aging.final2 * c.aging.final2)
    )


@routine(inline=True)
def meets(c: Pinned, xi: float, x: float, h: float, end: float, passage: float) -> bool:
    """Whether a threshold that went from `xi` to `end` has met the stretch in between;
    `passage` is a uniform. Some of these passages are yet to be `confirmed`.

    The chance is that of a Brownian bridge kept away from 0, corrected for how the
    drift differs, to first order, on a path that touches and on one that does not.
    """
    gap, ahead = xi - x, end - x - c.moves * h
    variance = 0.5 * c.aging.alpha * c.aging.final2 * h
    if ahead <= 0.0:
        return True
    if 2.0 * gap * ahead >= 40.0 * variance:
        return False
    touch = x + gap / (gap + ahead) * (c.moves * h)
    swerve = swerve_of(c, variance, xi, gap, touch, ahead, end)
    if (
        c.aging.shape < 0.5 and swerve > _FIRST_ORDER
    ):  # a bound, which a process of 2n + 2 < 3 dimensions has next to 0
        swerve = (
            min(swerve, (0.5 - c.aging.shape) * log(xi * end / (touch * touch)))
            + _BOUND
        )
    per = -2.0 / variance
    zero = exp(xi * end * per)
    pull = pull_of(c, variance, xi, gap, ahead, end)
    return passage * (1.0 - zero) < (exp(gap * ahead * per) - zero) * exp(swerve + pull)


@routine
def confirmed(
    c: Pinned, xi: float, x: float, h: float, end: float, passage: float
) -> bool:
    """Whether a passage of `meets` holds: for n < 1/2 next to 0, where first order
    fails, by `touching`."""
    gap, ahead = xi - x, end - x - c.moves * h
    if c.aging.shape >= 0.5 or ahead <= 0.0:
        return True
    variance = 0.5 * c.aging.alpha * c.aging.final2 * h
    touch = x + gap / (gap + ahead) * (c.moves * h)
    if swerve_of(c, variance, xi, gap, touch, ahead, end) <= _FIRST_ORDER:
        return True
    pull = pull_of(c, variance, xi, gap, ahead, end)
    return passage < touching(
        c.aging.shape, touch + gap, touch + ahead, touch, variance
    ) * math.exp(pull)


@routine
def touching(n: float, a: float, b: float, r: float, t: float) -> float:
    """The chance that a bridge of the (2n+2)-dimensional Bessel process from a to b
    touches r < a, b in a time t, in which each component gathers the variance t
    (derived):

        exp(-(a-r)(b-r)/t) K(aq) K(bq) I(rs/t)/(K(rq) K(sq) I(ab/t)),   q = (a+b-2r)/t,   s = a+b-r

    with Bessel functions of order n. It is the saddle point of the inverse Laplace
    transform, with arguments such that it is exact for n = 1/2, at a = r and b = r and
    to first order in t. Of all passages in a step it misses 3e-3.
    """
    s, q = a + b - r, (a + b - 2.0 * r) / t
    low, high = r / t * s, a / t * b
    kept = (
        bessel_k(n, a * q)
        / bessel_k(n, r * q)
        * bessel_k(n, b * q)
        / bessel_k(n, s * q)
    )
    return (
        math.exp(-(a - r) * (b - r) / t)
        * kept
        * (low / high) ** n
        * bessel_i(n, low)
        / bessel_i(n, high)
    )


@routine
def bessel_i(n: float, z: float) -> float:
    """I_n(z) (2/z)^n Gamma(n+1), 0 <= n, 0 < z < 700."""
    square, k, term, total = 0.25 * z * z, 0.0, 1.0, 1.0
    while term > 1e-6 * total:
        k += 1.0
        term *= square / (k * (k + n))
        total += term
    return total


@routine
def bessel_k(n: float, z: float) -> float:
    """exp(z) K_n(z) to 1e-6, z > 0: the integral of exp(-z (cosh u - 1)) cosh(n u) over
    u > 0 by trapezoids."""
    width = 1.0 / math.sqrt(4.0 + z)
    total, u, exponent = 0.5, width, 0.0
    while exponent < 16.0:
        root = math.sinh(0.5 * u)
        exponent = 2.0 * z * root * root - n * u
        total += math.exp(-exponent) * 0.5 * (1.0 + math.exp(-2.0 * n * u))
        u += width
    return width * total


@routine(inline=True)
def heats(
    c: Pinned, xi: float, x: float, h: float, end: float, along: float, lost: float
) -> tuple[float, float]:
    """Thermal rates half-way, averaged over the bridge, and at the end."""
    middle, spread = halfway(c, xi, along, end, lost)
    slid = c.moves * h
    between = 0.5 * (
        heat(c, middle + spread, x + 0.5 * slid)
        + heat(c, middle - spread, x + 0.5 * slid)
    )
    return between, heat(c, end, x + slid)


@routine(inline=True)
def work_of(
    c: Pinned,
    xi: float,
    x: float,
    h: float,
    end: float,
    along: float,
    lost: float,
    broke: bool,
) -> float:
    """Work done over k in a step, by Simpson's rule for the force; in one that was cut
    short the stiffness goes straight."""
    k0, k1 = kappa(c.springs, xi), kappa(c.springs, end)
    middle, _ = halfway(c, xi, along, end, lost)
    k01 = 0.5 * (k0 + k1) if broke else kappa(c.springs, middle)
    slid = c.moves * h
    return slid * (k0 * x + 4.0 * k01 * (x + 0.5 * slid) + k1 * (x + slid)) / 6.0


@routine(inline=True)
def hazard(h: float, rate: float, between: float, last: float) -> float:
    """Hazard of a step, by Simpson's rule."""
    return h * (rate + 4.0 * between + last) / 6.0


@routine(inline=True)
def whole_work(c: Pinned, x: float, work: float) -> float:
    """Work done over k in a life that ended at `x`: `work`, that of all steps, where
    the stiffness varies."""
    return work if c.springs.slope > 0.0 else 0.5 * c.springs.constant * x * x


@routine
def meeting(c: Pinned, path: Path, h: float, end: float) -> tuple[Any, Any, Any]:
    """After which part of a step the threshold has met the stretch, both there, and the
    next draw (Michael, Schucany and Haas, 1976)."""
    a, b, d, _ = midpoints(path.key, path.contact, path.life, path.draw)
    z, _ = normals_of(a, b)
    x = path.x
    gap = path.xi - x
    mean, steep = (
        gap / max(abs(end - x - c.moves * h), 1e-300),
        gap * gap / (0.5 * c.aging.alpha * c.aging.final2 * h),
    )
    y = mean * z * z / steep
    ratio = (
        mean * 2.0 / (2.0 + y + math.sqrt(y * (4.0 + y)))
    )  # the smaller root, without cancellation
    if d > mean / (mean + ratio):
        ratio = mean * (mean / ratio)
    h = h * ratio / (1.0 + ratio) if ratio < 1e15 else h
    return h, x + c.moves * h, path.draw + 1


@routine(inline=True)
def cut_heats(
    c: Pinned, xi: float, x: float, h: float, end: float
) -> tuple[float, float]:
    """`heats` of a step cut short by a passage, which is short."""
    middle, spread = (
        0.5 * (xi + end),
        0.5 * math.sqrt(0.5 * c.aging.alpha * c.aging.final2 * h),
    )
    slid = c.moves * h
    between = 0.5 * (
        heat(c, middle + spread, x + 0.5 * slid)
        + heat(c, middle - spread, x + 0.5 * slid)
    )
    return between, heat(c, end, x + slid)


@routine
def burn(
    c: Pinned, path: Path, h: float, end: float, rates: Rates
) -> tuple[Any, Any, Any, Any, Any]:
    """Whether heat breaks a contact in a step, which ends there, the length of the
    step, the threshold at its end, the hazard spent and the next draw."""
    rate, between, last, slope = rates
    spent, scatter, draw, xi, left = (
        hazard(h, rate, between, last),
        0.0,
        path.draw,
        path.xi,
        path.left,
    )
    if (
        spent > _SCATTERS
    ):  # the average over bridges has a spread of its own, which keeps some contacts pinned
        a, b, _, _ = midpoints(path.key, path.contact, path.life, draw)
        draw += 1
        z, _ = normals_of(a, b)
        scatter = slope * math.sqrt(0.5 * c.aging.alpha * c.aging.final2 * h / 12.0)
        scatter = scatter if scatter < 1.0 else 0.0
        factor = exp(scatter * (z - 0.5 * scatter))
        rate, between, last, spent = (
            rate * factor,
            between * factor,
            last * factor,
            spent * factor,
        )
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
    part = min(
        part * (1.0 + scatter * scatter * (6.0 * part * (1.0 - part) - 1.0)), 1.0
    )
    return True, part * h, xi + part * (end - xi), left, draw


# ------------------------------------------------------------------------------------------------
# one path, or many


@routine(inline=True)
def moved(path: Path, draw: int, xi: float, x: float, left: float) -> Path:
    """A path after a step."""
    return Path(path.key, path.contact, path.life, draw, xi, x, left)


@routine(inline=True)
def walk(c: Pinned, path: Path, most: float, step: float) -> tuple[Any, Any, Any, Any]:
    """One step, at most `most` long. Returns whether the contact broke, its path from
    there, the length of the step, and the work done over k where the stiffness varies.
    """
    xi, x = path.xi, path.x
    h, rate, slope = pace(c, xi, x, path.left, most, step)
    normal, square, passage, draw = random_step(
        path.key, path.contact, path.life, path.draw, c.aging.shape
    )
    along, end, lost = move(c, xi, h, normal, square)
    broke, spent = (
        meets(c, xi, x, h, end, passage) and confirmed(c, xi, x, h, end, passage),
        0.0,
    )
    if broke:
        h, end, draw = meeting(c, moved(path, draw, xi, x, path.left), h, end)
    if thermal(c.barrier):
        between, last = (
            cut_heats(c, xi, x, h, end)
            if broke
            else heats(c, xi, x, h, end, along, lost)
        )
        now = moved(path, draw, xi, x, path.left)
        burnt, h, end, spent, draw = burn(
            c, now, h, end, Rates(rate, between, last, slope)
        )
        broke = broke or burnt
    work = (
        work_of(c, xi, x, h, end, along, lost, broke) if c.springs.slope > 0.0 else 0.0
    )
    return broke, moved(path, draw, end, x + c.moves * h, path.left - spent), h, work


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
    broke, path, h, work = walk(
        mirrored, moved(path, path.draw, path.xi, side * path.x, path.left), most, step
    )
    return broke, moved(path, path.draw, path.xi, side * path.x, path.left), h, work


@routine
def follow(
    c: Pinned, path: Path, length: float, step: float
) -> tuple[Any, Any, Any, Any]:
    """Whether a contact breaks within a `length` of time, its path from there or from
    the end, after how long, and the work done over k until then where the stiffness
    varies."""
    broke, elapsed, total = False, 0.0, 0.0
    while not broke and elapsed < length:
        broke, path, h, work = stride(c, path, length - elapsed, step)
        elapsed += h
        total += work
    return broke, path, elapsed, total


class Paths(NamedTuple):
    """Lives to be followed, arrays (n,): contact and number of each life, threshold at
    birth and clock at breaking; and what they come to: stretch at breaking, and int
    (k_i/k) x dx until then."""

    contact: Array
    number: Array
    threshold: Array
    clock: Array
    travel: Array
    work: Array


class Walkers(NamedTuple):
    """Paths that advance side by side, arrays (WALKERS,).

    Attributes
    ----------
    number, contact, life, draw : ndarray of int
        Which of the `Paths` each is, -1 if none; its stream of random numbers.
    xi, x, left, work : ndarray
        Where it is: threshold, stretch, rest of the clock, work so far.
    h, rate, slope, along, end, lost, between, last, spent : ndarray
        Its step, as in `walk`.
    normal, square, passage, u : ndarray
        Deviates of the step.
    broke : ndarray of bool
    special : ndarray of int
        Which of them need more than the usual.
    """

    number: Array
    contact: Array
    life: Array
    draw: Array
    xi: Array
    x: Array
    left: Array
    work: Array
    h: Array
    rate: Array
    slope: Array
    along: Array
    end: Array
    lost: Array
    between: Array
    last: Array
    spent: Array
    normal: Array
    square: Array
    passage: Array
    u: Array
    broke: Array
    special: Array

    @classmethod
    def empty(cls) -> "Walkers":
        """None on their way."""
        whole, real = np.zeros((5, WALKERS), np.int64), np.zeros((17, WALKERS))
        return cls._make((*whole[:4], *real, np.zeros(WALKERS, np.bool_), whole[4]))


@routine
def draw_steps(key: Key, shape: float, walkers: Walkers, count: int) -> None:
    """`random_step` of many paths."""
    contact, life, draw = walkers.contact, walkers.life, walkers.draw
    normal, square, passage, u = (
        walkers.normal,
        walkers.square,
        walkers.passage,
        walkers.u,
    )
    for i in range(count):
        normal[i], square[i], u[i], passage[i] = midpoints(
            key, contact[i], life[i], draw[i]
        )
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
    """Note the ends of broken paths among the first `count` of `w.special`, and begin
    others in their lanes: the number of lanes in use, and of paths begun."""
    for j in range(
        count - 1, -1, -1
    ):  # from the end, so that no broken path fills a gap
        i = w.special[j]
        if not w.broke[i]:
            continue
        done = w.number[i]
        if done >= 0:
            paths.travel[done] = w.x[i]
            paths.work[done] = whole_work(laws, w.x[i], w.work[i])
        if begun < paths.threshold.size:
            w.number[i], w.contact[i], w.life[i], w.draw[i] = (
                begun,
                paths.contact[begun],
                paths.number[begun],
                0,
            )
            w.xi[i], w.x[i], w.left[i], w.work[i] = (
                paths.threshold[begun],
                0.0,
                paths.clock[begun],
                0.0,
            )
            begun += 1
        else:
            lanes -= 1
            w.number[i], w.contact[i], w.life[i], w.draw[i] = (
                w.number[lanes],
                w.contact[lanes],
                w.life[lanes],
                w.draw[lanes],
            )
            w.xi[i], w.x[i], w.left[i], w.work[i] = (
                w.xi[lanes],
                w.x[lanes],
                w.left[lanes],
                w.work[lanes],
            )
    return lanes, begun


@routine
def walk_all(c: Pinned, key: Key, step: float, paths: Paths, w: Walkers) -> None:
    """Follow lives from birth to breaking, the same bits as by `follow`.

    Paths advance side by side, one loop for each part of a step, and where one has
    ended the next begins.
    """
    xi, x, left, work, h, rate, slope = w.xi, w.x, w.left, w.work, w.h, w.rate, w.slope
    along, end, lost, between, last, spent = (
        w.along,
        w.end,
        w.lost,
        w.between,
        w.last,
        w.spent,
    )
    passage, broke, special = w.passage, w.broke, w.special
    lanes = min(WALKERS, paths.threshold.size)
    for i in range(WALKERS):
        w.number[i] = -1
        broke[i] = True  # as idle lanes are
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
                between[i], last[i] = heats(
                    c, xi[i], x[i], h[i], end[i], along[i], lost[i]
                )
            for i in range(lanes):
                spent[i] = hazard(h[i], rate[i], between[i], last[i])

        count = 0
        for i in range(lanes):
            special[count] = i
            count += broke[i] or spent[i] > _SCATTERS or spent[i] >= left[i]
        for j in range(count):
            i = special[j]
            path = Path(key, w.contact[i], w.life[i], w.draw[i], xi[i], x[i], left[i])
            if broke[i] and not confirmed(c, xi[i], x[i], h[i], end[i], passage[i]):
                broke[i] = False
            if broke[i]:
                h[i], end[i], w.draw[i] = meeting(c, path, h[i], end[i])
            if thermal(c.barrier):
                if broke[i]:
                    between[i], last[i] = cut_heats(c, xi[i], x[i], h[i], end[i])
                rates = Rates(rate[i], between[i], last[i], slope[i])
                now = moved(path, w.draw[i], xi[i], x[i], left[i])
                burnt, h[i], end[i], spent[i], w.draw[i] = burn(
                    c, now, h[i], end[i], rates
                )
                if burnt:
                    broke[i] = True

        for i in range(lanes if c.springs.slope > 0.0 else 0):
            work[i] += work_of(
                c, xi[i], x[i], h[i], end[i], along[i], lost[i], broke[i]
            )
        for i in range(lanes):
            x[i] += h[i]
            xi[i] = end[i]
            left[i] -= spent[i]
