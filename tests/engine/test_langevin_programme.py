"""Thresholds that fluctuate along programmes of segments; engine/test_oracle.py compares the
same contacts in time steps."""

import math

import numpy as np
import pytest
from cases import chosen
from kernels import compiled

from eqsim import (
    Aging,
    Delay,
    Drive,
    Ensemble,
    Gamma,
    InputError,
    Programme,
    Segment,
    Thermal,
    trajectory,
)
from eqsim.engine import langevin
from eqsim.engine.contacts import contacts as laws_of
from eqsim.engine.langevin import STEP, STEP_ERROR
from eqsim.engine.trajectory import predicted_lives

AGING, UNIFORM = Aging("langevin", 0.1, 2.0), {"stiffness_law": "uniform"}
LAWS = {
    "soft sqrt, exponential delay": {
        "thermal": Thermal(0.1),
        "delay": Delay(1.0, "exponential"),
        "eta": 1.0,
    },
    "soft uniform": {"thermal": Thermal(0.1), **UNIFORM},
    "soft uniform, fixed delay": {
        "thermal": Thermal(0.1),
        "delay": Delay(1.0),
        "eta": 2.0,
        **UNIFORM,
    },
    "soft sqrt, n = 0.3": {"thermal": Thermal(0.1), "thresholds": Gamma(0.3)},
    "mechanical sqrt": {},
    "mechanical uniform, n = 0": {"thresholds": Gamma(0.0), **UNIFORM},
    "stiff uniform": {"thermal": Thermal(0.1, barrier="stiff"), **UNIFORM},
}
# By default a kernel that other tests compile, too.
CHOSEN = ["soft sqrt, exponential delay"]
MIXED = (
    Segment(0.1, distance=2.0, points=20),
    Segment(0.0, time=20.0, points=10),
    Segment(1.0, distance=1.5, points=15),
    Segment(-0.2, distance=3.0, points=30),
    Segment(0.0, time=4.0, points=3),
    Segment(-0.05, time=20.0, points=15),
    Segment(0.3, distance=2.0, points=20),
)


def contacts(name, count, aging=AGING):
    return Ensemble(count=count, aging=aging, **LAWS[name])


def ends(run):
    """Forces and their errors at the ends of segments."""
    last = np.flatnonzero(np.diff(run.segment, append=-1))
    return run.force[last], run.force_stderr[last]


def scores(one, other):
    """Differences of forces in standard errors, beyond what steps may cost."""
    (force, sigma), (expected, theirs) = one, other
    return np.maximum(
        np.abs(force - expected) - STEP_ERROR * np.abs(expected), 0.0
    ) / np.hypot(sigma, theirs)


@chosen("name", LAWS, CHOSEN)
def test_one_segment_has_the_bits_of_a_constant_drive(name):
    """Also where edges of averaging windows are no grid points."""
    ensemble = contacts(name, 500)
    expected = trajectory(ensemble, Drive(0.1, 6.0), points=75, seed=3, replicas=2)
    found = trajectory(
        ensemble, Programme([Segment(0.1, distance=6.0)]), points=75, seed=3, replicas=2
    )
    for column in ("X", "t", "force", "pinned", "force_replica_std"):
        assert (
            getattr(found, column).tobytes() == getattr(expected, column).tobytes()
        ), column
    assert found.lives == expected.lives


@chosen("name", LAWS, [])
def test_many_segments_are_one(name):
    """Sixteen segments at one velocity: steps that end at their ends, and random
    numbers that go on. |z| < 4.5."""
    ensemble = contacts(name, 30_000)
    parts = trajectory(
        ensemble, Programme([Segment(0.2, distance=0.25, points=1)] * 16), seed=4
    )
    whole = trajectory(
        ensemble, Programme([Segment(0.2, distance=4.0)]), points=17, seed=5
    )
    assert (
        scores(
            (parts.force[1:], parts.force_stderr[1:]),
            (whole.force[1:], whole.force_stderr[1:]),
        ).max()
        < 4.5
    )


@pytest.mark.verification
def test_the_same_whatever_is_recorded():
    """Where the stiffness follows its threshold steps end at instants, of holds as
    well."""
    ensemble = contacts("soft sqrt, n = 0.3", 20_000)
    few, many = (
        [Segment(s.velocity, s.distance, s.time, points) for s in MIXED]
        for points in (1, 30)
    )
    runs = [
        ends(trajectory(ensemble, Programme(segments), seed=seed))
        for seed, segments in enumerate((few, many))
    ]
    assert scores(*runs).max() < 4.5


@chosen("name", [*CHOSEN, "soft uniform, fixed delay"], CHOSEN)
def test_same_bits_on_anything(name):
    one, two = (
        trajectory(contacts(name, 700), Programme(MIXED), seed=9, replicas=5, threads=n)
        for n in (1, 2)
    )
    assert one.segments == two.segments
    for column in ("force", "force_stderr", "pinned", "force_replica_std"):
        assert getattr(one, column).tobytes() == getattr(two, column).tobytes(), column


def test_reversal_is_a_mirror():
    ensemble = contacts("soft sqrt, exponential delay", 2000)
    mirrored = [Segment(-s.velocity, s.distance, s.time, s.points) for s in MIXED]
    one, other = (
        trajectory(ensemble, Programme(segments)) for segments in (MIXED, mirrored)
    )
    assert np.array_equal(one.pinned, other.pinned)
    assert one.force == pytest.approx(-other.force, rel=0, abs=1e-12)


@chosen("name", LAWS, CHOSEN)
def test_slow_aging_is_none(name):
    """Thresholds that move by 1e-4 of themselves along the programme."""
    slow = ends(
        trajectory(
            contacts(name, 50_000, Aging("langevin", 1e-10, 2.0)),
            Programme(MIXED),
            seed=1,
        )
    )
    none = ends(trajectory(contacts(name, 50_000, Aging()), Programme(MIXED), seed=2))
    assert scores(slow, none).max() < 4.5


@pytest.mark.verification
def test_fast_aging_is_not_none():
    """Negative control."""
    name = "soft uniform"
    fast = ends(trajectory(contacts(name, 50_000), Programme(MIXED), seed=1))
    none = ends(trajectory(contacts(name, 50_000, Aging()), Programme(MIXED), seed=2))
    assert np.sort(scores(fast, none))[-3] > 10


@pytest.mark.verification
def test_a_hold_is_the_limit_of_slow_sliding():
    """Sliding by 1e-6 x_* in a time T, against a hold of T: at another pace, and with x
    that hardly moves."""
    ensemble = contacts("soft uniform", 50_000, Aging("langevin", 0.01, 2.0))
    slow, held = (
        ends(
            trajectory(
                ensemble,
                Programme(
                    [Segment(0.1, distance=2.0), middle, Segment(0.1, distance=1.0)]
                ),
                seed=i,
            )
        )
        for i, middle in enumerate((Segment(1e-7, time=10.0), Segment(0.0, time=10.0)))
    )
    assert scores(slow, held).max() < 4.5


@pytest.mark.verification
def test_a_hold_of_unstretched_contacts():
    """Thresholds age while nothing pulls: the law they have then is that of the slide
    from it."""
    rate, final, time = 0.1, 2.0, 3.0
    scale = math.sqrt(
        final**2 + (1.0 - final**2) * math.exp(-4.0 * rate * time / final**2)
    )
    quiet = {"thermal": Thermal(0.1, 1e-9), **UNIFORM}  # heat never breaks a contact
    held = Programme(
        [Segment(0.0, time=time, points=2), Segment(1e3, distance=3.0, points=12)]
    )
    aged = trajectory(
        Ensemble(count=50_000, aging=Aging("langevin", rate, final), **quiet),
        held,
        seed=1,
    )
    assert not aged.force[aged.segment == 0].any()
    # what moves so fast does not age
    grown = Ensemble(Gamma(1.0, scale), count=50_000, **quiet)
    fresh = trajectory(
        grown, Programme([Segment(1e3, distance=3.0, points=12)]), seed=2
    )
    slid = aged.segment == 1
    one, other = (
        (aged.force[slid], aged.force_stderr[slid]),
        (fresh.force[1:], fresh.force_stderr[1:]),
    )
    assert (
        scores(tuple(part[:6] for part in one), tuple(part[:6] for part in other)).max()
        < 4.5
    )


def test_nothing_meets_an_unstretched_contact_at_rest():
    """One step takes it to the end of a hold; thresholds of two dimensions (n = 0) dive
    towards 0 again and again."""
    c = laws_of(contacts("mechanical uniform, n = 0", 1), 1.0)
    at_rest = langevin.Pinned(c.barrier, c.springs, c.aging, 0.0)
    length, _, _ = compiled(langevin.pace)(at_rest, 1e-9, 0.0, math.inf, 5.0, STEP)
    assert length == 5.0


@pytest.mark.verification
def test_steps_are_part_of_the_error_where_they_cost_more():
    """A hold in which thresholds relax 4000 times, D T/x_*^2 = 1000: 2.6e-3 of the
    force instead of 1e-3."""
    programme = Programme(
        [Segment(1.0, distance=0.5, points=1), Segment(0.0, time=1e4, points=1)]
    )
    run = trajectory(
        Ensemble(count=20, thermal=Thermal(0.1), aging=Aging("langevin", 0.1, 1.0)),
        programme,
    )
    assert run.force_stderr[1] > 1.6e-3 * run.force[1]


@pytest.mark.verification
def test_predicted_lives():
    """Within a fifth of what a programme takes."""
    programme = Programme(
        [
            Segment(0.1, distance=20.0),
            Segment(0.0, time=100.0),
            Segment(-1.0, distance=20.0),
        ]
    )
    ensemble = contacts("soft uniform", 2000)
    assert trajectory(ensemble, programme).lives == pytest.approx(
        predicted_lives(ensemble, programme), rel=0.2, abs=0
    )


@pytest.mark.parametrize(
    ("programme", "message"),
    [
        (
            Programme(MIXED, "stationary", 0.1),
            'rule "langevin" follow a programme from a fresh start only',
        ),
        (
            Programme([MIXED[0], Segment(time=1e8)]),
            r"drive.programme.1.4 rate hold / x_star_final\^2 = 10000000.0",
        ),
    ],
)
def test_refusals(programme, message):
    with pytest.raises(InputError, match=message) as refused:
        trajectory(contacts("soft uniform", 10), programme)
    assert "\n" not in str(refused.value)
