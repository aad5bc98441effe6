"""Error bars of few contacts: what the law says of the scatter of forces, and whether
errors quoted by it are true.

Seeds are fixed; stated false-alarm rates are those of a fresh seed.
"""

import math

import numpy as np
import pytest
import scipy.stats
from cases import chosen

from eqsim import (
    Aging,
    Delay,
    Delta,
    Distribution,
    Drive,
    Ensemble,
    Gamma,
    Programme,
    Segment,
    Stage,
    Table,
    Thermal,
    reference,
    trajectory,
)
from eqsim.engine.blocks import Totals
from eqsim.engine.contacts import contacts
from eqsim.engine.programme import constant_drive
from eqsim.engine.recorder import Run, Scales, moments
from eqsim.engine.scatter import births, known_variance, scatter
from eqsim.engine.stationary import Fresh
from eqsim.engine.trajectory import independent
from eqsim.estimate import z_score
from eqsim.master.transient import fluctuations, transient
from eqsim.model.reduced import drag_of
from eqsim.numerics.streams import TRAJECTORY, key

UNIFORM = {"stiffness_law": "uniform"}
# at v = 1 hardly a contact is pinned before X = 5
LATE = Ensemble(thermal=Thermal(0.1), delay=Delay(5.0))
HOT = Ensemble(thermal=Thermal(1.0))  # heavy-tailed at v = 1e-3
BROAD = Distribution(scipy.stats.lognorm(1.0))
CASES = {
    "late": (LATE, 1.0, 20.0),
    "hot": (HOT, 1e-3, 6.0),
    "drag": (Ensemble(delay=Delay(1.0, "exponential"), eta=2.0, **UNIFORM), 1.0, 8.0),
    "annealed": (
        Ensemble(
            thermal=Thermal(1.0, 1.0, "stiff"), delay=Delay(2.0), disorder="annealed"
        ),
        0.1,
        8.0,
    ),
    "broad": (Ensemble(BROAD), 1.0, 60.0),
    "table": (
        Ensemble(Table([0.5, 0.9, 1.0, 1.3, 2.0]), Thermal(0.05), **UNIFORM),
        0.1,
        8.0,
    ),
    "flow": (
        Ensemble(
            Gamma(1.0, 0.5), Thermal(0.05), aging=Aging("flow", 0.1, 1.0), **UNIFORM
        ),
        1.0,
        8.0,
    ),
}


def law(ensemble, v, distance):
    """Fresh and stationary, in the user's units: X, mean, variance of each."""
    c, unit, drag = (
        contacts(ensemble, v),
        ensemble.thresholds.scale,
        drag_of(ensemble, v),
    )
    born = births(c)
    found = [scatter(c, born, far, drag) for far in (distance / unit, None)]
    return [(s.X * unit, s.mean * unit, s.variance * unit**2) for s in found]


@chosen("name", CASES, ["late", "hot", "drag", "broad", "table"])
def test_moments_of_the_law(name):
    """Mean and variance of a contact's force against the master equation, as good as
    they are taken for: 5 % of the variance (and of the force) in the transient,
    wherever it is; the stationary mean to 1e-3, the variance to 1e-2. X is not near
    multiples of a threshold or delay, where the lattice rounds steps off; before 0.3
    uniform stiffness scatters by less than a cell."""
    ensemble, v, distance = CASES[name]
    (X, mean, variance), (_, level, spread) = law(ensemble, v, distance)
    exact = transient(ensemble, Drive(v, distance * 0.987), points=38, variance=True)
    force = np.interp(exact.X, X, mean)
    np.testing.assert_allclose(
        force, exact.force, rtol=0.05, atol=1e-7 * exact.force.max()
    )
    assert level[0] == pytest.approx(
        reference(ensemble, Drive(v)).friction.value, rel=1e-3, abs=0
    )
    assert spread[0] == pytest.approx(
        fluctuations(ensemble, Drive(v, 1.0), points=2).covariance[0], rel=1e-2, abs=0
    )
    if (known := exact.force_variance) is not None:
        late = exact.X > 0.3
        np.testing.assert_allclose(
            np.interp(exact.X, X, variance)[late], known[late], rtol=0.05, atol=0
        )


def test_another_law_has_another_scatter():
    """Negative control: thresholds of n = 2."""
    (_, _, ours), (_, _, level) = law(LATE, 1.0, 20.0)
    (_, _, other), (_, _, control) = law(
        Ensemble(Gamma(2.0), Thermal(0.1), Delay(5.0)), 1.0, 20.0
    )
    assert abs(control[0] / level[0] - 1) > 0.05
    assert np.mean(abs(other[1:] / ours[1:] - 1) > 0.05) > 0.5


def test_fluctuating_thresholds():
    """A few thousand paths: the mean (of the table of friction) to a tenth."""
    ensemble = Ensemble(Gamma(1.0, 0.1), aging=Aging("langevin", 0.1, 1.0), **UNIFORM)
    _, (_, level, _) = law(ensemble, 1.0, 4.0)
    assert level[0] == pytest.approx(0.333598, rel=0.1, abs=0)


def scores(ensemble, drive, seeds, points):
    """z of the force at every X > 0, one run a row, and the runs."""
    exact = transient(ensemble, drive, points=points).force
    runs = [
        trajectory(ensemble, drive, points=points, seed=seed) for seed in range(seeds)
    ]
    return np.array(
        [(run.force - exact)[1:] / run.force_stderr[1:] for run in runs]
    ), runs


@pytest.mark.parametrize(
    ("ensemble", "drive"),
    [
        (Ensemble(thermal=Thermal(0.1), delay=Delay(5.0), count=500), Drive(1.0, 5.0)),
        (Ensemble(thermal=Thermal(1.0), count=1), Drive(1e-3, 4.0)),
        (Ensemble(thermal=Thermal(1.0), count=20), Drive(1e-3, 4.0)),
        (Ensemble(delay=Delay(1.0), eta=2.0, count=5, **UNIFORM), Drive(1.0, 10.0)),
    ],
)
def test_errors_of_few_contacts_are_true(ensemble, drive):
    """60 seeds: at each X the mean of z is 0 and that of z^2 at most 1, within 5 errors
    of a mean of 60 whose z^2 has a variance of at most 2 + K/N, K/N = 50 (3e-7 and, as
    z^2 is skewed, some 1e-4 a point); no |z| beyond 6."""
    z, runs = scores(ensemble, drive, 60, 21)
    assert all(run.force_reliable for run in runs)
    assert np.all(abs(z.mean(axis=0)) < 5 / math.sqrt(60))
    assert np.all((z**2).mean(axis=0) < 1 + 5 * math.sqrt(52 / 60))
    assert abs(z).max() < 6
    assert (z**2).mean() > 0.05  # nor are they useless


def test_scatter_of_the_sample_is_no_error_of_few():
    """Negative control: by the sample variance of 20 contacts alone, the rare ones that
    are still pinned would be found beyond 10 errors."""
    z, runs = scores(
        Ensemble(thermal=Thermal(0.1), delay=Delay(5.0), count=20),
        Drive(1.0, 5.0),
        60,
        21,
    )
    # X = 3: 0.008 contacts of each ensemble are pinned
    force, i = (np.array([run.force for run in runs]), 12)
    exact = transient(LATE, Drive(1.0, 5.0), points=21).force[i]
    assert np.all(force[:, i] == 0.0) or force[:, i].max() > 10 * exact
    assert np.all(abs(z) < 5)


def test_rare_contacts_among_many():
    """100 000 contacts of which 3.3 are pinned at X = 3.6, with ten times the typical
    force; none was met there by seed 1. Three seeds and 101 points, |z| < 5."""
    ensemble, drive = (
        Ensemble(thermal=Thermal(0.1), delay=Delay(5.0), count=100_000),
        Drive(1.0, 5.0),
    )
    exact = transient(ensemble, drive, points=101).force
    for seed in (1, 2, 3):
        run = trajectory(ensemble, drive, points=101, seed=seed, threads=2)
        z = (run.force - exact)[1:] / run.force_stderr[1:]
        assert abs(z).max() < 5


def test_one_contact_of_a_stationary_start():
    """Its error bar is what the law says of the stationary state, at every X."""
    ensemble = Ensemble(thermal=Thermal(0.3), count=1)
    run = trajectory(ensemble, Drive(0.1, 5.0, "stationary"), points=11)
    spread = fluctuations(ensemble, Drive(0.1, 1.0), points=2).covariance[0]
    np.testing.assert_allclose(run.force_stderr, run.force_stderr[0], rtol=1e-9)
    square = spread + reference(ensemble, Drive(0.1)).friction.value ** 2
    # one that was not met is added
    assert spread < run.force_stderr[0] ** 2 < spread + 4 * square


@pytest.mark.verification
@pytest.mark.parametrize(("count", "seeds"), [(100_000, 6), (3_000, 30)])
def test_rare_breaks_of_fluctuating_thresholds(count, seeds):
    """One contact in 2500 has broken, which hardly any of the law's own paths has: in
    samples of some 40 such contacts (sum of squared scores, p > 1e-4) and of one or
    none (no error of 5). With the law's variance alone errors are ten times too small,
    and without those that are not met a sample that has none is some 10 errors off."""
    aging = Aging("langevin", 0.00122, 0.808)
    cold = Ensemble(
        Gamma(9.57, 0.5825),
        Thermal(0.0041),
        aging=aging,
        stiffness_law="uniform",
        count=count,
    )
    drive = Drive(0.00121, 1.17)
    exact = transient(cold, drive, points=2).force[1]
    runs = [trajectory(cold, drive, points=2, seed=seed) for seed in range(seeds)]
    z = np.array([(run.force[1] - exact) / run.force_stderr[1] for run in runs])
    assert np.abs(z).max() < 5
    assert np.sum(z**2) < scipy.stats.chi2.isf(1e-4, seeds)
    if count == 100_000:
        assert np.sum(z**2) > scipy.stats.chi2.ppf(1e-4, seeds)


@pytest.mark.parametrize(
    ("count", "distance", "reliable"),
    [(1, 60.0, False), (2, 60.0, False), (100, 60.0, True)],
)
def test_few_long_lives(count, distance, reliable):
    """kT = 1, v = 1e-3: averages over too few of the lives that matter say so; those
    over enough are normal: chi-square of 40 scores, p > 1e-4."""
    ensemble, drive = Ensemble(thermal=Thermal(1.0), count=count), Drive(1e-3, distance)
    level = reference(ensemble, Drive(1e-3)).friction.value
    runs = [trajectory(ensemble, drive, points=2, seed=seed) for seed in range(40)]
    assert {run.averages.friction.reliable for run in runs} == {reliable}
    if reliable:
        z = np.array([z_score(run.averages.friction, level) for run in runs])
        assert 1e-4 < scipy.stats.chi2.cdf(np.sum(z**2), 40) < 1 - 1e-4
        assert abs(z.mean()) < 4 / math.sqrt(40)


def test_averages_of_few_lives_would_be_wrong():
    """Negative control of the count of lives: N = 1 over 4 x_*, whose errors 64 batches
    do not know."""
    ensemble = Ensemble(thermal=Thermal(1.0), count=1)
    level = reference(ensemble, Drive(1e-3)).friction.value
    runs = [
        trajectory(ensemble, Drive(1e-3, 4.0), points=2, seed=seed)
        for seed in range(40)
    ]
    assert not any(run.averages.friction.reliable for run in runs)
    assert np.mean([z_score(run.averages.friction, level) ** 2 for run in runs]) > 3


@pytest.mark.parametrize(("count", "replicas"), [(1, 1), (20, 1), (5, 20)])
def test_broad_laws_are_not_trusted(count, replicas):
    """Log-normal thresholds at T = 0 with the sqrt law: forces have no scatter that any
    sample could show."""
    run = trajectory(
        Ensemble(BROAD, count=count),
        Drive(1.0, 330.0, "stationary"),
        points=5,
        replicas=replicas,
    )
    assert not run.force_reliable
    assert not run.averages.friction.reliable
    tame = trajectory(
        Ensemble(count=count),
        Drive(1.0, 30.0, "stationary"),
        points=5,
        replicas=replicas,
    )
    assert tame.force_reliable


def test_a_transient_that_is_not_over():
    """Delays of 5: after 10 the average over the second half is still far from the
    steady one, which its halves alone do not show."""
    run = trajectory(
        Ensemble(thermal=Thermal(0.1), delay=Delay(5.0), count=2000),
        Drive(1.0, 20.0),
        points=2,
    )
    assert (
        abs(z_score(run.averages.friction, reference(LATE, Drive(1.0)).friction.value))
        > 3
    )
    assert not any(found.reliable for found in run.averages.averages().values())


@pytest.mark.parametrize(
    "ensemble", [Ensemble(), Ensemble(delay=Delay(1.0), eta=2.0, **UNIFORM)]
)
def test_many_contacts_know_their_errors(ensemble):
    """The errors of 100 000 ordinary contacts are those of the sample, to 2 %."""
    n, drag = 100_000, drag_of(ensemble, 1.0)
    run = Run(8.0, 41)
    c, total = contacts(ensemble, 1.0), Totals(42, 41, 1)
    scales = Scales.of(c, run, n, 1, drag)
    constant_drive(c, Fresh(), run, scales, key(1, TRAJECTORY), 0.0).simulate(
        total, 0, n
    )
    _, _, variance, _ = moments(total.deposits, scales, run, n, drag)
    born = births(c)
    fresh, level = scatter(c, born, 8.0, drag), scatter(c, born, None, drag)
    quoted, rare = known_variance(fresh.at(np.linspace(0, 8.0, 41)), level, variance, n)
    np.testing.assert_allclose(quoted[5:], variance[5:] / n, rtol=0.04)  # of the square
    assert rare[5:].max() < 1e-6


def test_no_scatter_at_all():
    """Identical contacts at T = 0 have exact averages, however few they are."""
    c = contacts(Ensemble(Delta(2.0), delay=Delay(0.25)), 2.0)
    assert set(independent(c, births(c), 0.3)[0]) == {math.inf}


@pytest.mark.parametrize("stage", [None, Stage(0.5)], ids=["rigid", "behind a spring"])
def test_change_in_which_hardly_a_contact_breaks(stage):
    """A hold in which a fifth of a contact breaks on the average: the force falls by
    what the mean field says within five of its errors, which know of the contacts that
    broke in no part (six or more would have to break, a false alarm of 1e-7 each)."""
    warm = Ensemble(count=640, thermal=Thermal(0.02), **UNIFORM)
    replicas = 8 if stage else 1
    hold = Segment(time=0.1 / warm.count / replicas)
    programme = Programme([Segment(0.1, distance=3.0), hold], stage=stage)
    before, after = transient(warm, programme, points=21).force[[10, 20]]
    for seed in range(5):
        run = trajectory(warm, programme, points=21, seed=seed, replicas=replicas)
        relaxation = run.segments[1].relaxation
        assert relaxation.reliable
        assert relaxation.stderr > 0.0
        assert abs(z_score(relaxation, before - after)) < 5.0


@pytest.mark.parametrize(("segments", "parts"), [(10, 50), (100, 20), (1000, 8)])
def test_many_segments_are_followed_in_few_parts(segments, parts):
    """Errors of changes are known from as many equal parts of 400 contacts as take
    little time; each takes some for every segment. At least eight tell them."""
    paces = [0.1 if i % 2 else 0.2 for i in range(segments)]
    programme = Programme([Segment(pace, distance=0.01) for pace in paces])
    run = trajectory(Ensemble(count=400, **UNIFORM), programme, points=2 * segments + 1)
    assert run.segments[1].step.a_minus_b.dof == parts - 1


def test_nothing_changes_in_cold_holds():
    programme = Programme([Segment(0.1, distance=3.0), Segment(time=1.0)])
    run = trajectory(Ensemble(count=6400), programme, points=21)
    relaxation = run.segments[1].relaxation
    assert (relaxation.value, relaxation.stderr) == (0.0, 0.0)
