"""The engine with aging thresholds: steps of a path, lives, trajectories and steady
averages against the references.

Statistical limits: |z| < 4.5 for single scores (false alarm 7e-6 each, some 700 of
them: 5e-3), p > 1e-5 for Kolmogorov-Smirnov tests (some 30: 3e-4). All seeds are fixed.
"""

import functools
import itertools
import math
import time
from dataclasses import replace

import numba
import numpy as np
import pytest
import scipy.stats
from cases import chosen
from kernels import compiled
from rows import BASIC, basic
from scipy.interpolate import CubicSpline

from eqsim import (
    Aging,
    Delay,
    Drive,
    Ensemble,
    Gamma,
    Thermal,
    reference,
    steady,
    trajectory,
)
from eqsim.engine import langevin
from eqsim.engine.contacts import contacts
from eqsim.engine.langevin import (
    STEP,
    WALKERS,
    Path,
    Paths,
    Walkers,
    pinned,
)
from eqsim.engine.sample import Source, lives
from eqsim.engine.stationary import stationary, stretches, whole_lives
from eqsim.master.fokker_planck import survival_of_fluctuating
from eqsim.master.transient import transient
from eqsim.model.reduced import reduced
from eqsim.numerics.streams import key

halfway, meeting, meets = (
    compiled(langevin.halfway),
    compiled(langevin.meeting),
    compiled(langevin.meets),
)
pace, touching = compiled(langevin.pace), compiled(langevin.touching)
follow, walk_all = compiled(langevin.follow), compiled(langevin.walk_all)

LIMIT, RARE = 4.5, 1e-5
STEPS = 1e-3  # what steps of the default accuracy may cost, relative (documented in `engine.langevin`)

# ----------------------------------------------------------------------------------------------------------
# steps


@numba.njit
def _deviates(stream, shape, count):
    found = np.empty((count, 3))
    for i in range(count):
        found[i, 0], found[i, 1], found[i, 2], _ = langevin.random_step(
            stream, i // 50, 3, (i % 50) * 1000, shape
        )
    return found


@chosen(
    "n", (0.3, 0.5, 6.0, 1.0, 0.0, 2.5, 10.7), (0.3, 6.0)
)  # of a small shape, and of sums
def test_deviates_of_a_step(n):
    """A normal, a chi-square of 2n+1 and a uniform deviate, not correlated: 60 000
    each."""
    found = _deviates(key(1, 99), n, 60_000)
    assert scipy.stats.kstest(found[:, 0], "norm").pvalue > RARE
    assert (
        scipy.stats.kstest(found[:, 1], scipy.stats.chi2(2 * n + 1).cdf).pvalue > RARE
    )
    assert scipy.stats.kstest(found[:, 2], "uniform").pvalue > RARE
    # control
    assert (
        scipy.stats.kstest(found[:, 1], scipy.stats.chi2(2.1 * n + 1.1).cdf).pvalue
        < RARE
    )
    for i, j in ((0, 1), (0, 2), (1, 2)):
        for power in (1, 2):
            assert (
                scipy.stats.spearmanr(np.abs(found[:, i]) ** power, found[:, j]).pvalue
                > RARE
            )
            assert scipy.stats.spearmanr(found[:, i], found[:, j]).pvalue > RARE


def crossing(c, xi, x, h, end):
    """The probability with which `meets` says that the stretch is met, by bisection in
    its uniform."""
    low, high = 0.0, 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if meets(c, xi, x, h, end, middle) else (low, middle)
    return low


def bridged(n, final, mobility, xi, x, h, end, bare, paths=20_000, cells=200):
    """The same and its error from Brownian bridges, weighted by what the drift b of the
    threshold makes of them: exp(-int (b^2/4D_v + b'/2) dx) (Girsanov), of which each
    cell meets the stretch like a bridge of its own. Without weights the probability is
    `bare`: the control variate."""
    rng, share = np.random.default_rng(17), np.arange(cells + 1) / cells
    walk = np.cumsum(
        rng.normal(0.0, math.sqrt(2 * mobility * h / cells), (paths, cells)), axis=1
    )
    walk = np.concatenate((np.zeros((paths, 1)), walk), axis=1)
    y = xi + walk - share * walk[:, -1:] + share * (end - xi)
    # what falls so low has met the stretch long before
    gap, safe = (y - x - share * h, np.maximum(y, 0.05))
    drift = mobility * ((2 * n + 1) / safe - 2 * safe / final**2)
    slope = mobility * (-(2 * n + 1) / safe**2 - 2 / final**2)
    weight = np.exp(
        -np.trapezoid(drift**2 / (4 * mobility) + slope / 2, dx=h / cells, axis=1)
    )
    pairs = np.maximum(gap[:, 1:], 0.0) * np.maximum(gap[:, :-1], 0.0)
    kept = np.prod(-np.expm1(-pairs / (mobility * h / cells)), axis=1)
    weight /= weight.mean()
    mean, plain = (weight * kept).mean(), kept.mean()
    return bare + plain - mean, np.std(
        weight * (kept - mean) - (kept - plain)
    ) / math.sqrt(paths)


@pytest.mark.parametrize(
    ("n", "final", "mobility", "xi", "x", "h", "end"),
    [
        (12.0, 2.0, 1.0, 3.5, 3.2, 0.1, 3.6),  # repelled by 0
        (0.5, 0.5, 0.4, 1.0, 0.8, 0.1, 1.1),  # pulled back, not repelled
        (2.5, 1.0, 0.4, 1.0, 0.75, 0.1, 1.05),  # both
        (12.0, 2.0, 1.0, 3.5, 3.05, 0.1, 3.6),  # a rarer passage
    ],
)
def test_the_drift_in_a_passage(n, final, mobility, xi, x, h, end):
    """What the drift of the threshold does to the logarithm of the chance that a step
    meets the stretch, as weighted Brownian bridges have it. `meets` takes it along
    straight ways, around which these scatter: it comes to be right where passages are
    rare, and is up to twice as large as it should be where they are likely."""
    c = pinned(
        contacts(Ensemble(Gamma(n), aging=Aging("langevin", mobility, final)), 1.0), 1.0
    )
    bare = math.exp(-(xi - x) * (end - x - h) / (mobility * h))
    exact, error = bridged(n, final, mobility, xi, x, h, end, bare)
    found, correction = (
        math.log(crossing(c, xi, x, h, end) / bare),
        math.log(exact / bare),
    )
    assert abs(correction - 0.8 * found) < 0.3 * abs(found) + LIMIT * error / exact
    assert abs(correction) > 2 * LIMIT * error / exact  # without it this would fail


@pytest.mark.parametrize(
    ("gap", "ahead", "length"),
    [(0.3, 0.3, 0.1), (0.1, 0.5, 0.2), (0.4, -0.2, 0.3), (1e-3, 0.2, 0.1)],
)
def test_when_a_passage_comes(gap, ahead, length):
    """The law of the first passage of a Brownian bridge of this length L over a line,
    from `gap` g0 above it to `ahead` g1 above it or below, by quadrature of its density
    g0/t^1.5 exp(-g0^2/4 D_v t) exp(-g1^2/4 D_v (L - t))/(L - t)^0.5 (reflection; 5000
    draws, p > 1e-5 in four cases). Of twice the mobility it is another."""
    c = pinned(contacts(Ensemble(aging=Aging("langevin", 0.5, 2.0)), 1.0), 1.0)
    paths = [Path(key(5, 99), i, 0, 0, 1.0 + gap, 1.0, math.inf) for i in range(5000)]
    drawn = np.array(
        [meeting(c, path, length, 1.0 + length + ahead)[:2] for path in paths]
    )
    # one sum, rounded
    np.testing.assert_allclose(drawn[:, 1], 1.0 + drawn[:, 0], rtol=1e-15)
    u = np.linspace(-30.0, 30.0, 4001)  # logarithm of t/(L - t)
    t, rest = length / (1 + np.exp(-u)), length / (1 + np.exp(u))

    def p_value(mobility):
        exponent = (gap * gap / t + ahead * ahead / rest) / (4 * mobility)
        # per unit of u
        density = np.exp(-exponent + exponent.min()) / np.sqrt(t * rest) / t * t * rest
        cdf = np.cumsum(density)
        return scipy.stats.kstest(
            np.log(drawn[:, 0] / (length - drawn[:, 0])),
            lambda at: np.interp(at, u, cdf / cdf[-1]),
        ).pvalue

    assert p_value(0.5) > RARE
    assert p_value(1.0) < RARE


@pytest.mark.parametrize("n", [0.0, 1.0, 6.0])
@pytest.mark.parametrize("final", [0.3, 1.0, 5.0])
@pytest.mark.parametrize("mobility", [0.01, 1.0])
def test_steps_keep_their_distance(n, final, mobility):
    """A step ends 1/STEP standard deviations short of where stretch and drifting
    threshold meet, or moves the threshold by no more than STEP/4 of itself, drift and
    slider included (T = 0)."""
    c = pinned(
        contacts(Ensemble(Gamma(n), aging=Aging("langevin", mobility, final)), 1.0), 1.0
    )
    for xi, part in itertools.product((0.3, 1.0, 3.0), (0.0, 0.3, 0.9, 0.999)):
        x, rest = part * xi, final**2 * (n + 0.5)  # where repulsion and pull are even
        h, *_ = pace(c, xi, x, math.inf, math.inf, STEP)
        drifted = math.sqrt(rest + (xi * xi - rest) * math.exp(-c.aging.alpha * h))
        scatter = math.sqrt(2 * mobility * h)
        far = drifted - x - h >= scatter / STEP * (1 - 1e-9)
        slight = max(xi - drifted, 0.0) + h + scatter <= 0.25 * STEP * xi * (1 + 1e-9)
        assert far or slight


# ----------------------------------------------------------------------------------------------------------
# lives

LIVES = 8_000
PATHS = [  # n, x_*f/x_*i, D_v, kT/(k x_*^2), omega x_*/v, barrier, stiffness
    (1.0, 10.0, 0.05, 0.0, 1.0, "soft", "uniform"),
    (1.0, 10.0, 1.0, 0.0, 1.0, "soft", "sqrt"),
    (0.0, 0.3, 0.3, 0.0, 1.0, "soft", "sqrt"),
    (2.5, 1.0, 3.0, 0.0, 1.0, "soft", "sqrt"),
    (1.0, 10.0, 1.0, 0.01, 20.0, "soft", "uniform"),
    (0.5, 3.0, 0.1, 0.1, 5.0, "soft", "sqrt"),
    (1.0, 10.0, 0.05, 0.1, 20.0, "stiff", "uniform"),
    (0.0, 0.3, 0.3, 0.1, 20.0, "stiff", "sqrt"),
    (6.0, 2.0, 0.3, 0.2, 10.0, "stiff", "uniform"),
]


@chosen(  # the length is in relaxation times
    ("length", "shape"),
    itertools.product([0.1, 1.0, 4.0], [0, 1]),
    [(0.1, 0), (4.0, 1)],
)
def test_halfway_of_a_step(shape, length):
    """E xi^2 half-way of the (2n+2)-dimensional process, drawn component by component,
    given both ends: false alarm 5e-5 each. The half-way point of a straight line fails
    for long steps."""
    c = pinned(
        contacts(Ensemble(Gamma(shape, 1.0), aging=Aging("langevin", 1.0, 2.0)), 1.0),
        1.0,
    )
    rng, final = np.random.default_rng(5), 4.0  # x_*f^2

    def step(x):
        kept = math.exp(-length / 2)
        return kept * x + rng.normal(0, math.sqrt(0.5 * final * (1 - kept**2)), x.shape)

    start = np.zeros((100_000, 2 * shape + 2))
    start[:, 0] = rng.exponential(1.0, len(start))
    middle = step(start)
    end = step(middle)
    xi, there, last = (np.sqrt((x * x).sum(axis=1)) for x in (start, middle, end))

    lost = -math.expm1(-length)
    found = np.array(
        [halfway(c, *given, lost) for given in zip(xi, end[:, 0], last, strict=True)]
    )

    def score(expected):
        difference = there**2 - expected
        return difference.mean() / difference.std() * math.sqrt(len(difference))

    assert abs(score(found[:, 0] ** 2 + found[:, 1] ** 2)) < 4.06
    straight = (0.5 * (xi + last)) ** 2 + 0.25 * final * length / 2
    assert length < 1 or abs(score(straight)) > 4.06


def ensemble_of(path, factor=1.0):
    """The contacts of one `path` at v = 1, D times `factor`."""
    n, final, mobility, kT, omega, barrier, stiffness = path
    aging = Aging("langevin", factor * mobility, final)
    return Ensemble(
        Gamma(n), Thermal(kT, omega, barrier), aging=aging, stiffness_law=stiffness
    )


def lived(path, factor=1.0, many=LIVES):
    """Work and stretch of so many lives on one `path`, D_v times `factor`."""
    u, v = np.random.default_rng(11).random((2, many))
    return lives(
        contacts(ensemble_of(path, factor), 1.0), Source(key(2, 98), 0, STEP), u, v
    )[:2]


@functools.cache
def expected(path):
    return survival_of_fluctuating(reduced(ensemble_of(path), 1.0))


def distance(stretch, life):
    """Greatest difference between the empirical and the expected law, times sqrt(N)."""
    x = np.sort(stretch)
    spline = CubicSpline(np.log(life.x[1:]), life.values[0, 1:])
    cdf = 1 - np.where(
        x > life.x[-1], 0.0, spline(np.log(np.clip(x, life.x[1], life.x[-1])))
    )
    rank = np.arange(x.size) / x.size
    return max(np.max(cdf - rank), np.max(rank + 1 / x.size - cdf)) * math.sqrt(x.size)


@chosen("path", PATHS, [PATHS[0], PATHS[3]])  # cold; one kernel for both
def test_lives_of_fluctuating_thresholds(path):
    """S(x) of the Fokker-Planck equation (Kolmogorov: P(sqrt(N) D > 2.5) = 7e-6, and
    steps may move S by 1e-3), mean stretch and mean work (|z| < 4.5 beyond 1e-3)."""
    work, stretch = lived(path)
    life = expected(path)
    assert distance(stretch, life) < 2.5 + STEPS * math.sqrt(LIVES)
    for sample, exact in ((stretch, life.stretch), (work, life.work)):
        assert abs(
            sample.mean() - exact
        ) < STEPS * exact + LIMIT * sample.std() / math.sqrt(LIVES)


@chosen("path", [PATHS[1], PATHS[2], PATHS[4]], [PATHS[1], PATHS[2]])
def test_the_longest_life_of_a_stationary_start(path):
    """No more than some 1e-5 of all time is spent beyond it, by the Fokker-Planck
    equation. The longest of 2^15 paths say where that is: a factor 3 is left to chance,
    and it must not be much longer than it has to be."""
    longest = stationary(contacts(ensemble_of(path), 1.0)).longest

    def beyond(x):
        life = expected(path)
        inside = life.x > x
        return np.trapezoid(life.values[0, inside], life.x[inside]) / life.stretch

    assert beyond(longest) < 3e-5
    assert beyond(0.7 * longest) > 1e-5


@chosen("path", PATHS[:5], PATHS[:4])
def test_lives_with_another_rate_fail(path):
    """Negative control: D 20 % off."""
    assert distance(lived(path, 1.2)[1], expected(path)) > 2.5 + STEPS * math.sqrt(
        LIVES
    )


def test_steps_next_to_zero():
    """Two-dimensional paths that come close to 0 while the stretch is short hardly ever
    meet it: S(x) as above, of so many lives that 1 % of wrong breaks would show."""
    path, many = (0.0, 5.0, 5.0, 0.0, 1.0, "soft", "sqrt"), 100_000
    _, stretch = lived(path, many=many)
    assert distance(stretch, expected(path)) < 2.5 + STEPS * math.sqrt(many)


@chosen(
    ("r", "n"),
    itertools.product([1e-4, 1e-2, 0.1, 0.5], [0.0, 0.1, 0.3, 0.49]),
    itertools.product([1e-4, 0.5], [0.0, 0.49]),
)
def test_passages_next_to_zero(n, r):
    """The chance to touch r in a step of the default accuracy from 1: summed over all
    ends within 4e-3 of the inverse Laplace transform on a straight contour, at no end
    off by more than 5e-2. Control: a process of 0.1 dimensions more."""
    t = (0.35 * (1 - r)) ** 2
    u, weight = np.polynomial.legendre.leggauss(400)
    log_ahead = math.log(1e-6) + 0.5 * (u + 1) * math.log(2e6)
    b = r + np.exp(log_ahead)
    arrive = (
        weight
        * (b - r)
        * b
        / t
        * b**n
        * np.exp(-((1 - b) ** 2) / (2 * t))
        * scipy.special.ive(n, b / t)
    )
    y, share = np.polynomial.hermite_e.hermegauss(80)
    both = 1 + b - 2 * r
    q = both[:, None] / t + 1j * y / math.sqrt(t)

    def k(z):
        return np.sqrt(z) * scipy.special.kve(n, z)

    i = np.sqrt(r * q) * scipy.special.iv(n, r * q) * np.exp(-r * q)
    values = (
        (k(q) * k(b[:, None] * q) * i / k(r * q)).real
        @ share
        / share.sum()
        * math.sqrt(2 / math.pi)
    )
    exact = (
        np.exp(-2 * (1 - r) * (b - r) / t)
        * values
        / (np.sqrt(b / t) * scipy.special.ive(n, b / t))
    )

    def found(n):
        return np.array([touching(n, 1.0, end, r, t) for end in b])

    matter = arrive * exact > 1e-4 * np.max(arrive * exact)
    assert np.abs(found(n) / exact - 1)[matter].max() < 5e-2
    assert abs(arrive @ found(n) / (arrive @ exact) - 1) < 4e-3
    assert r == 0.5 or abs(arrive @ found(n + 0.05) / (arrive @ exact) - 1) > 8e-3


@pytest.mark.verification
@pytest.mark.parametrize("path", [
    (0.1, 22.8, 522.0, 0.0, 1.0, "soft", "sqrt"), (0.0, 22.8, 522.0, 1.0, 60.0, "soft", "uniform")
])  # fmt: skip
def test_thresholds_that_dive(path):
    """Few dimensions, growth and fluctuations carry thresholds down to the stretch
    again and again: mean stretch and S(x) as above, of so many lives that what first
    order makes of such passages, 5 % of the mean, is 12 of its standard errors.
    Control: D 20 % off."""
    many = 2**16
    life = expected(path)
    stretch, other = lived(path, many=many)[1], lived(path, 1.2, many)[1]
    allowed = STEPS * life.stretch + LIMIT * stretch.std() / math.sqrt(many)
    assert distance(stretch, life) < 2.5 + STEPS * math.sqrt(many)
    assert abs(stretch.mean() - life.stretch) < allowed
    assert (
        distance(other, life) > 2.5 + STEPS * math.sqrt(many)
        or abs(other.mean() - life.stretch) > allowed
    )


@pytest.mark.verification
@pytest.mark.parametrize(("lives_log2", "chance"), [(18, 2.8e-4), (20, 1.4e-4)])
def test_clocks_that_stop_within_a_step(lives_log2, chance):
    """Low barriers, early breaks: fluctuations change the mean stretch by some per
    mille, which a single step has to get right. `chance` is left of so many lives (1
    s.e. of the mean, from ten seeds); 4 of these are allowed."""
    path = (2.5, 6.0, 0.3, 3.0, 180.0, "stiff", "uniform")
    u, v = (
        scipy.stats.qmc.Sobol(2, rng=np.random.default_rng(1)).random(2**lives_log2).T
        + 2.0**-31
    )
    stretch = lives(
        contacts(ensemble_of(path), 1.0), Source(key(2, 99), 0, STEP), u, v
    ).travel
    assert abs(stretch.mean() / expected(path).stretch - 1) < 4 * chance


@pytest.mark.parametrize("path", [PATHS[2], PATHS[3]])
def test_work_of_a_stiffness_that_fluctuates(path):
    """Work under the sqrt law with the same lives under the uniform law as a control
    variate (at T = 0 they break at the same stretch): within 1e-3 and 4.5 of what
    errors are left."""
    size = 25_000
    u, v = np.random.default_rng(12).random((2, size))
    excess = []
    for law in ("sqrt", "uniform"):
        one = (*path[:6], law)
        work, stretch, *_ = lives(
            contacts(ensemble_of(one), 1.0), Source(key(3, 98), 0, STEP), u, v
        )
        life = expected(one)
        excess += [work / life.work - 1.0, stretch / life.stretch - 1.0]
    basis = np.stack((excess[2], excess[3], np.ones(size)), axis=1)
    fit = np.linalg.lstsq(basis, excess[0])[0]
    assert abs(fit[2]) < STEPS + LIMIT * np.std(excess[0] - basis @ fit) / math.sqrt(
        size
    )


def _one_by_one(c, stream, contact, births, clocks):
    """Stretches at breaking and work of one contact after the other."""
    paths = [
        Path(stream, contact + i, 2, 0, births[i], 0.0, clocks[i])
        for i in range(births.size)
    ]
    ends = [follow(c, path, math.inf, STEP) for path in paths]
    assert all(broke for broke, *_ in ends)
    varies, constant = c.springs.slope > 0.0, c.springs.constant
    return np.array(
        [
            (path.x, work if varies else 0.5 * constant * path.x**2)
            for _, path, _, work in ends
        ]
    ).T


@chosen("path", [*PATHS, (0.3, *PATHS[1][1:]), (1.3, *PATHS[5][1:])], [])
def test_paths_side_by_side_as_one_by_one(path):
    """To the last bit, however many there are and whatever else advances beside them."""
    c = pinned(contacts(ensemble_of(path), 1.0), 1.0)
    size, stream = 5 * WALKERS // 2, key(2, 97)
    births, clocks = np.random.default_rng(13).exponential(size=(2, size)) + 0.1
    single = _one_by_one(c, stream, 5, births, clocks)
    for first, last in ((0, size), (3, WALKERS), (7, 8), (9, 9)):
        part, travel, work = (
            slice(first, last),
            np.zeros(last - first),
            np.zeros(last - first),
        )
        contact, number = np.arange(5 + first, 5 + last), np.full(last - first, 2)
        paths = Paths(contact, number, births[part], clocks[part], travel, work)
        walk_all(c, stream, STEP, paths, Walkers.empty())
        np.testing.assert_array_equal((travel, work), single[:, part])
    # control: other contacts
    assert np.all(_one_by_one(c, stream, 6, births, clocks)[0] != single[0])


@pytest.mark.parametrize("rate", [0.01, 1.0, 4.0])
@pytest.mark.parametrize("law", ["uniform", "sqrt"])
def test_steps_of_bonds_are_as_long_as_their_rate_allows(law, rate):
    """Where heat counts, a step is one in which stretch and spread of the threshold
    together change ln of the off-rate by 3 STEP, but for the drift and the product of
    both changes. A bond that a threshold hardly changes is not followed as one whose
    barrier it makes."""
    heat = Thermal(barrier="bell", off_rate=1.0, force_scale=0.004)
    bond = Ensemble(
        Gamma(1.5), heat, aging=Aging("langevin", rate, 2.0), stiffness_law=law
    )
    c, xi, x = pinned(contacts(bond, 1.0), 1.0), 1.5, 0.02
    h, *_ = pace(c, xi, x, math.inf, math.inf, STEP)
    spread = math.sqrt(0.5 * c.aging.alpha * c.aging.final2 * h)

    def log_rate(xi, x):
        return c.barrier.b * (c.springs.constant + c.springs.slope * xi) * x

    changed = log_rate(xi + spread, x + h) - log_rate(xi, x)
    assert 2.5 * STEP < changed < 3.3 * STEP


@pytest.mark.verification
def test_steps_of_many_paths_vectorise():
    """Packed roots and products of doubles in loops over paths; there are none where a
    path is alone."""
    c, stream = pinned(contacts(ensemble_of(PATHS[4]), 1.0), 1.0), key(0, 0)
    paths = Paths(np.arange(3), np.arange(3), *np.ones((4, 3)))
    walk_all(c, stream, STEP, paths, Walkers.empty())
    follow(c, Path(stream, 0, 0, 0, 1.0, 0.0, 1.0), math.inf, STEP)

    def packed(function):
        (assembly,) = (
            asm
            for (given,), asm in function.inspect_asm().items()
            if given.types[0] == numba.typeof(c)
        )
        return assembly.count("mulpd")

    many, one = packed(walk_all), packed(follow)
    assert many > 30
    assert one < 5


# ---------------------------------------------------------------------------------------------------
# trajectories

UNIT = {"thresholds": Gamma(1.0, 0.1), "thermal": Thermal(0.01)}
RUNS = {
    "flow sqrt": Ensemble(**UNIT, delay=Delay(0.1), aging=Aging("flow", 0.1, 1.0), count=20_000),
    "flow uniform exponential": Ensemble(
        **UNIT, delay=Delay(0.1, "exponential"), aging=Aging("flow", 0.1, 1.0), stiffness_law="uniform", eta=0.3,
        count=20_000,
    ),
    "langevin sqrt": Ensemble(
        **UNIT, delay=Delay(0.1), aging=Aging("langevin", 0.1, 1.0), stiffness_law="sqrt", count=2_000
    ),
    "flow weaker": Ensemble(
        Gamma(0.5), Thermal(0.2, 2.0, "stiff"), Delay(0.4), Aging("flow", 0.5, 0.2), stiffness_law="sqrt", count=20_000
    ),
    "langevin sqrt exponential": Ensemble(
        **UNIT, delay=Delay(0.3, "exponential"), aging=Aging("langevin", 0.02, 1.0), count=4_000, eta=0.2
    ),
    "langevin uniform": Ensemble(
        Gamma(1.0), Thermal(0.1, 3.0), Delay(0.5), Aging("langevin", 0.2, 0.7), stiffness_law="uniform", count=2_000
    ),
    "langevin cold exponential": Ensemble(
        Gamma(0.0), delay=Delay(0.5, "exponential"), aging=Aging("langevin", 0.3, 2.0), stiffness_law="uniform",
        count=2_000,
    ),
    "annealed sqrt": Ensemble(
        **UNIT, delay=Delay(0.1), aging=Aging("langevin", 0.1, 1.0), disorder="annealed", count=20_000
    ),
    "annealed uniform exponential": Ensemble(
        Gamma(2.5), Thermal(0.3, 1.0, "stiff"), Delay(0.5, "exponential"), Aging("flow", 0.5, 0.4),
        stiffness_law="uniform", disorder="annealed", count=20_000,
    ),
}  # fmt: skip
# what is known only so well, relative: C of annealed births (`_SETTLED`) and steps of
# paths Both rules that need paths, with and without heat, each stiffness law and delay
# law.
CHOSEN = [
    "flow sqrt",
    "flow uniform exponential",
    "langevin sqrt",
    "langevin cold exponential",
]
KNOWN = {"annealed": 2e-4, "langevin": STEPS, "flow": 1e-6}


@functools.cache
def run(name, start, points=21, seed=4):
    ensemble = RUNS[name]
    return trajectory(
        ensemble, Drive(1.0, 2.0, start), points=points, seed=seed, threads=2
    )


@functools.cache
def fresh(name):
    return transient(RUNS[name], Drive(1.0, 2.0), points=21)


def scores(result, exact_force, exact_pinned, known):
    """Force and pinned at every grid point that is not certain, in standard errors
    beyond `known` relative."""
    found = []
    for value, stderr, exact in (
        (result.force, result.force_stderr, exact_force),
        (result.pinned, result.pinned_stderr, exact_pinned),
    ):
        excess = np.maximum(np.abs(value - exact) - known * np.abs(exact), 0.0)
        random = stderr > 0
        found.append(np.where(excess[~random] < 1e-12, 0.0, np.inf))  # certain
        found.append(excess[random] / stderr[random])
    return np.concatenate(found)


@chosen("name", RUNS, ["flow sqrt", "langevin sqrt"])
def test_fresh_start(name):
    """F(X) and pinned(X) from a fresh start at 21 points, 40 scores a run, against the
    renewal equation."""
    exact = fresh(name)
    known = KNOWN[name.split()[0]] + 1e-5
    assert scores(run(name, "fresh"), exact.force, exact.pinned, known).max() < LIMIT


@pytest.mark.verification
@chosen("name", RUNS, ["flow sqrt"])
def test_stationary_start(name):
    """Level from X = 0 on, at 21 points (42 scores), and in the averages over the
    second half (3 scores)."""
    exact, known = reference(RUNS[name], Drive(1.0)), KNOWN[name.split()[0]]
    result = run(name, "stationary")
    assert scores(result, exact.friction.value, exact.pinned.value, known).max() < LIMIT
    for name, late in basic(result.averages):
        value = getattr(exact, name).value
        assert late.reliable
        assert abs(late.value - value) < LIMIT * late.stderr + known * value


@pytest.mark.parametrize("name", ["flow sqrt", "langevin sqrt"])
def test_the_variance_of_aging_stiffness(name):
    """Forces that are no ramps leave their squares point by point: the quoted error is
    the scatter of 300 ensembles of 40 contacts at four points, to 4.5/sqrt(2 300) and
    the 0.9 of a normal law that 40 contacts have."""
    ensemble = replace(RUNS[name], count=40)
    found = trajectory(
        ensemble, Drive(1.0, 0.8), points=5, replicas=300, seed=2, threads=2
    )
    quoted = found.force_stderr * math.sqrt(300)
    np.testing.assert_allclose(
        found.force_replica_std[1:], quoted[1:], rtol=1.1 * LIMIT / math.sqrt(2 * 300)
    )


@pytest.mark.verification  # its kernels are those of no other test
def test_delays_longer_than_any_life_in_a_stationary_start():
    """Cycles are found in proportion to their length, and what is found detached waits
    for the rest of its delay: force and pinned fraction at nine points, |z| < 4.5 in 18
    scores."""
    ensemble = Ensemble(
        Gamma(1.0, 0.1),
        delay=Delay(20.0),
        aging=Aging("langevin", 0.1, 1.0),
        stiffness_law="uniform",
        count=4000,
    )
    found = trajectory(ensemble, Drive(1.0, 4.0, "stationary"), points=9, threads=2)
    exact = reference(ensemble, Drive(1.0))
    assert exact.break_stretch.value < 0.5
    assert scores(found, exact.friction.value, exact.pinned.value, STEPS).max() < LIMIT


@pytest.mark.verification
def test_stationary_averages_over_seeds():
    """6 seeds of N = 640, flow and sqrt law: mean (|z| < 4.5) and scatter (chi-square,
    p > 1e-4) of their scores are those of normal deviates, for each of three averages.
    """
    ensemble = Ensemble(
        **UNIT, delay=Delay(0.1), aging=Aging("flow", 0.1, 1.0), count=640
    )
    exact = reference(ensemble, Drive(1.0))
    runs = [
        trajectory(ensemble, Drive(1.0, 2.0, "stationary"), points=3, seed=seed)
        for seed in range(6)
    ]
    for name in BASIC:
        found = [getattr(run.averages, name) for run in runs]
        z = np.array(
            [(one.value - getattr(exact, name).value) / one.stderr for one in found]
        )
        assert abs(z.mean()) * math.sqrt(6) < LIMIT
        assert 1e-4 < scipy.stats.chi2.cdf(np.sum(z**2), 6) < 1 - 1e-4


@pytest.mark.parametrize("name", ["flow sqrt", "langevin sqrt"])
def test_negative_controls(name):
    """The other rule, D 10 % off, and births instead of survivors at X = 0 do not pass."""
    ensemble, result = replace(RUNS[name], count=60_000), run(name, "fresh")
    other = "flow" if ensemble.aging.rule == "langevin" else "langevin"
    wrong = replace(ensemble, aging=replace(ensemble.aging, rule=other))
    exact = transient(wrong, Drive(1.0, 2.0), points=21)
    assert scores(result, exact.force, exact.pinned, 1e-3).max() > LIMIT
    wrong = replace(
        ensemble, aging=replace(ensemble.aging, rate=1.1 * ensemble.aging.rate)
    )
    exact = fresh(name)
    result = trajectory(wrong, Drive(1.0, 2.0), points=21, threads=2)
    assert scores(result, exact.force, exact.pinned, 1e-3).max() > LIMIT
    level = reference(ensemble, Drive(1.0))
    assert scores(result, level.friction.value, level.pinned.value, 1e-3).max() > 10.0


@chosen(  # contacts whose thresholds flow are in test_portable.py, too
    "name", ["flow sqrt", "langevin sqrt exponential"], []
)
def test_same_bits_for_any_threads(name):
    ensemble = replace(RUNS[name], count=600)
    if ensemble.disorder == "annealed":
        ensemble = replace(ensemble, aging=replace(ensemble.aging, rate=math.inf))
    for replicas in (1, 3):
        runs = [
            trajectory(
                ensemble,
                Drive(1.0, 1.0, "stationary"),
                points=31,
                threads=threads,
                replicas=replicas,
            )
            for threads in (1, 2)
        ]
        for field in (
            "force",
            "force_stderr",
            "pinned",
            "pinned_stderr",
            "force_replica_std",
        ):
            first, second = (getattr(one, field) for one in runs)
            assert first is second is None or first.tobytes() == second.tobytes()
        assert runs[0].averages == runs[1].averages
        assert runs[0].lives == runs[1].lives


@pytest.mark.verification
@pytest.mark.parametrize(
    "name",
    ["flow sqrt", "flow uniform exponential", "langevin uniform", "annealed sqrt"],
)
def test_a_finer_grid_sees_the_same(name):
    """Where steps do not end at grid points, every tenth point of a fine grid is the
    coarse one, to rounding."""
    coarse, fine = (run(name, "stationary", points) for points in (21, 201))
    # deposits are rounded to units of 2^-62 of a bound on the sum over contacts; ten
    # times as many are added up
    np.testing.assert_allclose(fine.force[::10], coarse.force, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(fine.pinned[::10], coarse.pinned)
    assert fine.averages.friction.value == pytest.approx(
        coarse.averages.friction.value, rel=1e-12, abs=0
    )


def test_grids_of_steps():
    """The sqrt law under `langevin` ends its steps at grid points: 2 and 401 points
    both agree with the reference."""
    exact = reference(RUNS["langevin sqrt"], Drive(1.0))
    for points in (2, 401):
        result = run("langevin sqrt", "stationary", points)
        # 802 scores
        assert (
            scores(result, exact.friction.value, exact.pinned.value, STEPS).max()
            < LIMIT + 0.5
        )
        late = result.averages.friction
        assert abs(late.value - exact.friction.value) < LIMIT * late.stderr + STEPS


@chosen(  # by default those whose paths are followed along the grid
    "name", ["flow sqrt", "langevin sqrt", "langevin uniform"], ["langevin sqrt"]
)
def test_conservation(name):
    """Every contact is pinned or detached: with a huge drag the force counts the
    detached ones; without delay all are pinned at every X."""
    ensemble = replace(RUNS[name], count=300, eta=1e6)
    result = trajectory(ensemble, Drive(1.0, 1.0, "stationary"), points=11)
    # the elastic force, some lengths of a threshold, is less than 200 beside a drag of
    # 1e6
    np.testing.assert_allclose(
        result.force / 1e6, 1.0 - result.pinned, rtol=0, atol=2e-4
    )
    # a count over 300, times 300: rounding alone, far below the distance to the next
    # count
    assert np.all(np.abs(result.pinned * 300 - np.rint(result.pinned * 300)) < 1e-9)
    for start in ("fresh", "stationary"):
        result = trajectory(
            replace(ensemble, delay=Delay(), eta=0.0), Drive(1.0, 1.0, start), points=11
        )
        assert np.all(result.pinned == 1.0)


# ---------------------------------------------------------------------------------------------------------
# steady


@chosen("name", RUNS, CHOSEN)
def test_steady(name):
    """Steady averages to 1e-2 (paths) or 2e-4 against the reference: |z| < 4.5 in three
    averages. So few paths need not call their error bars reliable."""
    exact, known = reference(RUNS[name], Drive(1.0)), KNOWN[name.split()[0]]
    paths = RUNS[name].fluctuates
    found = steady(RUNS[name], Drive(1.0), rel_error=1e-2 if paths else 2e-4)
    for name, one in basic(found):
        level = getattr(exact, name)
        assert one.reliable or paths
        assert (
            abs(one.value - level.value)
            < LIMIT * one.stderr + known * level.value * paths
        )


@pytest.mark.verification
@chosen("stiffness", ("sqrt", "uniform"), ["sqrt"])
def test_limits(stiffness):
    """No aging at D -> 0; the final law at infinite rate, with the newborn rms; weaker
    contacts; and fluctuations that lower friction at large D_v."""
    base = {
        "thresholds": Gamma(1.0, 0.5),
        "thermal": Thermal(0.05),
        "stiffness_law": stiffness,
    }
    plain = steady(Ensemble(**base), Drive(1.0), rel_error=1e-4).friction
    for rule, disorder in (
        ("flow", "quenched"),
        ("langevin", "quenched"),
        ("flow", "annealed"),
    ):
        slow = Ensemble(**base, aging=Aging(rule, 1e-12, 1.0), disorder=disorder)
        like = (
            plain
            if disorder == "quenched"
            else steady(Ensemble(**base, disorder=disorder), Drive(1.0)).friction
        )
        found = steady(slow, Drive(1.0), rel_error=2e-3).friction
        assert abs(found.value - like.value) < LIMIT * math.hypot(
            found.stderr, like.stderr
        )
    for final in (1.0, 0.2):
        aged = steady(
            Ensemble(Gamma(1.0, final), Thermal(0.05), stiffness_law="uniform"),
            Drive(1.0),
            rel_error=1e-4,
        )
        for disorder in ("quenched", "annealed"):
            at_once = Ensemble(
                **(base | {"thermal": Thermal(0.0)}),
                aging=Aging("flow", math.inf, final),
                disorder=disorder,
            )
            found = steady(at_once, Drive(1.0), rel_error=1e-4).friction
            # T = 0: <x^2>/2<x> of the final law, times <x^3>/<x> over the newborn rms
            # for the sqrt law
            if stiffness == "uniform":
                exact = final * 4.0 / (3.0 * math.sqrt(math.pi))
            else:
                exact = 0.5 * 2.5 * final**2 / (0.5 * math.sqrt(2.0))
            assert abs(found.value - exact) < LIMIT * found.stderr + 1e-8
        if stiffness == "uniform":
            found = steady(
                Ensemble(**base, aging=Aging("flow", math.inf, final)),
                Drive(1.0),
                rel_error=1e-4,
            ).friction
            assert abs(found.value - aged.friction.value) < LIMIT * math.hypot(
                found.stderr, aged.friction.stderr
            )
    few = [
        steady(
            Ensemble(**base, aging=Aging("langevin", rate, 0.5)),
            Drive(1.0),
            rel_error=1e-2,
        ).friction.value
        for rate in (1e-6, 0.1, 1.0, 10.0)
    ]
    assert np.all(np.diff(few) < -0.05 * np.array(few[:-1]))


def test_flow_of_strong_cold_contacts():
    """Where the barrier of a contact about to break is known to some units only, by
    rounding of its threshold: a life took seconds. The break is at the threshold to
    1e-14, and friction is that of the reference."""
    ensemble = Ensemble(
        Gamma(300.0), Thermal(0.5 / 2.6e5), aging=Aging("flow", 57.9, 579.0)
    )
    c, stretch = contacts(ensemble, 1.0), np.empty(2000)
    xi, ends, hazard = np.full((3, 2000), np.linspace(15.0, 20.0, 2000))
    whole_lives(c, xi, ends, hazard)
    stretches(c, xi[:1], np.ones(1), np.empty(1))  # compiles
    begin = time.thread_time()
    stretches(c, xi, np.ones(2000), stretch)
    assert time.thread_time() - begin < 1.0  # of some 0.01
    np.testing.assert_allclose(stretch, ends, rtol=1e-14)
    found, exact = (
        steady(ensemble, Drive(1.0), rel_error=1e-2).friction,
        reference(ensemble, Drive(1.0)).friction,
    )
    assert abs(found.value - exact.value) < LIMIT * math.hypot(
        found.stderr, exact.stderr
    )


@chosen("v", [1e-17, 1e-18, 1e-20, 1e-90], [1e-17, 1e-90])
def test_flow_with_the_shortest_lives(v):
    """Hot contacts with the sqrt law break after 1/omega, before they have slid 1e-17
    x_* or far less, while their thresholds grow: friction within 4.5 errors of some
    3e-5. Without growth it is more than 50 errors away."""
    ensemble = Ensemble(thermal=Thermal(1000.0), aging=Aging("flow", 0.5, 3.0))
    found = steady(ensemble, Drive(v), rel_error=1e-2).friction
    assert (
        abs(found.value - reference(ensemble, Drive(v)).friction.value)
        < LIMIT * found.stderr
    )
    still = steady(replace(ensemble, aging=Aging()), Drive(v), rel_error=1e-2).friction
    assert abs(still.value / found.value - 1) > 50 * found.stderr / found.value


@pytest.mark.verification
@pytest.mark.parametrize(("v", "annealed", "flow", "langevin"), [
    (0.01, 0.746793, 0.752253, 0.228496), (1.0, 0.347086, 0.463275, 0.333598), (10.0, 0.0986062, 0.108048, 0.100408)
])  # fmt: skip
def test_given_friction(v, annealed, flow, langevin):
    """x_*i = .1, x_*f = 1, D = .1, T = 0, uniform stiffness (six printed digits), by
    `steady`."""
    for rule, disorder, exact in (
        ("flow", "annealed", annealed), ("flow", "quenched", flow), ("langevin", "quenched", langevin)
    ):  # fmt: skip
        ensemble = Ensemble(
            Gamma(1.0, 0.1),
            aging=Aging(rule, 0.1, 1.0),
            stiffness_law="uniform",
            disorder=disorder,
        )
        found = steady(
            ensemble, Drive(v), rel_error=1e-2 if exact == langevin else 1e-4
        ).friction
        assert (
            abs(found.value - exact)
            < LIMIT * found.stderr + (STEPS if exact == langevin else 1e-6) * exact
        )


def test_what_steps_cost_depends_on_relaxations_in_the_final_scale():
    """Or in the newborn one, if that is smaller; and on those in the time of a hold."""

    def error(rate, final, time=None):
        law = Aging("langevin", rate, final).law(Gamma(1.0), 1.0)
        return langevin.step_error(law, time=time)

    assert error(1.0, 1.0) == langevin.STEP_ERROR == error(1e-2, 0.1)
    for relaxed in (1e3, 1e4):
        same = [error(relaxed * final, final) for final in (1.0, 0.3, 0.1)]
        same += [
            error(relaxed, 5.0),
            error(1.0, 1.0, relaxed),
            error(0.1, 0.1, relaxed / 10),
        ]
        assert same == pytest.approx([same[0]] * 6, rel=1e-12, abs=0)
    assert error(1e4, 1.0, 0.5) < error(1e4, 1.0)
    # by how much mean lives were measured to be too long
    for relaxed, measured in ((1e3, 4.0e-3), (1e4, 1.7e-2), (1e5, 3.8e-2)):
        assert measured < error(relaxed, 1.0) < 2.0 * measured


@pytest.mark.long
@pytest.mark.parametrize(("rate", "final"), [(1e4, 1.0), (1e3, 0.1), (100.0, 0.1)])
def test_fast_relaxation_towards_weaker_contacts(rate, final):
    """The cost of the steps is quoted (|z| < 4.5 beyond it for 2 averages: false alarm
    1e-5), and steps that are asked for 1 % cost a third of that."""
    aging = Aging("langevin", rate, final)
    ensemble = Ensemble(Gamma(1.0), aging=aging, stiffness_law="uniform")
    exact = reference(ensemble, Drive(1.0))
    for accuracy in (0.1, 0.01):
        found = steady(ensemble, Drive(1.0), rel_error=accuracy, seed=11)
        assert found.hidden <= 1.01 * accuracy / 3.0
        for name in ("friction", "travel"):
            mean, right = getattr(found, name), getattr(exact, name).value
            scatter = math.sqrt(mean.stderr**2 - (found.hidden * right) ** 2)
            assert abs(mean.value - right) < found.hidden * right + 4.5 * scatter
            assert mean.stderr < (found.hidden + 5e-3) * right
