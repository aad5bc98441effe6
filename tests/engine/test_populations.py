"""Contacts of several kinds: exact sums over kinds, and simulations of them.

Seeds are fixed; stated false-alarm rates are those of a fresh seed.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cases import chosen
from scipy import stats

from eqsim import (
    OBSERVABLES,
    Aging,
    Delay,
    Delta,
    Drive,
    Elastic,
    Ensemble,
    Estimate,
    Gamma,
    InputError,
    Interface,
    Newborn,
    NoThresholds,
    Pareto,
    Population,
    Programme,
    Segment,
    Stage,
    Thermal,
    Units,
    breaks,
    curve,
    elastic_trajectory,
    fluctuations,
    reference,
    stability,
    steady,
    trajectory,
    transient,
    z_score,
)
from eqsim.engine import slider
from eqsim.master import slider as mean_field
from eqsim.model.ensemble import Kind, split
from eqsim.model.mixture import mixed_averages

STRONG = Population(
    0.3, 4.0, Gamma(3.0, x_star=2.0), Thermal(kT=0.4), Delay(2.0, "exponential")
)
WEAK = Population(0.7, thresholds=Gamma(1.0, x_star=0.5))
# k = 0.3 4 + 0.7 1 = 1.9
MIX = Ensemble(
    thermal=Thermal(kT=0.05), delay=Delay(0.5), eta=0.2, populations=(STRONG, WEAK)
)
K = 1.9
ALONE = [
    replace(
        MIX,
        populations=(),
        stiffness=4.0,
        thresholds=Gamma(3.0, x_star=2.0),
        thermal=Thermal(kT=0.4),
        delay=Delay(2.0, "exponential"),
    ),
    replace(MIX, populations=(), thresholds=Gamma(1.0, x_star=0.5)),
]
WEIGHTS = np.array([0.3 * 4.0, 0.7]) / K
SHARES = np.array([0.3, 0.7])
DRIVE = Drive(0.3)
ROUND_TRIP = Programme(
    [Segment(0.3, distance=3.0), Segment(0, time=4.0), Segment(-0.6, distance=1.0)]
)


def chi_square(z):
    """Probability of a chi-square as far out, on either side."""
    z = np.asarray(z)
    below = stats.chi2.cdf(np.sum(z**2), z.size)
    return 2.0 * min(below, 1.0 - below)


# ---- the contacts ----


@pytest.mark.parametrize(
    ("count", "shares", "expected"),
    [
        (1, [0.5, 0.3, 0.2], [1, 0, 0]),
        (2, [0.5, 0.3, 0.2], [1, 1, 0]),
        (10, [0.5, 0.3, 0.2], [5, 3, 2]),
        (1, [1, 1, 1], [1, 0, 0]),
        (2, [1, 1, 1], [1, 1, 0]),
        (10, [1, 1, 1], [4, 3, 3]),
        (10, [0.26, 0.26, 0.48], [3, 2, 5]),
        (10**12, [1e-100, 1e100, 1e100], [0, 5 * 10**11, 5 * 10**11]),
    ],
)
def test_contacts_are_divided_by_largest_remainders(count, shares, expected):
    assert split(count, shares) == expected


def test_division_is_within_one_contact():
    rng = np.random.default_rng(1)
    for _ in range(300):
        shares = 10 ** rng.uniform(-3, 3, rng.integers(1, 9))
        count = int(10 ** rng.uniform(0, 9))
        numbers = split(count, shares.tolist())
        assert sum(numbers) == count
        assert np.all(abs(numbers - count * shares / shares.sum()) < 1 + 1e-9)


def test_shares_are_relative_and_of_the_contacts_that_there_are():
    kinds = MIX.kinds
    assert [kind.contacts.count for kind in kinds] == [30_000, 70_000]
    assert [replace(kind.contacts, count=1) for kind in kinds] == [
        replace(each, count=1) for each in ALONE
    ]
    doubled = [replace(each, share=2.0 * each.share) for each in MIX.populations]
    assert replace(MIX, populations=doubled).kinds == kinds
    few = replace(MIX, count=3).kinds
    assert [(kind.share, kind.contacts.count) for kind in few] == [
        (1 / 3, 1),
        (2 / 3, 2),
    ]
    (only,) = replace(MIX, count=1).kinds
    assert (only.number, only.share, only.weight) == (1, 1.0, 1.0)
    assert replace(MIX, count=1).mean_stiffness == 1.0
    assert MIX.mean_stiffness == pytest.approx(K, rel=1e-15, abs=0)


@pytest.mark.parametrize("share", [0.0, -1.0, np.nan, np.inf, "a", None])
def test_wrong_shares(share):
    with pytest.raises(InputError, match=r"^share = .* must be a"):
        Population(share)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (Population(1.0, stiffness=0.0), r"^population.1.stiffness = 0.0: must be"),
        (Population(1.0, thresholds="gamma"), r"^population.1.thresholds = "),
    ],
)
def test_wrong_laws_name_their_population(wrong, said):
    with pytest.raises(InputError, match=said):
        Ensemble(populations=[Population(1.0), wrong])


def test_a_population_takes_objects_of_its_types():
    with pytest.raises(InputError, match=r"^delay = 3.0: must be Delay\("):
        Population(1.0, delay=3.0)


# ---- exact values ----


def test_exact_averages_are_sums_over_kinds():
    """Shares of the breaks are found here from pinned shares and travels."""
    mixed = reference(MIX, DRIVE, variance=True)
    each = [reference(alone, DRIVE, variance=True) for alone in ALONE]

    def of(name):
        return np.array([getattr(one, name).value for one in each])

    per_way = SHARES * of("pinned") / of("travel")  # breaks per contact
    expected = {
        "friction": WEIGHTS @ of("friction"),
        "pinned": SHARES @ of("pinned"),
        "force_variance": WEIGHTS**2 / SHARES @ of("force_variance"),
        "travel": per_way @ of("travel") / per_way.sum(),
        "break_stretch": per_way @ of("break_stretch") / per_way.sum(),
        "birth_stretch": 0.0,
        "f_k": WEIGHTS @ (of("f_k") * of("pinned")) / (SHARES @ of("pinned")),
    }
    for name, value in expected.items():
        found = getattr(mixed, name)
        assert found.value == pytest.approx(value, rel=1e-13, abs=0), name
        assert found.stderr < 1e-8
    found = curve(MIX, [0.3, 3.0])
    for name in ("friction", "pinned", "break_stretch"):
        value = getattr(mixed, name).value
        assert getattr(found, name)[0] == pytest.approx(value, rel=1e-13, abs=0)


def test_two_thresholds_in_closed_form():
    """At T = 0 and of uniform stiffness: a life of threshold a takes a, carries a/2 in
    the mean, and then waits for v tau."""
    contacts = Ensemble(
        stiffness_law="uniform",
        count=1000,
        populations=[
            Population(1.0, 2.0, Delta(1.0)),
            Population(3.0, 0.5, Delta(4.0), delay=Delay(2.0)),
        ],
    )
    exact = reference(contacts, Drive(0.5), variance=True)
    # per contact, in units of force
    forces = (0.25 * 2.0 * 0.5, 0.75 * 0.5 * (8.0 / 5.0))
    k = 0.25 * 2.0 + 0.75 * 0.5
    assert exact.friction.value == pytest.approx(sum(forces) / k, rel=1e-12, abs=0)
    assert exact.pinned.value == pytest.approx(0.25 + 0.75 * 0.8, rel=1e-12, abs=0)
    rates = 0.25 / 1.0, 0.75 / 5.0
    mean = (rates[0] * 1.0 + rates[1] * 4.0) / sum(rates)
    assert exact.break_stretch.value == pytest.approx(mean, rel=1e-12, abs=0)
    variances = 1 / 3 - 0.25, 64 / 3 / 5 - (8 / 5) ** 2
    variance = 0.25 * 4.0 * variances[0] + 0.75 * 0.25 * variances[1]
    found = exact.force_variance.value
    assert found == pytest.approx(variance / k**2, rel=1e-12, abs=0)
    force = exact.in_units(Units(force="N"), Interface(contacts_per_area=1.0))["force"]
    assert force.value == pytest.approx(1000 * sum(forces), rel=1e-12, abs=0)


@chosen("drive", [Drive(0.3, 4.0), ROUND_TRIP], [Drive(0.3, 4.0)])
def test_transients_are_sums_over_kinds(drive):
    mixed = transient(MIX, drive, 41, variance=True)
    each = [transient(alone, drive, 41, variance=True) for alone in ALONE]
    for name, factor in (
        ("force", WEIGHTS),
        ("pinned", SHARES),
        ("breaks", SHARES),
        ("force_variance", WEIGHTS**2 / SHARES),
    ):
        expected = sum(f * getattr(x, name) for f, x in zip(factor, each, strict=True))
        assert getattr(mixed, name) == pytest.approx(expected, rel=1e-13, abs=1e-15)
    assert np.all(mixed.X == each[0].X)


def test_fluctuations_are_sums_over_kinds():
    drive = Drive(0.3, 4.0)
    mixed = fluctuations(MIX, drive, 5)
    each = [fluctuations(alone, drive, 5).covariance for alone in ALONE]
    factors = WEIGHTS**2 / SHARES
    expected = factors[0] * each[0] + factors[1] * each[1]
    assert mixed.covariance == pytest.approx(expected, rel=1e-13, abs=1e-15)


def test_the_default_distance_is_that_of_the_largest_thresholds():
    way = 200.0 * max(alone.thresholds.mean for alone in ALONE)
    assert transient(MIX, DRIVE, 3).X[-1] == pytest.approx(way, rel=1e-15, abs=0)


# ---- simulations ----


DRIVES = [Drive(0.3, 4.0), ROUND_TRIP, replace(ROUND_TRIP, stage=Stage(0.5))]


@chosen("drive", DRIVES, DRIVES[:1])
def test_one_population_is_the_ensemble_to_the_last_bit(drive):
    alone = replace(ALONE[0], count=500)
    only = replace(MIX, populations=[STRONG], count=500)
    for name in OBSERVABLES:
        ours, theirs = (getattr(steady(x, DRIVE), name) for x in (only, alone))
        assert (ours.value, ours.n) == (theirs.value, theirs.n)
    ours, theirs = (trajectory(x, drive, points=11, replicas=2) for x in (only, alone))
    for name, column in ours.columns().items():
        assert np.array_equal(column, theirs.columns()[name], equal_nan=True), name


def test_errors_of_means_over_breaks():
    """In first order, by differences: of a kind's travel and stretch at birth, which may
    be off together, and of all kinds in quadrature or as bounds."""
    errors, step = np.array([[0.03, 0.01], [0.02, 0.04]]), 1e-6

    def averages(births, travels):  # of both kinds
        each = []
        for birth, travel, (of_birth, of_travel) in zip(
            births, travels, errors, strict=True
        ):
            found = dict.fromkeys(OBSERVABLES, Estimate(0.5, 0.1, 9))
            found["birth_stretch"] = Estimate(birth, of_birth, 9)
            found["travel"] = Estimate(travel, of_travel, 9)
            found["break_stretch"] = Estimate(birth + travel, None, 9)
            each.append(SimpleNamespace(**found))
        return each

    at = np.array([[0.3, 0.1], [1.5, 0.4]])
    names = ("birth_stretch", "travel", "break_stretch")

    def values(births, travels):
        mixed = mixed_averages(MIX.kinds, averages(births, travels), 0.7)
        return np.array([mixed[name].value for name in names])

    slopes = np.empty((2, 2, 3))  # quantities, kinds, means
    for place in np.ndindex(2, 2):
        beyond, before = at.copy(), at.copy()
        beyond[place] += step
        before[place] -= step
        slopes[place] = np.abs(values(*beyond) - values(*before)) / (2.0 * step)
    of_kinds = np.sum(slopes * errors.T[:, :, None], axis=0)
    for bounds, known in (
        (False, np.sqrt(np.sum(of_kinds**2, axis=0))),
        (True, of_kinds.sum(axis=0)),
    ):
        mixed = mixed_averages(MIX.kinds, averages(*at), 0.7, bounds)
        stated = [mixed[name].stderr for name in names]
        # means of 1 over 2e-6 round slopes, .01 to 1, to 1e-10: relative to the errors,
        # which the largest slopes make, to 1e-9; what is left of third order is 1e-12
        np.testing.assert_allclose(stated, known, rtol=1e-8, atol=0)


BIRTHS = [Newborn(), Newborn("normal", mean=0.1, std=0.05)]


@chosen("newborn", BIRTHS, BIRTHS[:1])
def test_steady_averages(newborn):
    """60 seeds, each observable's chi-square on both sides (p > 1e-4) and |z| < 4.5; the
    control averages over contacts what are means over breaks."""
    contacts = replace(MIX, newborn=newborn)
    exact = reference(contacts, DRIVE, variance=True)
    found = [steady(contacts, DRIVE, rel_error=1e-2, seed=i) for i in range(60)]
    lives = sum(one.lives for one in found)
    assert lives >= 1e5
    for name in ("friction", "pinned", "break_stretch", "travel", "force_variance"):
        level = getattr(exact, name)
        ours = [getattr(one, name) for one in found]
        z = [z_score(each, level.value, level.stderr) for each in ours]
        assert chi_square(z) > 1e-4, (name, np.mean(np.square(z)))
        assert np.max(np.abs(z)) < 4.5, name
    each = [reference(alone, DRIVE).travel.value for alone in ALONE]
    wrong = [z_score(one.travel, SHARES @ each) for one in found]
    assert chi_square(wrong) < 1e-4


@pytest.fixture(scope="module")
def runs():
    """100 runs of 2000 contacts, some 40 lives of each."""
    contacts = replace(MIX, count=2000)
    return [
        trajectory(contacts, Drive(0.3, 40.0), points=81, seed=seed)
        for seed in range(100)
    ]


def test_trajectories(runs):
    """At three instants, and in the mean over the second half: chi-square over 100
    seeds, p > 1e-4 on both sides."""
    exact = transient(MIX, Drive(0.3, 40.0), 81)
    for i in (1, 5, 80):
        for name in ("force", "pinned"):
            z = [
                (getattr(run, name)[i] - getattr(exact, name)[i])
                / getattr(run, f"{name}_stderr")[i]
                for run in runs
            ]
            assert chi_square(z) > 1e-4, (i, name, np.mean(np.square(z)))
    level = reference(MIX, DRIVE)
    for name in ("friction", "pinned", "break_stretch"):
        value = getattr(level, name).value
        z = [z_score(getattr(run.averages, name), value) for run in runs]
        assert chi_square(z) > 1e-4, (name, np.mean(np.square(z)))
    # weights taken for shares, which a mixture of equal stiffness would not show
    friction = [reference(alone, DRIVE).friction.value for alone in ALONE]
    wrong = [z_score(run.friction, SHARES @ friction) for run in runs]
    assert chi_square(wrong) < 1e-4


def test_breaks_of_all_contacts_together():
    """The mean over a list of the breaks of both kinds, without any formula for their
    shares: 300 contacts over 400 lives, |z| < 4.5."""
    far, sums = Drive(0.3, 600.0), []
    for number, (alone, count) in enumerate(zip(ALONE, (90, 210), strict=True)):
        listed = breaks(replace(alone, count=count), far, seed=number + 1)
        late = listed.X > 100.0
        stretch = np.bincount(listed.contact[late], listed.stretch[late], count)
        sums.append((stretch, np.bincount(listed.contact[late], minlength=count)))
    value = sum(s.sum() for s, _ in sums) / sum(n.sum() for _, n in sums)
    of_kinds = [s - value * n for s, n in sums]
    variance = sum(r.size * np.var(r, ddof=1) for r in of_kinds)
    error = np.sqrt(variance) / sum(n.sum() for _, n in sums)
    assert sum(n.sum() for _, n in sums) > 1e5
    exact = reference(MIX, DRIVE).break_stretch.value
    assert abs(value - exact) < 4.5 * error
    assert abs(SHARES @ [reference(x, DRIVE).travel.value for x in ALONE] - value) > (
        4.5 * error
    )


@pytest.mark.verification
@chosen("count", [1, 2, 10], [2])
def test_few_contacts_of_three_kinds(count):
    """1e5 lives in ensembles of so few: the exact mean is that of the same division.
    |z| < 4.5 at four instants."""
    three = [replace(STRONG, share=0.5), replace(WEAK, share=0.3), Population(0.2)]
    contacts = replace(MIX, count=count, populations=three)
    drive, replicas = Drive(0.3, 30.0), 20_000 // count
    found = trajectory(contacts, drive, points=5, replicas=replicas)
    exact = transient(contacts, drive, 5)
    assert found.lives >= 1e5
    z = (found.force - exact.force)[1:] / found.force_stderr[1:]
    assert np.max(np.abs(z)) < 4.5
    z = (found.pinned - exact.pinned)[1:] / found.pinned_stderr[1:]
    assert np.max(np.abs(z)) < 4.5


@pytest.mark.parametrize("independent", [True, False])
def test_identical_populations_are_independent(monkeypatch, independent):
    """The variance over 2000 ensembles is that of one population, chi-square p > 1e-4
    on both sides; with the same random numbers for both it is twice as large."""
    if not independent:
        monkeypatch.setattr(Kind, "seed", lambda _, seed: seed)
    alone = replace(ALONE[1], count=20)
    two = replace(alone, populations=[Population(1.0), Population(1.0)])
    drive = Drive(0.3, 3.0)
    found = trajectory(two, drive, points=3, replicas=2000)
    exact = transient(alone, drive, 3, variance=True)
    std = np.std(found.force_replicas[:, -1], ddof=1)
    ratio = 20 * std**2 / exact.force_variance[-1]
    below = stats.chi2.cdf(1999 * ratio, 1999)
    assert (1e-4 < below < 1 - 1e-4) == independent
    if independent:
        z = (found.force - exact.force)[1:] / found.force_stderr[1:]
        assert np.max(np.abs(z)) < 4.5
        # of the scatter of each kind: 2000 ensembles tell it to 1.6 %
        assert found.force_replica_std[-1] == pytest.approx(std, rel=0.1, abs=0)


def test_threads_do_not_change_a_bit():
    for stage, count in ((None, 3000), (Stage(0.5), 40_000)):
        drive = replace(ROUND_TRIP, stage=stage)
        contacts = replace(MIX, count=count)
        one, two = (trajectory(contacts, drive, points=7, threads=n) for n in (1, 2))
        assert np.array_equal(one.force, two.force)
        assert one.lives == two.lives


# ---- behind a stage ----


@chosen("wrong", [False, True], [])
def test_a_stiff_stage_moves_all_kinds_as_a_rigid_slider(monkeypatch, wrong):
    """A spring of 2000 N k: X is the stage's to F/2000. |z| < 4.5 in the quoted error
    and the difference of X, and energies add up; not if lengths of a kind are taken for
    those of the ensemble."""
    if wrong:
        monkeypatch.setattr(slider, "_OF_LENGTH", np.zeros_like(slider._OF_LENGTH))
    contacts = replace(MIX, count=4000)
    drive = Programme(
        [Segment(0.3, distance=3.0), Segment(0, time=3.0)],
        start="stationary",
        velocity=0.3,
    )
    pulled = replace(drive, stage=Stage(2000.0, damping=0.5))
    found = trajectory(contacts, pulled, points=11, replicas=8)
    exact = transient(contacts, drive, 11)
    # the damped slider lags by (F + damping v)/2000; F changes by at most k_max/k dX
    lag = np.abs(found.X - np.interp(found.t, exact.t, exact.X)).max() * 4.0 / K
    z = (found.force - exact.force) / np.hypot(found.force_stderr, lag)
    pinned = (found.pinned - exact.pinned) / np.hypot(found.pinned_stderr, lag)
    agree = np.max(np.abs(z)) < 4.5
    missing = np.abs(found.energy[:, 3]).max() / found.energy[-1, 0]
    assert found.lives > 1e5
    assert np.max(np.abs(pinned)) < 4.5
    assert (agree and missing < 1e-3) == (not wrong)


@pytest.mark.verification
def test_a_stage_pulls_identical_populations_as_one():
    """Stick-slip of 16 replicas each; populations have other units than the ensemble.
    |z| < 4.5 of X and force at ten instants (one false alarm in 7000)."""
    alone = replace(ALONE[1], count=1000)
    parts = [Population(1.0, thresholds=alone.thresholds)] * 2
    two = replace(alone, thresholds=Gamma(1.0, x_star=3.0), populations=parts)
    stage = Stage(0.2, damping=0.05)
    drive = Programme([Segment(0.3, distance=4.0)], stage=stage)
    ours, theirs = (
        trajectory(contacts, drive, points=11, replicas=16, seed=seed)
        for contacts, seed in ((two, 7), (alone, 8))
    )
    for name in ("X", "force", "pinned"):
        difference = getattr(ours, name) - getattr(theirs, name)
        errors = [getattr(run, f"{name}_stderr") for run in (ours, theirs)]
        z = difference[1:] / np.hypot(*errors)[1:]
        assert np.max(np.abs(z)) < 4.5, name


# ---- the mean field of all kinds behind a spring ----

COLD = Ensemble(Gamma(1.0), delay=Delay(0.1), count=1000)
SLIDES = Programme([Segment(0.3, distance=4.0)], stage=Stage(0.5, damping=0.05))
DRIVEN = Programme(
    [Segment(0.3, distance=3.0), Segment(0.9, distance=1.5)], stage=Stage(2.0)
)


def missed(contacts, alone, drive=SLIDES):
    """Largest difference of means."""
    ours, theirs = (transient(x, drive, 9, variance=True) for x in (contacts, alone))
    names = "X", "force", "pinned", "breaks", "force_variance"
    return max(np.abs(getattr(ours, x) - getattr(theirs, x)).max() for x in names)


@pytest.mark.verification
def test_the_mean_field_of_identical_populations_is_that_of_one():
    """Steps are the same up to rounding, which moves their ends and with it what they
    miss, by less than 1e-10 of lengths of about 1; stiffer contacts are others."""
    kinds = [Population(0.3), Population(0.7)]
    assert missed(replace(COLD, populations=kinds), COLD) < 1e-10
    kinds = [Population(0.3), Population(0.7, stiffness=1.5, thresholds=Gamma(2.0))]
    assert missed(replace(COLD, populations=kinds), COLD) > 1e-2


@pytest.mark.verification
@pytest.mark.parametrize("start", ["fresh", "stationary"])
def test_steps_of_all_kinds_are_repeated(start):
    """As fits of records do, up to rounding of some hundred steps, each found again as
    the difference of its ends."""
    kinds = [Population(0.3), Population(0.7, thresholds=Gamma(1.0, x_star=0.5))]
    velocity = 0.3 if start == "stationary" else None
    drive = replace(SLIDES, start=start, velocity=velocity)
    task = replace(COLD, populations=kinds), drive, drive.grid(5), 0.7
    noted = mean_field.choices_of(*task, 4000)
    again = mean_field.force_of(*task, 4000, noted)
    assert np.abs(again - mean_field.force_of(*task, 4000)).max() < 1e-12


@pytest.mark.verification
def test_a_law_in_another_unit_changes_the_mean_field_within_its_error():
    """Rounding takes other decisions where cohorts are as wide as allowed."""
    kinds = [Population(share, thresholds=COLD.thresholds) for share in (0.3, 0.7)]
    other = replace(COLD, thresholds=Gamma(1.0, x_star=3.0), populations=kinds)
    most = transient(COLD, SLIDES, 9).force_error.max()
    assert missed(other, COLD) < most < 3e-4


@pytest.mark.verification
@pytest.mark.parametrize("exchanged", [False, True])
@pytest.mark.parametrize("contacts", [MIX, replace(MIX, thermal=Thermal(), eta=0.0)])
def test_the_mean_field_is_that_of_simulated_populations(contacts, exchanged):
    """|z| < 4.5 of X, force and pinned share at twelve instants, 16 replicas (one false
    alarm in 4000, the standard errors having 15 degrees of freedom and more where
    contacts are pooled); exchanged shares are found out."""
    found = trajectory(
        replace(contacts, count=20_000), DRIVEN, points=13, replicas=16, seed=3
    )
    kinds = contacts.populations
    if exchanged:
        shares = [kind.share for kind in kinds[::-1]]
        kinds = [replace(x, share=s) for x, s in zip(kinds, shares, strict=True)]
    exact, most = transient(replace(contacts, populations=kinds), DRIVEN, 13), []
    for name in ("X", "force", "pinned"):
        errors = [getattr(found, f"{name}_stderr"), getattr(exact, f"{name}_error")]
        apart = getattr(found, name) - getattr(exact, name)
        most.append(np.max(np.abs(apart[1:]) / np.hypot(*errors)[1:]))
    assert (max(most) < 4.5) == (not exchanged)


@pytest.mark.verification
def test_the_mean_field_behind_a_stiff_spring_is_a_rigid_mixture():
    """The slider lags by F/K, and F changes by at most k_max/k of that."""
    stiff = transient(MIX, replace(DRIVEN, stage=Stage(1e4)), 13)
    rigid = transient(MIX, replace(DRIVEN, stage=None), 13)
    lag = 4.0 / K * (np.abs(rigid.force).max() + 0.2 * 0.9 / K) / 1e4
    missed = lag + stiff.force_error + rigid.force_error
    assert np.all(np.abs(stiff.force - rigid.force) <= missed)
    assert lag < 1e-3


# ---- what stands above them ----


def test_kinds_do_not_depend_on_what_stands_above_them():
    """Contacts with thresholds among bonds without, whichever is written at the top."""
    bonds = Thermal(barrier="bell", off_rate=0.1, force_scale=1.0)
    warm = Thermal(0.1)
    half = Population(0.5)
    above = Ensemble(
        NoThresholds(),
        bonds,
        populations=(half, Population(0.5, thresholds=Gamma(), thermal=warm)),
    )
    below = Ensemble(
        Gamma(),
        warm,
        populations=(Population(0.5, thresholds=NoThresholds(), thermal=bonds), half),
    )
    laws = [kind.contacts.stiffness_law for kind in above.kinds]
    assert laws == ["uniform", "sqrt"]
    found = [reference(x, DRIVE).friction for x in (above, below)]
    errors = found[0].stderr + found[1].stderr
    assert abs(found[0].value - found[1].value) <= errors


def test_laws_that_no_contact_has_are_not_checked():
    """Nor is the unit of length that they have a measure of accuracy."""
    kinds = [Population(0.5, thresholds=Gamma(1.0, x_star=x)) for x in (1e-9, 2e-9)]
    aging = Aging("flow", rate=1e-9, x_star_final=3e-9)
    mixed = Ensemble(aging=aging, populations=kinds)
    assert reference(mixed, DRIVE).friction.value > 0.0
    pull = Programme([Segment(0.3, distance=1e-9)], stage=Stage(0.2))
    task = mean_field.task_of(replace(mixed, aging=Aging()), pull, pull.grid(3))
    assert task.spring.unit == 1e-9


# ---- what needs contacts of one kind ----

STAGED = Programme([Segment(0.3, distance=1.0)], stage=Stage(0.2))


@pytest.mark.parametrize(
    "refused",
    [
        lambda x: breaks(x, Drive(0.3, 1.0)),
        lambda x: breaks(
            replace(x, aging=Aging(rule="langevin", rate=0.1)), Drive(0.3)
        ),
        lambda x: stability(x, STAGED),
        lambda x: elastic_trajectory(
            Ensemble(stiffness_law="uniform", populations=x.populations),
            Drive(0.3, elastic=Elastic(10, 1.0, 0.1)),
        ),
    ],
)
def test_others_are_refused_in_one_line(refused):
    with pytest.raises(InputError, match=r"^population: [^\n]*$"):
        refused(MIX)


def test_an_infinite_variance_of_one_kind():
    heavy = Population(0.01, thresholds=Pareto(3.5))
    contacts = replace(MIX, populations=[WEAK, heavy], thermal=Thermal())
    assert "diverges" in contacts.divergence
    exact = reference(contacts, DRIVE, variance=True)
    found = steady(contacts, DRIVE, rel_error=1e-2)
    assert exact.force_variance.diverges
    assert found.force_variance.diverges
    assert np.isfinite(found.friction.value)
    assert not MIX.divergence


def test_bonds_that_never_form_again():
    """A bundle beside contacts that re-attach: only these are pinned in the end."""
    gone = Population(1.0, delay=Delay(np.inf))
    stays = Population(1.0, 2.0, delay=Delay(1.0))
    contacts = Ensemble(count=1000, populations=[gone, stays])
    exact = reference(contacts, DRIVE)
    alone = reference(Ensemble(stiffness=2.0, delay=Delay(1.0)), DRIVE)
    for name, share in (("friction", 2 / 3), ("pinned", 0.5), ("travel", 1.0)):
        expected = share * getattr(alone, name).value
        found = getattr(exact, name).value
        assert found == pytest.approx(expected, rel=1e-13, abs=0), name
    none = reference(replace(contacts, populations=[gone, gone]), DRIVE)
    assert none.pinned.value == none.friction.value == 0.0
    assert none.travel.value is none.f_k.value is None
    drive = Drive(0.3, 3.0)
    found, mean = trajectory(contacts, drive, points=4), transient(contacts, drive, 4)
    z = (found.force - mean.force)[1:] / found.force_stderr[1:]
    assert np.max(np.abs(z)) < 4.5
    with pytest.raises(InputError, match=r"^delay.time = inf"):
        trajectory(contacts, replace(drive, start="stationary"))


def test_delays_that_depend_on_temperature_and_velocity():
    """Each kind's own temperature decides its share of the breaks."""
    delay = Delay(0.1, activation=1.0, velocity_exponent=0.5)
    kinds = [Population(1.0, thermal=Thermal(kT=kT)) for kT in (0.3, 1.0)]
    contacts = Ensemble(delay=delay, populations=kinds)
    found = reference(contacts, DRIVE)
    each = [reference(kind.contacts, DRIVE) for kind in contacts.kinds]
    rates = np.array([one.pinned.value / one.travel.value for one in each])
    mean = rates @ [one.travel.value for one in each] / rates.sum()
    assert found.travel.value == pytest.approx(mean, rel=1e-13, abs=0)


def test_a_motor_drives_all_kinds_together():
    """At the velocity where its own friction is that of the mixture."""
    motor = Programme([Segment(1.0, distance=3.0)], stall_force=3.0)
    found = reference(MIX, motor)
    v = found.velocity.value
    friction = reference(MIX, Drive(v)).friction.value
    assert v == pytest.approx(1.0 - friction / 3.0, rel=1e-10, abs=0)
