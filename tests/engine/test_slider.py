"""A slider that a stage pulls through a spring: balance, energy, limits, mean field,
and a brute-force twin."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from kernels import compiled
from scipy import integrate, linalg, stats

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
    Stage,
    Thermal,
    Uniform,
    steady,
    trajectory,
    transient,
)
from eqsim.engine.contacts import contacts
from eqsim.engine.lanes import (
    LANES,
    ROUNDS,
    delay_after,
    draw_birth,
    draw_lives,
    idle_lanes,
)
from eqsim.engine.records import Slip, _mean_over
from eqsim.engine.slider import BreakRates, Slider
from eqsim.laws.aging.base import Held, spend
from eqsim.master import slider
from eqsim.master.avalanche_sizes import load_of, missed_by_few, size_law
from eqsim.master.programme import course_of, numerics_of
from eqsim.numerics.streams import TRAJECTORY, key

UNIFORM = {"stiffness_law": "uniform"}
DELAYED = Ensemble(count=20_000, delay=Delay(1.0), **UNIFORM)
STICKING = Stage(0.1, damping=0.1, preload=7.5)


def pulled(ensemble, time, stage, points=41, velocity=0.1, **how):
    return trajectory(
        ensemble,
        Programme([Segment(velocity, time=time)], stage=stage),
        points=points,
        **how,
    )


# ---- contacts along a piece ----


@pytest.mark.parametrize(
    "ensemble",
    [
        Ensemble(),
        Ensemble(Gamma(2.5), delay=Delay(1.0, "exponential")),
        Ensemble(Gamma(0.0), Thermal(0.1), Delay(1.0, "exponential")),
    ],
    ids=["mechanical", "mechanical, n=2.5, exponential delay", "soft"],
)
def test_one_life_is_that_of_many(ensemble):
    c, stream = contacts(ensemble, 1.0), key(3, TRAJECTORY)
    lanes, lives = idle_lanes(c, stream)
    lanes.contact[:], lanes.age[:] = np.arange(LANES) % 50, np.arange(LANES) // 50
    compiled(draw_lives)(c.newborn, c, lanes, lives, LANES)
    for i in range(0, LANES, 5):
        for r in range(ROUNDS):
            life = stream, lanes.contact[i], ROUNDS * lanes.age[i] + r
            drawn = lives.threshold[r, i], lives.birth[r, i], lives.clock[r, i]
            assert compiled(draw_birth)(c.newborn, c, *life) == drawn
            delay = compiled(delay_after)(c, *life)
            assert delay == lives.delay[r, i]
            assert delay > 0 if ensemble.delay.time else delay == 0


@pytest.mark.parametrize("law", ["soft", "logarithmic"])
def test_slower_motion_is_another_pace(law):
    """At m times the pace a segment is that of a slider whose pace is m times as high:
    ln(omega/v) is less by ln m, aging slower. Contacts at rest, on the way back and
    forth; to 1e-8, what tables are good to."""
    aging = (
        Aging("logarithmic", beta=0.3, cutoff_time=0.5)
        if law == "logarithmic"
        else Aging()
    )
    ensemble, go = Ensemble(thermal=Thermal(0.1), aging=aging), compiled(spend)
    for m in (0.01, 0.7, 40.0):
        ours, theirs = contacts(ensemble, 1.0), contacts(ensemble, m)
        for y, age, clock in (
            (0.0, 0.0, 0.5),
            (0.4, 1.0, 1e-3),
            (-0.6, 0.8, 0.02),
            (-0.9, 2.0, 3.0),
        ):
            for length in (0.1, 1.5):
                a, left = go(
                    ours.aging, ours, Held(1.2, 1.1, y, age), m, length / m, clock
                )
                b, rest = go(
                    theirs.aging, theirs, Held(1.2, 1.1, y, age * m), 1.0, length, clock
                )
                assert m * a == b or m * a == pytest.approx(b, rel=1e-7, abs=1e-9)
                assert left == pytest.approx(rest, rel=1e-7, abs=1e-9)


# ---- a twin: the same contacts, one small step after another ----


def twin(ensemble, stage, velocity, time, dt, records):
    """X at `records` instants by explicit steps of a damped slider at T = 0, every
    contact looked at in every step."""
    c, stream, draw = (
        contacts(ensemble, velocity),
        key(1, TRAJECTORY),
        compiled(draw_birth),
    )
    n, tau = ensemble.count, ensemble.delay.time
    xi = np.array([draw(c.newborn, c, stream, i, 0).threshold for i in range(n)])
    lives, birth, again, pinned = (
        np.ones(n, int),
        np.zeros(n),
        np.full(n, math.inf),
        np.full(n, True),
    )
    X, t, found, steps = 0.0, 0.0, [0.0], round(time / dt)
    for step in range(steps):
        for i in np.flatnonzero(pinned & (X - birth >= xi)):
            pinned[i], again[i] = False, t + tau
        for i in np.flatnonzero(again <= t):
            xi[i], birth[i], pinned[i], again[i] = (
                draw(c.newborn, c, stream, i, lives[i]).threshold,
                X,
                True,
                math.inf,
            )
            lives[i] += 1
        force = np.sum((X - birth)[pinned]) / n
        X += (
            dt
            * (stage.stiffness * (velocity * t + stage.preload - X) - force)
            / stage.damping
        )
        t += dt
        if (step + 1) % (steps // records) == 0:
            found.append(X)
    return np.array(found)


@pytest.mark.verification
def test_agrees_with_small_steps():
    """300 contacts, through a slip: X of the twin is right to the first order in its
    step, and that of the slider to its tolerance, but for the moments within a slip,
    when both are a little early or late. The error of the twin is twice its change when
    steps are halved. Negative control: damping 5 % off."""
    ensemble, stage = (
        replace(DELAYED, count=300),
        Stage(0.1, damping=0.1, preload=7.5, tolerance=1e-6),
    )
    coarse, fine = (twin(ensemble, stage, 0.1, 12.0, dt, 12) for dt in (2e-3, 1e-3))
    found = pulled(ensemble, 12.0, stage, 13).X
    # a break more or less
    allowed = 2.0 * np.max(np.abs(fine - coarse)) + 2.0 / ensemble.count
    assert allowed < 0.012
    assert np.max(np.abs(found - fine)) < allowed
    other = pulled(ensemble, 12.0, replace(stage, preload=7.0), 13).X
    assert np.max(np.abs(other - fine)) > 2.0 * allowed


# ---- energy, limits ----


@pytest.mark.verification
@pytest.mark.parametrize(
    ("ensemble", "stage"),
    [
        (DELAYED, STICKING),
        (
            replace(DELAYED, thermal=Thermal(0.1), stiffness_law="sqrt", eta=0.5),
            Stage(0.05, mass=0.3, damping=0.02),
        ),
        (replace(DELAYED, delay=Delay()), Stage(0.05)),
        pytest.param(
            replace(DELAYED, disorder="annealed", thermal=Thermal(0.1)),
            Stage(0.2, damping=0.3),
            marks=pytest.mark.verification,
        ),
    ],
    ids=["stick-slip", "soft sqrt, mass, viscous", "quasi-static", "annealed"],
)
def test_energy_and_threads(ensemble, stage, monkeypatch):
    """Work of the stage = stored + dissipated + what finite steps miss, to rounding.
    The latter is below the tolerance of the force, 1e-4, times the way; the mean force
    is more than 0.1. Two threads leave the same bits."""
    ensemble = replace(ensemble, count=6_000)
    found = pulled(ensemble, 150.0, stage, 61, 0.3)
    work, stored, dissipated, missing = found.energy.T
    assert np.abs(work - stored - dissipated - missing).max() < 1e-11 * max(
        work.max(), 1.0
    )
    assert np.abs(missing).max() < 1e-3 * dissipated.max()
    assert dissipated.max() > 0.1
    # as if the contacts were many
    monkeypatch.setattr("eqsim.engine.slider._BLOCKS_PER_THREAD", 3)
    same = pulled(ensemble, 150.0, stage, 61, 0.3, threads=2)
    assert same.columns().keys() == found.columns().keys()
    for name, column in found.columns().items():
        assert column.tobytes() == same.columns()[name].tobytes(), name
    assert same.slips == found.slips


@pytest.mark.verification
@pytest.mark.usefixtures("not_by_events")
def test_a_stiff_spring_is_a_rigid_slider():
    """X is that of the stage less F/kappa, but for what a step misses of F, which is up
    to its length where the motion turns. In the first segment contacts are the same,
    and F differs by what that makes: its slope, and breaks that are due in between (at
    most 6 of 2000 contacts, none above 3.5); later lives are others, and |z| < 4.5 at
    40 instants (false alarm 3e-4)."""
    ensemble, segments = (
        replace(DELAYED, count=2_000),
        [Segment(0.1, time=40.0), Segment(0.0, time=5.0)],
    )
    rigid = trajectory(
        ensemble, Programme([*segments, Segment(-0.2, time=20.0)]), points=61
    )
    stiff = trajectory(
        ensemble,
        Programme([*segments, Segment(-0.2, time=20.0)], stage=Stage(1e4)),
        points=61,
    )
    # the stage is summed up over some 1e4 steps, each rounded to 4e-16: 4e-12 at most
    np.testing.assert_allclose(stiff.stage, rigid.X, rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        stiff.X, stiff.stage - stiff.force / 1e4, rtol=0, atol=0.012 / 1e4
    )
    first, off = rigid.segment == 0, np.abs(stiff.force - rigid.force)
    assert off[first].max() < 1e-4 + 6 * 3.5 / 2_000
    assert np.all(off <= 4.5 * np.hypot(rigid.force_stderr, stiff.force_stderr) + 1e-4)
    assert stiff.slips == ()


@pytest.mark.verification
def test_thresholds_grow_behind_a_stiff_spring():
    """Contacts whose thresholds double are those of a rigid slider, and F differs as in
    the test above, with breaks at up to 7."""
    ensemble = Ensemble(count=2_000, aging=Aging("flow", 0.1, 2.0), **UNIFORM)
    rigid, stiff = (
        trajectory(
            ensemble, Programme([Segment(0.1, distance=4.0)], stage=stage), points=21
        )
        for stage in (None, Stage(1e4))
    )
    assert np.abs(stiff.force - rigid.force).max() < 1e-4 + 6 * 7.0 / 2_000


@pytest.mark.usefixtures("not_by_events")
def test_nothing_holds_the_slider():
    """Neither damping nor mass: slips take no time, and the slider never goes back by
    as much as its longest step, which is the root of the tolerance times the width of
    the law."""
    ensemble = replace(DELAYED, count=2_000, thermal=Thermal(0.05), **UNIFORM)
    found = pulled(ensemble, 200.0, Stage(0.05), 2001)
    assert len(found.slips) >= 1
    assert np.diff(found.X).min() > -0.01
    assert np.abs(found.spring - found.force)[1:].max() < 5e-3


@pytest.mark.usefixtures("not_by_events")
def test_steady_sliding_takes_the_longest_steps(monkeypatch):
    """The estimate of F knows of breaks, so that steps are about as long as the root of
    the tolerance allows. Negative control: without it they are cut."""
    longest, step = [], Slider.step

    def noted(slider, *given):
        longest.append(slider.longest)
        return step(slider, *given)

    monkeypatch.setattr(Slider, "step", noted)

    def steps_for_one():
        # as two sliders move by 4, one of them in longer steps
        longest.clear()
        pulled(DELAYED, 40.0, Stage(1.0), 11)
        return sum(longest) / (2.0 * 4.0)

    assert steps_for_one() < 1.5
    monkeypatch.setattr(BreakRates, "rho", 0.0)
    assert steps_for_one() > 5.0


def test_a_heavy_slider():
    """Without contacts' friction falling a heavy slider swings about the stage, and
    loses to friction."""
    ensemble = replace(DELAYED, count=2_000, delay=Delay())
    found = pulled(ensemble, 400.0, Stage(0.3, mass=1e4), 401)
    assert np.all(np.isfinite(found.X))
    assert np.abs(np.diff(found.X)).max() < 10.0


# ---- mean field ----

MEAN_FIELD = {
    4.0: 0.8219230,
    8.0: 0.8911854,
    10.0: 0.9318314,
    12.0: 0.9790210,
    20.0: 5.57667,
}


@pytest.mark.parametrize("mass", [0.0, 0.3])
@pytest.mark.parametrize("stiffness", [-0.5, 1e-9, 1.0, 20.0])
@pytest.mark.parametrize("dt", [1e-3, 0.1, 0.5])
def test_motion_in_a_step(mass, stiffness, dt):
    """The step against the exponential of a matrix: to 1e-3 of the displacement, to
    1e-4 without a mass, whatever the stiffness."""
    y = np.array([0.0, 0.5, 0.7, 1.3])
    row = [-stiffness, -0.1, 1.0, 0.0] if mass else [0.0] * 4
    first = [0, 1, 0, 0] if mass else [-stiffness / 0.1, 0.0, 10.0, 0.0]
    rates = np.array([first, np.array(row) / (mass or 1.0), [0, 0, 0, 1], [0.0] * 4])
    exact = (linalg.expm(dt * rates) @ y)[0]
    found, _ = slider.displaced(mass, 0.1, stiffness, 0.7, 1.3, 0.5, dt)
    assert found == pytest.approx(exact, rel=1e-3 if mass else 1e-4, abs=0)


def test_mean_field_is_of_second_order():
    """X(1) without rebirths, from eta X' = kappa (Y - X) - X J(X): with a quarter of
    the steps the error is more than 12 times as large, as of order 1.8 or more."""
    programme = Programme([Segment(0.1, time=1.0)], stage=STICKING)
    reduced, course = course_of(DELAYED, programme)
    spring = slider.Spring(0.1, 0.1, 0.0, 0.0, False, 7.5, 0.0, False, False, 1.0)

    def rate(t, X):
        return (0.1 * (0.1 * t + 7.5 - X) - X * (1 + X * X) * np.exp(-X * X)) / 0.1

    exact = integrate.solve_ivp(rate, (0.0, 1.0), [0.0], rtol=1e-12, atol=1e-13).y[
        0, -1
    ]
    numerics = numerics_of(reduced, course, math.inf)
    part = slider.Part(DELAYED.kinds[0], numerics, 1.0)
    task = slider.PulledTask([part], course, spring, np.array([0.0, 1.0]))
    found = (slider.solved(task, fine) for fine in (1, 4))
    coarse, fine = (abs(one.solution.X[-1] - exact) for one in found)
    assert coarse < 1e-5
    assert fine < coarse / 12


def test_mean_field_positions():
    """X of the fresh start into the first slip, known to 4e-5: within twice the stated
    errors, which are below 2e-4 before the slip; and X(1) from the equation without
    rebirths, eta X' = kappa (Y - X) - X J(X)."""
    found = transient(DELAYED, Programme([Segment(0.1, time=20.0)], stage=STICKING), 41)
    for t, X in MEAN_FIELD.items():
        i = int(np.argmin(np.abs(found.t - t)))
        assert abs(found.X[i] - X) < 2.0 * found.X_error[i] + 1e-7
        assert found.X_error[i] < (5e-4 if t < 15 else 2e-2)

    def rate(t, X):
        return (0.1 * (0.1 * t + 7.5 - X) - X * (1 + X * X) * np.exp(-X * X)) / 0.1

    exact = integrate.solve_ivp(rate, (0.0, 1.0), [0.0], rtol=1e-10, atol=1e-12).y[
        0, -1
    ]
    assert found.X[2] == pytest.approx(exact, rel=0, abs=1e-6)


@pytest.mark.parametrize(
    ("ensemble", "stage"),
    [
        (DELAYED, STICKING),
        pytest.param(replace(DELAYED, thermal=Thermal(0.1), delay=Delay(1.0, "exponential"), stiffness_law="sqrt"),
                     Stage(0.3, damping=0.1), marks=pytest.mark.verification),
        pytest.param(replace(DELAYED, thermal=Thermal(0.1), disorder="annealed"), Stage(0.3, damping=0.1, mass=0.5),
                     marks=pytest.mark.verification),
        pytest.param(replace(DELAYED, thermal=Thermal(0.1), delay=Delay(),
                             aging=Aging("logarithmic", beta=0.05, cutoff_time=0.1)), Stage(0.3, damping=0.1),
                     marks=pytest.mark.verification),
        pytest.param(replace(DELAYED, thermal=Thermal(0.005, 1e4), delay=Delay(),
                             aging=Aging("logarithmic", beta=0.02, cutoff_time=0.1)), Stage(0.3),
                     marks=pytest.mark.verification),
    ],
    ids=["mechanical", "soft sqrt, exponential delay", "annealed, mass", "logarithmic", "sharp barriers"],
)  # fmt: skip
def test_agrees_with_the_mean_field(ensemble, stage):
    """Means of 12 ensembles of 20 000 contacts before the first slip: force, X and
    pinned fraction at 8 instants,
    |z| < 6 of Student's law with 11 degrees of freedom (false alarm 2e-3 in 24 scores), beyond the error of the mean
    field and twice the bias of order 1/N, 2/N. Negative control: another damping."""
    time = 12.0

    def scores(ours, exact):
        at = np.arange(5, 41, 5)
        pairs = [
            (ours.force, exact.force, ours.force_stderr, exact.force_error),
            (ours.X, exact.X, ours.X_replica_std / math.sqrt(12), exact.X_error),
            (ours.pinned, exact.pinned, ours.pinned_stderr, exact.pinned_error),
        ]
        return np.concatenate(
            [
                np.maximum(np.abs(a - b)[at] - known[at] - 2.0 / ensemble.count, 0.0)
                / np.maximum(sigma[at], 1e-12)
                for a, b, sigma, known in pairs
            ]
        )

    found = pulled(ensemble, time, stage, replicas=12, threads=2)
    exact = transient(ensemble, Programme([Segment(0.1, time=time)], stage=stage), 41)
    assert scores(found, exact).max() < 6.0
    other = transient(ensemble, Programme([Segment(0.11, time=time)], stage=stage), 41)
    assert scores(found, other).max() > 6.0


@pytest.mark.verification
def test_warm_contacts_slip():
    """Of weak springs and high barriers, whose slips take no time: the mean field is
    finite, the spring is never pulled by more than a fresh start holds, a rigid drive's
    first peak times what contacts strengthen by in all, and what it loses in slips is
    as large as what particles lose, |z| < 4.5 beyond 2 % for the ends of slips in a
    noisy record."""
    warm = replace(DELAYED, thermal=Thermal(0.005, 1e4), delay=Delay(),
                   aging=Aging("logarithmic", beta=0.02, cutoff_time=0.1))  # fmt: skip
    stage = Stage(0.05)
    exact = transient(warm, Programme([Segment(0.1, time=300.0)], stage=stage), 3001)
    assert np.all(np.isfinite(exact.force))
    spring = 0.05 * (exact.stage - exact.X)
    peak = transient(warm, Programme([Segment(0.1, distance=5.0)]), 501).force.max()
    assert spring.max() < peak * (1.0 + 0.02 * math.log1p(300.0 / 0.1))
    falls = np.flatnonzero(np.diff(spring) < -0.05)
    assert falls.size > 2
    found = pulled(warm, 300.0, stage, 3001, replicas=4, threads=2)
    drop = np.mean(
        [spring[i - 5 : i + 1].max() - spring[i + 1 : i + 6].min() for i in falls[1:]]
    )
    assert abs(found.drop.value - drop) < 4.5 * found.drop.stderr + 0.02 * drop


@pytest.mark.verification
def test_stick_slip():
    """Period 60.070(10), largest force of the spring .7869; particles within their
    errors, |z| < 4.5, but for the drop, whose largest and least values in a noisy
    record are too far apart by a few 1e-3; and no slips of a stiff spring."""
    exact = transient(
        DELAYED, Programme([Segment(0.1, time=420.0)], stage=STICKING), 8401
    )
    spring = 0.1 * (exact.stage - exact.X)
    rises = (
        np.flatnonzero(
            (spring[1:-1] > spring[:-2])
            & (spring[1:-1] >= spring[2:])
            & (spring[1:-1] > 0.75)
        )
        + 1
    )
    period = np.diff(exact.t[rises])[1:]
    assert period.mean() == pytest.approx(60.070, rel=1e-3, abs=0)
    assert spring[exact.t > 60].max() == pytest.approx(0.7869, rel=1e-3, abs=0)
    drop = spring[exact.t > 60].max() - spring[exact.t > 60].min()
    found = pulled(DELAYED, 1500.0, STICKING, 1501, replicas=4, threads=2)
    assert abs(found.period.value - 60.070) < 4.5 * math.hypot(
        found.period.stderr, 0.01
    )
    assert abs(found.drop.value - drop) < 4.5 * found.drop.stderr + 5e-3
    assert pulled(DELAYED, 600.0, Stage(0.3, damping=0.1), 601).slips[1:] == ()


# ---- quasi-static pulling ----


def avalanches_one_by_one(n, kappa, until):
    """Sizes and places of avalanches by looking at all contacts for every break."""
    ensemble = Ensemble(count=n, **UNIFORM)
    c, stream, draw = contacts(ensemble, 1.0), key(1, TRAJECTORY), compiled(draw_birth)
    xi = np.array([draw(c.newborn, c, stream, i, 0).threshold for i in range(n)])
    birth, lives, Y, found = np.zeros(n), np.ones(n, int), 0.0, []
    while True:
        i = int(np.argmin(birth + xi))
        X = birth[i] + xi[i]
        needed = X + np.mean(X - birth) / kappa
        if needed > Y:
            if needed > until:
                return np.array(found)
            Y = needed
            found.append([X, 0])
        found[-1][1] += 1
        birth[i], xi[i] = X, draw(c.newborn, c, stream, i, lives[i]).threshold
        lives[i] += 1


@pytest.mark.parametrize("kappa", [2.0, 0.1])
def test_avalanches_one_by_one(kappa, monkeypatch):
    # the kernel is called again
    monkeypatch.setattr("eqsim.engine.avalanches._ROOM", 3)
    expected = avalanches_one_by_one(40, kappa, 12.0)
    found = pulled(
        Ensemble(count=40, **UNIFORM), 12.0, Stage(kappa), 5, velocity=1.0
    ).avalanches
    size = len(found["breaks"])
    assert len(expected) - size in (0, 1)  # the last one goes on
    np.testing.assert_array_equal(found["breaks"], expected[:size, 1])
    # positions up to 12 are sums of some ten thresholds, rounded to 2e-15 each
    np.testing.assert_allclose(found["X"], expected[:size, 0], rtol=0, atol=1e-12)


def busy_period(load, most):
    """P(1), ..., P(most) of customers in a busy period of M/G/1 (Takacs, 1955):
    E[exp(-load S) (load S)^(n-1)/n!], S the sum of n services of mean 1, here
    thresholds of a gamma law with n = 1; by Fourier convolution."""
    cells, top = 2**16, 6.0 * most
    x = (np.arange(cells) + 0.5) * top / cells
    density = (
        2
        * (x * 1.3293403881791370) ** 3
        * np.exp(-((x * 1.3293403881791370) ** 2))
        * 1.3293403881791370
    )
    one = np.fft.rfft(density * top / cells)
    shift = np.exp(-1j * np.pi * np.arange(one.size) / cells)  # of the centres of cells
    law = []
    for n in range(1, most + 1):
        sums = np.maximum(np.fft.irfft((one * shift) ** n / shift, cells), 0.0)
        with np.errstate(divide="ignore"):
            log = -load * x + (n - 1) * np.log(load * x) - math.lgamma(n + 1)
        law.append(float(np.sum(sums * np.exp(log))))
    return np.array(law)


@pytest.mark.parametrize(
    "stiffness", [2000, 500, pytest.param(100, marks=pytest.mark.verification)]
)
def test_avalanches_are_busy_periods(stiffness):
    """Mean 1 + N k/K, with the scatter of 40 independent ensembles (|z| < 5); sizes by
    chi-square against M/G/1 of load N/(N + K), p > 1e-4; and friction over displacement
    is the steady one. Negative control: 10 % less load."""
    n, runs = 2_000, 10
    found = pulled(
        Ensemble(count=n, **UNIFORM),
        40.0,
        Stage(stiffness / n),
        401,
        velocity=1.0,
        replicas=runs,
        threads=1,
    )
    after = found.avalanches["X"] > 8.0
    sizes, replica = (
        found.avalanches["breaks"][after],
        found.avalanches["replica"][after],
    )
    means = [sizes[replica == i].mean() for i in range(runs)]
    assert abs(np.mean(means) - (1 + n / stiffness)) < 5.0 * np.std(
        means, ddof=1
    ) / math.sqrt(runs)

    def p_value(load):
        law = busy_period(load, 60)
        edges = [0, *range(1, 12), 15, 20, 30, 45, 60]
        expected = np.array([law[a:b].sum() for a, b in itertools.pairwise(edges)])
        expected = np.append(expected, 1.0 - expected.sum()) * sizes.size
        counts = np.histogram(sizes, [1, *(e + 1 for e in edges[1:]), np.inf])[0]
        used = expected > 5
        return stats.chi2.sf(
            np.sum((counts - expected)[used] ** 2 / expected[used]), used.sum() - 1
        )

    load = n / (n + stiffness)
    assert p_value(load) > 1e-4
    assert p_value(0.9 * load) < 1e-6


@pytest.mark.parametrize(
    "law",
    [
        Gamma(),
        *(
            pytest.param(law, marks=pytest.mark.verification)
            for law in (Gamma(0.0), Gamma(4.0), Uniform(0.2, 1.8))
        ),
    ],
    ids=["n=1", "n=0", "n=4", "uniform"],
)
def test_avalanches_of_sqrt_contacts(law):
    """Mean size 1 + k_t N/K and the share of single breaks under the sqrt law, k_t = k
    xi_rms/<xi>; 16 ensembles of 500 contacts, |z| < 4.5 of Student's law with 15
    degrees of freedom (false alarm 4e-4 each) beyond what 500 contacts miss. Negative
    control: k in place of k_t, travel in place of the force lost."""
    kappa, runs, n = 0.25, 16, 500
    ensemble, distance = Ensemble(law, count=n), 60.0 * law.mean
    found = pulled(
        ensemble, distance, Stage(kappa), 11, velocity=1.0, replicas=runs
    ).avalanches
    late = found["X"] > 20.0 * law.mean
    sizes = [found["breaks"][late & (found["replica"] == i)] for i in range(runs)]
    load = load_of(law, kappa, "sqrt")
    few = missed_by_few(law, load, n, "sqrt")

    def score(seen, exact, missed):
        return (max(abs(np.mean(seen) - exact) - abs(missed), 0.0)) / (
            np.std(seen, ddof=1) / math.sqrt(runs)
        )

    means, single = (
        [np.mean(size) for size in sizes],
        [np.mean(size == 1) for size in sizes],
    )
    assert score(means, 1.0 / (1.0 - load), few.mean) < 4.5
    assert score(single, size_law(law, load, 1, "sqrt")[0], few.single) < 4.5
    assert score(single, size_law(law, 1.0 / (1.0 + kappa), 1)[0], few.single) > 4.5


def test_sqrt_avalanches_in_closed_form():
    """n = 1, where (xi/x_*)^2 is gamma distributed: mean size 5.2554 and single breaks
    (1 + rho/2)^-2 = .50668 at kappa = .25; P(2) = rho (1 + rho/2)^-5 from the sum of
    two drops, gamma distributed with shape 4."""
    load = load_of(Gamma(), 0.25, "sqrt")
    assert 1.0 / (1.0 - load) == pytest.approx(5.2554, rel=0, abs=5e-5)
    found = size_law(Gamma(), load, 2, "sqrt")
    assert found[0] == pytest.approx((1.0 + 0.5 * load) ** -2, rel=1e-9, abs=0)
    assert found[0] == pytest.approx(0.50668, rel=0, abs=5e-6)
    # E[e^-t t]/2 with t = rho g/2, g of shape 4: (1/2) (rho/2) 4 (1 + rho/2)^-5
    assert found[1] == pytest.approx(load * (1.0 + 0.5 * load) ** -5, rel=1e-9, abs=0)
    assert load_of(Gamma(), 0.25) == pytest.approx(0.8, rel=1e-15, abs=0)


@pytest.mark.verification
def test_friction_over_displacement_is_steady():
    ensemble = Ensemble(count=4_000, **UNIFORM)
    found = pulled(ensemble, 60.0, Stage(0.2), 1201, velocity=1.0, replicas=8)
    level = steady(ensemble, Drive(1.0)).friction
    late = found.X > 5.0
    mean = np.trapezoid(found.force[late], found.X[late]) / np.ptp(found.X[late])
    assert mean == pytest.approx(level.value, rel=0, abs=4e-3)


# ---- what is refused ----


@pytest.mark.parametrize(
    ("stage", "said"),
    [
        ({"stiffness": 0.0}, "stiffness = 0.0: must be a finite number > 0"),
        ({"stiffness": math.nan}, "stiffness = nan: must be"),
        (
            {"stiffness": 1.0, "damping": -1.0},
            "damping = -1.0: must be a finite number >= 0",
        ),
        ({"stiffness": 1.0, "mass": math.inf}, "mass = inf: must be"),
        ({"stiffness": 1.0, "preload": math.nan}, "preload = nan: must be"),
        ({"stiffness": 1.0, "tolerance": 1.0}, "tolerance = 1.0: must be"),
    ],
)
def test_bad_stages(stage, said):
    with pytest.raises(InputError, match=said):
        Stage(**stage)


def test_fluctuating_thresholds_are_refused():
    ensemble = Ensemble(count=10, aging=Aging("langevin", 0.1, 2.0))
    with pytest.raises(InputError, match='thresholds of rule "langevin"'):
        pulled(ensemble, 1.0, Stage(1.0))


def test_a_spring_that_pushes():
    """While the stage holds, a compressed spring moves the slider back as a stretched
    one moves it on."""
    ensemble = replace(DELAYED, count=1_000)
    for solve in (trajectory, transient):
        on, back = (
            solve(
                ensemble,
                Programme(
                    [Segment(0.0, time=5.0)],
                    stage=Stage(1.0, damping=1.0, preload=preload),
                ),
                points=9,
            )
            for preload in (2.0, -2.0)
        )
        # a mirror image but for the order of a few thousand sums, rounded to 2e-16 each
        np.testing.assert_allclose(back.X, -on.X, rtol=0, atol=1e-12)
        np.testing.assert_allclose(back.force, -on.force, rtol=0, atol=1e-12)
        assert on.X[-1] > 0.5


@pytest.mark.verification
def test_few_replicas_of_few_contacts_have_errors():
    """Eight replicas of which none has met a rare break: errors of the pinned share are
    not 0, and forces and places are within 4.5 of theirs of the mean of 1000 replicas
    (of 480 values of about 40 independent ones, false alarm 3e-4). Without the contact
    that was not met, of three contacts more than half are beyond 3."""
    drive = Programme([Segment(0.1, distance=1.5)], stage=Stage(0.5, damping=0.2))
    for count in (3, 20):
        few = Ensemble(
            Gamma(1.0),
            count=count,
            delay=Delay(1.0, law="exponential"),
            stiffness_law="uniform",
        )
        known = trajectory(few, drive, points=5, replicas=1000, seed=99)
        for seed in range(20):
            found = trajectory(few, drive, points=5, replicas=8, seed=seed)
            for name, error in {
                "force": found.force_stderr,
                "pinned": found.pinned_stderr,
                "X": found.X_stderr,
            }.items():
                off = np.abs(getattr(found, name) - getattr(known, name))[1:]
                assert np.all(error[1:] > 0.0)
                assert np.all(off < 4.5 * error[1:])


@pytest.mark.parametrize("kT", [0.0, 0.01])
def test_slips_of_a_whole_record(kT):
    """Ten equal contacts behind a spring slip together, all at an instant. The spring is
    loaded before the first slip and after the last one, break by break and event by
    event, so that none is cut by the record."""
    ensemble = Ensemble(Delta(1.0), Thermal(kT), count=10, **UNIFORM)
    found = pulled(ensemble, 15.9, Stage(0.1), points=160, velocity=1.0)
    assert found.avalanches is not None
    assert all(slip.begun and slip.ended for slip in found.slips)
    assert found.drop.n == len(found.slips) - 1 >= 4


def test_periods_of_short_records():
    """Renewals of unit mean and standard deviation 0.5 in 100 records that last for six:
    whole intervals are 7 % shorter, which the error includes: rms z below 1.5 (20
    samples). Without that it is 3."""
    rng, z = np.random.default_rng(3), []
    for _ in range(20):
        slips = []
        for replica in range(100):
            times = np.cumsum(rng.gamma(4.0, 0.25, 40))
            slips += [
                Slip(t, 0.0, 1.0, 0.0, 1.0, replica, True, True)
                for t in times[times < 6.0].tolist()
            ]
        found = _mean_over(
            slips, lambda s: [b.t - a.t for a, b in itertools.pairwise(s)]
        )
        z.append((found.value - 1.0) / found.stderr)
    assert math.sqrt(np.mean(np.square(z))) < 1.5


@pytest.mark.parametrize(("kT", "reliable"), [(0.0, False), (0.1, True)])
def test_errors_of_contacts_in_step_are_not_relied_on(kT, reliable):
    """Equal contacts that no heat tells apart all break within one step, whose error
    coarser steps do not tell."""
    equal = Ensemble(Delta(1.0), Thermal(kT), count=10, **UNIFORM)
    drive = Programme([Segment(0.5, distance=0.2)], stage=Stage(0.1, damping=0.5))
    run = trajectory(equal, drive, points=3, replicas=8)
    assert run.force_reliable == reliable
    assert run.segments[0].end.reliable == reliable
