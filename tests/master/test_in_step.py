"""Transients of contacts in step, of very short lives and of rare long ones: the
reference against plain simulations, closed forms and adaptive quadrature.

What fails by chance is said of each test; seeds are fixed.
"""

import itertools
import math

import numpy as np
import pytest
from reduced_cases import contacts as contacts_of
from scipy import integrate, special, stats

from eqsim import (
    Delay,
    Delta,
    Distribution,
    Drive,
    Ensemble,
    Gamma,
    Normal,
    Thermal,
)
from eqsim.master.survivors import survivor_moments
from eqsim.master.transient import fluctuations, transient


def soft_lives(rng, xi, a, w):
    """Where contacts of thresholds xi break: w exp(-a xi^2) int_0^x exp(a y^2) dy = E,
    or at xi (section II)."""
    x = np.minimum(
        rng.exponential(size=xi.size) * np.exp(np.minimum(a * xi**2, 600.0)) / w, xi
    )
    long = np.flatnonzero(a * x**2 > 1e-7)  # else the hazard is that at x = 0
    target, at = x[long], x[long]
    for _ in range(60):  # convex: from above
        spent = np.exp(a * at**2) * special.dawsn(math.sqrt(a) * at) / math.sqrt(a)
        at = np.maximum(at - (spent - target) * np.exp(-a * at**2), 0.0)
    x[long] = at
    return x


def plain_pinned(lives, contacts, delay, X):
    """Share of `contacts` that are pinned at each X, after a fresh start; `lives(n)`
    draws as many."""
    start, alive = np.zeros(contacts), np.zeros(X.size)
    while start.size:
        end = start + lives(start.size)
        alive += np.searchsorted(np.sort(start), X, "right") - np.searchsorted(
            np.sort(end), X, "right"
        )
        start = (end + delay)[end + delay <= X[-1]]
    return alive / contacts


def test_lives_much_shorter_than_their_mean():
    """A fixed delay 600 typical lives long, the mean life 300 of them: |z| < 4.5 at 60
    points with the quoted error, false alarm 4e-4 for a fresh seed. A delay 3 % off
    fails."""
    law, b, v, delay, contacts = (
        Distribution(stats.pareto(3.5)),
        0.2,
        8e-6,
        0.003 * 1.4,
        20_000,
    )
    kT = 0.5 * law.scale**2 / b
    rng = np.random.default_rng(5)

    def lives(n):
        return soft_lives(rng, rng.random(n) ** (-1 / 3.5), 0.5 / kT, 1.0 / v)

    drive = Drive(v, 0.07)

    def scores(delay):
        ensemble = Ensemble(law, Thermal(kT), Delay(delay / v), stiffness_law="uniform")
        return transient(ensemble, drive, points=61)

    exact = scores(delay)
    found = plain_pinned(lives, contacts, delay, exact.X)[1:]

    def z(result):
        p = np.clip(result.pinned[1:], 1.0 / contacts, 1 - 1.0 / contacts)
        return np.abs(found - result.pinned[1:]) / np.hypot(
            np.sqrt(p * (1 - p) / contacts), result.pinned_error[1:]
        )

    assert z(exact).max() < 4.5
    assert z(scores(1.03 * delay)).max() > 10
    assert exact.pinned_error.max() < 0.02


def test_narrow_thresholds_stay_in_step():
    """n = 1e4, T = 0: thresholds differ by 0.5 % and contacts leave step over hundreds
    of cycles, in which every life is a threshold: |z| < 4.5 at 40 points, false alarm
    3e-4. Thresholds 0.2 % greater fail."""
    n, contacts = 1e4, 2000
    rng = np.random.default_rng(6)
    ends = np.cumsum(np.sqrt(rng.gamma(n + 1.0, size=(contacts, 250))), axis=1)
    exact = transient(
        Ensemble(Gamma(n), stiffness_law="uniform"), Drive(1.0, 20_000.0), points=41
    )

    def off(ends):
        born = np.concatenate((np.zeros((contacts, 1)), ends), axis=1)
        force = np.array(
            [X - born[np.arange(contacts), (ends <= X).sum(axis=1)] for X in exact.X]
        )[1:]
        stderr = np.hypot(
            force.std(axis=1) / math.sqrt(contacts), exact.force_error[1:]
        )
        return np.abs((force.mean(axis=1) - exact.force[1:]) / stderr).max()

    assert off(ends) < 4.5
    assert np.median(exact.force_error) < 0.1
    assert off(1.002 * ends) > 10


def two_narrow(width):
    """40 % of the contacts just above .5, 60 % just above 1.5."""
    edges = np.array([0.5, 0.5 + width, 1.5, 1.5 + width])
    heights = np.array([0.4, 0.0, 0.6]) / width
    return Distribution(stats.rv_histogram((heights, edges), density=True))


@pytest.mark.parametrize(
    ("law", "delay", "windows"),
    [
        (
            Normal(0.003),
            0.0,
            [(0.0, 0.97, 1, 0.0), (1.03, 1.96, 1, 1.0), (2.04, 2.9, 1, 2.0)],
        ),
        (Normal(0.01), 2.0, [(0.0, 0.93, 1, 0.0), (1.07, 2.93, 0, 0.0)]),
        (
            two_narrow(0.002),
            0.0,
            [(0.0, 0.49, 1, 0.0), (0.51, 0.99, 1, 0.2004), (1.01, 1.49, 1, 0.28056)],
        ),
    ],
    ids=["normal", "delayed", "two"],
)
def test_all_but_equal_thresholds_are_resolved(law, delay, windows):
    """T = 0, between breaks, (from, to, share pinned, mean displacement at birth): F =
    share X - birth (exact). Errors were the largest force, and are less than a
    hundredth of it; the variance is known, and after one break is that of the
    thresholds."""
    cold = Ensemble(law, Thermal(0.0), Delay(delay), stiffness_law="uniform")
    found = transient(cold, Drive(1.0, 3.0), 101, variance=True)
    assert found.force_error.max() < 0.01 * found.force.max()
    assert found.force_variance is not None
    for low, high, share, birth in windows:
        inside = slice(*np.searchsorted(found.X, (low, high)))
        off = np.abs(found.force - share * found.X + birth)[inside]
        assert np.all(off <= found.force_error[inside] + 1e-12)
    if law == Normal(0.003):
        once = slice(*np.searchsorted(found.X, (1.03, 1.96)))
        off = np.abs(found.force_variance - 0.003**2)[once]
        assert np.all(off <= found.force_variance_error[once])


@pytest.mark.parametrize("delay", [0.37, 0.031, 3.3])
@pytest.mark.parametrize("distance", [200.0, 2000.0])
def test_identical_contacts_are_in_step_for_ever(delay, distance):
    """T = 0: a saw-tooth of period x_* + v tau (exact) at every point, within the
    quoted error."""
    exact = transient(
        Ensemble(Delta(1.0), delay=Delay(delay), stiffness_law="uniform"),
        Drive(1.0, distance),
        401,
    )
    phase = np.mod(exact.X, 1.0 + delay)
    # from jumps
    apart = (np.abs(phase - 1) > 1e-9) & (
        np.abs(phase - 0.5 - 0.5 * delay) < 0.5 + 0.5 * delay - 1e-9
    )
    assert apart.mean() > 0.9
    force, pinned = np.where(phase < 1, phase, 0.0), phase < 1
    assert np.all((np.abs(exact.force - force) <= exact.force_error + 1e-9)[apart])
    assert np.all((np.abs(exact.pinned - pinned) <= exact.pinned_error + 1e-9)[apart])
    if (delay, distance) == (3.3, 200.0):  # it says so where it knows
        assert np.median(exact.pinned_error) < 1e-9
        assert np.mean(exact.pinned_error > 0.1) < 0.3


def test_more_points_than_cells():
    """What straight lines between cells miss is part of the error: 100 001 points, and
    too many, against a tenth of the way."""
    ensemble = Ensemble(stiffness_law="uniform")
    near = transient(ensemble, Drive(1.0, 4.0), points=10_001)
    for points in (100_001, 400_001):
        far = transient(ensemble, Drive(1.0, 200.0), points=points)
        every = (points - 1) // 5000
        shared = slice(0, every * 100 + 1, every)  # X = 0, 0.04 .. 4
        assert np.allclose(far.X[shared], near.X[::100], rtol=1e-12, atol=0)
        assert np.all(
            np.abs(far.force[shared] - near.force[::100])
            <= far.force_error[shared] + near.force_error[::100]
        )
        assert np.median(far.force_error) < 1e-6


def test_fluctuations_of_identical_contacts():
    """T = 0: the stationary covariance is that of a saw-tooth at a random phase
    (exact), within the quoted error, for lags of a few and of a thousand cycles; more
    lags than cells are no trouble."""
    delay = 0.37
    ensemble = Ensemble(Delta(1.0), delay=Delay(delay), stiffness_law="uniform")
    period = 1.0 + delay
    at = (np.arange(100_000) + 0.5) * period / 100_000
    saw = np.where(at < 1, at, 0.0)
    for distance, points in ((5.0, 51), (1500.0, 51), (5.0, 20_001)):
        found = fluctuations(ensemble, Drive(1.0, distance), points=points)
        shown = np.linspace(0, points - 1, 26, dtype=int)
        moved = np.mod(at + found.lag[shown, None], period)
        exact = (saw * np.where(moved < 1, moved, 0.0)).mean(axis=1) - saw.mean() ** 2
        assert np.all(
            np.abs(found.covariance[shown] - exact) <= found.error[shown] + 2e-5
        )
        if distance < 10:
            assert found.error.max() < 0.2 * exact[0]


@pytest.mark.parametrize("law", ["fixed", "exponential"])
@pytest.mark.parametrize("velocity", [1e-12, 1e-16, 1e-30])
def test_very_short_lives(velocity, law):
    """Far from the start the linear creep of section 3: C = (v/omega)/(1 - b)^2,
    friction/pinned = (v/omega) ((1 - b)/(1 - 2b))^2, exact up to terms of the order of
    v; b 1 % off fails."""
    b = 0.05
    life = velocity / (1 - b) ** 2
    ensemble = Ensemble(
        thermal=Thermal(0.5 / b), delay=Delay(1.0, law), stiffness_law="uniform"
    )
    found = transient(ensemble, Drive(velocity, 60.0 * life), points=61)
    pinned = life / (life + velocity)
    for elastic, matches in (
        (((1 - b) / (1 - 2 * b)) ** 2, True),
        (((1 - b) / (1 - 2.02 * b)) ** 2, False),
    ):
        off = abs(found.force[-1] - pinned * velocity * elastic)
        assert (
            off <= found.force_error[-1] + 10 * velocity * found.force[-1]
        ) == matches
    assert abs(found.pinned[-1] - pinned) <= found.pinned_error[-1] + 10 * velocity
    assert found.force_error[-1] < 1e-6 * found.force[-1]


@pytest.mark.parametrize(("stiffness", "b"), [("sqrt", 0.1), ("uniform", 0.6)])
def test_contacts_too_strong_to_break_by_heat(stiffness, b):
    """S(x) where only one birth in 1e20 to 1e60 outlasts x, against adaptive quadrature
    over ln xi to its 1e-8: at such velocities these carry the force. A temperature 1 %
    off fails."""
    n, x = 1.0, 0.3
    for log_w in (30.0, 46.0, 69.0):

        def term(log_xi, b=b, log_w=log_w):
            xi = math.exp(log_xi)
            a = b * (xi / math.sqrt(n + 1) if stiffness == "sqrt" else 1.0)
            log_hazard = (
                log_w
                - a * (xi**2 - x**2)
                + math.log(special.dawsn(math.sqrt(a) * x) / math.sqrt(a))
            )
            return 2.0 * math.exp(
                (2 * n + 2) * log_xi - xi**2 - math.exp(min(log_hazard, 7.0))
            )

        grid = np.linspace(math.log(x), math.log(25.0), 2001)
        peak = grid[np.argmax([term(at) for at in grid])]
        edges = [
            math.log(x),
            *(peak + np.array([-0.3, -0.1, -0.03, 0.0, 0.03, 0.1, 0.3])),
            math.log(25.0),
        ]
        edges = sorted(max(edge, math.log(x)) for edge in edges)
        exact = sum(
            integrate.quad(term, *pair, epsabs=0, epsrel=1e-10)[0]
            for pair in itertools.pairwise(edges)
        )
        assert exact < 1e-15
        near = [
            contacts_of(Gamma(n), stiffness, "soft", factor * b, log_w)
            for factor in (1.0, 1.01)
        ]
        found, off = (survivor_moments(s, np.array([x]))[0, 0, 0] for s in near)
        assert found == pytest.approx(exact, rel=1e-7, abs=0)
        assert off != pytest.approx(exact, rel=1e-3, abs=0)
