"""Sliders under a force, behind a motor, or at rest, followed event by event: lifetimes
of clusters in closed form, a brute force for each drive, steps of the other engine, and
what must not change."""

import math
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from cases import chosen
from waiting import ALLOWED

from eqsim import (
    Delay,
    Delta,
    Drive,
    Ensemble,
    Gamma,
    InputError,
    NoThresholds,
    Programme,
    Segment,
    Stage,
    Thermal,
    Uniform,
    bursts,
    lifetime,
    reference,
    steady,
    trajectory,
    transient,
)
from eqsim.engine import events
from eqsim.engine.slider import Slider
from eqsim.laws.barrier import BARRIERS
from eqsim.laws.barrier.base import Barrier, Numbers

NEVER_AGAIN = Delay(math.inf)
CLUSTER = Ensemble(
    Delta(1.0), Thermal(0.2), NEVER_AGAIN, count=10, stiffness_law="uniform"
)
LONG = 1e6  # time in which every cluster lets go


def under(force, contacts, **how):
    """A constant force on all contacts together."""
    return Programme([Segment(force=force / contacts, time=LONG)], **how)


# ---- lifetimes of clusters ----


def life_score(ensemble, force, lives=100_000, exact=None, **how):
    """The mean lifetime of a cluster less the exact one, over its error."""
    drive = under(force, ensemble.count, **how)
    found = trajectory(ensemble, drive, points=2, replicas=lives, threads=2).lifetimes
    exact = exact or lifetime(ensemble, drive, points=2).mean.value
    return (found.mean() - exact) / (found.std(ddof=1) / math.sqrt(lives))


# Without thresholds that are reached exactly, where rounding decides.
CLUSTERS = [
    (1, 0.3, "soft"),
    (2, 0.7, "stiff"),
    (10, 1.0, "soft"),
    (10, 5.3, "stiff"),
    (100, 50.3, "soft"),
]


@chosen(("contacts", "force", "barrier"), CLUSTERS, CLUSTERS[:1])
def test_mean_life_of_clusters(contacts, force, barrier):
    """(|z| < 4.5: false alarm 7e-6)"""
    warm = Thermal(0.2, barrier=barrier)
    ensemble = replace(CLUSTER, thermal=warm, count=contacts)
    assert abs(life_score(ensemble, force)) < 4.5


BONDS = Ensemble(
    NoThresholds(),
    Thermal(barrier="bell", off_rate=1.0, force_scale=1.0),
    NEVER_AGAIN,
    stiffness_law="uniform",
)
# Contacts, force, rate at which contacts form again, and mean life, k = e^f.
BELL = [
    (10, 1.0, 0.0, 1.8335773204),
    (10, 5.0, 0.0, 0.5896197502),
    (100, 50.0, 0.0, 0.56280372087),
    (2, 1.0, 1.0, 0.7827098511),
    (10, 5.0, 1.0, 0.82105707121),
    (10, 1.0, 1.0, 17.908358462),
]


@pytest.mark.verification
@chosen(("contacts", "force", "again", "exact"), BELL, BELL[3:4])
def test_mean_life_of_bonds(contacts, force, again, exact):
    """T = sum t_n, t_n = (1 + g (N - n) t_{n+1})/(n k(F/n)): Erdmann and Schwarz
    (2004)."""
    delay = Delay(1.0 / again, "exponential") if again else NEVER_AGAIN
    bonds = replace(BONDS, delay=delay, count=contacts)
    shared = {"rebinding": "shared"} if again else {}
    assert abs(life_score(bonds, force, 100_000, exact, **shared)) < 4.5


@pytest.mark.verification
def test_contacts_that_form_again_share_the_force():
    """Unstretched ones bear nothing at first, and the cluster is lost sooner."""
    again = replace(CLUSTER, delay=Delay(1.0, "exponential"))
    shared = replace(under(5.3, 10), rebinding="shared")
    exact = lifetime(again, shared, points=2).mean.value
    assert abs(life_score(again, 5.3, 20_000, exact, rebinding="shared")) < 4.5
    assert life_score(again, 5.3, 20_000, exact) < -50.0


def test_law_of_lifetimes():
    """By Kolmogorov and Smirnov (p > 1e-4), and that of another force is far off."""
    drive = under(5.3, 10)
    run = trajectory(CLUSTER, drive, points=2, replicas=20_000)
    found = np.sort(run.lifetimes)
    rank = np.arange(1, found.size + 1) / found.size
    some = slice(0, None, 200)
    for force, within in ((5.3, True), (5.1, False)):
        end = float(found[-1])
        drive = Programme([Segment(force=force / 10, time=end)])
        exact = lifetime(CLUSTER, drive, points=1000)
        survival = np.interp(found[some], exact.t, exact.survival)
        distance = np.abs(1.0 - survival - rank[some]).max()
        assert (distance < 2.2 / math.sqrt(found.size)) == within


# ---- a brute force under a constant force ----


def brute_life(ensemble, force, delay, rng):
    """The lifetime of a cluster of contacts with the soft barrier: between two events
    nothing moves and all rates are constant (Gillespie, 1976)."""
    n, b, t, X = ensemble.count, 0.5 / ensemble.thermal.kT, 0.0, 0.0
    xi, birth = rng.uniform(0.5, 1.5, n), np.zeros(n)
    again = np.full(n, math.inf)
    pinned = np.ones(n, bool)
    while True:
        while True:  # move into balance, and break what breaks on the way
            if not pinned.any():
                return t
            target = birth[pinned].mean() + force / pinned.sum()
            reach = np.where(pinned, birth + xi, math.inf)
            first = int(np.argmin(reach))
            if reach[first] > target:
                break
            pinned[first] = False
            again[first] = t + rng.exponential(delay)
        X = target
        rates = np.where(pinned, _soft(X - birth, xi, b), 0.0)
        following = t + rng.exponential(1.0 / rates.sum())
        if again.min() < following:
            i = int(np.argmin(again))
            t, again[i] = again[i], math.inf
            xi[i], birth[i], pinned[i] = rng.uniform(0.5, 1.5), X, True
        else:
            t = following
            i = rng.choice(n, p=rates / rates.sum())
            pinned[i] = False
            again[i] = t + rng.exponential(delay)


def _soft(x, xi, b):
    """Rate of a soft contact: the difference of squares."""
    return np.exp(-b * np.maximum(xi**2 - x**2, 0.0))


@pytest.mark.verification
def test_unstretched_contacts_by_brute_force():
    """Thresholds that differ, and contacts that form again unstretched; half the delay
    is told apart."""
    ensemble = Ensemble(
        Uniform(0.5, 1.5),
        Thermal(0.2),
        Delay(2.0, "exponential"),
        count=3,
        stiffness_law="uniform",
    )
    rng = np.random.default_rng(1)
    exact = np.array([brute_life(ensemble, 1.2, 2.0, rng) for _ in range(3_000)])
    for delay, within in ((2.0, True), (1.0, False)):
        again = replace(ensemble, delay=Delay(delay, "exponential"))
        run = trajectory(again, under(1.2, 3), points=2, replicas=100_000)
        error = math.hypot(
            exact.std() / math.sqrt(exact.size), run.lifetimes.std() / math.sqrt(1e5)
        )
        assert (abs(run.lifetimes.mean() - exact.mean()) < 4.5 * error) == within


# ---- motors ----

CLUTCHES = replace(CLUSTER, delay=Delay(1.0, "exponential"))
UNLOADED, STALL = 0.5, 0.3


def brute_motor(contacts, spring, times, replicas, seed=1):
    """Force, displacement and pinned share of clutches in steps of time, arrays
    (replicas,) at each of `times`; `spring` is the stiffness of the substrate or
    None."""
    rng, dt, found = np.random.default_rng(seed), 0.0025, []
    x, on = np.zeros((replicas, contacts)), np.ones((replicas, contacts), bool)
    X = np.zeros(replicas)
    for step in range(1, round(max(times) / dt) + 1):
        force, held = (x * on).mean(axis=1), on.mean(axis=1)
        moved = UNLOADED * (1.0 - force / STALL) * dt
        if spring is not None:
            moved /= 1.0 + held / spring
        X += moved
        x += moved[:, None] * on
        u = rng.random((replicas, contacts))
        rate = _soft(x, 1.0, 2.5)
        broken = on & ((u < -np.expm1(-rate * dt)) | (np.abs(x) >= 1.0))
        pinned = ~on & (u < -math.expm1(-dt))
        while broken.any():
            freed = (x * broken).mean(axis=1)
            on &= ~broken
            if spring is None:
                break
            jump = freed / (spring + on.mean(axis=1))
            X += jump
            x += jump[:, None] * on
            broken = on & (np.abs(x) >= 1.0)
        x[~on] = 0.0
        on |= pinned
        if any(abs(step * dt - each) < 0.5 * dt for each in times):
            found.append(((x * on).mean(axis=1), X.copy(), on.mean(axis=1)))
    return found


def motor_scores(contacts, spring, stall=STALL):
    times, replicas = (2.0, 6.0, 12.0), 4000
    stage = Stage(spring) if spring else None
    drive = Programme([Segment(UNLOADED, time=12.0)], stage=stage, stall_force=stall)
    ensemble = replace(CLUTCHES, count=contacts)
    run = trajectory(ensemble, drive, points=13, replicas=replicas, seed=3)
    exact = brute_motor(contacts, spring, times, replicas)
    scores = []
    for t, columns in zip(times, exact, strict=True):
        for name, brute in zip(("force", "X", "pinned"), columns, strict=True):
            value, error = (getattr(run, name + end)[int(t)] for end in ("", "_stderr"))
            error = math.hypot(error, brute.std() / math.sqrt(replicas))
            scores.append((value - brute.mean()) / error)
    return np.array(scores)


@chosen(
    ("contacts", "spring"),
    [(n, spring) for n in (1, 2, 10) for spring in (None, 0.5)],
    [(2, None)],
)
def test_motors_by_brute_force(contacts, spring):
    """Nine scores each, with |z| < 4.5."""
    assert np.abs(motor_scores(contacts, spring)).max() < 4.5


@pytest.mark.verification
def test_a_stronger_motor_is_told_apart():
    assert np.abs(motor_scores(10, 0.5, 1.1 * STALL)).max() > 10.0


@pytest.mark.verification
def test_long_run_of_a_rigid_motor():
    """With many contacts v = u (1 - f(v)/s), to the error of the run and 1/N."""
    ensemble = replace(CLUTCHES, count=4000)
    drive = Programme([Segment(UNLOADED, time=40.0)], stall_force=STALL)
    run = trajectory(ensemble, drive, points=41, replicas=8, threads=2)
    late = run.X_replicas[:, 20:]
    v = (late[:, -1] - late[:, 0]) / 20.0
    low, high = 0.0, UNLOADED
    for _ in range(50):
        middle = 0.5 * (low + high)
        friction = reference(ensemble, Drive(middle)).friction.value
        faster = UNLOADED * (1.0 - friction / STALL) > middle
        low, high = (middle, high) if faster else (low, middle)
    error = v.std(ddof=1) / math.sqrt(8)
    assert abs(v.mean() - low) < 4.5 * error + low / ensemble.count
    assert abs(v.mean() - UNLOADED) > 100.0 * error


def test_a_motor_is_the_same_both_ways():
    ensemble = replace(CLUTCHES, count=20)
    for stage in (None, Stage(0.5)):
        there, back = (
            trajectory(
                ensemble,
                Programme(
                    [
                        Segment(u, time=10.0),
                        Segment(0.0, time=2.0),
                        Segment(-u, time=5.0),
                    ],
                    stage=stage,
                    stall_force=STALL,
                ),
                points=31,
                replicas=3,
            )
            for u in (UNLOADED, -UNLOADED)
        )
        # rounding, 1e-16, of each of some 1e3 events
        np.testing.assert_allclose(there.X, -back.X, rtol=0, atol=1e-12)
        np.testing.assert_allclose(there.force, -back.force, rtol=0, atol=1e-12)


# ---- other engines ----

MANY = Ensemble(
    Uniform(0.5, 1.5), Thermal(0.2), NEVER_AGAIN, count=2000, stiffness_law="uniform"
)
AGAIN = Delay(3.0, "exponential")
DRIVES = {
    "creep": (MANY, Programme([Segment(force=0.3, time=1.0)])),
    "formed again": (
        replace(MANY, delay=AGAIN),
        Programme([Segment(force=0.2, time=6.0)]),
    ),
    "ramps": (
        replace(MANY, delay=AGAIN),
        Programme(
            [Segment(force_rate=0.02, time=8.0), Segment(force_rate=-0.02, time=4.0)]
        ),
    ),
    "motor": (
        replace(MANY, delay=AGAIN),
        Programme([Segment(0.5, time=8.0), Segment(-0.2, time=4.0)], stall_force=0.3),
    ),
    "stage": (
        replace(MANY, delay=AGAIN),
        Programme([Segment(0.2, time=8.0), Segment(0.0, time=4.0)], stage=Stage(0.3)),
    ),
}


@chosen("name", DRIVES, ["creep", "ramps", "motor"])
def test_agrees_with_steps(name, monkeypatch):
    """Displacement, force and pinned share, with the errors that both quote; |z| <
    4.5."""
    ensemble, drive = DRIVES[name]
    runs = []
    for most in (events.MOST_CONTACTS, 0):
        monkeypatch.setattr(events, "MOST_CONTACTS", most)
        runs.append(
            trajectory(ensemble, drive, points=13, replicas=8, seed=2, threads=2)
        )
    exact, stepped = runs
    assert exact.coarser_slips is None
    assert stepped.coarser_slips is not None
    for column in ("X", "force", "pinned"):
        errors = [getattr(run, f"{column}_stderr") for run in runs]
        off = getattr(exact, column) - getattr(stepped, column)
        assert np.all(np.abs(off) <= 4.5 * np.hypot(*errors) + 1e-12)
    assert np.abs(exact.energy[:, 3]).max() == 0.0


@chosen(
    ("name", "eta"),
    [("creep", 0.0), ("ramps", 0.0), ("ramps", 0.5), ("motor", 0.0)],
    [("ramps", 0.0), ("ramps", 0.5)],
)
def test_many_contacts_are_the_mean_field(name, eta):
    """With viscosity in steps, else event by event. Of 2000 contacts the mean is off by
    less than a thousandth of what it is."""
    ensemble, drive = DRIVES[name]
    ensemble = replace(ensemble, eta=eta)
    run = trajectory(ensemble, drive, points=13, replicas=8, seed=2, threads=2)
    assert (run.coarser_slips is None) == (eta == 0.0)
    exact = transient(ensemble, drive, 13)
    for column in ("X", "force", "pinned"):
        value, mean = getattr(run, column), getattr(exact, column)
        error = 4.5 * getattr(run, f"{column}_stderr") + 1e-3 * np.abs(mean).max()
        assert np.all(np.abs(value - mean)[1:] <= error[1:])


def test_a_cluster_that_holds_on_after_it_should_let_go():
    """A slider of many contacts in steps lets go when it does event by event."""
    ensemble, drive = MANY, Programme([Segment(force=0.45, time=50.0)])
    lives = trajectory(ensemble, drive, points=3, replicas=8).lifetimes
    found = []
    for replica in range(8):
        with Slider(ensemble, drive, 1, replica, 1) as slider:
            while slider.state.time < slider.pull.ends[0] and not slider.let_go:
                slider.step(slider.pull.ends[0], 0.0)
            found.append(slider.state.time / slider.pull.ends[0] * 50.0)
    error = math.hypot(np.std(lives), np.std(found)) / math.sqrt(7)
    assert abs(np.mean(lives) - np.mean(found)) < 4.5 * error + 0.01 * np.mean(lives)


# ---- bundles under a force that rises ----


def bundle_scores(law, size_law, bundles, count, seed=1):
    """Scores of the numbers of bursts of each size, those of the last bursts apart."""
    ensemble = Ensemble(law, delay=NEVER_AGAIN, count=count, stiffness_law="uniform")
    drive = Programme([Segment(force_rate=1.0, time=1.0)])
    run = trajectory(ensemble, drive, points=2, replicas=bundles, seed=seed)
    table = run.avalanches
    assert table["breaks"].sum() == bundles * count
    seen = np.bincount(table["breaks"], minlength=20)[1:20]
    exact = size_law * bundles * count
    return (seen[: exact.size] - exact) / np.sqrt(exact)


def test_bursts_of_bundles():
    """Against Hemmer and Hansen (1992), chi-square over sizes 1 to 10 (p > 1e-4); the
    law of another bundle is far off. Bursts of a size are nearly Poisson."""
    law = Uniform(0.0, 1.0)
    exact = bursts(
        Ensemble(law, delay=NEVER_AGAIN, stiffness_law="uniform"), np.arange(1, 11)
    ).number
    scores = bundle_scores(law, exact, 4, 200_000)
    assert (scores**2).sum() < 35.6
    assert (bundle_scores(law, 1.02 * exact, 4, 200_000) ** 2).sum() > 35.6


def test_small_bundles_event_by_event_and_break_by_break(monkeypatch):
    """The same contacts by either engine: the same bursts, to rounding."""
    ensemble = Ensemble(Gamma(1.0), delay=NEVER_AGAIN, count=300)
    rise = Segment(force_rate=0.1, time=1.0)
    drive = Programme(
        [rise, Segment(force_rate=0.0, time=1.0), replace(rise, time=9.0)]
    )
    first = trajectory(ensemble, drive, points=9, replicas=3)
    monkeypatch.setattr(events, "by_events", lambda *_: True)
    second = trajectory(ensemble, drive, points=9, replicas=3)
    assert first.avalanches["breaks"].tolist() == second.avalanches["breaks"].tolist()
    # Rounding of sums over N = 300 contacts is N 1e-16 of a force, and N times that of a
    # displacement where one contact is left: 1e-11. Of a lifetime, which follows from
    # the force of the whole bundle, it is 3e-14.
    for name in ("t", "X", "drop"):
        pair = [run.avalanches[name] for run in (first, second)]
        np.testing.assert_allclose(*pair, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(first.lifetimes, second.lifetimes, rtol=1e-12)
    np.testing.assert_allclose(first.energy, second.energy, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(first.X, second.X, rtol=1e-9, atol=1e-12)


# ---- what must not change, and what ends ----


def test_threads_and_blocks_change_nothing(monkeypatch):
    drive = Programme([Segment(0.5, time=5.0)], stage=Stage(0.5), stall_force=STALL)
    runs = []
    for threads, together in ((1, 1 << 15), (2, 1 << 15), (3, 1)):
        monkeypatch.setattr(events, "_FOLLOWED_TOGETHER", together)
        runs.append(trajectory(CLUTCHES, drive, points=9, replicas=40, threads=threads))
    for run in runs[1:]:
        for name, column in runs[0].columns().items():
            assert np.array_equal(run.columns()[name], column)
        assert np.array_equal(run.avalanches["t"], runs[0].avalanches["t"])
        assert run.slips == runs[0].slips


def test_windows_change_no_law(monkeypatch):
    """Widths of the first window from far too small to far too large."""
    for width in (1e-6, 1e3):
        monkeypatch.setattr(events, "_FIRST_WIDTH", width)
        assert abs(life_score(CLUSTER, 5.3, 20_000)) < 4.5


def test_energy():
    """Work is stored or taken, at every instant: of forces and of motors with a spring
    nothing is found by this balance."""
    formed = replace(CLUTCHES, count=30)
    for drive in (
        Programme([Segment(force=0.1, time=5.0), Segment(force_rate=0.02, time=5.0)]),
        Programme([Segment(0.5, time=9.0)], stage=Stage(0.5), stall_force=STALL),
        Programme([Segment(0.5, time=9.0)], stage=Stage(0.5)),
    ):
        run = trajectory(formed, drive, points=21, replicas=3)
        work, stored, dissipated, missing = run.energy.T
        np.testing.assert_allclose(work, stored + dissipated, rtol=1e-9, atol=1e-12)
        assert not missing.any()


@pytest.mark.parametrize("power", [-90, 90])
def test_extreme_rates(power):
    """Lifetimes of a single contact at rates 1e-90 and 1e90, and a threshold that is
    passed at once."""
    rate = 10.0**power
    one = replace(CLUSTER, thermal=Thermal(1e6, rate), count=1)
    drive = Programme([Segment(force=1e-3, time=1e3 / rate)])
    found = trajectory(one, drive, points=2, replicas=10_000).lifetimes * rate
    assert abs(found.mean() - 1.0) < 4.5 / math.sqrt(10_000)
    at_once = Programme([Segment(force=2.0, time=1.0)])
    assert np.all(trajectory(one, at_once, points=2, replicas=3).lifetimes == 0.0)
    released = Programme([Segment(0.0, time=1.0)], stage=Stage(1.0, preload=2.5))
    run = trajectory(one, released, points=2)
    assert run.X[-1] == pytest.approx(2.5, rel=1e-15, abs=0)


def test_cold_barriers_are_thresholds():
    """At b = 5e8 contacts break at their thresholds: all that is left is a window that
    shrinks to 1e-8 of them."""
    cold = replace(CLUSTER, thermal=Thermal(1e-9))
    drive = Programme([Segment(force_rate=0.1, time=20.0)])
    found = trajectory(cold, drive, points=2, replicas=5).lifetimes
    np.testing.assert_allclose(found, 10.0, rtol=1e-6)


def test_nothing_pinned_takes_no_steps():
    """A bundle that has let go, pulled on for 5000 lengths."""
    drive = Programme([Segment(1.0, time=5000.0)], stage=Stage(0.3))
    gone = replace(MANY, count=200)
    run = trajectory(gone, drive, points=3)
    assert run.pinned[-1] == 0.0
    assert run.X[-1] == pytest.approx(5000.0, rel=1e-12, abs=0)
    damped = replace(drive, stage=Stage(0.3, damping=1.0))
    with Slider(gone, damped, 1, 0, 1) as slider:
        steps, end = 0, slider.pull.ends[0]
        while slider.state.time < end:
            slider.step(end, slider.pull.speeds[0])
            steps += slider.state.sums.pinned == 0.0
    assert steps < 5
    assert (
        pytest.approx(5000.0 - 1.0 / 0.3, rel=1e-6, abs=0)
        == slider.state.X * gone.thresholds.scale
    )


def test_segments_end_under_their_force():
    """Their last instant is before the force jumps, whatever their times and the unit
    of length: an instant that is rounded to a later time is not. Sums of 2000 forces are
    rounded to 1e-13, and the next force is another by half or more."""
    rng = np.random.default_rng(1)
    for seed in range(50):
        length = round(rng.uniform(0.2, 3.0), 2)
        small = replace(
            MANY, thresholds=Delta(length), thermal=Thermal(0.02 * length**2)
        )
        forces = 0.5 * length * np.array([0.1, 0.3, 0.15, 0.4])
        times = rng.uniform(0.1, 10.0, 4).round(2)
        steps = [Segment(force=f, time=t) for f, t in zip(forces, times, strict=True)]
        run = trajectory(small, Programme(steps), points=9, seed=seed)
        ends = [segment.end.value for segment in run.segments]
        np.testing.assert_allclose(ends, forces, rtol=1e-9)


def test_units():
    """Lengths 1e-3 and times 60 times as large."""
    length, duration = 1e-3, 60.0
    run = trajectory(CLUTCHES, under(5.3, 10), points=5, replicas=200)
    small = replace(
        CLUTCHES,
        thresholds=Delta(length),
        thermal=Thermal(0.2 * length**2, 1.0 / duration),
        delay=Delay(duration, "exponential"),
    )
    drive = Programme([Segment(force=0.53 * length, time=LONG * duration)])
    other = trajectory(small, drive, points=5, replicas=200)
    np.testing.assert_allclose(other.lifetimes, run.lifetimes * duration, rtol=1e-9)


def test_what_cannot_go_on_ends():
    """An error in `progress` ends threads that would go on for hours."""
    endless = replace(CLUTCHES, delay=Delay(1e-3))
    drive = Programme([Segment(0.5, time=1e7)], stall_force=STALL)
    before = threading.active_count()

    def stop(lives):
        if lives > 1e4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        trajectory(endless, drive, points=2, replicas=4, threads=2, progress=stop)
    begin = time.monotonic()
    while threading.active_count() > before:
        assert time.monotonic() - begin < ALLOWED


@pytest.mark.parametrize("count", [1, 100])
@pytest.mark.parametrize("stage", [None, Stage(1.0)])
def test_a_motor_that_friction_stops_stands_still(count, stage):
    """Its force is that of the stall, where X no longer changes in any bit."""
    contacts = Ensemble(count=count, stiffness_law="uniform")
    segments = [Segment(1.0, time=60.0), Segment(0.5, time=60.0)]
    drive = Programme(segments, stage=stage, stall_force=0.1)
    run = trajectory(contacts, drive, points=121, replicas=8)
    for segment in run.segments:
        for shown in (segment.peak, segment.end):
            assert abs(shown.value - 0.1) < 4.5 * shown.stderr + 1e-9


def test_more_lives_than_allowed_are_refused():
    fast = replace(CLUTCHES, delay=Delay(0.0))
    drive = Programme([Segment(force=1.0, time=100.0)])
    with pytest.raises(InputError, match="more than max_lives"):
        trajectory(fast, drive, points=2, max_lives=1e5)


class Humped(Numbers, Barrier):
    """A rate that is greatest at half the threshold."""

    __slots__ = ()

    @staticmethod
    def exponent(gap, total, xi, a):
        return 40.0 * a * (0.5 * (total - gap) - 0.5 * xi) ** 2

    @classmethod
    def log_hazard(cls, x, xi, a):
        return np.zeros(np.broadcast(x, xi, a).shape)


@pytest.mark.verification
def test_a_rate_that_is_greatest_in_between_is_refused(monkeypatch):
    monkeypatch.setitem(BARRIERS, "humped", Humped)
    humped = replace(CLUSTER, thermal=Thermal(0.2, barrier="humped"))
    with pytest.raises(InputError, match="greatest at an end"):
        trajectory(humped, under(5.0, 10), points=2)


@pytest.mark.parametrize(
    ("ensemble", "drive", "said"),
    [
        (CLUSTER, lambda: steady(CLUSTER, under(1.0, 10)), "drive.force: .* no steady"),
        (
            CLUTCHES,
            Programme(
                [Segment(0.5, time=1.0)], stage=Stage(0.5, mass=1.0), stall_force=1.0
            ),
            "drive.stall_force: with drive.stage: needs",
        ),
        (
            replace(CLUTCHES, delay=Delay(0.0)),
            under(1.0, 10, rebinding="shared"),
            'rebinding = "shared": needs a delay.time > 0',
        ),
        (
            replace(CLUTCHES, disorder="annealed"),
            under(1.0, 10, rebinding="shared"),
            'rebinding = "shared": needs contacts.count',
        ),
    ],
)
def test_refused(ensemble, drive, said):
    with pytest.raises(InputError, match=said) as refused:
        drive() if callable(drive) else trajectory(ensemble, drive, points=2)
    assert "\n" not in str(refused.value)
