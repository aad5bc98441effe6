"""Contacts along a motion that their stretch does not resolve: heat and age pass as in
a hold, whatever it is.

Exact values: mpmath, sums over equal parts of a piece, and contacts behind a spring
broken one by one.
"""

import functools
import itertools
import math

import mpmath
import numpy as np
import pytest
from cases import chosen
from kernels import compiled
from scipy import integrate

from eqsim import (
    Aging,
    Delay,
    Ensemble,
    InputError,
    Newborn,
    Programme,
    Segment,
    Stage,
    Table,
    Thermal,
    trajectory,
    transient,
)
from eqsim.engine.contacts import contacts
from eqsim.engine.trajectory import guarded
from eqsim.laws.aging.base import Held, spend, spent
from eqsim.laws.barrier.base import averaged, back, hazard, mean_rate, onward, rate
from eqsim.laws.barrier.soft import Soft
from eqsim.laws.barrier.stiff import Stiff

SOFT, STIFF, UNIFORM = (
    Thermal(0.1),
    Thermal(0.1, barrier="stiff"),
    {"stiffness_law": "uniform"},
)
LAWS = {
    "soft": Ensemble(thermal=SOFT, **UNIFORM),
    "stiff sqrt": Ensemble(thermal=STIFF),
    "annealed": Ensemble(thermal=SOFT, disorder="annealed", **UNIFORM),
    "annealed table": Ensemble(
        Table([0.5, 1.0, 2.3]), SOFT, disorder="annealed", **UNIFORM
    ),
    "flow sqrt": Ensemble(thermal=SOFT, aging=Aging("flow", 0.1, 2.0)),
    "falling flow": Ensemble(thermal=SOFT, aging=Aging("flow", 0.05, 0.3), **UNIFORM),
    "logarithmic": Ensemble(
        thermal=STIFF, aging=Aging("logarithmic", beta=0.2, cutoff_time=0.1), **UNIFORM
    ),
    "mechanical": Ensemble(**UNIFORM),
}
# of a slider, over the pace
VELOCITIES = (0.0, 1e-300, 1e-30, 1e-18, 1e-16, 3e-16, 1e-12, 0.1)
follow, passed = compiled(spend), compiled(spent)


@pytest.mark.verification
@pytest.mark.parametrize("barrier", [Soft, Stiff])
def test_mean_rate_however_short(barrier):
    """Against quadrature in 50 digits, for b up to 1e8, from 0 and next to the
    threshold, over 1 to 1e-30 of the stretch: 1e-8, and what a unit in the last place
    of stretch and threshold means. And of a law that has no closed forms. The
    difference of two stretches has no digit left (negative control)."""
    average, average_of_any = compiled(mean_rate), compiled(averaged)
    rng, worst, lost = np.random.default_rng(1), [0.0, 0.0], 0
    for _ in range(150):
        b, xi = 10 ** rng.uniform(-3, 8), rng.uniform(0.3, 2.0)
        part = rng.choice(
            [
                0.0,
                rng.random(),
                10 ** rng.uniform(-20, 0),
                1.0 - 10 ** rng.uniform(-6, 0),
            ]
        )
        # as high as barriers that matter: E below 200
        x = xi * max(
            part,
            1.0 - (200.0 / (b * xi * xi)) ** (1.0 if barrier is Soft else 2 / 3),
            0.0,
        )
        length = min((x or xi) * 10 ** rng.uniform(-30, 0), xi - x)
        law = barrier(b, 0.0)
        with mpmath.workdps(50):
            start, way, end, a = map(mpmath.mpf, (x, length, xi, b))

            def r(y, end=end, a=a):
                gap = end - y
                if barrier is Soft:
                    return mpmath.exp(-a * gap * (end + y))
                return mpmath.sqrt(gap / end) * mpmath.exp(
                    -a * gap * mpmath.sqrt(gap * end)
                )

            steps = max(2, int(math.log2(1.0 + 3.0 * b * xi * length)) + 3)
            edges = [start + way * (1 - mpmath.mpf(2) ** -j) for j in range(steps)] + [
                start + way
            ]
            exact = float(mpmath.quad(r, edges) / way)
        if exact < 1e-250:
            continue
        # one unit in the last place of xi, times d ln r/d xi; stiff: of the gap itself,
        # too
        allowed = 1e-8 + 4e-16 * (
            b * xi * xi + (xi / (xi - x) if barrier is Stiff and x < xi else 1.0)
        )
        for k, found in enumerate(
            (
                average(law, barrier.hazard_table(), xi, 1.0, x, length),
                average_of_any(law, xi, 1.0, x, length),
            )
        ):
            worst[k] = max(worst[k], abs(found / exact - 1.0) / allowed)
        lost += (x + length) - x == 0.0
    assert max(worst) <= 1.0
    assert lost > 30


@pytest.mark.verification
@chosen("name", LAWS, ["soft", "mechanical"])
def test_pieces_add_up(name):
    """The hazard of a piece is that of 30 equal parts, and of 1000, to 1e-8 and 1e-8 of
    an exponential clock's mean; and contacts break at the same instant, or have the
    same clock left. Before, between and beyond stretch 0, at rest and at the least
    velocities."""
    c = contacts(LAWS[name], 1.0)
    tried = broken = 0
    for moves, y, age in itertools.product(
        VELOCITIES, (0.7, 0.2, -0.2, -0.6, 1e-20, 0.0), (0.0, 0.3)
    ):
        length = 1.5 if moves < 0.01 else 2.0
        contact = Held(0.9, 1.2, y, age)
        if name == "falling flow" and (abs(y) > 0.3 or moves > 0.01):
            continue  # breaks
        whole = passed(c.aging, c, contact, moves, length)
        for parts in (30, 1000):
            step = length / parts
            total = sum(
                passed(
                    c.aging,
                    c,
                    Held(0.9, 1.2, y + moves * step * j, age + step * j),
                    moves,
                    step,
                )
                for j in range(parts)
            )
            assert total == pytest.approx(whole, rel=1e-8, abs=1e-8)
        tried += 1
        if whole == 0.0:
            continue
        clock, at, x, left = 0.6 * whole, 0.0, y, math.inf
        once, _ = follow(c.aging, c, contact, moves, length, clock)
        step, rest = length / 30, clock
        while at < length:
            found, left = follow(
                c.aging, c, Held(0.9, 1.2, x, age + at), moves, step, rest
            )
            if found <= step:
                break
            at, x, rest = at + step, x + moves * step, left
        assert at + found == pytest.approx(once, rel=1e-7, abs=1e-7)
        assert 0.0 < once < length
        broken += 1
    assert tried > 50
    assert (broken > 50) == (name != "mechanical")


@chosen("name", LAWS, ["soft", "mechanical"])
def test_slow_motion_meets_the_hold(name):
    """As v goes to 0 the hazard of every law, and where contacts break, are those of a
    hold, to rounding."""
    c = contacts(LAWS[name], 1.0)
    for y in (0.25, -0.2) if name == "falling flow" else (0.7, -0.5, 0.25):
        held = passed(c.aging, c, Held(0.9, 1.2, y, 0.1), 0.0, 5.0)
        for moves in (1e-300, 1e-40, 1e-17):
            slow = passed(c.aging, c, Held(0.9, 1.2, y, 0.1), moves, 5.0)
            assert slow == pytest.approx(held, rel=1e-12, abs=0)
            if held > 0.0:
                at, _ = follow(c.aging, c, Held(0.9, 1.2, y, 0.1), 0.0, 5.0, 0.3 * held)
                soon, _ = follow(
                    c.aging, c, Held(0.9, 1.2, y, 0.1), moves, 5.0, 0.3 * held
                )
                assert soon == pytest.approx(at, rel=1e-8, abs=0)


def test_slow_falls_cross_when_they_do():
    """A falling threshold meets a stretch that hardly moves, in a segment of 1e-16 of a
    threshold at a pace of 1e-18: at the instant xi(t) = x, closed form, to 1e-12."""
    c = contacts(Ensemble(aging=Aging("flow", 0.05, 0.3), **UNIFORM), 1e-18)
    x, final2 = 0.7, 0.3**2
    exact = math.log((1.0 - final2) / (x * x - final2)) * final2 / (4.0 * 0.05)
    for moves in (1.0, 0.0):
        broke, _ = follow(c.aging, c, Held(1.0, 1.0, x, 0.0), moves, 1e-16, 1.0)
        assert broke * 1e18 == pytest.approx(exact, rel=1e-12, abs=0)


@pytest.mark.parametrize("moves", [0.0, 1e-18])
def test_ages_below_the_resolution_of_the_stretch(moves):
    """A contact at stretch .7 that grows as the logarithm of its age, from a millionth
    of the hold on, at a pace of 1e-18: all of the hold is 1e-18 of a displacement, and
    the threshold grows fivefold in it. Quadrature over ln t."""
    ensemble = Ensemble(
        thermal=Thermal(0.1),
        aging=Aging("logarithmic", beta=0.3, cutoff_time=1e-6),
        **UNIFORM,
    )
    pace, xi, x = 1e-18, 0.9, 0.7
    c = contacts(ensemble, pace)
    b = 1.0 / (2.0 * 0.1)

    def per_log(u):
        t = math.exp(u)
        grown = xi * (1.0 + 0.3 * math.log1p(t / 1e-6))
        return t * math.exp(-b * (grown * grown - x * x))

    exact = integrate.quad(per_log, -40.0, 0.0, epsabs=0.0, epsrel=1e-11, limit=500)[0]
    assert passed(c.aging, c, Held(xi, 1.0, x, 0.0), moves, pace) == pytest.approx(
        exact, rel=1e-7, abs=0
    )


@chosen("name", ["soft", "stiff sqrt", "annealed", "annealed table"], ["soft"])
def test_travel_inverts_the_mean_rate(name):
    """Of contacts carried on and back, to 1e-7 of the travel and 4 units in the last
    place of the hazard, down to 1e-30 of the stretch."""
    c, go, go_back = contacts(LAWS[name], 1.0), compiled(onward), compiled(back)
    average, now, whole = compiled(mean_rate), compiled(rate), compiled(hazard)
    rng = np.random.default_rng(4)
    for _ in range(300):
        xi, y = 2.0, rng.uniform(0.02, 1.4)
        way = y * 10 ** rng.uniform(-30, -0.5)
        table = c.hazard_table
        least = min(now(c.barrier, xi, 1.0, x) for x in (y - way, y, y + way))
        if not least > 1e-12:
            continue
        lost = 1e-15 * whole(c.barrier, table, xi, 1.0, y + way) / least
        on = average(c.barrier, table, xi, 1.0, y, way) * way
        found = go(c.barrier, c, xi, 1.0, y, on)
        assert found == pytest.approx(way, rel=1e-7, abs=lost if way > 1e-9 else 0)
        returned = average(c.barrier, table, xi, 1.0, y - way, way) * way
        found, left = go_back(c.barrier, c, xi, 1.0, y, returned)
        assert left < 0.0
        assert found == pytest.approx(way, rel=1e-7, abs=lost if way > 1e-9 else 0)


# ------------------------------------------------------------------------------------------------
# behind a spring


@functools.cache
def one_by_one(count, runs, time=100.0, kT=0.1, spring=0.1, preload=4.5):
    """Pinned share and its error after a hold behind a spring, n = 1, k = omega = 1:
    contacts break one after the other and never form again; without mass and damping
    the slider is in balance between any two breaks. Nothing is shared with eqsim."""
    rng, shares = np.random.default_rng(7), np.empty(runs)

    def settled(xi):
        """Where the slider comes to rest, and the thresholds that it leaves."""
        while xi.size:
            X = spring * preload / (spring + xi.size / count)
            if xi[0] > X:
                return X, xi
            xi = xi[1:]  # the weakest breaks, and the others carry more
        return math.inf, xi

    for run in range(runs):
        X, xi = settled(np.sort(np.sqrt(rng.gamma(2.0, size=count))))
        at = 0.0
        while xi.size:
            rates = np.exp(-(xi**2 - X**2) / (2.0 * kT)).cumsum()
            at += rng.exponential() / rates[-1]
            if at > time:
                break
            X, xi = settled(
                np.delete(xi, np.searchsorted(rates, rates[-1] * rng.random()))
            )
        shares[run] = xi.size / count
    return shares.mean(), shares.std(ddof=1) / math.sqrt(runs)


def held(count, replicas, points, segment=None, **how):
    """Pinned share and its error at the end of the same hold."""
    ensemble = Ensemble(thermal=SOFT, delay=Delay(1e12), count=count, **UNIFORM)
    programme = Programme(
        [segment or Segment(0.0, time=100.0)], stage=Stage(0.1, preload=4.5, **how)
    )
    run = trajectory(ensemble, programme, points=points, replicas=replicas)
    return run.pinned[-1], run.pinned_stderr[-1]


@pytest.mark.usefixtures("not_by_events")
@pytest.mark.parametrize(
    ("count", "replicas", "points", "segment"),
    [
        (
            100,
            16,
            2,
            Segment(1e-20, time=100.0),
        ),  # few contacts one by one, see engine/test_hold_oracle.py, take longer
        pytest.param(10, 100, 2, None, marks=pytest.mark.verification),
        pytest.param(10, 1000, 2, None, marks=pytest.mark.verification),
        pytest.param(100, 100, 2, None, marks=pytest.mark.verification),
        pytest.param(1, 1000, 2, None, marks=pytest.mark.verification),
        pytest.param(2, 1000, 31, None, marks=pytest.mark.verification),
        pytest.param(100, 40, 31, None, marks=pytest.mark.verification),
        pytest.param(
            100, 40, 1001, Segment(1e-25, time=100.0), marks=pytest.mark.verification
        ),
    ],
)
def test_a_hold_behind_a_spring(count, replicas, points, segment):
    """However often one looks, and of a stage that all but stands: |z| < 4.5, 7e-6 for
    each. A hold of a 20th of the time fails (negative control)."""
    found, error = held(count, replicas, points, segment)
    exact, missing = one_by_one(count, 20_000 // max(count, 4))
    assert abs(found - exact) < 4.5 * math.hypot(error, missing)
    shorter, missing = one_by_one(count, 20_000 // max(count, 4), time=5.0)
    assert abs(found - shorter) > 4.5 * math.hypot(error, missing)


@pytest.mark.usefixtures("not_by_events")
@pytest.mark.parametrize("damping", [0.1, 0.0])
def test_a_slow_stage_takes_no_time_to_slip(damping):
    """A preload lets a slider slip at once; behind a stage so slow that the hold is
    1e-12 of a threshold in its pace contacts break at rest as often as in a hold, and
    the run ends."""
    ensemble, stage = (
        Ensemble(thermal=Thermal(1.0), count=50, **UNIFORM),
        Stage(0.5, damping=damping, preload=0.3),
    )
    slow, hold = (
        trajectory(ensemble, Programme([segment], stage=stage), points=3, replicas=8)
        for segment in (Segment(1e-15, time=20.0), Segment(0.0, time=20.0))
    )
    assert slow.lives == pytest.approx(
        hold.lives, rel=4.5 * math.sqrt(2.0 / hold.lives), abs=0
    )


# ---------------------------------------------------------------------------------------------------
# programmes


BEFORE, AFTER = Segment(0.5, distance=0.8), Segment(0.5, distance=0.3)


def ends(ensemble, middle, seed, start="fresh"):
    """Forces and errors at the end of the middle part and after it."""
    run = trajectory(
        ensemble, Programme([BEFORE, *middle, AFTER], start, 0.5), points=41, seed=seed
    )
    at = [np.flatnonzero(run.segment == len(middle))[-1], -1]
    return run.force[at], run.force_stderr[at]


HELD = {
    name: LAWS[name]
    for name in (
        "soft",
        "stiff sqrt",
        "annealed",
        "flow sqrt",
        "falling flow",
        "logarithmic",
    )
}
JITTER = [Segment((-1) ** j * 10.0 ** -(16 + j % 4), time=1.0) for j in range(20)]


MOTIONS = {
    "slow": [Segment(1e-18, time=20.0)],
    "back": [Segment(-1e-25, time=20.0)],
    "jitter": JITTER,
}


@chosen(
    ("name", "motion"),
    itertools.product(HELD, MOTIONS),
    [("soft", "slow")],
)
def test_slow_segments_are_holds(name, motion):
    """A velocity of 1e-18 or -1e-25, and a drive that jitters by 1e-16 to 1e-19 of a
    threshold, are holds: |z| < 4.5 for the force at the end and after sliding on; 36
    scores, false alarm 2e-4. Half the hold fails (negative control).
    """
    ensemble = Ensemble(**{**vars(HELD[name]), "count": 4000})
    found, error = ends(ensemble, MOTIONS[motion], 1)
    exact, missing = ends(ensemble, [Segment(0.0, time=20.0)], 2)
    assert np.all(np.abs(found - exact) < 4.5 * np.hypot(error, missing))
    nothing, missing = ends(ensemble, [Segment(0.0, time=1e-6)], 2)
    assert abs(found - nothing)[0] > 4.5 * math.hypot(error[0], missing[0])


@pytest.mark.parametrize("start", ["fresh", "stationary"])
def test_parts_of_a_segment_are_the_segment(start):
    """A slower segment in one part and in three: the same clocks, so that forces agree
    far within their errors, but for those of contacts that are drawn anew. |z| < 4.5
    from the renewal equation in 2 scores: 1e-5."""
    ensemble = Ensemble(thermal=SOFT, count=4000, **UNIFORM)
    parts = [
        Segment(0.1, distance=0.2),
        Segment(0.1, distance=0.1),
        Segment(0.1, distance=0.1),
    ]
    programme = Programme([Segment(1.0, distance=0.5), *parts], start, 1.0)
    found, exact = (
        trajectory(ensemble, programme, points=21),
        transient(ensemble, programme, 21),
    )
    assert abs(found.force[-1] - exact.force[-1]) < 4.5 * math.hypot(
        found.force_stderr[-1], exact.force_error[-1]
    )


@pytest.mark.verification
def test_stretched_births_and_slow_starts():
    """Contacts born stretched that slide by 1e-17 of a threshold in their lives, from a
    stationary start: they break as often as in the steady state, mean life over time,
    |z| < 4.5; Poisson."""
    births = Newborn("uniform", low=0.2, high=0.6)
    ensemble = Ensemble(thermal=Thermal(3.0), newborn=births, count=2000, **UNIFORM)
    slow, hold = (
        trajectory(
            ensemble, Programme([segment], "stationary", 1e-18), points=3, seed=seed
        )
        for seed, segment in (
            (1, Segment(1e-18, time=5.0)),
            (2, Segment(0.0, time=5.0)),
        )
    )
    assert slow.lives > 1000
    assert abs(slow.lives - hold.lives) < 4.5 * math.sqrt(slow.lives + hold.lives)
    z = (slow.force - hold.force) / np.hypot(slow.force_stderr, hold.force_stderr)
    assert np.abs(z).max() < 4.5


def test_paths_in_slow_segments():
    """Fluctuating thresholds under the sqrt law, whose steps end where the force is
    recorded: a motion of 1e-18."""
    # at the pace of a slow segment others relax too often to be followed
    aging = Aging("langevin", 1e-14, 1.0)
    ensemble = Ensemble(thermal=SOFT, aging=aging, count=2000)
    found, error = ends(ensemble, [Segment(1e-18, time=20.0)], 1)
    exact, missing = ends(
        Ensemble(thermal=SOFT, count=2000), [Segment(0.0, time=20.0)], 2
    )
    assert np.all(np.abs(found - exact) < 4.5 * np.hypot(error, missing))


# --------------------------------------------------------------------------------------------------------
# lives


STAGES = [None, Stage(0.5, damping=0.1)]


@pytest.mark.verification
@chosen(
    ("rule", "stage"),
    itertools.product(["logarithmic", "none", "flow", "langevin"], STAGES),
    [("logarithmic", None), ("none", STAGES[1])],
)
def test_lives_of_holds_are_predicted(rule, stage):
    """Hot contacts that age break in a hold as often as others, and too many lives are
    refused before they are simulated; within a fifth."""
    given = {"none": {}, "logarithmic": {"beta": 0.05, "cutoff_time": 0.1}}
    drifts = {"rate": 0.01, "x_star_final": 2.0}
    aging = Aging(rule, **given.get(rule, drifts))
    ensemble = Ensemble(thermal=Thermal(200.0), aging=aging, count=2)
    if rule == "langevin" and stage:
        pytest.skip("follow no stage")
    hold = Programme([Segment(0.0, time=1e3)], stage=stage)
    with pytest.raises(
        InputError,
        match=r"needs about [12][.\d]*e\+0[45] lives, more than max_lives = 1e\+03",
    ) as caught:
        trajectory(ensemble, hold, points=2, replicas=10, max_lives=1000)
    assert "\n" not in str(caught.value)
    assert trajectory(ensemble, hold, points=2, replicas=10).lives == pytest.approx(
        2e4, rel=0.2, abs=0
    )


@pytest.mark.parametrize("stage", STAGES)
def test_runs_of_too_many_lives_stop(stage, monkeypatch):
    """Where the prediction says too little."""
    from eqsim.engine import trajectory as module

    monkeypatch.setattr(module, "predicted_lives", lambda *_: 10.0)
    ensemble = Ensemble(thermal=Thermal(200.0), count=2000, **UNIFORM)
    with pytest.raises(
        InputError,
        match=r"has taken .* lives, more than max_lives = 1e\+05; 10 were expected",
    ):
        trajectory(
            ensemble,
            Programme([Segment(0.0, time=1e9)], stage=stage),
            points=2,
            max_lives=1e5,
        )
    told = []
    guarded(told.append, 10.0, 1e5)(150_000)
    assert told == [150_000]
