"""The validation program itself: it passes for the right engine and fails when one
thing is wrong."""

import dataclasses
import itertools
import json
import math
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy import stats
from typer.testing import CliRunner

from eqsim import (
    Aging,
    Delay,
    Delta,
    Distribution,
    Drive,
    Ensemble,
    Gamma,
    InputError,
    Lognormal,
    Pathway,
    Programme,
    Segment,
    Table,
    Thermal,
    reference,
    steady,
    trajectory,
)
from eqsim.cli.app import app
from eqsim.estimate import OBSERVABLES, Estimate, mean_of, z_score
from eqsim.laws.barrier import BARRIERS
from eqsim.laws.newborn import Newborn
from eqsim.laws.no_thresholds import NoThresholds
from eqsim.master.transient import transient
from eqsim.validation import (
    columns,
    law_text,
    points,
    pulled,
    scores,
    validate,
    verdict,
)
from eqsim.validation.comparison import DECLINED, REASONS, Point, Score, Unscored
from eqsim.validation.enough import (
    many_contribute,
    squaring_share_at_last,
    squaring_shares_at_first,
)
from eqsim.validation.points import DRAWN_LAWS, SUITES, Suite, sample
from eqsim.validation.scores import (
    _mean_squares,
    averages,
    compare_driven,
    fluctuating,
    hazards,
    of_products,
    programme_of,
    programmes,
    transients,
)
from eqsim.validation.verdict import KINDS, Validation, judge

QUICK = SUITES["quick"]


def at(ensemble, velocity, shown=None, seed=1, threads=1):
    """A point of the parameter space."""
    return Point(0, ensemble, shown or ensemble, velocity, seed, 1, threads)


def changed(**changes):
    return lambda ensemble: dataclasses.replace(ensemble, **changes)


def flowing(ensemble):
    """The same contacts, whose thresholds follow the mean drift."""
    aging = dataclasses.replace(ensemble.aging, rule="flow")
    return dataclasses.replace(ensemble, aging=aging)


def smooth_and_warm(e, v):
    """True of contacts born unstressed that heat breaks, with thresholds without
    atoms."""
    return e.thermal.kT > 0 and not e.thresholds.steps.size and not e.newborn.active


def made(found):
    return [one for one in found if isinstance(one, Score)]


@pytest.mark.parametrize(
    ("size", "wrong", "of", "kinds"),
    [
        (
            2,
            changed(disorder="quenched"),
            lambda e, v: (
                smooth_and_warm(e, v)
                and e.thermal.barrier == "soft"  # of kernels that others compile, too
                and not e.aging.active
            ),
            {"friction", "break_stretch"},
        ),
        pytest.param(
            4,
            changed(disorder="quenched"),
            smooth_and_warm,
            {"friction", "break_stretch", "transient", "hazard", "hazard law"},
            marks=pytest.mark.verification,
        ),
        pytest.param(
            3,
            flowing,
            lambda e, v: e.fluctuates and v > 0.1 * e.thresholds.scale,
            {"friction", "break_stretch"},
            marks=pytest.mark.verification,
        ),
        pytest.param(
            6,
            changed(aging=Aging()),
            lambda e, v: True,
            {"friction", "break_stretch"},
            marks=pytest.mark.verification,
        ),
        pytest.param(
            4,
            changed(newborn=Newborn()),
            lambda e, v: e.newborn.active,
            {"friction", "break_stretch"},
            marks=pytest.mark.verification,
        ),
    ],
    ids=[
        "quenched instead of annealed, two points",
        "quenched instead of annealed",
        "flow instead of langevin",
        "aging ignored",
        "births ignored",
    ],
)
def test_negative_controls(size, wrong, of, kinds, monkeypatch):
    """One thing wrong in the engine alone: a few points that know it fail, where they
    should; more under `-m verification`."""
    drawn = sample
    # delays need no better unit here than the mean threshold; lives would have to be
    # compiled for every law that is drawn
    monkeypatch.setattr(points, "typical_life", lambda e, v: e.thresholds.mean)

    def knowing(count, seed, *_):
        known = (
            (e, v) for _, e, v in drawn(48 * count, seed) if of(e, v) and wrong(e) != e
        )
        return (
            (index, e, v) for index, (e, v) in enumerate(itertools.islice(known, count))
        )

    monkeypatch.setattr(verdict, "sample", knowing)
    monkeypatch.setitem(SUITES, "few", Suite(size, 0))
    result = validate("few", threads=2, wrong=wrong)
    assert not result.passed
    assert kinds <= {v.kind for v in result.verdicts if not v.passed}


@pytest.mark.verification
@pytest.mark.parametrize(
    "suite",
    [Suite(3, 1), pytest.param(SUITES["quick"], marks=pytest.mark.verification)],
)
def test_command(suite, tmp_path, monkeypatch):
    """A small suite, and with -m verification the quick one, passes (false alarm 1/500
    for a fresh seed) and leaves a table and a picture."""
    monkeypatch.setitem(SUITES, "quick", suite)
    result = CliRunner().invoke(
        app,
        ["validate", "quick", "--out", str(tmp_path / "v"), "--seed", "3", "--json"],
    )
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    assert summary["passed"]
    assert summary["declined"] == summary["refused"] == []
    left_out = sum(summary["left_out"].get("transient", {}).values())
    (scored,) = [
        verdict for verdict in summary["verdicts"] if verdict["kind"] == "transient"
    ]
    assert left_out + scored["count"] == 8 * -(-suite.points // 3)
    assert [v["kind"] for v in summary["verdicts"]] == list(KINDS)
    table = pq.read_table(tmp_path / "v" / "scores.parquet")
    assert (
        table.num_rows
        == sum(v["count"] for v in summary["verdicts"])
        > 5 * suite.points
    )
    ours, exact, sigma, z, even = (
        table[name].to_numpy() for name in ("value", "reference", "sigma", "z", "even")
    )
    # a score has the sign of engine less master, and its size but for what few batches
    # make of it: 3 of 15 degrees of freedom is 2.56 of a normal number
    compared = table["kind"].to_numpy() != "hazard law"
    plain = ((ours - exact) / sigma)[compared]
    assert np.all(z[compared] * plain >= 0)
    near = np.abs(plain) < 3.0
    np.testing.assert_allclose(z[compared][near], plain[near], rtol=0.2, atol=0)
    assert np.all(np.abs(z[compared]) <= np.abs(plain) * (1 + 1e-12))
    assert even.sum() == sum(v["even"] for v in summary["verdicts"]) > 3 * suite.points
    z = z[even]
    np.testing.assert_allclose(np.var(z), 1.0, rtol=0, atol=5 * math.sqrt(2 / z.size))
    assert (tmp_path / "v" / "validation.png").stat().st_size > 10_000


@pytest.mark.verification
@pytest.mark.parametrize(("was", "wrong"), [("stiff", "soft"), ("soft", "stiff")])
def test_hazard(was, wrong):
    """One barrier instead of the other: the number of thermal breaks and the law of
    hazards both fail; the right one passes (false alarm 4e-4 for a fresh seed)."""
    passed, failed = [], []
    for index, ensemble, v in sample(240, 1, (1, 3)):
        if ensemble.thermal.barrier == was and not ensemble.aging.active:
            other = dataclasses.replace(
                ensemble, thermal=dataclasses.replace(ensemble.thermal, barrier=wrong)
            )
            passed += made(hazards(at(ensemble, v, seed=index), QUICK))
            failed += made(hazards(at(ensemble, v, other, index), QUICK))
    for kind in ("hazard", "hazard law"):
        assert judge(kind, passed).count >= 3
        assert judge(kind, passed).passed
        assert not judge(kind, failed).passed


def test_verdict():
    """Too large, too small and one far out are all refused."""

    def of(z):
        return judge(
            "mean",
            [
                Score("mean", Ensemble(), 1.0, 0.0, 0.0, 1.0, float(value))
                for value in z
            ],
        )

    normal = np.random.default_rng(1).standard_normal(500)
    assert of(normal).passed
    assert not of(1.4 * normal).passed
    assert not of(0.7 * normal).passed
    assert not of(np.append(normal, 6.0)).passed
    with pytest.raises(InputError, match="suite"):
        validate("everything")
    # p = 1e-4 decides, and that of the largest of 500 is that none is larger: 4.2 alone
    # has 2.7e-5
    alone, many = (float(stats.norm.isf(p / 2)) for p in (0.9e-4, 1.1e-4))
    assert (of([alone]).passed, of([many]).passed) == (False, True)
    far = of(np.append(normal[np.abs(normal) < 3.0], 4.2))
    assert far.passed
    assert far.p_largest == pytest.approx(
        1.0 - (1.0 - 2.0 * stats.norm.sf(4.2)) ** far.count, rel=1e-9, abs=0
    )
    farther = of(np.append(normal[np.abs(normal) < 3.0], 5.4))
    assert (farther.p_chi_square > 1e-2, farther.passed) == (True, False)


@pytest.mark.parametrize("wrong", [0.98, 1.02])
def test_signs_of_scores(wrong):
    """Engine less master over the joint error, in the scores and in their table; the
    engine's barrier is 2 % off."""
    contacts = Ensemble(thermal=Thermal(0.3), delay=Delay(2.0))
    shown = dataclasses.replace(contacts, thermal=Thermal(0.3 * wrong))
    found = steady(shown, Drive(0.1), rel_error=1e-4)
    table = columns(made(averages(at(contacts, 0.1, shown), found))[:3])
    assert table["kind"] == ["friction", "pinned", "break_stretch"]
    ours, exact, sigma, z = (
        np.array(table[name]) for name in ("value", "reference", "sigma", "z")
    )
    assert list(ours) == [
        found.friction.value,
        found.pinned.value,
        found.break_stretch.value,
    ]
    assert np.all(z * (ours - exact) > 0)
    assert np.all(z * np.sign(1.0 - wrong) > 4.5)  # a higher temperature, a lower value
    np.testing.assert_allclose(
        sigma,
        [found.friction.stderr, found.pinned.stderr, found.break_stretch.stderr],
        rtol=1e-3,
    )


def without(name, reliable=True):
    """Averages of which one has no value."""
    return {name: Estimate(None, None, 0, None, reliable)}


def exactly(name, value):
    return {name: Estimate(value, 0.0, 0)}


@pytest.mark.parametrize(
    ("of_engine", "of_reference", "kind", "said"),
    [
        ({}, without("force_variance"), "force_variance", "no reference"),
        (without("force_variance"), {}, "force_variance", "refused"),
        (without("friction", reliable=False), {}, "friction", "unreliable"),
        (exactly("birth_stretch", 0.0), {}, "birth_stretch", math.inf),
        (exactly("pinned", 0.9), {}, "pinned", math.inf),
        (exactly("pinned", 1.0), {}, "pinned", None),
    ],
    ids=[
        "no reference",
        "no value",
        "none seen",
        "no births",
        "not all pinned",
        "all pinned",
    ],
)
def test_no_average_is_dropped(of_engine, of_reference, kind, said, monkeypatch):
    """Each is scored, or left out with its reason: also one that an engine does not
    give, or that it gives without an error. Only one that has none in both and is the
    same, or that says nothing of contacts born unstretched, is not asked for."""
    contacts = Ensemble(newborn=Newborn("delta", stretch=0.1))
    sampled = steady(contacts, Drive(0.1), rel_error=1e-2)
    exact = reference(contacts, Drive(0.1), variance=True)
    changed = dataclasses.replace(exact, **of_reference)
    monkeypatch.setattr(scores, "reference", lambda *_, **__: changed)
    found = averages(at(contacts, 0.1), dataclasses.replace(sampled, **of_engine))
    assert {one.kind for one in found} | {"pinned", "birth_stretch"} == set(OBSERVABLES)
    got = [
        one.z if isinstance(one, Score) else one.reason
        for one in found
        if one.kind == kind
    ]
    assert got == ([] if said is None else [said])


def test_contacts_of_a_laboratory(monkeypatch):
    """A share of those that heat breaks, here half of 240 (to 5 standard deviations),
    with barriers and attempts as they should be; the others are as without."""
    monkeypatch.setattr(points, "typical_life", lambda ensemble, v: 1.0)
    both = zip(sample(240, 1), sample(240, 1, solids=0.5), strict=True)
    warm, high = 0, []
    for (_, usual, v), (_, solid, _) in both:
        warm += usual.thermal.active
        if solid.thermal != usual.thermal:
            high.append((solid, v))
            assert solid.delay == usual.delay
    assert abs(len(high) - 0.5 * warm) < 5 * math.sqrt(0.25 * warm)
    for solid, v in high:
        heat, unit = solid.thermal, solid.thresholds.scale
        slip = heat.slip.rate if heat.slip else heat.off_rate
        if slip is None:
            log_attempts = math.log(heat.attempt_frequency * unit / v)
            assert log_attempts <= 0.5 * unit**2 / heat.kT * (1.0 + 1e-9) < 1.1e9
        else:
            log_attempts = -math.log(slip * unit / v)
        assert 8.99 < log_attempts < 40.01


def test_sample(monkeypatch):
    """Thresholds drift in a third of the points, in every way there is, and the others
    have laws of every kind; of the quenched ones of these a third grow as a logarithm;
    each axis is covered from end to end, here to a tenth of it (of 240 even numbers,
    none is there once in 1e10 seeds)."""
    monkeypatch.setattr(points, "typical_life", lambda ensemble, v: 1.0)
    drawn = list(sample(SUITES["full"].points, 1))
    ensembles = [ensemble for _, ensemble, _ in drawn]
    growing = [
        ensemble for ensemble in ensembles if ensemble.aging.rule == "logarithmic"
    ]
    aging = [
        ensemble
        for ensemble in ensembles
        if ensemble.aging.active and ensemble not in growing
    ]
    assert [index for index, _, _ in drawn] == list(range(len(drawn)))
    assert len(aging) == len(drawn) // 3
    every = {(e.aging.rule, e.thermal.barrier) for e in aging}
    assert len(every) == 2 * len(BARRIERS)
    for name in ("disorder", "stiffness_law"):  # cold points have the soft barrier
        met = {(getattr(e, name), e.thermal.barrier) for e in aging}
        assert len(met) >= 2 * len(BARRIERS) - 1
    assert {e.thermal.kT > 0 for e in aging} == {True, False}
    assert {e.aging.rate == math.inf for e in aging} == {True, False}
    others = sum(e.disorder == "quenched" and not e.aging.active for e in ensembles)
    assert abs(len(growing) / (len(growing) + others) - 1 / 3) < 5 * math.sqrt(
        2 / 9 / (len(growing) + others)
    )
    every = {(e.stiffness_law, e.thermal.barrier) for e in growing}
    assert len(every) == 2 * len(BARRIERS)
    assert len({type(e.thresholds) for e in growing}) >= 3
    share = np.mean([e.disorder == "quenched" for e in aging])
    assert abs(share - 0.5) < 5 * math.sqrt(0.25 / len(aging))

    def even(numbers, low, high):
        numbers = np.array(numbers)
        assert low <= numbers.min() < low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) < numbers.max() <= high

    even([math.log10(e.aging.x_star_final / e.thresholds.x_star) for e in aging], -2, 2)
    even([math.log10(e.delay.time * v) for _, e, v in drawn if e.delay.time], -3, 3)
    laws = [ensemble.thresholds for ensemble in ensembles]
    even([law.n for law in laws if isinstance(law, Gamma) and law.n <= 10], 0, 10)
    of = {}
    for law in laws:
        if isinstance(law, Distribution):
            name = getattr(getattr(law.frozen, "dist", None), "name", "histogram")
        else:
            thresholds = np.unique(law.steps).size
            name = {0: "gamma", 1: "delta", 2: "two"}.get(
                thresholds, "few" if thresholds <= 12 else "sample"
            )
            narrow = isinstance(law, Lognormal) or (
                isinstance(law, Gamma) and law.n > 100
            )
            name = "narrow" if narrow else name
        of.setdefault({"beta": "arcsine"}.get(name, name), []).append(law)
    assert set(of) == set(DRAWN_LAWS)
    assert min(map(len, of.values())) > 4
    few, samples = (
        [np.unique(law.steps) for law in of[name]] for name in ("few", "sample")
    )
    assert {3, 12} < {steps.size for steps in few}
    assert 3.0 < max(math.log10(steps[-1] / steps[0]) for steps in few) < 4.0
    assert 200 < max(steps.size for steps in samples) <= 500
    assert min(law.support[0] / law.support[1] for law in of["uniform"]) > 0.0
    # gaps
    assert {0 in law.frozen._histogram[0] for law in of["histogram"]} == {True, False}


@pytest.mark.verification
def test_delays_are_in_units_of_a_life():
    """The sampler's mean travel of a life, which is positive wherever contacts are born,
    is within a factor of 4 of the exact one at three points in four."""
    off = []
    for _, ensemble, v in sample(20, 4):
        if not ensemble.fluctuates:
            life = points.typical_life(ensemble, v)
            exact = reference(ensemble, Drive(v)).travel.value
            off.append(abs(math.log(life / exact)))
    assert len(off) > 12
    assert np.quantile(off, 0.75) < math.log(4.0)


def heat_of(row):
    """The heat of a row of scores."""

    def pathway(name):
        rate = row[f"{name}_rate"][0]
        return None if math.isnan(rate) else Pathway(rate, row[f"{name}_force"][0])

    bond = {
        name: row[name][0]
        for name in ("off_rate", "force_scale")
        if not math.isnan(row[name][0])
    }
    ways = {name: pathway(name) for name in ("catch", "slip")}
    kT, barrier = row["kT"][0], row["barrier"][0]
    return Thermal(kT, 1.0, barrier, **bond, **ways)


def test_points_can_be_made_again():
    """The same seed gives the same points, in parts or together, and a row of scores
    tells all there is to know."""
    once = [(index, e, v, law_text(e.thresholds)) for index, e, v in sample(12, 5)]
    for part in range(3):
        for index, ensemble, v in sample(12, 5, (part, 3)):
            _, first, first_v, text = once[index]
            assert (index % 3, v, law_text(ensemble.thresholds)) == (
                part,
                first_v,
                text,
            )
            same = dataclasses.replace(ensemble, thresholds=first.thresholds)
            assert same == first
    births = [f"newborn_{name}" for name in ("stretch", "low", "high", "mean", "std")]
    names = {
        "Gamma": Gamma,
        "Table": Table,
        "Delta": Delta,
        "Lognormal": Lognormal,
        "Distribution": Distribution,
        "NoThresholds": NoThresholds,
    }
    names["stats"] = stats
    for _, ensemble, v, text in once:
        law = eval(text, names)
        e = np.geomspace(1e-10, 40.0, 50)
        np.testing.assert_array_equal(
            law.inverse_survival(e), ensemble.thresholds.inverse_survival(e)
        )
        row = columns([Score("friction", ensemble, v, 1.0, 1.0, 1.0, 0.0)])
        assert row["thresholds"] == [text]
        beta, cutoff_time = (
            None if math.isnan(row[name][0]) else row[name][0]
            for name in ("beta", "cutoff_time")
        )
        shapes = (
            None if math.isnan(row[name][0]) else row[name][0]
            for name in ("delay_shape", "delay_sigma")
        )
        final = np.nan_to_num(row["x_star_final"][0], nan=1.0)
        aging = Aging(row["aging"][0], row["aging_rate"][0], final, beta, cutoff_time)
        again = Ensemble(
            ensemble.thresholds,
            heat_of(row),
            Delay(row["delay"][0], row["delay_law"][0], *shapes),
            aging,
            stiffness_law=row["stiffness_law"][0],
            disorder=row["disorder"][0],
            eta=row["eta"][0],
            newborn=Newborn(
                *(row[f"newborn_{name}"][0] for name in ("law", "of")),
                *(
                    None if math.isnan(row[name][0]) else row[name][0]
                    for name in births
                ),
            ),
        )
        assert again == ensemble


@pytest.mark.verification
def test_no_fluctuations_where_the_stationary_start_is_refused():
    """Most contacts break at once, a few with high thresholds live long: the suite goes
    on, and counts them."""
    aging, rare = Aging("langevin", 1.4e-4, 7.8), Delay(1500.0)
    hot = Ensemble(
        Gamma(0.5), Thermal(0.92, barrier="stiff"), rare, aging, stiffness_law="uniform"
    )
    wide = Suite(3, 1, ((20, 2000),))
    assert made(compare_driven(at(hot, 2.2e-4)._replace(number=2), wide)[3:]) == []
    warm = dataclasses.replace(hot, thermal=Thermal(0.1))
    assert made(fluctuating(at(warm, 2.2e-4), wide)) != []


@pytest.mark.verification
def test_averages_that_call_themselves_unreliable_are_not_scored():
    """Few contacts that live long carry the force, and 2^16 lives of fluctuating
    thresholds say that they miss some."""
    aging = Aging("langevin", 1.4e-3, 4.0)
    warm = Ensemble(
        Gamma(0.0), Thermal(1.9, barrier="stiff"), aging=aging, stiffness_law="uniform"
    )
    for velocity, scored in (
        (2.7e-4, []),
        (0.1, ["friction", "break_stretch", "force_variance"]),
    ):
        found = steady(warm, Drive(velocity), rel_error=1.0)
        assert found.friction.reliable == bool(scored)
        found = averages(at(warm, velocity), found)
        assert [score.kind for score in made(found)] == scored
        assert {one.reason for one in found if isinstance(one, Unscored)} == (
            set() if scored else {"unreliable"}
        )


def test_errors_that_are_bounds_do_not_count_as_scatter():
    """Of a table the error of steady averages is what all randomisations may miss
    alike, and near its thresholds that of the transient is a jump: such scores are too
    small for a chi-square, and the suite knows which they are. The largest still tells:
    with one threshold of four 1 % too high, steady averages are off by many errors."""
    few = Ensemble(
        Table([0.5, 0.8, 1.0, 1.6183]), Thermal(0.0), stiffness_law="uniform"
    )
    smooth = dataclasses.replace(few, thresholds=Gamma(1.0))
    for ensemble, even in ((few, False), (smooth, True)):
        of_steady = made(
            averages(at(ensemble, 1.0), steady(ensemble, Drive(1.0), rel_error=1e-4))
        )
        of_force = made(transients(at(ensemble, 1.0, seed=2), QUICK))
        assert {score.even for score in of_steady} == {even}
        assert all(score.even for score in of_force) == even
        assert max(abs(score.z) for score in of_steady + of_force) < 5.0
    wrong = dataclasses.replace(few, thresholds=Table([0.5, 0.8, 1.0, 1.634483]))
    of_steady = made(
        averages(at(few, 1.0, wrong), steady(wrong, Drive(1.0), rel_error=1e-4))
    )
    assert min(abs(score.z) for score in of_steady) > 10.0


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ({"seed": -1}, "seed = -1: must be an integer from 0"),
        ({"part": (0, 0)}, r"part = \(0, 0\): must be integers \(i, m\)"),
        ({"part": (-1, 4)}, r"part = \(-1, 4\): must be integers \(i, m\)"),
        ({"part": (32, 33)}, r"part = \(32, 33\): .* with i from 0 to 31"),
        ({"part": (0.5, 2)}, r"part = \(0.5, 2\): must be"),
        ({"part": (0,)}, r"part = \(0,\): must be"),
        ({"part": "ab"}, "part = 'ab': must be"),
        ({"part": 3}, "part = 3: must be"),
    ],
)
def test_what_is_no_seed_or_part(what, said):
    with pytest.raises(InputError, match=said):
        validate("quick", **what)


def test_too_many_refused():
    """A suite does not pass where the program declines more comparisons of a kind than
    it makes."""
    few = Ensemble()
    score = Score("friction", few, 1.0, 0.0, 0.0, 1.0, 0.5)
    left = [Unscored("friction", few, 1.0, reason) for reason in REASONS]
    verdicts = [judge("friction", [score] * 9)]
    for count, declined in ((0, []), (9, []), (10, ["friction"])):
        unscored = [left[index % len(DECLINED)] for index in range(count)] + left[
            len(DECLINED) :
        ] * 9
        result = Validation("quick", 1, [score] * 9, verdicts, unscored)
        assert result.declined == declined
        assert result.passed == (not declined)


def test_nothing_compared_does_not_pass():
    """Verdicts without scores are no evidence, and no p-value is small."""
    result = Validation("quick", 1, [], [judge(kind, []) for kind in KINDS], [])
    assert not result.passed
    assert result.p_overall == 1.0
    assert "nothing compared" in repr(result)


def test_every_part_has_points():
    """A part begins at its first point, also one beyond its step."""
    for part in ((1, 4), (5, 4), (11, 40)):
        drawn = [index for index, *_ in sample(12, 5, part)]
        assert drawn == list(range(part[0], 12, part[1]))


def test_an_engine_that_refuses_everything_does_not_pass(monkeypatch):
    monkeypatch.setitem(SUITES, "few", Suite(1, 0))

    def refuse(*_, **__):
        raise InputError("velocity: never")

    monkeypatch.setattr(scores, "steady", refuse)
    result = validate("few")
    assert not result.passed
    assert set(result.declined) >= set(OBSERVABLES)
    assert {one.message for one in result.unscored if one.kind == "friction"} == {
        "velocity: never"
    }


def forces_by_hand(law, wait, drag, X, rng):
    """F/k of 200 000 annealed contacts without heat, from break to break."""
    born, force = np.zeros(200_000), np.full(200_000, drag)
    lasting = np.full(born.size, True)
    while lasting.any():
        broken = born[lasting] + law.rvs(lasting.sum(), random_state=rng)
        force[lasting] = np.where(broken > X, X - born[lasting], drag)
        born[lasting] = broken + wait
        lasting = born <= X
    return force


def test_squares_of_laws_that_begin_with_a_jump():
    """E[f^2] at T = 0 of Pareto thresholds, by hand: 200 000 contacts from break to
    break (|z| < 4.5 in eight scores, false alarm 6e-5, beyond the stated error)."""
    ensemble, drive = (
        Ensemble(Distribution(stats.pareto(6.9)), stiffness_law="uniform"),
        Drive(1.0, 2.4),
    )
    exact = transient(ensemble, drive, points=9, variance=True)
    squares = exact.force_variance + exact.force**2
    error = exact.force_variance_error - 2 * exact.force * exact.force_error
    rng = np.random.default_rng(1)
    for i in range(1, 9):
        force = forces_by_hand(stats.pareto(6.9), 0.0, 0.0, exact.X[i], rng)
        sigma = np.std(force**2) / math.sqrt(force.size)
        assert abs(np.mean(force**2) - squares[i]) < 4.5 * sigma + error[i]


def test_contacts_that_make_a_mean_square():
    """<d^2>^2/<d^4> of fresh contacts at four displacements, and of stationary ones,
    against forces by hand, whose error is the scatter of 64 groups over 8 (five |z| <
    4.5, false alarm 4e-5; cells, 1/100 of a threshold at most, move it by 1e-4)."""
    law, v, wait = stats.uniform(0.5, 1.0), 0.5, 0.4
    ensemble = Ensemble(
        Distribution(law), delay=Delay(wait / v), eta=0.1, stiffness_law="uniform"
    )
    drive, rng = Drive(v, 3.0), np.random.default_rng(2)
    exact = transient(ensemble, drive, points=5)
    found = squaring_shares_at_first(ensemble, drive, exact.force)[1:]
    level = reference(ensemble, drive).friction.value
    found += [squaring_share_at_last(ensemble, v, level)]
    levels = [*exact.force[1:], level]
    for share, mean, X in zip(found, levels, [*exact.X[1:], 40.0], strict=True):
        force = forces_by_hand(law, wait, ensemble.eta * v, X, rng)
        off = ((force - mean) ** 2).reshape(64, -1)
        each = off.mean(axis=1) ** 2 / (off**2).mean(axis=1)
        by_hand = off.mean() ** 2 / (off**2).mean()
        assert abs(share - by_hand) < 4.5 * each.std() / 8 + 1e-4 * share


def test_variances_of_a_few_old_contacts_are_not_scored():
    """A tenth of the variance is made by 3e-6 of the contacts, which are as old as the
    second wave of births, and neither sample nor pilot has one of them."""
    law, v = Distribution(stats.pareto(7.671, scale=0.3584)), 0.187
    few = Ensemble(law, delay=Delay(7.52), disorder="annealed", eta=0.75)
    found = transients(at(few, v), QUICK)
    last = [one for one in found if one.kind == "transient variance"][-1]
    assert last.reason == "few contacts"


def test_variances_know_what_rounding_hides():
    """Contacts that go back and forth, of a law with a tail so heavy that sums of
    squares leave room for contacts a million times as strong as any that is met: what
    rounding may hide, ten times the variance, is part of the error."""
    law, barrier = Distribution(stats.pareto(5.47, scale=0.7469)), "stiff"
    heavy = Ensemble(law, Thermal(0.0652, barrier=barrier), Delay(10666.2), eta=86.96)
    steps = Segment(3.361e-4, distance=0.1585), Segment(-1.642e-4, distance=0.1144)
    drive = Programme(tuple(dataclasses.replace(each, points=1) for each in steps))
    exact = transient(heavy, drive, 2, variance=True)
    group, variance = dataclasses.replace(heavy, count=1562), exact.force_variance[-1]
    squares, lost = _mean_squares(exact.force[-1], group, drive, 7)
    scatter = squares.std(ddof=1) / 8
    assert abs(squares.mean() - variance) < 4.5 * scatter + lost
    assert lost > 10 * variance


def test_variances_of_a_few_broken_contacts_are_not_scored():
    """Before thresholds are reached contacts of uniform stiffness have the same force,
    but for the one in a million that has broken, and the sample has none of these;
    later variances are scored."""
    cold = Ensemble(Gamma(5.0, 0.5), Thermal(0.005), stiffness_law="uniform")
    found = transients(at(cold, 7e-4), QUICK)
    found = [one for one in found if one.kind == "transient variance"]
    assert [isinstance(one, Score) for one in found] == [False, False, *[True] * 6]
    assert {one.reason for one in found[:2]} == {"few contacts"}
    assert max(abs(one.z) for one in found[2:]) < 4.5


def test_squares_of_a_few_contacts_are_no_sample():
    """Means of 1000 squares of normal numbers pass as a pilot, those of 10 do not, nor
    do those whose tail is so heavy (Pareto, exponent 1.5: infinite variance) that one
    group makes the error: of these every eighth passes."""
    rng = np.random.default_rng(1)
    assert many_contribute((rng.standard_normal((64, 1000)) ** 2).mean(axis=1))
    assert not many_contribute((rng.standard_normal((64, 10)) ** 2).mean(axis=1))
    heavy = [
        many_contribute((1.0 + rng.pareto(1.5, (64, 5000))).mean(axis=1))
        for _ in range(40)
    ]
    assert np.mean(heavy) < 0.4


GROWING = Ensemble(
    thermal=Thermal(0.1),
    aging=Aging("logarithmic", beta=0.2, cutoff_time=0.1),
    stiffness_law="uniform",
)


def programme_scores(ensemble, shown=None):
    """Of two programmes of steps, holds and reversals."""
    found = [programmes(at(ensemble, 0.1, shown, seed, 2), QUICK) for seed in (4, 10)]
    return np.array(
        [abs(score.z) for one in found for score in one if isinstance(score, Score)]
    )


@pytest.mark.verification
def test_programmes():
    """Scores of a right engine; and of one that is shown another cutoff time, or whose
    holds break no contact."""
    right = programme_scores(GROWING)
    assert right.size >= 10
    assert right.max() < 4.5
    aging = dataclasses.replace(GROWING.aging, cutoff_time=1.0)
    assert (
        programme_scores(GROWING, dataclasses.replace(GROWING, aging=aging)).max() > 10
    )


@pytest.mark.verification
@pytest.mark.parametrize(
    "stands",
    [lambda segment: segment.velocity == 0, lambda segment: 0 < segment.path < 1e-6],
)
def test_programmes_without_breaks_in_holds(stands, monkeypatch):
    """A negative control: holds, and crawls and jitter, that are over at once."""
    soft = Ensemble(thermal=Thermal(0.1), stiffness_law="uniform")
    assert programme_scores(soft).max() < 4.5

    def hurried(ensemble, drive, **how):
        segments = [
            dataclasses.replace(s, time=1e-6 * s.time) if stands(s) else s
            for s in drive.segments
        ]
        return trajectory(
            ensemble, dataclasses.replace(drive, segments=tuple(segments)), **how
        )

    monkeypatch.setattr("eqsim.validation.scores.trajectory", hurried)
    assert programme_scores(soft).max() > 10


def test_programmes_that_all_but_stand():
    """Programmes hold crawls and jitter, which take the place of holds of the same
    time, and move by nearly nothing."""
    slowest = set()
    for seed in range(40):
        course = programme_of(at(GROWING, 0.1, seed=seed))
        assert len(course.same.segments) == len(course.ends)
        for segment, first, last in zip(
            course.same.segments, [0, *course.ends], course.ends, strict=False
        ):
            pieces = course.programme.segments[first:last]
            time = sum(piece.duration for piece in pieces)
            assert time == pytest.approx(segment.duration, rel=1e-12, abs=0)
            if segment.velocity == 0:
                assert max(piece.path for piece in pieces) <= course.off < 1e-6
                slowest.add((len(pieces), pieces[0].velocity != 0))
    assert slowest == {(1, False), (1, True), (8, True)}


# ----------------------------------------------------------- one thing wrong in what a
# pulled slider is compared with


def pulled_scores(compare, chosen, count=4):
    """Scores of the first points that are asked for, with as many replicas as in the
    quick suite."""
    drawn = ((index, e, v) for index, e, v in sample(60, 1) if chosen(e))
    points = (
        at(e, v, seed=1000 + index)._replace(number=index)
        for index, e, v in itertools.islice(drawn, count)
    )
    return [
        score for point in points for score in made(compare(point, SUITES["quick"]))
    ]


def passes(scores):
    """Whether the scores of each kind pass."""
    return {
        kind: judge(kind, scores).passed for kind in {score.kind for score in scores}
    }


def as_if(monkeypatch, change):
    """The engine follows another ensemble and programme than it is asked for."""
    monkeypatch.setattr(
        pulled,
        "trajectory",
        lambda ensemble, drive, **how: trajectory(*change(ensemble, drive), **how),
    )


def without_heat(ensemble, drive):
    return dataclasses.replace(
        ensemble, thermal=dataclasses.replace(ensemble.thermal, kT=0.0)
    ), drive


def looks_that_cost_time(ensemble, drive):
    """Of a hold that is looked at often nine tenths of the time are lost."""
    (segment,) = drive.segments
    time = segment.time if segment.points == 1 else segment.time / 10.0
    return ensemble, dataclasses.replace(
        drive, segments=(dataclasses.replace(segment, time=time),)
    )


def hot(ensemble):
    return ensemble.thermal.kT > 0 and ensemble.disorder == "quenched"


@pytest.mark.verification
@pytest.mark.parametrize(
    ("compare", "wrong"),
    [(pulled.holds, without_heat), (pulled.pieces, looks_that_cost_time)],
)
def test_holds_of_few_contacts(compare, wrong, monkeypatch):
    """Holds without heat, and looks at a hold that take nine tenths of its time, fail;
    that a third of it is lost does not show in as few replicas as the quick suite has.
    """
    count = 6 if wrong is looks_that_cost_time else 4
    assert all(passes(pulled_scores(compare, hot, count)).values())
    as_if(monkeypatch, wrong)
    assert not any(passes(pulled_scores(compare, hot, count)).values())


def single_contacts(monkeypatch, replicas, smaller=1.0):
    """Scores of every number of single contacts that may be pinned after a hold of so
    many replicas, and their probabilities; errors are quoted `smaller` than they
    are."""
    plan, scores = Suite(0, 0, replicas=replicas), []
    point = at(Ensemble(Gamma(1.0), Thermal(0.1)), 0.1, seed=5)
    counts = np.arange(replicas + 1)
    for count in counts:
        share = count / replicas
        scatter = math.sqrt(share * (1.0 - share) / (replicas - 1))
        error = smaller * max(scatter, 2.0 / replicas)  # as the slider quotes it
        run = SimpleNamespace(pinned=[share], pinned_stderr=[error])
        monkeypatch.setattr(pulled, "_slide", lambda *_, run=run: run)
        scores += made(pulled.holds(point, plan))
    assert {score.count for score in scores} == {1}
    share = scores[0].reference
    assert 0.2 < share < 0.8
    return np.array([score.z for score in scores]), stats.binom.pmf(
        counts, replicas, share
    )


@pytest.mark.parametrize("replicas", [60, 200])
def test_single_contacts_score_as_normal_numbers_do(replicas, monkeypatch):
    """Outcomes of a hold, weighted with their exact probabilities, score no more often
    beyond 3.9, 4.3 and 4.7 than normal numbers, and scores spread as these do, to the
    6 % by which Student's law of 59 degrees of freedom shrinks them; by the scatter
    of the sample alone it is twice to ten times as many. With errors a third as large
    one in ten is beyond 3.9."""
    z, chance = single_contacts(monkeypatch, replicas)
    for far in (3.9, 4.3, 4.7):
        assert chance[np.abs(z) > far].sum() < 2.0 * stats.norm.sf(far)
    assert 0.94 < chance @ z**2 - (chance @ z) ** 2 < 1.0
    z, chance = single_contacts(monkeypatch, replicas, 1.0 / 3.0)
    assert chance[np.abs(z) > 3.9].sum() > 0.1


@pytest.mark.parametrize("kT", [0.01, 10.0])
def test_holds_without_breaks_or_contacts_are_left_out(kT):
    """Contacts that stay for the longest hold leave nothing to compare, nor do those
    of which few survive the shortest."""
    heat = Thermal(kT, 1e-9 if kT < 1.0 else 1e9)
    point = at(Ensemble(Delta(1.0), heat, stiffness_law="uniform"), 0.1)
    for compare in (pulled.holds, pulled.pieces):
        (found,) = compare(point, QUICK)
        assert isinstance(found, Unscored)
        assert found.reason == "few contacts"


@pytest.mark.parametrize("rounding", [0.0, 2.0**-53])
def test_shares_that_coincide_are_not_too_good_to_be_true(monkeypatch, rounding):
    """Shares of few contacts are counts and may be the same, to the last bit or but for
    the order of a sum, which a chi-square of next to 0 would hold to be impossible."""

    def half(_point, _waits, looks, *_):
        return Estimate(0.5 + rounding * (looks > 1), 0.05, 12, 11)

    monkeypatch.setattr(pulled, "_pinned", half)
    for seed in range(5):
        point = at(Ensemble(Gamma(1.0), Thermal(0.1)), 0.1, seed=seed)
        assert passes(pulled.pieces(point, QUICK)) == {"pieces": True}


def test_avalanches_know_the_stiffness_that_shares_the_force(monkeypatch):
    """The program's law of sizes with k in the place of k_t fails, the right one
    passes."""
    ensemble = Ensemble(Gamma(0.0))

    def verdicts():
        found = [
            pulled.avalanches(at(ensemble, 0.1, seed=seed), SUITES["quick"])
            for seed in range(3)
        ]
        return passes(made(itertools.chain.from_iterable(found)))

    assert verdicts() == {"avalanche": True, "single break": True}
    monkeypatch.setattr(pulled, "load_of", lambda _, kappa, *__: 1.0 / (1.0 + kappa))
    assert verdicts() == {"avalanche": False, "single break": False}


@pytest.mark.parametrize(
    ("law", "wrong", "kind"),
    [
        (
            stats.uniform(0.5, 1.0),
            stats.trapezoid(0.2, 0.8, loc=0.4, scale=1.2),
            "friction",
        ),
        (stats.pareto(5.3), stats.truncpareto(5.3, 6.0), "force_variance"),
    ],
    ids=["jump blurred", "tail cut"],
)
def test_steady_averages_know_the_law(law, wrong, kind):
    """Contacts whose thresholds lack a jump, or the highest of a heavy tail, fail; the
    right ones pass (|z| < 4.5)."""
    right, other = (
        Ensemble(Distribution(each), Thermal(0.02), stiffness_law="uniform")
        for each in (law, wrong)
    )

    def largest(shown):
        found = made(
            averages(at(right, 0.1, shown), steady(shown, Drive(0.1), rel_error=1e-4))
        )
        return abs({score.kind: score.z for score in found}[kind])

    assert largest(right) < 4.5
    assert largest(other) > 10.0


def pulled_harder(ensemble, drive):
    """A force 1 % larger."""
    (segment,) = drive.segments
    segment = dataclasses.replace(segment, force=1.01 * segment.force)
    return ensemble, dataclasses.replace(drive, segments=(segment,))


def test_lifetimes_of_clusters(monkeypatch):
    """Five clusters pass, and fail under a force 1 % larger."""
    ensemble = Ensemble(Gamma(), Thermal(0.05))

    def verdicts():
        points = (at(ensemble, 0.1, seed=seed) for seed in range(5))
        found = [pulled.lifetimes(point, SUITES["quick"]) for point in points]
        return passes(made(itertools.chain.from_iterable(found)))

    assert verdicts() == {"lifetime": True}
    as_if(monkeypatch, pulled_harder)
    assert verdicts() == {"lifetime": False}


def test_squares_that_happen_to_be_small_have_errors_of_the_usual_size():
    """Of 20 000 mean squares of 150 normal forces 46 +- 7 score beyond 3.29, at most 75
    (false alarm 3e-5); by their own scatter 110 do."""
    rng, far, alone = np.random.default_rng(1), 0, 0
    for forces in rng.standard_normal((20_000, 150)):
        squares = forces**2
        far += abs(z_score(of_products(squares, forces, 1.0), 1.0)) > 3.29
        alone += abs(z_score(mean_of(squares, 150), 1.0)) > 3.29
    assert far <= 75 < 85 < alone


@pytest.mark.verification
def test_squares_rounded_beside_far_stronger_contacts():
    """Lognormal thresholds, the strongest of which are 1e12 times the usual ones: after
    a reversal squares are stored to .1. The variance along a programme has no bias by
    that: |z| < 4.5."""
    heat, delay = Thermal(0.705, 1.0, "stiff"), Delay(0.0046, "exponential")
    law = Distribution(stats.lognorm(1.774, scale=0.8625))
    contacts = Ensemble(
        law, heat, delay, stiffness_law="uniform", disorder="annealed", eta=0.135
    )
    point = Point(0, contacts, contacts, 1.368, 2, 2)
    found = programmes(point, SUITES["quick"])
    assert max(abs(score.z) for score in made(found)) < 4.5
