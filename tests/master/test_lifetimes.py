"""Lifetimes of clusters under a constant force against published numbers, the matrix
exponential of the chain, mpmath and clusters broken one by one."""

import math
from dataclasses import replace

import mpmath
import numpy as np
import pytest
from cases import chosen
from scipy import linalg, stats

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
    Thermal,
    lifetime,
)
from eqsim.master.lifetimes import Chain, chain_of, moments, survival_of_chain


def creep(force, time=50.0):
    return Programme([Segment(force=force, time=time)], rebinding="shared")


CREEP = creep(0.3)


def chain(N, F, g):
    """Rates k = e^f, pinned again at the rate g."""
    n = np.arange(1.0, N + 1.0)
    return Chain(np.log(n) + F / n, g * (N - n))


def bonds(N, delay=2.0, **more):
    return Ensemble(
        Delta(), Thermal(0.2, 3.0), Delay(delay, "exponential"), count=N, **more
    )


@pytest.mark.parametrize(
    ("N", "F", "g", "known"),
    [
        (10, 1, 0, 1.8335773204),
        (10, 5, 0, 0.5896197502),
        (100, 50, 0, 0.56280372087),
        (2, 1, 1, 0.7827098511),
        (10, 5, 1, 0.82105707121),
        (10, 1, 1, 17.908358462),
    ],
)
def test_published_means(N, F, g, known):
    """Ten digits are given. Negative control: contacts pinned again one too few."""
    cluster = chain(N, F, g)
    assert moments(cluster)[0] == pytest.approx(known, rel=1e-10, abs=0)
    if g:
        fewer = cluster._replace(pinned_again=np.maximum(cluster.pinned_again - g, 0.0))
        assert abs(moments(fewer)[0] / known - 1.0) > 1e-3


@pytest.mark.parametrize(
    ("N", "F", "g", "known"),
    [(100, 50, 0, 0.56280372087), (2, 1, 1, 0.7827098511), (10, 1, 1, 17.908358462)],
)
def test_published_means_of_bell_bonds(N, F, g, known):
    """The same by keys: forces are over N k."""
    bell = Ensemble(
        NoThresholds(),
        Thermal(barrier="bell", off_rate=1.0, force_scale=1.0),
        Delay(1.0 / g if g else math.inf, "exponential"),
        count=N,
    )
    found = lifetime(bell, creep(F / N), points=2)
    assert found.mean.value == pytest.approx(known, rel=1e-10, abs=0)


@pytest.mark.parametrize(
    ("N", "F", "g"), [(1, 2, 1), (2, 1, 1), (10, 5, 1), (30, 9, 0)]
)
def test_survival_is_the_exponential_of_the_chain(N, F, g):
    cluster = chain(N, F, g)
    breaks, again = np.exp(cluster.log_breaks), cluster.pinned_again
    rates = np.diag(-breaks - again) + np.diag(breaks[1:], -1) + np.diag(again[:-1], 1)
    mean, std = moments(cluster)
    t = mean * np.array([0.0, 1e-3, 0.1, 0.5, 1.0, 2.0, 10.0])
    expected = [linalg.expm(rates * each)[-1].sum() for each in t]
    found = survival_of_chain(cluster, t, mean, std)
    assert found == pytest.approx(np.array(expected), rel=0, abs=1e-9)
    # the integrals of S and 2 t S
    inverse = np.linalg.inv(rates)
    assert mean == pytest.approx(-inverse[-1].sum(), rel=1e-12, abs=0)
    square = 2.0 * (inverse @ inverse)[-1].sum()
    assert std == pytest.approx(math.sqrt(square - mean**2), rel=1e-11, abs=0)


def test_narrow_law_of_many_contacts():
    """1000 breaks at equal rates: a gamma law, 3 % wide."""
    cluster = Chain(np.zeros(1000), np.zeros(1000))
    t = np.array([800.0, 970.0, 1000.0, 1040.0, 3000.0])
    found = survival_of_chain(cluster, t, *moments(cluster))
    assert found == pytest.approx(stats.gamma(1000).sf(t), rel=0, abs=1e-9)


@chosen(
    ("N", "log_rate"),
    [(N, rate) for N in (1, 2, 100_000) for rate in (-300.0, 300.0)],
    [(1, -300.0), (2, 300.0), (2, -300.0)],
)
def test_extreme_rates(N, log_rate):
    """Without re-attachment contacts break at equal rates; with it, ratios of 1e260 in
    one direction or the other."""
    same = Chain(np.full(N, log_rate), np.zeros(N))
    mean, std = moments(same)
    assert mean == pytest.approx(N * math.exp(-log_rate), rel=1e-12, abs=0)
    assert std == pytest.approx(math.sqrt(N) * math.exp(-log_rate), rel=1e-12, abs=0)
    mean, _ = moments(same._replace(pinned_again=np.arange(N)[::-1] * 1.0))
    exact = N * math.exp(-log_rate) if log_rate > 0 or N == 1 else None
    exact = exact or (math.exp(600.0) if N == 2 else math.inf)
    assert mean == pytest.approx(exact, rel=1e-12, abs=0)


def test_times_between_that_overflow():
    """t_2 = e^1000, and t_1 = e^-900 (1 + g t_2) with g = e^-90."""
    cluster = Chain(np.array([900.0, -1000.0]), np.array([math.exp(-90.0), 0.0]))
    assert moments(cluster)[0] == math.inf
    cluster = Chain(np.array([900.0, -500.0]), np.array([math.exp(220.0), 0.0]))
    expected = math.exp(500.0) * (1.0 + math.exp(-680.0))
    assert moments(cluster)[0] == pytest.approx(expected, rel=1e-12, abs=0)


@pytest.mark.verification
def test_many_contacts_by_mpmath():
    N, again = 100_000, 1e-3
    cluster = chain(N, 0.7 * N, again)
    with mpmath.workdps(30):
        t = total = mpmath.mpf(0)
        for log_rate, u in zip(
            cluster.log_breaks[::-1], cluster.pinned_again[::-1], strict=True
        ):
            t = mpmath.exp(-log_rate) * (1 + u * t)
            total += t
        expected = float(total)
    assert moments(cluster)[0] == pytest.approx(expected, rel=1e-13, abs=0)


@pytest.mark.parametrize("again", [True, False])
def test_clusters_broken_one_by_one(again):
    """1e5 clusters of 4 contacts behind soft barriers, rates 3 exp(-b (1 - x^2)) with b
    = 1/(2 0.2); |z| < 4.5 of the mean, and Kolmogorov and Smirnov's test of the law.
    Negative control: a force 2 % larger."""
    rng, N, count = np.random.default_rng(7), 4, 100_000
    pinned, time = np.full(count, N), np.zeros(count)
    while pinned.any():
        n = pinned[alive := np.flatnonzero(pinned)]
        breaks = n * 3.0 * np.exp(-2.5 * (1.0 - np.minimum(0.3 * N / n, 1.0) ** 2))
        breaks = np.where(n <= 0.3 * N, 1e12, breaks)
        attach = (N - n) * (0.5 if again else 0.0)
        time[alive] += rng.exponential(size=n.size) / (breaks + attach)
        up = rng.random(n.size) * (breaks + attach) < attach
        pinned[alive] += np.where(up, 1, -1)
    ensemble = bonds(N)
    cluster = chain_of(ensemble, CREEP)
    if not again:
        cluster = cluster._replace(pinned_again=np.zeros(N))
    stderr = time.std(ddof=1) / math.sqrt(count)
    mean, std = moments(cluster)
    assert abs(time.mean() - mean) < 4.5 * stderr
    assert np.std(time) == pytest.approx(std, rel=4.5 * 2.0 / math.sqrt(count), abs=0)
    t = np.quantile(time, np.linspace(0.02, 0.98, 25))
    seen = 1.0 - np.linspace(0.02, 0.98, 25)
    off = np.abs(survival_of_chain(cluster, t, mean, std) - seen).max()
    assert off < stats.kstwobign.isf(1e-5) / math.sqrt(count)
    harder = creep(0.306)
    cluster = chain_of(ensemble, harder)._replace(pinned_again=cluster.pinned_again)
    assert abs(time.mean() - moments(cluster)[0]) > 4.5 * stderr


def test_result_and_limits():
    """Without heat a cluster holds for ever or, where a contact's share is beyond its
    threshold, not at all."""
    found = lifetime(bonds(10), CREEP, points=11)
    assert found.t.shape == found.survival.shape == (11,)
    assert found.survival[0] == 1.0
    assert np.all(np.diff(found.survival) <= 0.0)
    cold = Ensemble(Delta(), delay=Delay(1.0, "exponential"), count=5)
    assert lifetime(cold, CREEP).mean.value == math.inf
    assert lifetime(cold, CREEP, points=3).survival.tolist() == [1.0, 1.0, 1.0]
    strong = lifetime(cold, creep(1.0, 1.0), points=3)
    assert (strong.mean.value, strong.survival.tolist()) == (0.0, [1.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("ensemble", "drive", "said"),
    [
        (bonds(3), Drive(1.0), "drive.force: must be given"),
        (bonds(3), Programme([Segment(0.1, time=1.0)]), "drive.force: must be given"),
        (bonds(3), Programme([Segment(force=-0.1, time=1.0)]), "drive.force: must be"),
        (
            bonds(3),
            Programme([Segment(force_rate=0.1, time=1.0)]),
            "drive.force: must be given, constant",
        ),
        (bonds(3), Programme([Segment(force=0.3, time=1.0)]), "rebinding: must be"),
        (Ensemble(Gamma(), Thermal(0.1), count=5), CREEP, "thresholds: must all"),
        (Ensemble(Delta(), Thermal(0.1), Delay(2.0), count=5), CREEP, "delay.time = 2"),
        (bonds(3, 0.0), CREEP, "delay.time = 0: must be inf"),
        (bonds(200_000), CREEP, "contacts.count = 200000"),
        (
            replace(bonds(3), delay=Delay(2.0, "exponential", velocity_exponent=1.0)),
            CREEP,
            "delay.velocity_exponent = 1: must be 0",
        ),
        (bonds(3, eta=0.1), CREEP, "viscosity: not in a cluster"),
    ],
)
def test_refused(ensemble, drive, said):
    with pytest.raises(InputError, match=said):
        lifetime(ensemble, drive)
