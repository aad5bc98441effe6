"""Transients against a plain convolution on a lattice: laws with jumps, kinks, atoms
and infinite densities."""

import itertools
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
from cases import chosen
from convolution import Contacts, means
from scipy import integrate, stats

from eqsim import (
    Delay,
    Delta,
    Distribution,
    Drive,
    Ensemble,
    Gamma,
    Table,
    Thermal,
    fluctuations,
    transient,
)
from eqsim.laws.named import Exponential, Lognormal, Normal, Pareto, Uniform, Weibull
from eqsim.master.transient import _with_error

VELOCITY = 0.1
LATTICE = 0.01  # on which thresholds of discrete laws, delays and distances are
KINDS = [
    "gamma", "narrow", "lognormal", "weibull", "normal", "exponential", "uniform", "pareto", "histogram", "beta",
    "triang", "trapezoid", "loguniform", "table", "delta",
]  # fmt: skip


class Case(NamedTuple):
    """Contacts as eqsim and as the lattice has them, how far they slide and how much
    finer the lattice is."""

    ensemble: Ensemble
    contacts: Contacts
    distance: float
    finer: int


def on_lattice(x):
    return round(float(x), 2)


def law_of(kind, rng):
    """A law of random parameters."""
    width = float(10.0 ** rng.uniform(-2.6, -1.2))
    if kind == "gamma":
        return Gamma(float(np.exp(rng.uniform(-2.0, 3.0))))
    if kind == "narrow":
        return [Gamma(0.25 / width**2), Lognormal(width), Normal(width)][
            rng.integers(3)
        ]
    if kind == "lognormal":
        return Lognormal(float(rng.uniform(0.1, 1.0)))
    if kind == "weibull":
        return Weibull(float(np.exp(rng.uniform(np.log(0.5), np.log(10.0)))))
    if kind == "normal":
        return Normal(float(rng.uniform(0.05, 2.0)))
    if kind == "exponential":
        return Exponential()
    if kind == "uniform":
        low = on_lattice(rng.uniform(0.0, 0.95))
        return Uniform(low, on_lattice(low + rng.uniform(0.05, 1.0)))
    if kind == "pareto":
        return Pareto(float(rng.uniform(3.05, 30.0)), on_lattice(rng.uniform(0.3, 1.0)))
    if kind == "histogram":
        bins = rng.integers(1, 5)
        edges = (
            np.sort(rng.choice(np.arange(10, 200), bins + 1, replace=False)) * LATTICE
        )
        counts = rng.integers(0, 5, bins)
        counts[[0, -1]] += 1
        return Distribution(stats.rv_histogram((counts, edges), density=True))
    if kind == "beta":
        return Distribution(stats.beta(*rng.uniform(0.4, 1.0, 2).tolist()))
    if kind == "triang":
        return Distribution(
            stats.triang(
                float(rng.uniform(0.05, 0.95)), loc=float(rng.uniform(0.0, 0.5))
            )
        )
    if kind == "trapezoid":
        return Distribution(stats.trapezoid(0.2, 0.7, loc=0.3))
    if kind == "loguniform":
        return Distribution(stats.loguniform(0.3, float(rng.uniform(0.6, 3.0))))
    if kind == "table":
        return Table(rng.integers(20, 200, rng.choice([2, 2, 3, 5, 12])) * LATTICE)
    return Delta(on_lattice(rng.uniform(0.5, 2.0)))


def drawn(kind, seed):
    """A random ensemble; a third of them is warm, and less than half of these annealed."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    law = law_of(kind, rng)
    warm = bool(rng.random() < 0.35) and kind != "narrow"
    b, attempts = np.exp(rng.uniform(np.log([1.0, 0.05]), np.log([40.0, 20.0]))) * warm
    annealed = warm and rng.random() < 0.4
    delays = str(rng.choice(["none", "fixed", "exponential"]))
    delay = 0.0 if delays == "none" else on_lattice(rng.uniform(0.05, 2.0))
    contacts = Contacts(
        law,
        str(rng.choice(["uniform", "sqrt"])),
        float(b),
        float(attempts),
        str(rng.choice(["soft", "stiff"])),
        bool(annealed),
        delay,
        delays == "exponential",
        float(rng.uniform(0.0, 1.0)) * bool(rng.random() < 0.3),
    )
    distance, finer = on_lattice(rng.uniform(2.0, 8.0)), 4 if warm else 16
    if kind == "narrow":
        width = np.sqrt(law.rms**2 - law.mean**2)
        finer = max(finer, int(2.0 ** np.ceil(np.log2(20.0 * LATTICE / width))))
    return Case(ensemble_of(contacts), contacts, distance, finer)


def ensemble_of(c):
    """The same contacts for eqsim, k = 1."""
    heat = (
        Thermal(0.5 / c.b, c.attempts * VELOCITY, c.barrier)
        if c.attempts
        else Thermal()
    )
    delay = Delay(c.delay / VELOCITY, "exponential" if c.random else "fixed")
    disorder = "annealed" if c.annealed else "quenched"
    return Ensemble(
        c.law,
        heat,
        delay,
        stiffness_law=c.stiffness,
        disorder=disorder,
        eta=c.drag / VELOCITY,
    )


def scores(case):
    """How much force and pinned share differ from those of the lattice by more than its
    error, in quoted errors, arrays (points,); at X = 0 nothing is to be told."""
    points = round(case.distance / LATTICE)
    exact = means(case.contacts, LATTICE / case.finer, points * case.finer)
    found = transient(case.ensemble, Drive(VELOCITY, case.distance), points + 1)
    z = []
    for name in ("force", "pinned"):
        known, missed = (
            getattr(exact, part)[:: case.finer] for part in (name, f"{name}_error")
        )
        apart = np.maximum(np.abs(getattr(found, name) - known) - missed, 0.0)
        z.append((apart / np.maximum(getattr(found, f"{name}_error"), 1e-300))[1:])
    return z


def test_the_lattice_by_closed_forms():
    """Exponential thresholds break at the rate 1: F = 1 - exp(-X); identical ones are a
    saw-tooth; with a fixed delay all are detached after the first break. Half of a jump
    is told where it is."""
    X = 0.01 * np.arange(401)
    found = means(Contacts(Exponential()), 0.01, 400)
    assert np.all(np.abs(found.force - (1.0 - np.exp(-X))) <= found.force_error)
    assert found.force_error.max() < 1e-4
    teeth = means(Contacts(Delta(1.0), delay=0.5), 0.01, 400)
    phase = np.mod(X, 1.5)
    inside = (np.abs(phase - 1.0) > 1e-9) & (phase > 1e-9) & (phase < 1.5 - 1e-9)
    np.testing.assert_allclose(
        teeth.pinned[inside], np.where(phase < 1.0, 1.0, 0.0)[inside], rtol=0, atol=1e-9
    )
    np.testing.assert_allclose(
        teeth.force[inside],
        np.where(phase < 1.0, phase, 0.0)[inside],
        rtol=0,
        atol=1e-9,
    )


# one of each kind, and seeds with heat, annealed contacts and delays of both laws among
# them
FEW = [(kind, seed) for seed, kind in enumerate(KINDS)]


@chosen(
    ("kind", "seed"), FEW, [case for case in FEW if case[0] not in ("narrow", "normal")]
)  # which take longest
def test_transients_are_those_of_the_lattice(kind, seed):
    """Quoted errors are bounds: none of the hundreds of points of either observable is
    beyond."""
    assert max(z.max() for z in scores(drawn(kind, seed))) <= 1.0


def test_errors_of_lives_are_passed_on():
    """A life that is known to 1e-3 is one of all that were born since: where the force
    has fallen its error has not."""
    falling = np.abs(np.cos(np.linspace(-1.0, 3.0, 41)))[None, :]
    cells = SimpleNamespace(
        profile=SimpleNamespace(error=1e-3, jumps=False), in_step=0.0
    )
    _, error = _with_error(falling, falling, cells, np.zeros((1, 1)))
    assert error[0, -1] >= 1e-3 * falling.max()
    assert np.all(np.diff(error) >= 0.0)


def test_a_wrong_delay_and_a_wrong_edge_are_seen():
    """Negative control: a delay that is 1 percent longer, and a law whose lower end is
    1 percent higher."""
    contacts = Contacts(Uniform(0.9, 1.1), delay=0.5)
    for wrong in (
        Contacts(Uniform(0.9, 1.1), delay=0.51),
        Contacts(Uniform(0.91, 1.1), delay=0.5),
    ):
        case = Case(ensemble_of(wrong), contacts, 3.0, 16)
        assert max(z.max() for z in scores(case)) > 100.0
    assert (
        max(z.max() for z in scores(Case(ensemble_of(contacts), contacts, 3.0, 16)))
        <= 1.0
    )


def test_panels_across_a_kink_are_seen(monkeypatch):
    """Negative control: without panels that end where a density jumps, and are split
    where one is missed."""
    monkeypatch.setattr(Uniform, "kinks", property(lambda _: np.empty(0)))
    monkeypatch.setattr("eqsim.master.profile._NARROWEST_IN_LN_X", 0.05)
    contacts = Contacts(Uniform(0.9, 1.1))
    assert (
        max(z.max() for z in scores(Case(ensemble_of(contacts), contacts, 3.0, 16)))
        > 3.0
    )


def test_errors_are_those_of_the_force_that_is_there():
    """Thresholds far away are no unit of errors: F = X, known to a millionth of itself."""
    for ensemble in (
        Ensemble(Delta(1e6)),
        Ensemble(Delta(1e6), delay=Delay(1.0, "exponential"), eta=1.0),
    ):
        found = transient(ensemble, Drive(VELOCITY, 5.0), 6)
        np.testing.assert_allclose(found.force, found.X, rtol=1e-9, atol=0.0)
        assert np.all(found.force_error <= 2e-6 * found.X + 1e-15)


@pytest.mark.verification
def test_many_transients_are_those_of_the_lattice():
    """Of 210 random ensembles: no point in a thousand beyond its quoted error, and none
    beyond twice that."""
    z = np.concatenate(
        [
            np.concatenate(scores(drawn(kind, seed)))
            for kind in KINDS
            for seed in range(100, 114)
        ]
    )
    assert (z > 1.0).mean() < 1e-3
    assert z.max() < 2.0


def of_two(x):
    """F of thresholds 1 and 2, after whole steps of which a share B is born: F = sum_n
    B_n (x - n) S(x - n), S = 1 up to 1 and 1/2 up to 2."""
    born = [1.0, 0.5]
    while len(born) <= np.max(x):
        born.append(0.5 * (born[-1] + born[-2]))
    since = np.asarray(x)[..., None] - np.arange(len(born))
    share = np.where(since < 1.0, 1.0, 0.5) * ((since >= 0.0) & (since < 2.0))
    return (np.array(born) * since * share).sum(axis=-1)


@pytest.mark.parametrize("law", ["sqrt", "uniform"])
@pytest.mark.parametrize("distance", [2e-30, 1e-18, 1e-15])
def test_transients_over_next_to_nothing(law, distance):
    """The force is E[k_i/k] X, with E[xi]/xi_rms = 0.94 of the sqrt law."""
    found = transient(Ensemble(stiffness_law=law), Drive(VELOCITY, distance), 3)
    mean = Gamma().mean / Gamma().rms if law == "sqrt" else 1.0
    assert found.force[1:] == pytest.approx(mean * found.X[1:], rel=1e-7, abs=0)


def test_the_force_of_a_fresh_start_is_known():
    """Also where cells are so long that many contacts break in the first one."""
    contacts = Ensemble(delay=Delay(1.0))
    found = transient(contacts, Drive(VELOCITY, 1e5), 3, variance=True)
    assert (found.force[0], found.pinned[0]) == (0.0, 1.0)
    assert (found.force_error[0], found.pinned_error[0]) == (0.0, 0.0)
    assert found.force_variance_error[0] == 0.0 < found.force_error[1]


def test_transients_and_fluctuations_of_two_thresholds():
    """Sums over the births of whole steps, at places that are no edges of cells; spread
    evenly over cells births were off by up to a third of one, and errors were 1e-11."""
    contacts = Ensemble(Table([1.0, 2.0]), stiffness_law="uniform")
    found = transient(contacts, Drive(VELOCITY, 10.333), 41)
    # a jump may be on either side of an edge
    inside = np.abs(found.X - np.round(found.X)) > 0.01
    off = np.abs(found.force - of_two(found.X))[inside]
    assert np.all(off <= found.force_error[inside] + 1e-12)
    # next to jumps, which cells blur the more the later, they are larger
    assert np.sum(found.force_error < 1e-9) >= 10

    lagged = fluctuations(contacts, Drive(VELOCITY, 2.52), 5)
    for lag, value, error in zip(
        lagged.lag[1:], lagged.covariance[1:], lagged.error[1:], strict=True
    ):
        total = 0.0
        for xi in (1.0, 2.0):  # found at x, a break after xi - x
            breaks = {xi - lag + n for n in range(4)}
            edges = sorted({0.0, xi} | {x for x in breaks if 0.0 < x < xi})

            def product(x, xi=xi, lag=lag):
                return x * (x + lag if lag < xi - x else of_two(lag - (xi - x)))

            total += sum(
                integrate.quad(product, low, high, epsabs=1e-12)[0]
                for low, high in itertools.pairwise(edges)
            )
        exact = total / 3.0 - (2.5 / 3.0 / 2.0 * 2.0 * 0.5 * 2.0) ** 2
        assert abs(value - exact) <= error
        assert error < 1e-5


@pytest.mark.parametrize(
    ("exponent", "stiffness", "typical"),
    [(3.5, "uniform", 1e-7), (8.0, "uniform", 1e-7), (3.05, "sqrt", 1e-3)],
)
def test_first_breaks_beyond_a_jump_of_the_density(exponent, stiffness, typical):
    """Up to twice the least threshold no contact breaks twice: with kappa = k_i/k and
    its mean <kappa>, F = X E[kappa; xi > X] + <kappa> int_1^X a y^(-a-1) (X - y) dy,
    within errors that are small; they were a tenth of the truth, and all of it where
    half of the work is that of 1e-20 of the contacts."""
    law = Pareto(exponent, 1.0)
    contacts = Ensemble(law, stiffness_law=stiffness)
    found = transient(contacts, Drive(VELOCITY, 1.9), 201)
    y = np.maximum(found.X, 1.0)
    born = y * (1.0 - y**-exponent)
    born -= exponent / (exponent - 1.0) * (1.0 - y ** (1.0 - exponent))
    kappa = law.mean / law.rms if stiffness == "sqrt" else 1.0
    power = 1.0 - exponent if stiffness == "sqrt" else -exponent
    exact = kappa * (found.X * y**power + born)
    assert np.all(np.abs(found.force - exact) <= found.force_error + 1e-14)
    # next to the jump they are larger
    assert np.median(found.force_error) < typical
