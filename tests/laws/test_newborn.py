"""Contacts born stretched: how far they are carried, in steady averages, in runs, along
programmes, with a stage."""

import csv
import dataclasses
import itertools
import math
from pathlib import Path

import mpmath
import numpy as np
import pytest
import scipy.integrate
import scipy.stats
from cases import chosen
from kernels import compiled
from oracle import Contacts, simulate

from eqsim import (
    Delay,
    Delta,
    Distribution,
    Drive,
    Ensemble,
    Gamma,
    InputError,
    Programme,
    Segment,
    Stage,
    Table,
    Thermal,
    reference,
    steady,
    trajectory,
    transient,
)
from eqsim.engine import langevin
from eqsim.engine.contacts import contacts
from eqsim.engine.sample import Source, lives
from eqsim.estimate import OBSERVABLES, z_score
from eqsim.laws.barrier.base import travel
from eqsim.laws.newborn import Newborn, newborn_draw, stretched
from eqsim.laws.threshold import for_kernels
from eqsim.numerics.streams import key
from eqsim.validation.points import sample

LIMIT = 4.5
ROWS = list(csv.DictReader((Path(__file__).parents[1] / "data" / "newborn.csv").open()))
UNIFORM = {"stiffness_law": "uniform"}


def ensemble_of(row, **changes):
    """The ensemble of a row of the table, and its velocity."""
    number = {
        name: float(row[name])
        for name in row
        if name in ["n", "x_star", "stiffness", "kT", "delay", "eta", "velocity"]
    }
    a, b = float(row["birth_a"]), float(row["birth_b"] or "nan")
    numbers = {
        "delta": {"stretch": a},
        "uniform": {"low": a, "high": b},
        "exponential": {"mean": a},
        "normal": {"mean": a, "std": b},
    }[row["birth_law"]]
    of = "threshold" if row["rule"] == "fraction" else "length"
    gamma = row["threshold_law"] == "gamma"
    ensemble = Ensemble(
        Gamma(number["n"], number["x_star"]) if gamma else Delta(number["x_star"]),
        Thermal(number["kT"], float(row["attempt_frequency"]), row["barrier"]),
        Delay(number["delay"]),
        stiffness=number["stiffness"],
        stiffness_law=row["stiffness_law"],
        disorder=row["disorder"],
        eta=number["eta"],
        newborn=Newborn(row["birth_law"], of, **numbers),
    )
    return dataclasses.replace(ensemble, **changes), number["velocity"]


def scores(row, found):
    """z of all observables, with the accuracy of the row."""
    pairs = ((found.averages()[name], float(row[name])) for name in OBSERVABLES)
    return [
        z
        for one, exact in pairs
        if (z := z_score(one, exact, abs(exact) * float(row["rel_accuracy"])))
        is not None
    ]


# ---- births ----


BIRTHS = [
    Newborn("delta", stretch=0.5),
    Newborn("uniform", low=-0.4, high=0.6),
    Newborn("exponential", mean=0.06),
    Newborn("normal", mean=0.1, std=0.15),
]
THRESHOLDS = [Gamma(1.0), Gamma(0.5, 3.0), Distribution(scipy.stats.uniform(0.2, 2.0))]


@chosen(  # by default each law of births once
    ("newborn", "law"),
    itertools.product(BIRTHS, THRESHOLDS),
    [*zip(BIRTHS, [*THRESHOLDS, THRESHOLDS[0]], strict=True)],
)
def test_births(law, newborn):
    """Stretches follow their law (Kolmogorov and Smirnov, p > 1e-4, 9 of them) and the
    share of thresholds that are above, among those above |y|, or above y, is the
    uniform it was drawn with, to what tables are good to."""
    draw, unit = compiled(newborn_draw), law.scale
    u, v = np.random.default_rng(1).random((2, 4000))
    for two_sided in (True, False):
        born = stretched(newborn, law, two_sided)
        xi, y = np.array(
            [draw(born, for_kernels(law), *pair) for pair in zip(u, v, strict=True)]
        ).T
        bound = np.abs(y) if two_sided else np.maximum(y, 0.0)
        assert np.all(xi >= bound)
        np.testing.assert_allclose(
            law.sf(xi * unit) / law.sf(bound * unit), u, rtol=0, atol=1e-8
        )
        if newborn.law != "delta":
            cdf = np.vectorize(lambda at: 1.0 - newborn.reduced(unit).sf(at))
            assert scipy.stats.kstest(y, cdf).pvalue > 1e-4


def test_fractions_and_steps():
    """Fractions of the contact's own threshold; of a table one of the steps above, all
    equally likely."""
    draw, law = compiled(newborn_draw), for_kernels(Gamma(1.0))
    born = stretched(
        Newborn("uniform", "threshold", low=-1.0, high=0.5), Gamma(1.0), True
    )
    xi, y = draw(born, law, 0.3, 0.2)
    assert (xi, y) == (
        draw(born, law, 0.3, 0.9)[0],
        pytest.approx(xi * (-1.0 + 1.5 * 0.2), rel=1e-15, abs=0),
    )
    table = Table([0.5, 0.8, 1.0, 1.7])
    born = stretched(Newborn("delta", stretch=0.8), table, True)
    found = [
        draw(born, for_kernels(table), u, 0.5)[0] for u in (0.01, 0.49, 0.51, 0.99)
    ]
    assert found == [1.7, 1.7, 1.0, 1.0]


@pytest.mark.parametrize(
    ("newborn", "word"),
    [
        ({"law": "delta"}, "stretch: is required"),
        ({"law": "delta", "stretch": 1.0, "of": "threshold"}, "> -1 and < 1"),
        ({"law": "delta", "stretch": math.nan}, "stretch = nan"),
        ({"law": "uniform", "low": 1.0, "high": 0.5}, "high = 0.5"),
        ({"law": "uniform", "low": -1.2, "high": 0.5, "of": "threshold"}, "low = -1.2"),
        ({"law": "exponential", "mean": 0.0}, "mean = 0.0"),
        ({"law": "exponential", "mean": 0.1, "of": "threshold"}, 'takes "delta"'),
        ({"law": "normal", "mean": 0.0, "std": -1.0}, "std = -1.0"),
        (
            {"law": "normal", "mean": 0.0, "std": 1.0, "low": 1.0},
            "low = 1.0: not allowed",
        ),
        ({"law": "weibull"}, "law = 'weibull'"),
        ({"of": "area"}, "of = 'area'"),
        ({"law": "delta", "stretch": 30.0}, "no threshold is above"),
        ({"law": "normal", "mean": 0.0, "std": 10.0}, "no threshold is above"),
    ],
)
def test_refused(newborn, word):
    with pytest.raises(InputError, match=word.replace("(", r"\(")):
        Ensemble(newborn=Newborn(**newborn))


# ---- travel ----


# E ~ (1 - x/xi)^power with the prefactor (1 - x/xi)^(power - 1)
POWER = {"stiff": 1.5, "cusp": 2.0}


def passed(barrier, a, xi, x):
    """int_0^x r, odd in x, in 50 digits."""
    # where it breaks mechanically x is rounded
    sign, x = (mpmath.sign(x), min(abs(x), xi))
    if barrier == "soft":
        root = mpmath.sqrt(a)
        return (
            sign
            * mpmath.exp(-a * xi**2)
            * mpmath.sqrt(mpmath.pi)
            / (2 * root)
            * mpmath.erfi(root * x)
        )
    power = mpmath.mpf(POWER[barrier])
    top = mpmath.exp(-a * xi**2 * (1 - x / xi) ** power)
    return sign / (power * a * xi) * (top - mpmath.exp(-a * xi**2))


def rate(barrier, a, xi, x):
    if barrier == "soft":
        return mpmath.exp(-a * (xi**2 - x**2))
    gap, power = 1 - abs(x) / xi, mpmath.mpf(POWER[barrier])
    return gap ** (power - 1) * mpmath.exp(-a * xi**2 * gap**power)


@chosen(
    ("kT", "w", "barrier"),
    [
        (*heat, barrier)
        for heat in ((3.0, 1e3), (0.1, 1.0), (1e-4, 1e6), (1e-8, 1e9))
        for barrier in ("soft", "stiff", "cusp")
    ],
    [(3.0, 1e3, "soft"), (1e-8, 1e9, "stiff"), (0.1, 1.0, "cusp"), (1e-8, 1e9, "cusp")],
)
def test_travel(barrier, kT, w):
    """Where the hazard since birth is the clock, against 50 digits: to 1e-8 of the
    travel, however short, and however close births are to breaking on either side."""
    c, run = contacts(Ensemble(thermal=Thermal(kT, w, barrier)), 1.0), compiled(travel)
    rng = np.random.default_rng(4)
    with mpmath.workdps(50):
        a, attempts = mpmath.mpf(c.barrier.b), mpmath.e ** mpmath.mpf(c.barrier.log_w)
        for _ in range(150):
            xi, clock = (
                float(np.exp(rng.normal(0.0, 0.5))),
                float(10 ** rng.uniform(-6, 1.3)),
            )
            y = float(
                xi
                * rng.choice([-1, 1])
                * rng.choice([rng.uniform(0, 1), 1 - 10 ** rng.uniform(-9, 0)])
            )
            s = run(c, xi, 1.0, y, clock)
            exact = [mpmath.mpf(part) for part in (xi, y, s)]
            done = attempts * (
                passed(barrier, a, exact[0], exact[1] + exact[2])
                - passed(barrier, a, exact[0], exact[1])
            )
            if s >= (xi - y) * (1 - 1e-12):
                assert done <= clock * (1 + 1e-6)
            else:
                off = (
                    (done - clock)
                    / (attempts * rate(barrier, a, exact[0], exact[1] + exact[2]))
                    / exact[2]
                )
                assert abs(off) < 1e-8, (xi, y, clock, s)


@pytest.mark.verification
@pytest.mark.parametrize("barrier", ["soft", "stiff"])
def test_travel_of_annealed_contacts(barrier):
    """Against quadrature of the pooled rate, to the 1e-6 that its table is good to."""
    ensemble = Ensemble(
        thermal=Thermal(0.2, 3.0, barrier),
        disorder="annealed",
        newborn=Newborn("delta", stretch=0.1),
    )
    c, run = contacts(ensemble, 1.0), compiled(travel)
    rng, law = np.random.default_rng(5), c.barrier
    for _ in range(40):
        y, clock = float(rng.uniform(-1.5, 1.5)), float(10 ** rng.uniform(-5, 1))
        s = run(c, 1e3, 1.0, y, clock)
        rates = np.gradient(law.G, law.x)
        x = np.linspace(y, y + s, 20_001)
        inside = np.abs(x) <= law.x[-1]
        found = np.trapezoid(
            np.where(inside, np.interp(np.abs(x), law.x, rates), 0.0), x
        ) * math.exp(law.log_w)
        assert s >= 1e3 - y - 1e-9 or found == pytest.approx(clock, rel=2e-3, abs=1e-9)


@pytest.mark.verification
def test_nothing_overflows():
    """Lives of extreme ranks and clocks, at points all over the parameter space:
    finite, and forwards."""
    rng = np.random.default_rng(1)
    u, v = np.exp(-np.exp([rng.uniform(-37, 6, 4000), rng.uniform(-37, 3.7, 4000)]))
    for _, ensemble, velocity in sample(50, 7):
        if ensemble.newborn.active:
            found = lives(
                contacts(ensemble, velocity), Source(key(0, 1), 0, langevin.STEP), u, v
            )
            assert all(np.all(np.isfinite(part)) for part in found)
            assert np.all(found.travel >= 0.0)


# ---- steady averages ----


@chosen(  # by default each law of births and each rule once
    "row", ROWS, [f"newborn-{number}" for number in ("000", "010", "012", "018", "026", "056", "060")],
    ids=lambda row: row["id"],
)  # fmt: skip
def test_rows(row):
    """All six observables: |z| < 4.5 (168 scores in all rows, false alarm 1e-3), as
    exact as was asked for."""
    ensemble, velocity = ensemble_of(row)
    found = steady(ensemble, Drive(velocity), rel_error=1e-3, seed=11, threads=2)
    assert found.reached
    assert found.friction.reliable
    assert max(map(abs, scores(row, found))) < LIMIT


@pytest.mark.verification
def test_errors_over_seeds():
    """Of all rows, 24 seeds each: scores of each observable are normal (chi-square, p >
    1e-4, and no |z| > 5)."""
    for row in ROWS:
        ensemble, velocity = ensemble_of(row)
        table = [
            scores(row, steady(ensemble, Drive(velocity), rel_error=1e-2, seed=seed))
            for seed in range(24)
        ]
        for column in np.array(table).T:
            assert scipy.stats.chi2.sf(np.sum(column**2), column.size) > 1e-4
            assert np.abs(column).max() < 5.0


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("newborn-014", {"newborn": Newborn()}),  # births ignored
        ("newborn-012", {"newborn": Newborn("delta", stretch=1.39)}),
        ("newborn-028", {"disorder": "quenched"}),
    ],
)
def test_negative_controls(name, wrong):
    (row,) = [row for row in ROWS if row["id"] == name]
    ensemble, velocity = ensemble_of(row, **wrong)
    assert (
        max(
            map(
                abs,
                scores(row, steady(ensemble, Drive(velocity), rel_error=1e-3, seed=11)),
            )
        )
        > 2 * LIMIT
    )


def test_travel_is_not_the_stretch_at_breaking():
    """The displacement while pinned is that of birth to breaking: with <x_b> in its
    place a delay is wrong."""
    (row,) = [row for row in ROWS if row["id"] == "newborn-012"]
    ensemble, velocity = ensemble_of(row)
    found = steady(ensemble, Drive(velocity), rel_error=1e-4)
    delay = velocity * ensemble.delay.time
    wrong = found.break_stretch.value / (found.break_stretch.value + delay)
    assert abs(found.pinned.value - float(row["pinned"])) < LIMIT * found.pinned.stderr
    assert abs(wrong - float(row["pinned"])) > 100 * found.pinned.stderr


@pytest.mark.verification  # 10 s: the default suite has to end in time on a machine that others use as well
def test_plain_births_and_small_births():
    """Plain Monte Carlo agrees (|z| < 4.5, five scores); births of 1e-9 are as good as
    none."""
    ensemble, velocity = ensemble_of(ROWS[4])
    exact = reference(ensemble, Drive(velocity))
    plain = steady(ensemble, Drive(velocity), rel_error=1e-2, plain=True)
    for name in ("friction", "pinned", "break_stretch", "travel", "birth_stretch"):
        assert (
            abs(z_score(getattr(plain, name), getattr(exact, name).value) or 0.0)
            < LIMIT
        )
    small = Ensemble(thermal=Thermal(0.1), newborn=Newborn("delta", stretch=1e-9))
    found, none = (
        reference(e, Drive(0.1))
        for e in (small, dataclasses.replace(small, newborn=Newborn()))
    )
    ours = steady(small, Drive(0.1), rel_error=1e-4)
    assert abs(z_score(ours.friction, none.friction.value)) < LIMIT
    assert found.friction.value == pytest.approx(none.friction.value, rel=1e-8, abs=0)


# ---- runs ----


@pytest.mark.verification
@pytest.mark.parametrize(
    ("name", "start"),
    [
        ("newborn-018", "fresh"),
        *(
            pytest.param(f"newborn-{number}", start, marks=pytest.mark.verification)
            for number in ("002", "012", "024", "048", "052")
            for start in ("fresh", "stationary")
        ),
    ],
)
def test_runs(name, start):
    """F at ten X against the exact transient, and averages of the second half: |z| <
    4.5 (150 scores, 1e-3)."""
    (row,) = [row for row in ROWS if row["id"] == name]
    ensemble, velocity = ensemble_of(row, count=4000)
    distance = 20 * (float(row["travel"]) + velocity * float(row["delay"]))
    drive = Drive(velocity, distance, start)
    run, exact = (
        trajectory(ensemble, drive, points=11, seed=5, threads=2),
        transient(ensemble, drive, 11),
    )
    sigma = np.hypot(run.force_stderr, exact.force_error)
    away = np.abs(run.force - exact.force)
    assert np.all(away <= LIMIT * sigma)
    for name in OBSERVABLES:
        late = getattr(run.averages, name)
        if late.reliable and late.stderr:
            assert abs(z_score(late, float(row[name]))) < LIMIT


@pytest.mark.verification
def test_same_bits_and_units():
    """Whatever the threads, and in nanometres."""
    newborn = Newborn("uniform", low=-0.3, high=0.5)
    one = Ensemble(thermal=Thermal(0.2), delay=Delay(0.5), count=3000, newborn=newborn)
    runs = [
        trajectory(one, Drive(0.3, 9.0), points=19, threads=threads)
        for threads in (1, 3)
    ]
    assert np.array_equal(runs[0].force, runs[1].force)
    k, nm = 7e5, 2.0**-29
    small = dataclasses.replace(
        one, thresholds=Gamma(1.0, nm), thermal=Thermal(0.2 * k * nm**2), stiffness=k,
        newborn=Newborn("uniform", low=-0.3 * nm, high=0.5 * nm),
    )  # fmt: skip
    other = trajectory(small, Drive(0.3 * nm, 9.0 * nm), points=19)
    np.testing.assert_allclose(other.force / nm, runs[0].force, rtol=1e-9, atol=1e-12)


# ---- programmes and stages ----

STEP, SPACING = 0.02, 0.4
FACTORS = (1.0, 0.0, 0.4, -1.0, -0.3, 0.0, 1.0)
CASES = {
    "fractions against the motion": Contacts(
        births=(-0.6, 0.2), fraction=True, delay=0.3
    ),
    "lengths, warm": Contacts(births=(-0.3, 0.5), kT=0.3, stiffness_law="uniform"),
    "lengths, stiff, delay": Contacts(
        births=(0.5, 1.2), kT=0.3, barrier="stiff", delay=0.3
    ),
    "annealed": Contacts(births=(0.1, 0.6), kT=0.3, disorder="annealed"),
    "annealed, one velocity": Contacts(births=(-0.8, 0.2), kT=0.3, disorder="annealed"),
}


def by_steps(c, count=100_000):
    """F by time steps, extrapolated to none, and its error."""
    fine, coarse = (
        simulate(c, count, step, round(SPACING / step), 7, seed=(23, i))
        for i, step in enumerate((STEP, 2 * STEP))
    )
    return 2 * fine.force - coarse.force, np.hypot(
        2 * fine.force_stderr, coarse.force_stderr
    )


def by_engine(c, count=100_000):
    of = "threshold" if c.fraction else "length"
    ensemble = Ensemble(
        thermal=Thermal(c.kT, 1.0, c.barrier), delay=Delay(c.delay), count=count, stiffness_law=c.stiffness_law,
        disorder=c.disorder, newborn=Newborn("uniform", of, low=c.births[0], high=c.births[1]),
    )  # fmt: skip
    if not c.factors:
        return trajectory(
            ensemble, Drive(1.0, 7 * SPACING), points=8, seed=17, threads=2
        )
    segments = [Segment(factor, time=SPACING, points=1) for factor in c.factors]
    return trajectory(ensemble, Programme(segments), points=8, seed=17, threads=2)


@chosen("name", CASES, [])
def test_time_steps_agree(name):
    """Through a hold, reversals and steps, and at constant velocity: |z| < 4.5 beyond
    what extrapolation leaves, of the second order in a step: (0.02/0.2)^2 of the
    forces' 0.3, 0.2 the shortest of the lengths over which they change. Negative
    control: newborn thresholds that do not know that they hold."""
    c = (
        CASES[name]
        if "one velocity" in name
        else dataclasses.replace(CASES[name], factors=FACTORS)
    )
    found = by_engine(c)

    def worst(c):
        force, stderr = by_steps(c)
        excess = np.maximum(np.abs(force - found.force[1:]) - 3e-3, 0.0)
        return np.max(excess / np.hypot(stderr, found.force_stderr[1:]))

    assert worst(c) < LIMIT
    if name == "lengths, stiff, delay":
        assert worst(dataclasses.replace(c, careless=True)) > LIMIT


@pytest.mark.verification
def test_one_segment_has_the_bits_of_the_constant_drive():
    ensemble = Ensemble(
        thermal=Thermal(0.2),
        count=2000,
        newborn=Newborn("uniform", "threshold", low=-0.4, high=0.1),
    )
    one, other = (
        trajectory(ensemble, drive, points=17, seed=2)
        for drive in (Drive(0.3, 8.0), Programme([Segment(0.3, distance=8.0)]))
    )
    np.testing.assert_array_equal(one.force, other.force)


def test_annealed_births_against_the_motion_follow_no_programme():
    ensemble = Ensemble(
        thermal=Thermal(0.2),
        disorder="annealed",
        newborn=Newborn("delta", stretch=-0.1),
    )
    with pytest.raises(InputError, match="disorder = "):
        trajectory(ensemble, Programme([Segment(1.0, distance=1.0)]))


@pytest.mark.verification
@pytest.mark.parametrize("damping", [0.0, 0.1])
def test_a_stiff_stage_is_the_rigid_slider(damping):
    """Contact by contact: where the spring is 1e5 times as stiff as they are, X is that
    of the stage to 1e-5, and F changes by less than its slope of 1 times as much."""
    ensemble = Ensemble(
        count=500, newborn=Newborn("uniform", low=-0.2, high=0.4), **UNIFORM
    )
    programme = Programme([Segment(1.0, distance=4.0)])
    rigid = trajectory(ensemble, programme, points=9, seed=3)
    pulled = trajectory(
        ensemble, dataclasses.replace(programme, stage=Stage(1e5, damping=damping)), points=9, seed=3
    )  # fmt: skip
    slack = 2.0 / ensemble.count  # a contact that breaks a little early or late
    assert np.all(np.abs(pulled.force - rigid.force) < 1e-4 + slack)


def test_energy_with_a_stage():
    """What the stage has done is stored, dissipated or missing, and births bring energy
    with them: contacts born at about half their threshold."""
    ensemble = Ensemble(
        count=2000,
        newborn=Newborn("uniform", "threshold", low=0.4, high=0.6),
        **UNIFORM,
    )
    stage = Stage(0.3, damping=0.1)
    run = trajectory(
        ensemble,
        Programme([Segment(0.1, distance=20.0)], stage=stage),
        points=41,
        seed=3,
    )
    energy = {
        name: run.columns()[name]
        for name in ("work", "stored", "dissipated", "missing")
    }
    total = energy["stored"] + energy["dissipated"] + energy["missing"]
    np.testing.assert_allclose(energy["work"], total, rtol=1e-10, atol=1e-12)
    assert abs(energy["missing"][-1]) < 0.02 * energy["dissipated"][-1]
