"""Transients of aging annealed contacts: against unaged ones, against star1 at rest and
against finite differences."""

import itertools
import math

import numpy as np
import pytest
from cases import chosen
from scipy import linalg
from test_asymptotics import exponent, star1

from eqsim import Aging, Delay, Drive, Ensemble, Gamma, InputError, Thermal
from eqsim.laws.aging import Flow
from eqsim.laws.barrier import BARRIERS, Mechanical
from eqsim.master.closure import AgedLaws, march_closure
from eqsim.master.closure import closure as solve
from eqsim.master.transient import transient


def closure(
    n, x_i, x_f, rate, *, velocity, distance, points, thermal=None, stiffness=1.0
):
    contacts = Ensemble(
        Gamma(n, x_i), thermal or Thermal(), aging=Aging("flow", rate, x_f), stiffness=stiffness,
        stiffness_law="uniform", disorder="annealed",
    )  # fmt: skip
    return solve(contacts, Drive(velocity, distance), points)


@pytest.mark.parametrize(
    ("n", "thermal", "v"),
    [
        (0.0, Thermal(), 1.0),
        (1.0, Thermal(1.0), 0.3),
        pytest.param(0.3, Thermal(0.2), 0.01, marks=pytest.mark.verification),
        (5.0, Thermal(0.1, 2.0, "stiff"), 0.1),
    ],
)
def test_without_aging(n, thermal, v):
    """D = 0 is the renewal equation of contacts that do not age, within both errors,
    whatever x_*f is."""
    found = closure(
        n,
        1.5,
        3.0,
        0.0,
        stiffness=2.0,
        thermal=thermal,
        velocity=v,
        distance=12.0,
        points=101,
    )
    contacts = Ensemble(
        Gamma(n, 1.5),
        thermal,
        stiffness=2.0,
        stiffness_law="uniform",
        disorder="annealed",
    )
    exact = transient(contacts, Drive(v, 12.0), 101)
    np.testing.assert_allclose(found.X, exact.X, rtol=1e-15)
    assert np.all(
        np.abs(found.force - exact.force) <= found.force_error + exact.force_error
    )
    assert found.force_error.max() < 1e-4
    np.testing.assert_allclose(
        found.mean_threshold, contacts.thresholds.mean, rtol=1e-12
    )


@chosen(  # by default both cold contacts that strengthen and warm ones that weaken
    ("kT", "aging"),
    itertools.product(
        (0.0, 0.1, 1.0),
        [(0.1, 0.2, 1.0, 0.1), (0.1, 0.1, 1.0, 1.0), (0.3, 1.0, 0.4, 0.5)],
    ),
    [(0.0, (0.1, 0.2, 1.0, 0.1)), (0.1, (0.3, 1.0, 0.4, 0.5))],
)
def test_comes_to_rest_at_star1(monkeypatch, kT, aging):
    """After 30 lives friction and C = 1/Gamma are those of star1 by quadrature, within
    the stated errors; those of a D 5 % larger, the negative control, are ten errors or
    more away."""
    D, x_i, x_f, v = aging
    # half the accuracy is enough, and faster
    monkeypatch.setattr("eqsim.master.closure.MOST_CELLS", 1000)
    C, f_k, _ = star1(v, D, x_i, x_f, kT)
    other_C, other_f_k, _ = star1(v, 1.05 * D, x_i, x_f, kT)
    found = closure(
        1.0, x_i, x_f, D, thermal=Thermal(kT), velocity=v, distance=30 * C, points=11
    )
    assert abs(found.force[-1] - f_k) < found.force_error[-1]
    assert abs(found.breaks[-1] - 1 / C) < found.breaks_error[-1]
    assert abs(found.force[-1] - other_f_k) > 10 * found.force_error[-1]
    assert abs(found.breaks[-1] - 1 / other_C) > 10 * found.breaks_error[-1]
    if kT == 0:  # nothing but its threshold breaks a contact: C is the mean threshold
        assert found.mean_threshold[-1] == pytest.approx(
            C, abs=found.mean_threshold_error[-1]
        )


def test_values_at_zero_temperature():
    """Friction of x_*i = .1, x_*f = 1, D = .1, to the six digits known, held for ever."""
    found = closure(1.0, 0.1, 1.0, 0.1, velocity=1.0, distance=200.0, points=21)
    assert found.force[-1] == pytest.approx(0.347086, abs=5e-7 + found.force_error[-1])
    assert found.force_error[-1] < 1e-4 * found.force[-1]
    np.testing.assert_array_equal(found.force[10:], found.force[-1])


def marched(cells, x_f, rate, thermal):
    barrier = Mechanical()
    if thermal.kT > 0:
        barrier = BARRIERS[thermal.barrier](
            0.5 / thermal.kT, math.log(2.0 * thermal.attempt_frequency)
        )
    pool = AgedLaws(1.0, Flow(x_f**2, rate), 4.0, barrier)
    means = march_closure(pool, 4.0 / cells, cells)
    return np.array([quantity[:: cells // 50] for quantity in means])[:, 2:]


@pytest.mark.verification
@chosen(
    ("x_f", "thermal"),
    itertools.product(
        (0.4, 3.0), [Thermal(), Thermal(0.2), Thermal(0.1, 1.0, "stiff")]
    ),
    [(0.4, Thermal()), (3.0, Thermal(0.1, 1.0, "stiff"))],
)
def test_second_order(x_f, thermal):
    """The error against a fine grid falls as the square of the cell (2 within 0.1), for
    all three quantities, so that what two grids give is of higher order. Left out are
    the first two of 50 points: at X = 0 the breaks, a one-sided derivative there, take
    smaller cells to show it."""
    fine = marched(3200, x_f, 0.7, thermal)
    errors = [
        np.abs(marched(cells, x_f, 0.7, thermal) - fine).max(axis=1)
        for cells in (100, 200, 400)
    ]
    for quantity in np.transpose(errors):
        # the fine grid itself is off by (cell/3200)^2 of the error, < 2 %
        assert exponent(np.array([100.0, 200.0, 400.0]), quantity) == pytest.approx(
            -2.0, abs=0.1
        )


@pytest.mark.verification
@pytest.mark.parametrize(
    ("n", "x_i", "x_f", "D", "kT", "v"),
    [
        pytest.param(1.0, 0.1, 1.0, 1.0, 0.1, 1.0, marks=pytest.mark.verification),
        # contacts age within a few cells
        pytest.param(0.3, 0.1, 1.0, 20.0, 0.01, 1.0, marks=pytest.mark.verification),
        pytest.param(
            1.0, 0.1, 1.0, 0.1, 1.0, 1e-4, marks=pytest.mark.verification
        ),  # lives of 1e-4
        (4.0, 1.0, 0.2, 0.1, 0.0, 0.1),
    ],
)
def test_stated_errors(monkeypatch, n, x_i, x_f, D, kT, v):
    """A grid three times finer, whose error is nine times smaller, lies within the
    stated errors."""
    arguments = {"thermal": Thermal(kT), "velocity": v, "distance": 2.0, "points": 51}
    monkeypatch.setattr("eqsim.master.closure.MOST_CELLS", 600)
    found = closure(n, x_i, x_f, D, **arguments)
    monkeypatch.setattr("eqsim.master.closure.FEWEST_CELLS", 1800)
    monkeypatch.setattr("eqsim.master.closure.MOST_CELLS", 1800)
    finer = closure(n, x_i, x_f, D, **arguments)
    for name in ("force", "breaks", "mean_threshold"):
        difference = np.abs(getattr(found, name) - getattr(finer, name))
        assert np.all(difference <= getattr(found, name + "_error"))


def differences(d, D, kT, v, barrier, x_i=0.5, x_f=1.0):
    """Force at X = 0.25, 0.5, ..., 2 by the plainest finite differences, of first order
    in d: L by implicit Euler, the rate h by summation, all contacts moved by d in each
    step (n = 1, k = omega = 1)."""
    xi = d * (np.arange(round(6.0 / d)) + 0.5)
    edge = d * np.arange(1, xi.size)
    rest, start = Gamma(1.0, x_f).pdf, Gamma(1.0, x_i).pdf(xi) * d
    flux = D / v * d / d**2  # in one step
    # between neighbours
    up, down = (flux * rest(edge) / rest(xi[:-1]), flux * rest(edge) / rest(xi[1:]))
    bands = np.zeros((3, xi.size))
    bands[1] = 1 + np.append(up, 0) + np.append(0, down)
    bands[0, 1:], bands[2, :-1] = -down, -up
    y = xi[:, None]
    with np.errstate(invalid="ignore"):
        gap = np.where(xi > y, 1 - y / xi, 0.0)
    if kT == 0:
        r = np.zeros_like(gap)
    elif barrier == "soft":
        r = np.where(xi > y, np.exp(-(xi**2 - y**2) / (2 * kT)), 0.0)
    else:
        r = np.sqrt(gap) * np.exp(-(xi**2) * gap**1.5 / (2 * kT))
    P, Q, force = start.copy(), np.zeros(xi.size), []
    Q[0] = 1.0  # fresh
    for step in range(1, round(2.0 / d) + 1):
        above = np.append(np.cumsum(P[::-1])[::-1], 1e-300)
        survive = above[1:] / np.maximum(above[:-1], 1e-300) * np.exp(-d / v * (r @ P))
        kept = Q * survive
        breaks = 1.0 - kept.sum()
        Q = np.append(breaks, kept[:-1])
        P = linalg.solve_banded((1, 1), bands, (1 - breaks) * P + breaks * start)
        if step % round(0.25 / d) == 0:
            force.append(Q @ (xi - 0.5 * d))
    return np.array(force)


@pytest.mark.parametrize(("kT", "barrier"), [(0.2, "soft"), (0.1, "stiff")])
def test_finite_differences(kT, barrier):
    """The equations themselves, discretised without any of the closed forms:
    extrapolated from two steps they agree within the difference of these; twice the
    rate of aging, the negative control, does not."""
    coarse, fine = (differences(d, 0.2, kT, 0.5, barrier) for d in (0.025, 0.0125))
    best, error = 2 * fine - coarse, np.abs(fine - coarse)
    for rate, right in ((0.2, True), (0.4, False)):
        found = closure(
            1.0,
            0.5,
            1.0,
            rate,
            thermal=Thermal(kT, 1.0, barrier),
            velocity=0.5,
            distance=2.0,
            points=9,
        )
        assert (
            bool(np.all(np.abs(found.force[1:] - best) < error + found.force_error[1:]))
            is right
        )


def test_units_and_limits():
    """Lengths scale with x_*, energies with k x_*^2; infinite D is the final law at
    once."""
    one = closure(
        1.0, 0.5, 1.0, 0.2, thermal=Thermal(0.1), velocity=0.5, distance=3.0, points=31
    )
    two = closure(
        1.0,
        5.0,
        10.0,
        20.0,
        stiffness=3.0,
        thermal=Thermal(30.0),
        velocity=5.0,
        distance=30.0,
        points=31,
    )
    np.testing.assert_allclose(two.force, 10 * one.force, rtol=1e-9)
    np.testing.assert_allclose(two.breaks, one.breaks / 10, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(two.mean_threshold, 10 * one.mean_threshold, rtol=1e-9)
    final = closure(1.0, 0.5, 1.0, math.inf, velocity=0.5, distance=3.0, points=31)
    unaged = closure(1.0, 1.0, 1.0, 0.0, velocity=0.5, distance=3.0, points=31)
    assert np.all(
        np.abs(final.force - unaged.force) <= final.force_error + unaged.force_error
    )


def test_refusals():
    """Contacts that the closure does not describe."""
    right = {
        "aging": Aging("flow", 0.1, 1.0),
        "stiffness_law": "uniform",
        "disorder": "annealed",
    }
    wrong = {"disorder": "quenched", "stiffness_law": "sqrt", "delay": Delay(1.0)}
    for name, value in wrong.items():
        with pytest.raises(InputError, match=name):
            solve(
                Ensemble(Gamma(1.0, 0.1), **{**right, name: value}), Drive(1.0, 1.0), 11
            )
    contacts = Ensemble(Gamma(1.0, 0.1), **right)
    for drive, points, name in (
        (Drive(1.0, 1e9), 11, "distance"),
        (Drive(1.0), 1, "points"),
    ):
        with pytest.raises(InputError, match=name):
            solve(contacts, drive, points)
    narrow = Ensemble(Gamma(1000.0, 1e-3), **right)
    with pytest.raises(InputError, match="too far"):
        solve(narrow, Drive(1.0, 1e-2), 11)
