"""The reference for contacts born stretched: against a table of exact values, closed
forms, identities of the master equation, and lives drawn one by one. Closed forms are
derived; rho is r/x_*, lengths are in x_*."""

import math
from pathlib import Path

import mpmath
import numpy as np
import pandas as pd
import pytest
import scipy.stats
from cases import chosen
from scipy import integrate, special

from eqsim import (
    Delay,
    Delta,
    Distribution,
    Drive,
    Ensemble,
    Gamma,
    InputError,
    Pareto,
    Programme,
    Segment,
    Stage,
    Table,
    Thermal,
    reference,
    steady,
    trajectory,
    z_score,
)
from eqsim.laws.newborn import Newborn
from eqsim.master.closure import closure
from eqsim.master.curves import StationaryState
from eqsim.master.stability import stability
from eqsim.master.transient import fluctuations, transient

ROWS = pd.read_csv(Path(__file__).parents[1] / "data" / "newborn.csv")
NAMES = (
    "friction",
    "pinned",
    "break_stretch",
    "travel",
    "birth_stretch",
    "force_variance",
)
NUMBERS = {
    "delta": ("stretch",),
    "uniform": ("low", "high"),
    "exponential": ("mean",),
    "normal": ("mean", "std"),
}
F_K0, C_0 = 0.75225277806367505, 1.3293403881791370  # 4/(3 sqrt(pi)), 3 sqrt(pi)/4


def born(law, *numbers, of="length"):
    return Newborn(law, of, **dict(zip(NUMBERS[law], numbers, strict=True)))


def contacts(newborn, disorder="quenched", law=None, **more):
    given = {"stiffness_law": "uniform", "thermal": Thermal(0.0, 1.0)}
    return Ensemble(
        thresholds=law or Gamma(1.0),
        newborn=newborn,
        disorder=disorder,
        **(given | more),
    )


def solve(newborn, disorder="quenched", v=1.0, **more):
    return reference(contacts(newborn, disorder, **more), Drive(v))


def covered(estimate, exact):
    """Whether the quoted error covers the truth, which is known to rounding."""
    return abs(estimate.value - exact) <= estimate.stderr + 1e-14 * abs(exact)


@pytest.mark.parametrize("row", list(ROWS.itertuples()), ids=lambda row: row.id)
def test_table(row):
    """Every row to ten times its own accuracy, or 1e-7; the quoted errors are no larger
    than that."""
    newborn = born(
        row.birth_law,
        *[row.birth_a, row.birth_b][: len(NUMBERS[row.birth_law])],
        of="threshold" if row.rule == "fraction" else "length",
    )
    ensemble = Ensemble(
        thresholds=Gamma(row.n, row.x_star)
        if row.threshold_law == "gamma"
        else Delta(row.x_star),
        thermal=Thermal(row.kT, row.attempt_frequency, row.barrier),
        delay=Delay(row.delay),
        eta=row.eta,
        stiffness=row.stiffness,
        stiffness_law=row.stiffness_law,
        disorder=row.disorder,
        newborn=newborn,
    )
    result = reference(ensemble, Drive(row.velocity))
    within = max(10 * row.rel_accuracy, 1e-7)
    for name in NAMES:
        estimate, value = getattr(result, name), getattr(row, name)
        # births that cancel are zero on the scale of x_*; a variance of next to nothing
        # is that of two squares
        size = {
            "birth_stretch": row.x_star,
            "force_variance": row.friction**2 + row.force_variance,
        }.get(name, 0.0)
        size = max(abs(value), size if abs(value) < 1e-4 * size else 0.0)
        assert estimate.value == pytest.approx(value, rel=0, abs=within * size), name
        assert estimate.stderr <= 1e-7 * size, name
    assert result.f_k.value * row.travel == pytest.approx(
        (row.friction * (row.travel + row.velocity * row.delay))
        - row.eta / row.stiffness * row.velocity**2 * row.delay,
        rel=within,
        abs=0,
    )


# -------------------------------------------------------------------------------------------------
# T = 0, exactly


def erfcx_travel(r):
    return (0.75 * math.sqrt(math.pi) * special.erfcx(r) + 0.5 * r) / (1 + r * r)


def f(z):
    si, ci = special.sici(z)
    return ci * math.sin(z) + (math.pi / 2 - si) * math.cos(z)


def uniform_travel_n0(r):
    hyper = float(mpmath.hyp2f2(1, 1, 1.5, 2, r * r))
    return (
        math.sqrt(math.pi)
        / (2 * r)
        * (
            math.sqrt(math.pi) / 2 * special.erfi(r)
            - r * r / math.sqrt(math.pi) * hyper
        )
    )


def exponential_travel_n0(m):
    s = 1 / m
    return (
        s
        / 4
        * math.exp(-s * s / 4)
        * (math.pi * special.erfi(s / 2) - special.expi(s * s / 4))
    )


def normal_travel_n0(sd):
    c = 1 / (2 * sd * sd) - 1
    root = math.sqrt(abs(c))
    positive = (math.atan if c > 0 else math.atanh)(root) / (
        sd * math.sqrt(2 * math.pi) * root
    )
    return 0.5 * (positive + math.sqrt(math.pi) / 2 + sd * math.sqrt(2 / math.pi))


C_1, C_00 = 0.75 * math.sqrt(math.pi), 0.5 * math.sqrt(math.pi)
CLOSED = [  # births, disorder, n, travel, work
    (("delta", 0.8), "quenched", 1.0, erfcx_travel(0.8), (1 + 0.32) / (1 + 0.64)),
    (("delta", 3.0), "annealed", 1.0, erfcx_travel(3.0), (1 + 4.5) / 10),
    (("delta", 0.8), "annealed", 0.0, C_00 * special.erfcx(0.8), 0.5),
    (("uniform", 0.0, 0.7), "quenched", 1.0, None, 0.5 + math.atan(0.7) / 1.4),
    (("uniform", 0.0, 0.7), "quenched", 0.0, uniform_travel_n0(0.7), 0.5),
    (("uniform", 0.0, 3.0), "annealed", 0.0, uniform_travel_n0(3.0), 0.5),
    (("exponential", 0.5), "quenched", 1.0, None, 0.5 + f(2.0)),
    (("exponential", 0.5), "annealed", 1.0, None, 0.5 + f(2.0)),
    (("exponential", 0.3), "annealed", 0.0, exponential_travel_n0(0.3), 0.5),
    (("exponential", 0.3), "quenched", 0.0, exponential_travel_n0(0.3), 0.5),
    (("delta", -0.9), "annealed", 1.0, C_1 + 0.9, (2 - 0.81) / 2),
    (("delta", -0.9), "annealed", 0.0, C_00 + 0.9, (1 - 0.81) / 2),
    (("delta", -2.5), "annealed", 0.0, C_00 + 2.5, (1 - 6.25) / 2),
    (
        ("uniform", -0.7, 0.7),
        "annealed",
        1.0,
        None,
        0.25 + math.atan(0.7) / 2.8 + (2 - 0.49 / 3) / 4,
    ),
    (
        ("normal", 0.0, 0.5),
        "annealed",
        0.0,
        normal_travel_n0(0.5),
        0.25 + (1 - 0.25) / 4,
    ),
    (
        ("normal", 0.0, 0.9),
        "annealed",
        0.0,
        normal_travel_n0(0.9),
        0.25 + (1 - 0.81) / 4,
    ),
]


@pytest.mark.parametrize(("law", "disorder", "n", "travel", "work"), CLOSED)
def test_closed_forms(law, disorder, n, travel, work):
    """Travel and work without heat, n = 0 and 1: the quoted errors cover the closed
    forms."""
    result = solve(born(*law), disorder, law=Gamma(n))
    assert covered(result.friction, work / result.travel.value)
    assert travel is None or covered(result.travel, travel)


@pytest.mark.parametrize("n", [0.0, 0.3, 1.0, 6.5])
@pytest.mark.parametrize("r", [0.01, 0.9, 4.0, -0.9])
def test_identical_births(n, r):
    """travel = E[xi | xi > |r|] - r, E[W] = (E[xi^2 | xi > |r|] - r^2)/2 and V =
    (E[xi^3 | xi > |r|] - r^3)/3 by incomplete gamma functions, which lose the digits by
    which the threshold is larger than the birth."""
    result = solve(born("delta", r), law=Gamma(n))
    J = special.gammaincc(n + 1, r * r)
    mean = [
        special.gammaincc(n + 1 + p / 2, r * r) * special.poch(n + 1, p / 2) / J
        for p in (1, 2, 3)
    ]
    travel, work, square = mean[0] - r, (mean[1] - r**2) / 2, (mean[2] - r**3) / 3
    for estimate, exact in (
        (result.travel, travel),
        (result.friction, work / travel),
        (result.force_variance, square / travel - (work / travel) ** 2),
    ):
        assert abs(estimate.value - exact) <= estimate.stderr + 1e-14 * abs(
            r
        ) ** 2 / travel + 1e-13 * abs(r)


@pytest.mark.parametrize("rho", [-0.9, -0.2, 0.3, 0.999])
def test_fractions(rho):
    """f_k = (1 + rho) f_k0 and travel = (1 - rho) C_0."""
    result = solve(born("delta", rho, of="threshold"))
    assert covered(result.f_k, (1 + rho) * F_K0)
    assert covered(result.travel, (1 - rho) * C_0)
    assert covered(result.birth_stretch, rho * C_0)


ANCHORS = [
    (("delta", 0.5), "quenched", 1.052915, 0.854770),
    (("uniform", 0.0, 0.5), "quenched", 0.888166, 1.084986),
    (("exponential", 0.3), "quenched", 0.894307, 1.057928),
    (("exponential", 1.0), "quenched", 1.129258, 0.717927),
    (("normal", 0.0, 0.5), "annealed", 0.665834, 1.348962),
    (("normal", 0.0, 0.5), "quenched", 0.673228, 1.368583),
    (("uniform", -0.5, 0.5), "annealed", 0.721376, (1.084986 + C_0 + 0.25) / 2),
    (("uniform", -0.5, 0.5), "quenched", 0.721841, None),
    (("delta", -0.5), "annealed", 0.478314, None),
    (("delta", -0.5), "quenched", 0.485235, None),
    (("delta", -1.0), "annealed", 0.214653, None),
    (("delta", -1.0), "quenched", 0.295951, None),
    (("delta", -1.5), "annealed", -0.044180, None),
    (("delta", -1.5), "quenched", 0.194464, None),
]


@pytest.mark.parametrize("disorder", ["quenched", "annealed"])
@pytest.mark.parametrize("a", [3.1, 3.5])
def test_tails_without_a_mean_square(a, disorder):
    """Pareto's law, sqrt law, heat that breaks 1e-13 of the contacts or none: work
    <xi^3 - y^2 xi>/(2 xi_rms) in a travel of <xi> - y (exact). The mean square of the
    force is infinite, and errors were 1e12 times the work, or not a number."""
    law, y = Pareto(a), 0.3
    work = (a / (a - 3.0) - y * y * law.mean) / (2.0 * law.rms)
    exact = work / (law.mean - y)
    heat = Thermal(0.1, 1e-14) if disorder == "annealed" else Thermal(0.0)
    contacts = Ensemble(law, heat, newborn=born("delta", y), disorder=disorder)
    found = reference(contacts, Drive(1.0)).friction
    assert abs(found.value - exact) <= found.stderr
    assert found.stderr < 1e-5 * exact


@pytest.mark.parametrize(("law", "disorder", "f_k", "travel"), ANCHORS)
def test_anchors(law, disorder, f_k, travel):
    """Values printed to six decimals."""
    result = solve(born(*law), disorder)
    assert result.f_k.value == pytest.approx(f_k, rel=0, abs=6e-7)
    assert travel is None or result.travel.value == pytest.approx(
        travel, rel=0, abs=6e-7
    )


def test_best_birth():
    """With a delay there is a best fraction: rho* = .31337, friction .471464 against
    .429306 of unstressed ones."""
    best = solve(
        born("delta", 0.31337, of="threshold"), delay=Delay(1.0)
    ).friction.value
    assert best == pytest.approx(0.471464, rel=0, abs=6e-7)
    assert reference(
        contacts(Newborn(), delay=Delay(1.0)), Drive(1.0)
    ).friction.value == pytest.approx(0.429306, rel=0, abs=6e-7)
    for rho in (0.30, 0.33):
        assert (
            solve(born("delta", rho, of="threshold"), delay=Delay(1.0)).friction.value
            < best
        )


# ---------------------------------------------------------------------------------------------------
# identities


@pytest.mark.parametrize("stiffness_law", ["uniform", "sqrt"])
@pytest.mark.parametrize(
    "law", [("delta", 0.7), ("uniform", 0.1, 1.5), ("exponential", 0.4)]
)
def test_theorem(law, stiffness_law):
    """Without heat, and births on y >= 0, literal contacts are those of the master
    equation."""
    quenched, annealed = (
        solve(born(*law), disorder, law=Gamma(0.5), stiffness_law=stiffness_law)
        for disorder in ("quenched", "annealed")
    )
    for name in ("friction", "travel", "force_variance"):
        one, other = getattr(quenched, name), getattr(annealed, name)
        assert abs(one.value - other.value) <= one.stderr + other.stderr, name


@pytest.mark.parametrize("kT", [0.0, 0.5])
@pytest.mark.parametrize("r", [-0.6, 0.4])
def test_slope(kT, r):
    """d f_k/dr = (f_k - r)/L(r) of identical births, at any temperature. Central
    differences: h^2 f'''/6 is about 1e-8, the errors over h are 2e-7."""
    h, thermal = 1e-4, Thermal(kT, 1.0)
    low, middle, high = (
        solve(born("delta", r + d), "annealed", 0.3, thermal=thermal)
        for d in (-h, 0.0, h)
    )
    slope = (high.f_k.value - low.f_k.value) / (2 * h)
    assert slope == pytest.approx(
        (middle.f_k.value - r) / middle.travel.value, rel=0, abs=1e-6
    )


def test_small_births():
    """f_k = f_k0 (1 + <y>/C_0 + O(y^2)), of symmetric ones f_k0 (1 - <y^2>/<xi^2> +
    O(y^4)): halving births halves the slope's error, and quarters that of the
    curvature."""
    errors = [
        solve(born("delta", y)).f_k.value / F_K0 - 1 - y / C_0 for y in (2e-3, 1e-3)
    ]
    assert errors[1] == pytest.approx(errors[0] / 4, rel=0.01, abs=0)
    errors = []
    for half in (0.2, 0.1):
        value = solve(born("uniform", -half, half), "annealed").f_k.value
        errors.append(value / F_K0 - 1 + half**2 / 3 / 2)
    assert abs(errors[1]) < abs(errors[0]) / 12


def test_far_births():
    """r -> infinity: f_k -> r + 1/(2 r), travel -> 1/(2 r)."""
    for r in (5.0, 10.0, 20.0):
        result = solve(born("delta", r))
        assert abs(result.f_k.value - r - 0.5 / r) < r**-5
        assert abs(result.travel.value * 2 * r - 1) < r**-2


# ------------------------------------------------------------------------------------------------
# sign, low velocity


def test_negative_friction():
    """Births against the motion that heat breaks before they turn round."""
    thermal = Thermal(1.0, 1.0)
    for disorder, value in (("quenched", -0.473656), ("annealed", -0.497898)):
        result = solve(born("delta", -0.5), disorder, 1e-3, thermal=thermal)
        assert result.friction.value == pytest.approx(value, rel=0, abs=6e-7)
        assert 0 < result.friction.stderr < 1e-9
        assert result.f_k.value == result.friction.value
    assert solve(
        born("delta", -0.5), "annealed", 1e-6, thermal=thermal
    ).friction.value == pytest.approx(
        -0.5,
        rel=0,
        abs=3e-6,  # a thousandth of what is missing at 1e-3
    )


def symmetric(v):
    return solve(
        born("uniform", -1.0, 1.0, of="threshold"), v=v, thermal=Thermal(3.0, 1.0)
    ).friction


def test_linear_creep():
    """Fractions between -1 and 1: friction/v -> (E[t^2 (1 - 2 a y^2)] - 1/2)/E[t], t =
    exp(a (xi^2 - y^2))/omega, as births in the layer xi - |y| < v/omega break
    mechanically on one side only; what is left is of first order in v."""
    a = 1 / 6

    def over(power, curved):
        def inner(xi):
            u, w = special.roots_legendre(60)
            t = np.exp(a * xi**2 * (1 - u**2)) ** power
            return (
                0.5
                * w
                @ (t * (1 - 2 * a * (xi * u) ** 2 if curved else 1))
                * 2
                * xi**3
                * math.exp(-(xi**2))
            )

        return integrate.quad(inner, 0, 9, epsabs=1e-13, epsrel=1e-13)[0]

    limit = (over(2, True) - 0.5) / over(1, False)
    assert limit == pytest.approx(0.677039, rel=0, abs=6e-7)
    at = [symmetric(v) for v in (1e-4, 1e-5)]
    first, second = at[0].value / 1e-4, at[1].value / 1e-5
    assert second == pytest.approx(limit, rel=0, abs=2e-6)
    # a straight line through both ends at the limit
    assert (10 * second - first) / 9 == pytest.approx(
        limit, rel=0, abs=2 * at[1].stderr / 1e-5
    )


@pytest.mark.verification
def test_linear_creep_forwards():
    """The same by the stationary density of each threshold, an initial-value problem
    upwards in x."""
    a, v, total = 1 / 6, 1e-3, np.zeros(2)
    x, weights = special.roots_legendre(24)
    for low, high in ((0, 0.1), (0.1, 1), (1, 2.5), (2.5, 6)):
        for node, weight in zip(x, weights, strict=True):
            xi = 0.5 * (low + high) + 0.5 * (high - low) * node
            solved = integrate.solve_ivp(
                lambda x, q, xi=xi: [0.5 / xi - math.exp(-a * (xi * xi - x * x)) / v * q[0], q[0], x * q[0]],
                (-xi, xi), [0, 0, 0], method="Radau", rtol=1e-11, atol=1e-17,
                jac=lambda x, q, xi=xi: [[-math.exp(-a * (xi * xi - x * x)) / v, 0, 0], [1, 0, 0], [x, 0, 0]],
            )  # fmt: skip
            total += (
                weight
                * 0.5
                * (high - low)
                * 2
                * xi**3
                * math.exp(-xi * xi)
                * solved.y[1:, -1]
            )
    estimate = symmetric(v)
    assert estimate.value == pytest.approx(
        total[1] / total[0], rel=1e-8, abs=estimate.stderr
    )


# ------------------------------------------------------------------------------------------------
# drawn lives


def pooled_rate(a, x):
    """E[exp(-a (xi^2 - x^2)); xi > x] of the gamma law with n = 1."""
    return (1 + (1 + a) * x * x) * np.exp(-x * x) / (1 + a) ** 2


def drawn(newborn, rng, count, kT, v, *, pooled=False, conditioned=True, ignored=False):
    """Births, breaks and forces over k of contacts with n = 1 thresholds and a soft
    barrier of k = omega = 1: draw y, xi and a clock, and add up the hazard cell by
    cell."""
    y = np.zeros(count) if ignored else {
        "delta": lambda: np.full(count, newborn.stretch),
        "uniform": lambda: rng.uniform(newborn.low, newborn.high, count),
        "normal": lambda: rng.normal(newborn.mean, newborn.std, count),
    }[newborn.law]()  # fmt: skip
    xi = np.sqrt(rng.gamma(2.0, size=count))
    if newborn.of == "threshold":
        y = y * xi
    else:
        bound = np.maximum(y, 0.0) if pooled else np.abs(y)
        while conditioned and (low := xi <= bound).any():
            xi[low] = np.sqrt(rng.gamma(2.0, size=int(low.sum())))
        xi = np.maximum(xi, y)
    a, cells, clock = 0.5 / kT, 500, rng.exponential(size=count)
    step, end, hazard = (xi - y) / cells, xi.copy(), np.zeros(count)
    for i in range(cells):
        x = np.abs(y + (i + 0.5) * step)
        rate = (
            pooled_rate(a, x)
            if pooled
            else np.where(x < xi, np.exp(-a * (xi**2 - x**2)), 1.0)
        )
        more = hazard + rate * step / v
        breaks = (hazard < clock) & (more >= clock)
        end[breaks] = (
            y + (i + (clock - hazard) / np.where(rate > 0, more - hazard, 1.0)) * step
        )[breaks]
        hazard = more
    return y, end


def scores(exact, y, end):
    """Standard-normal scores of travel, friction and mean square of the force."""
    travel = end - y
    found = [(travel.mean() - exact.travel.value) / (travel.std() / math.sqrt(y.size))]
    square = exact.force_variance.value + exact.friction.value**2
    for total, value in (
        ((end**2 - y**2) / 2, exact.friction.value),
        ((end**3 - y**3) / 3, square),
    ):
        residual = total - value * travel
        found.append(residual.mean() / (residual.std() / math.sqrt(y.size)))
    return np.abs(found)


DRAWN = [
    (born("uniform", -0.8, 0.9), "quenched"),
    (born("normal", 0.2, 0.5), "annealed"),
    (born("uniform", -0.9, 0.6, of="threshold"), "quenched"),
    (born("delta", -0.7), "quenched"),
    (born("delta", 0.5, of="threshold"), "annealed"),
]
COUNT, KT, V = 40_000, 0.4, 0.2


def exact_of(newborn, disorder):
    return solve(newborn, disorder, V, thermal=Thermal(KT, 1.0))


@chosen(("newborn", "disorder"), DRAWN, [DRAWN[0], DRAWN[4]])
def test_drawn_lives(newborn, disorder):
    """Fifteen scores below 4.5: one false alarm in 10^4. Cells of the midpoint rule are
    wrong by 1e-5, a hundredth of the statistical error."""
    lives = drawn(
        newborn, np.random.default_rng(5), COUNT, KT, V, pooled=disorder == "annealed"
    )
    assert (scores(exact_of(newborn, disorder), *lives) < 4.5).all()


def test_drawn_lives_notice():
    """Mistakes are seen: births ignored, thresholds not conditioned, the stretch at
    breaking for the travel."""
    newborn = born("delta", -0.7)
    exact, rng = exact_of(newborn, "quenched"), np.random.default_rng(6)
    assert scores(exact, *drawn(newborn, rng, COUNT, KT, V, ignored=True)).max() > 9
    assert (
        scores(exact, *drawn(newborn, rng, COUNT, KT, V, conditioned=False)).max() > 9
    )
    y, end = drawn(newborn, rng, COUNT, KT, V)
    assert scores(exact, 0 * y, end).max() > 9


# ---------------------------------------------------------------------------------------------------------
# corners


def test_short_lives():
    """Attempts so frequent that contacts hardly move: the mean travel is E[v/(omega
    r(y, xi))], for given births at y with n = 1, a = 1/(2 kT) < 1: (v/omega) E[exp(a
    (xi^2 - y^2)) | xi > y]. What is left is of the order of it."""
    v, a, y = 1e-9, 0.25, 0.6
    result = solve(born("delta", y), v=v, thermal=Thermal(2.0, 1.0))
    share = (1 + y * y) * math.exp(-y * y)
    mean = (
        math.exp(-a * y * y)
        * (1 + (1 - a) * y * y)
        * math.exp(-(1 - a) * y * y)
        / (1 - a) ** 2
        / share
    )
    assert result.travel.value == pytest.approx(v * mean, rel=1e-7, abs=0)
    assert result.friction.value == pytest.approx(y, rel=1e-7, abs=0)


@pytest.mark.parametrize("width", [0.03, 1e-6])
def test_births_in_a_small_part_of_the_way(width):
    """A narrow uniform law among strong contacts is one of identical births in its
    middle, but for width^2/24 times the second derivative, some 10 in units of the
    travel; panels that end at its jumps are much narrower than rounding allows to tell
    from one another."""
    thermal = Thermal(0.547, 1.0, "stiff")
    narrow, one = (
        solve(newborn, v=2.32e-6, law=Gamma(6.0), thermal=thermal, stiffness_law="sqrt")
        for newborn in (
            born("uniform", 0.02 - width / 2, 0.02 + width / 2),
            born("delta", 0.02),
        )
    )
    assert narrow.travel.stderr < 1e-9
    assert narrow.travel.value == pytest.approx(
        one.travel.value, rel=width**2 + 1e-9, abs=0
    )


@pytest.mark.parametrize("gap", [1e-3, 1e-9])
def test_births_next_to_breaking(gap):
    """Identical contacts without heat: f_k = (xi + r)/2 and travel xi - r, which 1 - r
    knows to 1e-16."""
    result = solve(born("delta", 1.0 - gap), law=Delta(1.0))
    assert result.travel.value == pytest.approx(gap, rel=1e-10 + 2e-16 / gap, abs=0)
    assert result.f_k.value == pytest.approx(1.0 - gap / 2, rel=1e-10, abs=0)
    near = solve(
        born("delta", 1.0 - gap, of="threshold"), thermal=Thermal(1.0, 1.0), v=1.0
    )
    assert near.travel.value == pytest.approx(gap * C_0, rel=2 * gap + 1e-7, abs=0)


@pytest.mark.parametrize("disorder", ["quenched", "annealed"])
@pytest.mark.parametrize("of", ["length", "threshold"])
def test_units(disorder, of):
    """The same contacts in nanometres: forces over k scale."""
    found = []
    for unit in (1.0, 1e-9):
        scale = unit if of == "length" else 1.0
        found.append(
            solve(
                born("uniform", -0.3 * scale, 0.5 * scale, of=of), disorder, 0.2 * unit, law=Gamma(0.0, unit),
                thermal=Thermal(0.3 * unit**2, 1.0, "stiff"), delay=Delay(0.7), eta=0.3, stiffness_law="sqrt",
            )
        )  # fmt: skip
    one, other = found
    for name, power in zip(NAMES, (1, 0, 1, 1, 1, 2), strict=True):
        scale = 1e-9**power
        assert getattr(other, name).value == pytest.approx(
            getattr(one, name).value * scale, rel=1e-9, abs=0
        )
        assert getattr(other, name).stderr <= 2e-9 * scale


@pytest.mark.parametrize(
    ("law", "newborn"),
    [
        (Table([0.6, 0.9, 1.4]), born("delta", 0.7)),
        (Table([0.6, 0.9, 1.4]), born("uniform", -0.5, 1.0)),
        (Distribution(scipy.stats.uniform(0.5, 1.0)), born("uniform", -0.7, 0.9)),
        pytest.param(
            Distribution(scipy.stats.lognorm(0.4)),
            born("exponential", 0.2),
            marks=pytest.mark.verification,
        ),
    ],
)
def test_other_laws(law, newborn):
    """Without heat by direct quadrature over births: E[xi^p | xi > |y|]."""
    edges = [0.5, 0.6, 0.7, 0.9, 1.4]
    births = newborn.reduced(1.0)
    grid = np.unique(
        np.clip([*edges, *[-edge for edge in edges], 0.0, *births.range], *births.range)
    )
    if newborn.law == "exponential":
        grid = np.unique(np.append(np.linspace(0.0, 1.0, 15), np.linspace(1.0, 7.0, 9)))
    x, weights = special.roots_legendre(30)
    half = 0.5 * np.diff(grid)[:, None]
    y = (
        np.array([newborn.stretch])
        if newborn.law == "delta"
        else (grid[:-1, None] + half * (1 + x)).ravel()
    )
    weight = (
        np.ones(1)
        if newborn.law == "delta"
        else (half * weights).ravel() * births.pdf(y)
    )
    total = np.zeros(2)
    for at, w in zip(y, weight, strict=True):
        if isinstance(law, Table):
            above = law.steps[law.steps > abs(at)]
            first, second = above.mean(), (above**2).mean()
        else:
            low, high = max(abs(at), law.support[0]), min(law.support[1], 30.0)
            u, v = special.roots_legendre(120)
            z = np.exp(
                0.5 * (math.log(max(low, 1e-3)) * (1 - u) + math.log(high) * (1 + u))
            )
            p = v * z * law.pdf(z) * 0.5 * math.log(high / max(low, 1e-3))
            first, second = p @ z / p.sum(), p @ z**2 / p.sum()
        total += w * np.array([first - at, (second - at**2) / 2])
    total /= weight.sum()
    result = solve(newborn, law=law)
    assert result.travel.value == pytest.approx(total[0], rel=1e-8, abs=0)
    assert result.friction.value == pytest.approx(total[1] / total[0], rel=1e-8, abs=0)


# ------------------------------------------------------------------------------------------------------
# transients


def volterra(r, X, cells):
    """Force at X of contacts born at r >= 0 with n = 1 thresholds, without heat and
    delay, by the trapezoid rule."""
    h = X / cells
    z = r + h * np.arange(cells + 1)
    share = (1 + r * r) * math.exp(-r * r)
    g, m = 2 * z**3 * np.exp(-z * z) / share, z * (1 + z * z) * np.exp(-z * z) / share
    births = np.zeros(cells + 1)
    births[0] = g[0]
    for i in range(1, cells + 1):
        inner = births[1:i] @ g[i - 1 : 0 : -1] + 0.5 * births[0] * g[i]
        births[i] = (g[i] + h * inner) / (1 - 0.5 * h * g[0])
    return m[-1] + h * (
        births[1:-1] @ m[-2:0:-1] + 0.5 * (births[0] * m[-1] + births[-1] * m[0])
    )


@pytest.mark.parametrize("disorder", ["quenched", "annealed"])
def test_transient(disorder):
    """F(.5), F(1) and F(1.5) of births at .5 by another solution of the renewal
    equation, extrapolated."""
    way = transient(contacts(born("delta", 0.5), disorder), Drive(1.0, distance=1.5), 4)
    assert way.force[0] == pytest.approx(0.5, rel=1e-9, abs=0)
    for index, printed in ((1, 0.923447), (2, 1.068416), (3, 1.056560)):
        coarse, fine = (volterra(0.5, 0.5 * index, cells) for cells in (400, 800))
        exact = (4 * fine - coarse) / 3
        assert (
            abs(way.force[index] - exact)
            <= way.force_error[index] + abs(fine - coarse) * 1e-2
        )
        assert exact == pytest.approx(printed, rel=0, abs=3e-6)


def test_transient_with_delay():
    way = transient(
        contacts(born("delta", 0.5), delay=Delay(0.5)), Drive(1.0, distance=3.0), 7
    )
    assert way.force[[1, 2, 6]] == pytest.approx(
        [0.75579, 0.68424, 0.66198], rel=0, abs=6e-6
    )


def test_transient_of_spread_births():
    """Births on either side of 0: the force of the master equation, and the difference
    that knowing |y| makes."""
    published, literal = (
        transient(
            contacts(born("uniform", -0.4, 0.6), disorder), Drive(1.0, distance=1.0), 2
        ).force[-1]
        for disorder in ("annealed", "quenched")
    )
    assert published == pytest.approx(0.790850, rel=0, abs=2e-6)
    assert literal > published + 1e-4


LONG = [
    (born("delta", -0.5), "quenched", "stiff", "uniform"),
    (born("delta", -0.5), "annealed", "soft", "sqrt"),
    (born("normal", 0.2, 0.3), "annealed", "stiff", "sqrt"),
    (born("delta", 0.4, of="threshold"), "annealed", "soft", "uniform"),
    *(
        pytest.param(*case, marks=pytest.mark.verification)
        for case in (
            (born("normal", 0.2, 0.3), "quenched", "stiff", "uniform"),
            (born("uniform", -0.9, 0.9, of="threshold"), "quenched", "soft", "sqrt"),
            (born("uniform", -0.5, 0.5), "quenched", "soft", "sqrt"),
        )
    ),
]


@pytest.mark.parametrize(("newborn", "disorder", "barrier", "stiffness_law"), LONG)
def test_long_run(newborn, disorder, barrier, stiffness_law):
    """Force, pinned fraction and variance end at their steady values, found by other
    equations."""
    ensemble = contacts(
        newborn,
        disorder,
        thermal=Thermal(0.2, 1.0, barrier),
        delay=Delay(0.5),
        eta=0.3,
        stiffness_law=stiffness_law,
    )
    way = transient(ensemble, Drive(0.1, distance=40.0), 9, variance=True)
    exact = reference(ensemble, Drive(0.1))
    assert abs(way.force[-1] - exact.friction.value) <= way.force_error[-1]
    assert abs(way.pinned[-1] - exact.pinned.value) <= way.pinned_error[-1]
    assert (
        abs(way.force_variance[-1] - exact.force_variance.value)
        <= way.force_variance_error[-1]
    )
    assert (way.force_error[-1], way.force_variance_error[-1]) < (1e-6, 1e-6)
    assert way.breaks[-1] == pytest.approx(
        exact.pinned.value / exact.travel.value, rel=1e-5, abs=0
    )


def test_stationary_start_and_fluctuations():
    """Nothing changes; the autocovariance begins at the variance and is forgotten."""
    ensemble = contacts(
        born("delta", -0.5),
        "annealed",
        thermal=Thermal(0.2, 1.0),
        delay=Delay(0.5),
        eta=0.3,
    )
    exact = reference(ensemble, Drive(0.1))
    way = transient(
        ensemble, Drive(0.1, distance=5.0, start="stationary"), 3, variance=True
    )
    assert way.force == pytest.approx([exact.friction.value] * 3, rel=1e-14, abs=0)
    assert way.force_variance == pytest.approx(
        [exact.force_variance.value] * 3, rel=1e-14, abs=0
    )
    assert way.breaks == pytest.approx(
        [exact.pinned.value / exact.travel.value] * 3, rel=1e-12, abs=0
    )
    found = fluctuations(ensemble, Drive(0.1, distance=30.0), 11)
    assert (
        abs(found.covariance[0] - exact.force_variance.value)
        <= found.error[0] + exact.force_variance.stderr
    )
    assert abs(found.covariance[-1]) <= found.error[-1]


COLD, WARM, STIFF = Thermal(0.0, 1.0), Thermal(0.2, 1.0), Thermal(0.2, 1.0, "stiff")
WAITING = Delay(0.5, "exponential")
FLUCTUATING = [
    ("annealed", born("delta", -0.5), Gamma(1.0), WARM, WAITING),
    ("annealed", born("delta", -0.5), Gamma(1.0), WARM, Delay()),
    ("quenched", born("delta", 0.5), Gamma(1.0), COLD, Delay()),
    ("quenched", born("delta", -0.5), Table([0.7, 1.3]), COLD, Delay()),
    ("quenched", born("delta", 0.3), Table([0.7, 1.3]), COLD, WAITING),
    ("quenched", born("delta", 0.3, of="threshold"), Gamma(1.0), STIFF, WAITING),
    ("annealed", born("uniform", -0.4, 0.3), Gamma(1.0), WARM, Delay()),
    ("quenched", born("normal", 0.2, 0.3), Gamma(1.0), COLD, Delay(0.5)),
    ("quenched", born("exponential", 0.2), Gamma(1.0), COLD, Delay()),
]


@chosen(
    ("disorder", "newborn", "law", "thermal", "delay"),
    FLUCTUATING,
    [FLUCTUATING[3]],
)
def test_autocovariance_from_lag_0_on(disorder, newborn, law, thermal, delay):
    """It is the variance at lag 0, beside which it does not jump: over 1e-6 of a life it
    falls by some 1e-6, a tenth of what is allowed. At five lags up to two lives it is
    that of 2000 simulated ensembles of 50 contacts, |z| < 4.5 (3 of 1e5 runs fail)."""
    ensemble = contacts(
        newborn, disorder, law, thermal=thermal, delay=delay, eta=0.3, count=50
    )
    exact = reference(ensemble, Drive(0.1))
    life = exact.travel.value
    near = fluctuations(ensemble, Drive(0.1, 1e-6 * life), 2)
    assert (
        abs(np.ptp(near.covariance)) < 2.0 * near.error[0] + 1e-5 * near.covariance[0]
    )
    found = fluctuations(ensemble, Drive(0.1, 2.0 * life), 6)
    run = trajectory(
        ensemble,
        Drive(0.1, 2.0 * life, "stationary"),
        points=6,
        replicas=2000,
        seed=7,
    )
    off = run.force_replicas - exact.friction.value
    products = 50.0 * off * off[:, :1]
    errors = products.std(axis=0, ddof=1) / math.sqrt(2000.0)
    z = (products.mean(axis=0) - found.covariance) / np.hypot(errors, found.error)
    assert np.abs(z[1:]).max() < 4.5


# --------------------------------------------------------------------------------------------------
# the rest of it


def test_unstressed():
    """Travel and stretch at breaking are the same, and the variance is that of T = 0, v
    = 1, tau = 1, eta = 2, whose standard deviation at N = 20 is .163412."""
    ensemble = contacts(Newborn(), delay=Delay(1.0), eta=2.0)
    plain, full = (
        reference(ensemble, Drive(1.0), variance=variance) for variance in (False, True)
    )
    assert plain.force_variance.value is None
    assert math.sqrt(full.force_variance.value / 20) == pytest.approx(
        0.163412, rel=0, abs=6e-7
    )
    assert full.travel == full.break_stretch
    assert full.birth_stretch.value == 0


def test_continuous_at_0():
    """Births at next to nothing are unstressed ones."""
    for disorder in ("quenched", "annealed"):
        more = {"thermal": Thermal(0.3, 1.0, "stiff"), "stiffness_law": "sqrt"}
        near, at = (
            solve(newborn, disorder, 0.2, **more)
            for newborn in (born("delta", 1e-12), Newborn())
        )
        for name in ("friction", "travel"):
            assert getattr(near, name).value == pytest.approx(
                getattr(at, name).value, rel=1e-10, abs=0
            )


def test_refused():
    """No reference along programmes, none for stages, and no densities: one line each."""
    ensemble, line = contacts(born("delta", 0.5), "annealed"), 'newborn.law = "delta": '
    back_and_forth = Programme((Segment(1.0, time=1.0), Segment(-1.0, time=1.0)))
    pulled = Programme((Segment(1.0, time=1.0),), stage=Stage(0.5))
    for refused in (
        lambda: transient(ensemble, back_and_forth, 3),
        lambda: transient(ensemble, pulled, 3),
        lambda: stability(ensemble, pulled),
        lambda: closure(ensemble, Drive(1.0, distance=1.0), 3),
        lambda: StationaryState(ensemble, Drive(1.0)).density(0.5),
    ):
        with pytest.raises(InputError, match=f"^{line}") as caught:
            refused()
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("law", "newborn"),
    [
        (Delta(1.0), Newborn("exponential", mean=0.04)),
        (Table([0.8, 1.0, 1.3]), Newborn("normal", mean=0.5, std=0.08)),
    ],
    ids=["exponential", "normal"],
)
def test_births_right_below_a_discrete_threshold(law, newborn):
    """Heat that breaks contacts in layers of 1e-15 of a threshold: as simulated, |z| <
    4.5 (false alarm 3e-5 in all). Births within a rounding of it were taken for births
    of 1e300 contacts."""
    heat = Thermal(kT=1.0 / 72.0, attempt_frequency=math.exp(36.0))
    contacts = Ensemble(law, heat, stiffness_law="uniform", newborn=newborn)
    exact = reference(contacts, Drive(1.0))
    found = steady(contacts, Drive(1.0), rel_error=1e-4)
    for name in ("travel", "friction"):
        value = getattr(exact, name)
        assert value.stderr < 1e-9
        assert abs(z_score(getattr(found, name), value.value)) < 4.5


def test_births_among_thresholds_of_a_broad_law():
    """Hazards over short ways at thresholds of 1e30 are numbers: 0, or below the last
    bit of the exponent there. Contacts simulated agree (|z| < 4.5 at four points, a
    false alarm of 3e-5)."""
    births = Newborn("delta", stretch=0.3)
    broad = Ensemble(Pareto(3.5), Thermal(0.1), count=10_000, newborn=births)
    exact = transient(broad, Drive(0.1, 2.0), points=5)
    run = trajectory(broad, Drive(0.1, 2.0), points=5)
    assert np.all(exact.force_error < 1e-4)
    off = np.abs(run.force - exact.force)[1:]
    assert np.all(off < 4.5 * np.hypot(run.force_stderr, exact.force_error)[1:])
