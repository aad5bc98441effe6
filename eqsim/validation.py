"""The engine against the master equation: a verdict a sceptic would accept.

A suite draws parameter points with a seeded sampler and compares, point by point, what particles estimate with what the
master equation says, each difference as a score z in units of the quoted errors:

    friction, pinned, break_stretch    steady averages, rel_error 1e-4
    transient                          F(X) from a fresh start, every X from its own ensemble
    hazard                             the integrated hazard at breaking is Exp(1): events less hazard, over its root
    hazard law                         the whole law of it, by Kolmogorov and Smirnov, as the normal score of p
    mean, variance, covariance         stationary F/(N k) at N = 20, 100, 10 000, the covariance at one lag

Scores of one kind are independent. A kind passes if their sum of squares has a chi-square probability above 1e-4 on
both sides, and the largest |z| a probability above 1e-4 given their number. With nine kinds and three tests each a
correct program fails a suite once in some 370 seeds.
"""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from eqsim.engine.life import lives
from eqsim.engine.ramps import Run, Scales, moments, simulate
from eqsim.engine.standing import standing, thresholds
from eqsim.engine.steady import steady
from eqsim.engine.streams import TRAJECTORY, key
from eqsim.engine.trajectory import Totals, arguments, predicted_lives, trajectory
from eqsim.ensemble import Drive, Ensemble, lower
from eqsim.errors import InputError
from eqsim.estimate import OBSERVABLES, known, z_score
from eqsim.laws.delay import Delay
from eqsim.laws.octaves import Array
from eqsim.laws.stiffness import relative_stiffness
from eqsim.laws.thermal import Thermal, log_hazard
from eqsim.laws.threshold import Gamma
from eqsim.master.reference import reference, setting
from eqsim.master.transient import Profile, fluctuations, transient

KINDS = (*OBSERVABLES, "transient", "hazard", "hazard law", "mean", "variance", "covariance")
SUITES = {"quick": (32, 3), "full": (240, 18)}  # points, and how many of them are also tested for fluctuations
ALARM = 1e-4
_ENOUGH = 400  # contacts of either state for a mean over them to be normal
_SIZES = ((20, 2000), (100, 1000), (10_000, 150))  # contacts and ensembles of the fluctuation tests

Mutation = Callable[[Ensemble], Ensemble]
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Score:
    """One comparison: its kind, the ensemble and velocity, what the engine and the master said, and z.

    Of a hazard law these are the distance of Kolmogorov and Smirnov, 0, and n^(-1/2) of n lives."""

    kind: str
    ensemble: Ensemble
    velocity: float
    value: float
    reference: float
    sigma: float
    z: float


@dataclass(frozen=True)
class Verdict:
    """Of the `count` scores of a kind: both probabilities, the largest |z|, and whether it passes."""

    kind: str
    count: int
    chi_square: float
    p_chi_square: float
    largest: float
    p_largest: float
    passed: bool


@dataclass(frozen=True)
class Validation:
    """All scores of a suite and the verdict on each kind."""

    suite: str
    seed: int
    scores: list[Score]
    verdicts: list[Verdict]

    @property
    def passed(self) -> bool:
        return all(verdict.passed for verdict in self.verdicts)


def sample(count: int, seed: int) -> list[tuple[Ensemble, float]]:
    """Ensembles and velocities over the whole parameter space, the same for the same seed."""
    rng = np.random.default_rng((seed, 1))
    points = []
    for index in range(count):
        v = 10 ** rng.uniform(-4, 2)
        kT = 0.0 if index % 10 == 9 else 10 ** rng.uniform(-2, 0.5)
        tau = 0.0 if rng.random() < 0.4 else 10 ** rng.uniform(-2, 1) / v
        law = Gamma(float(rng.choice([0.0, 0.5, 1.0, 2.5, rng.uniform(0, 6)])), 10 ** rng.uniform(-0.5, 0.5))
        ensemble = Ensemble(
            law,
            Thermal(kT * law.x_star**2, 1.0, ("soft", "stiff")[index // 2 % 2]),
            Delay(tau, ("fixed", "exponential")[int(rng.integers(2))]),
            stiffness_law=("sqrt", "uniform")[index // 4 % 2],
            disorder=("quenched", "annealed")[index % 2],
            eta=float(rng.choice([0.0, 10 ** rng.uniform(-2, 0) / v])),
        )
        points.append((ensemble, v * law.x_star))
    return points


def validate(
    suite: str = "quick",
    *,
    seed: int = 1,
    threads: int = 1,
    wrong: Mutation | None = None,
    progress: Progress | None = None,
) -> Validation:
    """Run a suite. `wrong` changes the ensemble the engine sees but not the reference's: a suite that then still
    passes is worthless. Raises InputError for an unknown suite."""
    if suite not in SUITES:
        raise InputError(f"suite = {suite!r}: must be one of " + ", ".join(f'"{name}"' for name in SUITES))
    count, wide = SUITES[suite]
    scores: list[Score] = []
    points = sample(count, seed)
    for index, (ensemble, v) in enumerate(points):
        shown = wrong(ensemble) if wrong else ensemble
        scores += _averages(ensemble, shown, v, seed, threads)
        if index % 3 == 0:
            scores += _transient(ensemble, shown, v, seed + index, threads)
        if index % 3 == 1:
            scores += _hazard(ensemble, shown, v, seed + index)
        if index % (count // wide) == 2:
            scores += _fluctuations(ensemble, shown, v, seed + index, _SIZES[index // (count // wide) % 3])
        if progress:
            progress(index + 1, count)
    return Validation(suite, seed, scores, [verdict(kind, scores) for kind in KINDS])


def verdict(kind: str, scores: list[Score]) -> Verdict:
    """Chi-square and largest |z| of the scores of a kind."""
    z = np.array([score.z for score in scores if score.kind == kind])
    if z.size == 0:
        return Verdict(kind, 0, 0.0, 1.0, 0.0, 1.0, True)
    total, largest = float(np.sum(z**2)), float(np.abs(z).max())
    p_square = 2 * min(stats.chi2.cdf(total, z.size), stats.chi2.sf(total, z.size))
    p_largest = -math.expm1(z.size * math.log1p(-min(2 * stats.norm.sf(largest), 1 - 1e-16)))
    passed = bool(p_square > ALARM and p_largest > ALARM)
    return Verdict(kind, z.size, total, float(p_square), largest, p_largest, passed)


def _score(kind: str, ensemble: Ensemble, v: float, value: float, exact: float, sigma: float) -> Score:
    return Score(kind, ensemble, v, value, exact, sigma, float((value - exact) / sigma))


def _averages(ensemble: Ensemble, shown: Ensemble, v: float, seed: int, threads: int) -> list[Score]:
    found, exact = steady(shown, v, rel_error=1e-4, seed=seed, threads=threads), reference(ensemble, v)
    scores = []
    for name in OBSERVABLES:
        ours, theirs = getattr(found, name), getattr(exact, name)
        sigma = math.hypot(ours.stderr, theirs.stderr)
        if name == "pinned" and ensemble.delay.time == shown.delay.time == 0:
            continue  # 1, exactly
        z = z_score(ours, theirs.value, theirs.stderr)
        scores.append(Score(name, ensemble, v, known(ours), known(theirs), sigma, math.inf if z is None else z))
    return scores


def _transient(ensemble: Ensemble, shown: Ensemble, v: float, seed: int, threads: int) -> list[Score]:
    """Eight ensembles, each asked for F at one displacement of its own."""
    mean = ensemble.thresholds.mean
    cost = predicted_lives(dataclasses.replace(ensemble, count=1), Drive(v, 5 * mean))
    shown = dataclasses.replace(shown, count=int(min(20_000, max(200, 1e6 / cost))))
    exact = transient(ensemble, Drive(v, 5 * mean), points=9)
    scores = []
    for i in range(1, 9):
        if predicted_lives(shown, Drive(v, 5 * mean)) > 1e8:  # very low velocity: nothing for a test of minutes
            break
        pinned = shown.count * float(exact.pinned[i])
        if pinned < _ENOUGH or (ensemble.eta > 0 and ensemble.delay.time > 0 and shown.count - pinned < _ENOUGH):
            continue
        run = trajectory(shown, Drive(v, 5 * mean * i / 8), points=2, seed=seed * 10 + i, threads=threads)
        sigma = math.hypot(run.force_stderr[1], exact.force_error[i])
        scores.append(_score("transient", ensemble, v, float(run.force[1]), float(exact.force[i]), sigma))
    return scores


def _hazard(ensemble: Ensemble, shown: Ensemble, v: float, seed: int) -> list[Score]:
    """Integrated hazards at breaking against Exp(1), censored at each contact's own threshold, two ways.

    A life that ends by heat counts 1; the integrated hazard it went through has the same mean, and is the variance of
    the difference. And of the lives that heat would have ended somewhere before the threshold, a fraction
    U = (1 - exp(-Lambda))/(1 - exp(-Lambda(xi))) ends where they did or earlier: U of those it did end is uniform.
    """
    s = setting(ensemble, v)
    if s.barrier is None:
        return []
    rng = np.random.default_rng((seed, 2))
    u, clock = rng.random((2, 20_000)) * (1 - 2e-16) + 1e-16
    c = lower(shown, v)
    _, stretch = lives(c, key(seed, TRAJECTORY), 0, u, clock)
    xi = np.empty(u.size)
    thresholds(c, u, xi)
    thermal = stretch < xi
    unit = shown.thresholds.scale / ensemble.thresholds.scale
    at = np.stack((stretch, xi)) * unit
    if s.annealed:
        profile = Profile(s, np.empty(0))
        ahead = np.asarray(ensemble.thresholds.sf(at * ensemble.thresholds.scale))
        hazard, total = -np.log(np.clip(profile.at(at.ravel())[0].reshape(at.shape) / ahead, 1e-300, 1.0))
    else:
        a = s.b * relative_stiffness(s.stiffness, at[1], s.law.rms / s.law.scale)
        hazard, total = np.exp(log_hazard(s.barrier, at, at[1], a) + s.log_w)
    mean = float(hazard.sum())
    scores = [_score("hazard", ensemble, v, float(thermal.sum()), mean, math.sqrt(mean))]
    if thermal.any():
        uniform = np.expm1(-hazard[thermal]) / np.expm1(-total[thermal])
        distance, p = stats.kstest(uniform, "uniform")
        z = float(stats.norm.isf(np.clip(p, 1e-300, 1 - 1e-16)))  # low if U is too even
        scores.append(Score("hazard law", ensemble, v, float(distance), 0.0, 1 / math.sqrt(uniform.size), z))
    return scores


def _fluctuations(ensemble: Ensemble, shown: Ensemble, v: float, seed: int, size: tuple[int, int]) -> list[Score]:
    """Mean, variance and one autocovariance of F/(N k) of stationary ensembles."""
    contacts, ensembles = size
    lag = 0.5 * ensemble.thresholds.mean
    shown = dataclasses.replace(shown, count=contacts)
    if predicted_lives(shown, Drive(v, lag)) * ensembles > 2e8:
        return []
    exact, level = fluctuations(ensemble, v, lag, points=2), reference(ensemble, v).friction
    F = _stationary_forces(shown, Drive(v, lag, "stationary"), ensembles, seed)
    first, second = (F - known(level)).T
    scores = [
        _score("mean", ensemble, v, float(F[:, 0].mean()), known(level), float(first.std()) / math.sqrt(ensembles))
    ]
    for kind, products, value in (
        ("variance", first**2, exact.covariance[0]),
        ("covariance", first * second, exact.covariance[1]),
    ):
        sigma = float(products.std(ddof=1)) / math.sqrt(ensembles)
        scores.append(_score(kind, ensemble, v, float(products.mean()), float(value) / contacts, sigma))
    return scores


def _stationary_forces(ensemble: Ensemble, drive: Drive, ensembles: int, seed: int) -> Array:
    """F/(N k) at the beginning and the end of the drive's distance, shape (ensembles, 2)."""
    c, n, unit = lower(ensemble, drive.velocity), ensemble.count, ensemble.thresholds.scale
    run = Run(drive.over(ensemble) / unit, 2, True, False)
    scales = Scales.of(c, run, n, 1, 0.0)
    job = (c, standing(c), run, scales, key(seed, TRAJECTORY))
    drag = ensemble.drag(drive.velocity)
    forces = np.empty((ensembles, 2))
    for index in range(ensembles):
        total = Totals(2, 1)
        simulate(*arguments(job, total), index * n, (index + 1) * n)
        forces[index] = moments(total.deposits, scales, run, n, drag)[0] * unit
    return forces


def columns(scores: list[Score]) -> dict[str, list[Any]]:
    """The scores as columns of a table, one row per comparison."""
    table: dict[str, list[Any]] = {}
    for score in scores:
        e, law = score.ensemble, score.ensemble.thresholds
        row = {
            "kind": score.kind,
            "disorder": e.disorder,
            "barrier": e.thermal.barrier,
            "stiffness_law": e.stiffness_law,
            "n": getattr(law, "n", math.nan),
            "x_star": law.scale,
            "kT": e.thermal.kT,
            "delay": e.delay.time,
            "delay_law": e.delay.law,
            "eta": e.eta,
            "velocity": score.velocity,
            "value": score.value,
            "reference": score.reference,
            "sigma": score.sigma,
            "z": score.z,
        }
        for name, value in row.items():
            table.setdefault(name, []).append(value)
    return table
