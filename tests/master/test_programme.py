"""Contacts followed through the segments of a programme: exact in time, the same bits
on anything, the right laws."""

import itertools
import math
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import numpy as np
import pytest
from cases import chosen
from kernels import compiled
from scipy import integrate
from test_programme_reference import HEALING, HOLDS, KINDS, STEPS

from eqsim import (
    Aging,
    Delay,
    Delta,
    Drive,
    Ensemble,
    Gamma,
    InputError,
    Programme,
    Segment,
    Table,
    Thermal,
    trajectory,
    transient,
)
from eqsim.engine.contacts import contacts
from eqsim.laws.aging import Flow, Logarithmic
from eqsim.laws.aging.along import crossing
from eqsim.laws.aging.base import Held, spend, spent
from eqsim.laws.barrier import BARRIERS
from eqsim.laws.barrier.base import hazard, rate, stretch
from eqsim.laws.barrier.pooled import Pooled
from eqsim.laws.stiffness import kappa

SOFT, STIFF = Thermal(0.1), Thermal(0.1, barrier="stiff")
LOGARITHMIC, FLOW = (
    Aging("logarithmic", beta=0.05, cutoff_time=0.1),
    Aging("flow", 0.1, 2.0),
)
UNIFORM, STARTS = {"stiffness_law": "uniform"}, ("fresh", "stationary")
MIXED = (
    Segment(0.1, distance=2.0, points=20),
    Segment(0.0, time=30.0, points=10),
    Segment(1.0, distance=1.5, points=15),
    Segment(-0.2, distance=3.0, points=30),
    Segment(0.0, time=4.0, points=3),
    Segment(0.0, time=1.0, points=2),
    Segment(-0.05, time=30.0, points=15),
    Segment(0.3, distance=2.0, points=20),
)
LAWS = {
    "mechanical sqrt": {},
    "mechanical uniform, fixed delay": {"delay": Delay(1.0), "eta": 2.0, **UNIFORM},
    "soft uniform": {"thermal": SOFT, **UNIFORM},
    "soft sqrt, exponential delay": {
        "thermal": SOFT,
        "delay": Delay(1.0, "exponential"),
        "eta": 1.0,
    },
    "stiff sqrt": {"thermal": STIFF},
    "annealed soft uniform, fixed delay": {
        "thermal": SOFT,
        "disorder": "annealed",
        "delay": Delay(2.0),
        **UNIFORM,
    },
    "flow sqrt": {"thermal": SOFT, "aging": FLOW},
    "logarithmic uniform": {"thermal": SOFT, "aging": LOGARITHMIC, **UNIFORM},
    "identical": {"thermal": SOFT, "thresholds": Delta(1.3)},
    "table": {"thermal": SOFT, "thresholds": Table([1.0, 2.0, 3.5]), **UNIFORM},
}


@chosen(  # by default each kind of kernel once
    ("name", "start"),
    itertools.product(LAWS, STARTS),
    [
        ("mechanical sqrt", "fresh"),
        ("mechanical uniform, fixed delay", "stationary"),
        ("soft sqrt, exponential delay", "stationary"),
        ("stiff sqrt", "fresh"),
        ("annealed soft uniform, fixed delay", "fresh"),
        ("identical", "stationary"),
        ("table", "fresh"),
    ],
)
def test_one_segment_has_the_bits_of_a_constant_drive(name, start):
    ensemble = Ensemble(count=3000, **LAWS[name])
    expected = trajectory(
        ensemble, Drive(0.1, 6.0, start), points=121, seed=3, replicas=2
    )
    found = trajectory(
        ensemble,
        Programme([Segment(0.1, distance=6.0)], start, 0.1),
        points=121,
        seed=3,
        replicas=2,
    )
    for column in ("X", "t", "force", "pinned", "force_replica_std"):
        assert (
            getattr(found, column).tobytes() == getattr(expected, column).tobytes()
        ), column
    assert found.lives == expected.lives


def bits(ensemble, **how):
    run = trajectory(
        ensemble, Programme(MIXED, "stationary", 0.3), points=101, seed=9, **how
    )
    return (
        {name: column.tobytes() for name, column in run.columns().items()},
        run.segments,
        run.lives,
    )


@pytest.mark.parametrize(
    ("name", "replicas"),
    [
        ("soft sqrt, exponential delay", 5),
        pytest.param("logarithmic uniform", 1, marks=pytest.mark.verification),
    ],
)
def test_same_bits_on_anything(name, replicas):
    """Threads, processes, and blocks of contacts of any size."""
    ensemble = Ensemble(count=700, **LAWS[name])
    expected = bits(ensemble, replicas=replicas)
    assert bits(ensemble, replicas=replicas, threads=2) == expected
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        assert bits(ensemble, replicas=replicas, threads=(pool, 3)) == expected


def scores(found, exact):
    """Differences from the exact mean at the ends of segments in standard errors."""
    ends = np.flatnonzero(np.diff(found.segment, append=-1))
    force = (found.force - exact.force)[ends] / np.hypot(
        found.force_stderr, exact.force_error
    )[ends]
    sigma = np.hypot(found.pinned_stderr, exact.pinned_error)[ends]
    pinned = np.divide(
        (found.pinned - exact.pinned)[ends],
        sigma,
        out=np.zeros(ends.size),
        where=sigma > 1e-12,
    )
    return np.append(force, pinned)


@chosen(  # by default what takes less than a second
    ("name", "start"),
    itertools.product(LAWS, STARTS),
    [
        ("mechanical sqrt", "fresh"),
        ("mechanical uniform, fixed delay", "stationary"),
        ("identical", "stationary"),
        ("table", "fresh"),
    ],
)
def test_agrees_with_the_renewal_equation(name, start):
    """|z| < 4.5 for force and pinned fraction at the ends of eight segments, 320
    scores: false alarm 2e-3 together."""
    ensemble = Ensemble(count=15_000, **LAWS[name])
    programme = Programme(MIXED, start, 0.3)
    found = trajectory(ensemble, programme, seed=5, threads=2)
    assert np.abs(scores(found, transient(ensemble, programme, 2001))).max() < 4.5


SHORT_HOLD = Programme(
    [*MIXED[:1], Segment(0.0, time=0.3, points=10), *MIXED[2:]], "stationary", 0.3
)


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("mechanical uniform, fixed delay", SHORT_HOLD),
        pytest.param("soft uniform", SHORT_HOLD, marks=pytest.mark.verification),
        pytest.param(
            "annealed soft uniform, fixed delay",
            SHORT_HOLD,
            marks=pytest.mark.verification,
        ),
        pytest.param(
            "soft uniform",
            Programme(
                [Segment(abs(s.velocity), s.distance, s.time, s.points) for s in MIXED],
                "fresh",
            ),
            marks=pytest.mark.verification,
        ),
        pytest.param(
            "logarithmic uniform",
            {"aging": Aging("logarithmic", beta=0.05, cutoff_time=1.0)},
            marks=pytest.mark.verification,
        ),
    ],
)
def test_another_programme_or_law_fails(name, wrong):
    """Negative controls: a hold that breaks next to nothing, no reversal, another
    cutoff time."""
    programme = Programme(MIXED, "stationary", 0.3)
    ensemble = Ensemble(count=40_000, **LAWS[name])
    other = (
        Ensemble(count=40_000, **(LAWS[name] | wrong))
        if isinstance(wrong, dict)
        else ensemble
    )
    found = trajectory(
        other, wrong if isinstance(wrong, Programme) else programme, seed=5, threads=2
    )
    assert np.abs(scores(found, transient(ensemble, programme, 2001))).max() > 10


def test_a_hold_is_the_limit_of_slow_sliding():
    """Sliding by 1e-9 x_* in a time T is a hold of T: breaks are found by rates, where
    differences of hazards would have no digits left. The lives that begin there are
    others, so the two agree within their errors."""
    ensemble = Ensemble(count=100_000, thermal=SOFT, **UNIFORM)
    slow, held = (
        trajectory(
            ensemble,
            Programme([Segment(0.1, distance=3.0), middle, Segment(0.1, distance=1.0)]),
            seed=seed,
        )
        for seed, middle in (
            (1, Segment(1e-11, time=100.0)),
            (2, Segment(0.0, time=100.0)),
        )
    )
    for one, other in zip(slow.segments, held.segments, strict=True):
        z = (one.end.value - other.end.value) / math.hypot(
            one.end.stderr, other.end.stderr
        )
        assert abs(z) < 4.5


def test_reversal_is_a_mirror():
    """With all velocities negated, the same contacts pull the other way, to the last
    bit."""
    ensemble = Ensemble(count=5000, **LAWS["soft sqrt, exponential delay"])
    mirrored = [Segment(-s.velocity, s.distance, s.time, s.points) for s in MIXED]
    one, other = (
        trajectory(ensemble, Programme(segments)) for segments in (MIXED, mirrored)
    )
    assert np.array_equal(one.pinned, other.pinned)
    # in a hold forces are added in the direction of X
    assert one.force == pytest.approx(-other.force, rel=0, abs=1e-12)


def test_without_heat_a_hold_changes_nothing():
    """A hold at the beginning of a fresh start, too; contacts that go back break at -xi
    and not before."""
    ensemble = Ensemble(count=2000)
    segments = [
        Segment(0.0, time=5.0),
        Segment(1.0, distance=0.5),
        Segment(0.0, time=1e5),
        Segment(-1.0, distance=1.0),
    ]
    run = trajectory(ensemble, Programme(segments), points=401)
    assert run.force[run.segment == 0] == pytest.approx(0.0, abs=0)
    held = run.force[run.segment == 2]
    # each segment adds up in fixed point of its own, of 40 bits and more
    assert held == pytest.approx(run.force[run.segment == 1][-1], rel=0, abs=1e-12)


@pytest.mark.parametrize(
    "law", ["soft", "stiff", pytest.param("annealed", marks=pytest.mark.verification)]
)
def test_hazard_is_the_inverse_of_the_stretch(law):
    """Of contacts over many decades, to what tables are good to, 5e-9 in the stretch;
    its derivative is the rate."""
    there, back, slope = compiled(stretch), compiled(hazard), compiled(rate)
    rng = np.random.default_rng(1)
    tried = 0
    for _ in range(100 if law == "annealed" else 400):
        kT, omega = 10 ** rng.uniform(-4, 2), 10 ** rng.uniform(-4, 4)
        ensemble = Ensemble(
            thermal=Thermal(kT, omega, "stiff" if law == "stiff" else "soft"),
            disorder="annealed" if law == "annealed" else "quenched",
        )
        c = contacts(ensemble, 1.0)
        if law == "annealed" and not isinstance(c.barrier, Pooled):
            continue
        xi, clock = 10 ** rng.uniform(-1.5, 0.7), rng.exponential()
        stiffness = xi * c.springs.slope
        x = there(c.barrier, c.barrier_table, xi, stiffness, clock)
        if not 0 < x < xi * (1 - 1e-12):
            continue
        tried += 1
        step = 5e-9 * x
        low, high = (
            back(c.barrier, c.hazard_table, xi, stiffness, at)
            for at in (x - step, min(x + step, xi))
        )
        assert low <= clock * (1 + 1e-7)
        assert high >= clock * (1 - 1e-7)
        if law != "annealed":
            barrier = BARRIERS[ensemble.thermal.barrier](c.barrier.b, c.barrier.log_w)
            exact = math.exp(
                float(barrier.log_hazard(x, xi, c.barrier.b * stiffness))
                + c.barrier.log_w
            )
            assert back(c.barrier, c.hazard_table, xi, stiffness, x) == pytest.approx(
                exact, rel=1e-7, abs=0
            )
        small = (
            1e-4
            * min(x, xi - x)
            / (1 + c.barrier.b * stiffness * xi * x if law != "annealed" else 10)
        )
        after, before = (
            back(c.barrier, c.hazard_table, xi, stiffness, x + s * small)
            for s in (1, -1)
        )
        if small > 1e-9 * x and after > before * (1 + 1e-6):
            assert (after - before) / (2 * small) == pytest.approx(
                slope(c.barrier, xi, stiffness, x),
                rel=2e-3 if law == "annealed" else 1e-4,
                abs=0,
            )
    assert tried > 20


@pytest.mark.verification
@pytest.mark.parametrize("barrier", ["soft", "stiff"])
def test_clocks_along_a_segment(barrier):
    """Where a contact breaks, or what its clock has left, against the hazard added up
    in 20 000 trapezoids. On the way back to 0, across it, away from it, and at rest."""
    follow, passed = compiled(spend), compiled(spent)
    rng = np.random.default_rng(3)
    seen = {"way back": 0, "beyond": 0, "threshold": 0, "survived": 0}
    for _ in range(300):
        c = contacts(
            Ensemble(thermal=Thermal(10 ** rng.uniform(-1.5, 0.5), 1.0, barrier)),
            10 ** rng.uniform(-1.5, 0.5),
        )
        xi, length = rng.uniform(0.3, 2.0), 10 ** rng.uniform(-2, 0.5)
        stiffness, y, moves = (
            kappa(c.springs, xi),
            rng.uniform(-0.99, 0.99) * xi,
            int(rng.random() < 0.8),
        )
        s = np.linspace(0.0, min(length, xi - y) if moves else length, 20_001)
        law = BARRIERS[barrier](c.barrier.b, c.barrier.log_w)
        with np.errstate(divide="ignore", invalid="ignore"):
            exponent = law.log_rate(
                np.minimum(np.abs(y + moves * s), xi), xi, law.b * stiffness
            )
        rates = np.exp(law.log_w + np.nan_to_num(exponent, nan=-np.inf))
        hazards = integrate.cumulative_trapezoid(rates, s, initial=0.0)
        clock = rng.uniform(0.0, 1.5) * hazards[-1]
        broke, left = follow(
            c.aging, c, Held(xi, stiffness, y, 0.0), moves, length, clock
        )
        slack = 1e-9 + 1e-9 * hazards[-1] + 2.0 * np.abs(np.diff(rates)).max() * s[1]
        if clock < hazards[-1] - slack:
            assert np.interp(broke, s, hazards) == pytest.approx(
                clock, rel=0, abs=slack
            )
            seen["way back" if moves and y + broke < 0 else "beyond"] += 1
        elif moves and length > xi - y and clock > hazards[-1] + slack:
            assert broke == pytest.approx(xi - y, rel=0, abs=1e-9)
            seen["threshold"] += 1
        elif clock > hazards[-1] + slack:
            assert broke == math.inf
            assert left == pytest.approx(clock - hazards[-1], rel=0, abs=slack)
            assert passed(
                c.aging, c, Held(xi, stiffness, y, 0.0), moves, length
            ) == pytest.approx(hazards[-1], rel=0, abs=slack)
            seen["survived"] += 1
    assert min(seen.values()) > 15


@pytest.mark.parametrize(
    "law", [Flow(4.0, 0.7), Flow(0.1, 5.0), Flow(0.01, 300.0), Logarithmic(0.3, 50.0)]
)
def test_first_crossing(law):
    """Where a stretch first reaches its threshold, against a search on a grid of 20 000
    instants."""
    find = compiled(crossing)
    rng = np.random.default_rng(2)
    found = {True: 0, False: 0}
    for _ in range(500):
        xi, age, length = (
            10 ** rng.uniform(-1, 1),
            10 ** rng.uniform(-3, 1),
            10 ** rng.uniform(-2, 1),
        )
        y = rng.uniform(-1, 1) * xi * float(law.growth_at(np.asarray(age)))
        moves = int(rng.integers(2))
        s = np.linspace(0.0, length, 20_001)
        excess = xi * law.growth_at(age + s) - np.abs(y + moves * s)
        met = np.flatnonzero(excess <= 0)
        at = find(law, Held(xi, 1.0, y, age), moves, length)
        if met.size:
            assert s[max(met[0] - 1, 0)] - 1e-12 <= at <= s[met[0]] + 1e-12
        else:  # a crossing between two instants of the grid is none
            assert at == math.inf or excess.min() < 1e-3 * xi
        found[math.isfinite(at)] += 1
    assert min(found.values()) > 20


def test_error_bars_are_those_of_repeated_runs():
    """Forces of 400 small ensembles scatter as one of them says: chi-square within its
    1e-4 bounds at 20 instants."""
    ensemble = Ensemble(count=500, thermal=SOFT, delay=Delay(1.0), **UNIFORM)
    programme = Programme(MIXED[:4], "stationary", 0.3)
    many = trajectory(ensemble, programme, points=41, replicas=400, seed=1, threads=2)
    quoted = trajectory(ensemble, programme, points=41, seed=2).force_stderr
    ratio = (many.force_replica_std / quoted)[::4] ** 2
    # chi-square of 399 degrees of freedom: relative scatter 7 %, of the quoted variance
    # 500 contacts' worth, 10 %
    assert np.all(np.abs(ratio - 1) < 4 * math.hypot(0.07, 0.1))


def test_few_contacts_quote_what_they_did_not_meet():
    """T = 0, soon after a fresh start: none of 2000 contacts has broken, some 0.03 were
    expected to."""
    run = trajectory(
        Ensemble(count=2000, **UNIFORM),
        Programme([Segment(1.0, distance=0.06)]),
        points=11,
    )
    # X P(xi < X), more than the mean deficit
    lost = run.X * -math.expm1(-(0.06**4) / 2)
    assert np.all(np.abs(run.force - run.X)[1:] + lost[1:] < 5 * run.force_stderr[1:])


@pytest.mark.parametrize(
    ("ensemble", "message"),
    [
        (
            {"disorder": "annealed", "thermal": SOFT, "aging": FLOW},
            "annealed contacts cannot age",
        ),
        (
            {"aging": Aging("langevin", 0.1, 2.0)},
            'rule "langevin" follow a programme from a fresh start only',
        ),
    ],
)
def test_refused_contacts(ensemble, message):
    with pytest.raises(InputError, match=message):
        trajectory(Ensemble(count=10, **ensemble), Programme(MIXED, "stationary", 0.3))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Programme([]), "programme = []: must have at least one segment"),
        (lambda: Segment(1.0), "distance: a segment has either a distance or a time"),
        (
            lambda: Segment(1.0, 1.0, 1.0),
            "distance: a segment has either a distance or a time",
        ),
        (
            lambda: Segment(0.0, distance=1.0),
            "velocity = 0.0: must not be 0 with a distance",
        ),
        (lambda: Segment(1.0, time=0.0), "time = 0.0: must be a finite number > 0"),
        (
            lambda: Segment(1.0, distance=math.inf),
            "distance = inf: must be a finite number > 0",
        ),
        (
            lambda: Segment(math.nan, time=1.0),
            "velocity = nan: must be a finite number",
        ),
        (
            lambda: Segment(1.0, time=1.0, points=0),
            "points = 0: must be an integer from 1",
        ),
        (
            lambda: Programme([Segment(1.0, time=1.0)], "stationary"),
            'velocity: is required with start = "stationary"',
        ),
        (
            lambda: Programme([Segment(1.0, time=1.0)], "cold"),
            "start = 'cold': must be one of",
        ),
    ],
)
def test_bad_programmes(make, message):
    with pytest.raises(InputError) as caught:
        make()
    assert str(caught.value).startswith(message)


def test_too_many_lives():
    with pytest.raises(
        InputError, match=r"this run needs about .* lives, more than max_lives"
    ):
        trajectory(Ensemble(), Programme([Segment(1.0, distance=1e9)]))


def test_predicted_lives():
    """Within a fifth of what a programme takes."""
    ensemble = Ensemble(count=20_000, thermal=SOFT, thresholds=Gamma(1.0))
    from eqsim.engine.trajectory import predicted_lives

    programme = Programme(
        [
            Segment(0.1, distance=20.0),
            Segment(0.0, time=1e3),
            Segment(-1.0, distance=20.0),
        ]
    )
    lives = trajectory(ensemble, programme).lives
    assert lives == pytest.approx(predicted_lives(ensemble, programme), rel=0.2, abs=0)


def z_of(found, known, stated):
    """Difference from a number with a stated error, beyond it, in the quoted error."""
    return max(abs(found.value - known) - stated, 0.0) / found.stderr


@pytest.mark.verification
@pytest.mark.parametrize(("kind", "hold"), HOLDS)
def test_checked_numbers_of_holds(kind, hold):
    """A million contacts: the force at the end of a hold and the peak after it, |z| <
    4.5; maxima over a coarse grid may be 2e-4 low, that of quenched sqrt contacts after
    1e4 by 1e-3."""
    end, peak, stated, _ = HOLDS[kind, hold]
    ensemble = replace(KINDS[kind], count=1_000_000)
    segments = [
        Segment(0.0, time=float(hold), points=4),
        Segment(0.1, distance=3.0, points=300),
    ]
    held, slid = trajectory(
        ensemble, Programme(segments, "stationary", 0.1), seed=7, threads=2
    ).segments
    low = 1e-3 if (kind, hold) == ("quenched sqrt", 1e4) else 2e-4
    assert z_of(held.end, end, 2.5e-5) < 4.5
    assert z_of(slid.peak, peak + 0.5 * low, stated + 0.5 * low) < 4.5


@pytest.mark.verification
@pytest.mark.parametrize(
    ("kind", "before", "after", "extreme", "a", "b"),
    [(*case[:4], *case[5:7]) for case in STEPS],
)
def test_checked_numbers_of_steps(kind, before, after, extreme, a, b):
    ensemble = replace(KINDS[kind], count=1_000_000)
    programme = Programme(
        [Segment(after, distance=8.0, points=400)], "stationary", before
    )
    (found,) = trajectory(ensemble, programme, seed=8, threads=2).segments
    assert z_of(found.peak, extreme, 2.5e-5) < 4.5
    assert z_of(found.step.direct, a, 3e-5) < 4.5
    assert z_of(found.step.evolution, b, 3e-5) < 4.5


@pytest.mark.verification
@pytest.mark.parametrize(
    ("law", "kT", "v", "hold", "end", "peak", "stated"),
    [
        *(
            ("uniform", 0.0, 1.0, hold, 0.8677195, peak, 1e-5)
            for hold, (peak, _) in HEALING.items()
        ),
        *(
            ("sqrt", 0.0, 1.0, hold, 1.0274171, peak, 1e-5)
            for hold, (_, peak) in HEALING.items()
        ),
        ("uniform", 0.1, 0.1, 10.0, 0.82985, 0.99494, 2e-4),
        ("uniform", 0.1, 0.1, 1e3, 0.73605, 1.26331, 3e-4),
        ("sqrt", 0.1, 0.1, 10.0, 1.06597, 1.23305, 3e-4),
        ("sqrt", 0.1, 0.1, 1e3, 0.98668, 1.57632, 4e-4),
    ],
)
def test_checked_numbers_of_logarithmic_aging(law, kT, v, hold, end, peak, stated):
    """A million contacts at T = 0, 200 000 with heat; maxima over a grid may be 2e-4
    low."""
    count = 200_000 if kT else 1_000_000
    ensemble = Ensemble(
        thermal=Thermal(kT), aging=LOGARITHMIC, stiffness_law=law, count=count
    )
    segments = [Segment(0.0, time=hold, points=4), Segment(v, distance=3.0, points=150)]
    held, slid = trajectory(
        ensemble, Programme(segments, "stationary", v), seed=9, threads=2
    ).segments
    assert z_of(held.end, end, 2e-5) < 4.5
    assert z_of(slid.peak, peak + 1e-4, stated + 1e-4) < 4.5
