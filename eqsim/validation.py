"""The engine against the master equation: a verdict a sceptic would accept.

A suite draws parameter points with a seeded sampler and compares, point by point, what particles estimate with what the
master equation says, each difference as a score z in units of the quoted errors:

    friction, pinned, break_stretch    steady averages, rel_error 1e-4 (of `langevin` contacts from 65 536 lives)
    transient                          F(X) from a fresh start, every X from its own ensemble
    transient variance                 variance over contacts of the force of one, at the same X
    hazard                             the integrated hazard at breaking is Exp(1): events less hazard, over its root
    hazard law                         the whole law of it, by Kolmogorov and Smirnov, as the normal score of p
    mean, variance, covariance         stationary F/(N k) at N = 20, 100, 10 000, the covariance at one lag

A third of the points age. Thresholds that fluctuate (`langevin`) are plain Monte Carlo, with steps whose bias is below
1e-3 in friction, and least where thresholds hardly move and errors are smallest: it does little to scores from 65 536
lives, good to some 5e-4 to 5e-3, but would spoil scores at 1e-4. Their hazard is not known path by path; the whole law
of x_b, S(x_b) uniform, stands in for it. Fluctuations of aging quenched contacts whose stiffness follows their
thresholds (sqrt law) have no reference. Births of annealed contacts that age are found once a point, with the steady
averages, and then held.

Variances are taken about the master's mean, as means of squares. Their scores are the Y of a test suite of stochastic
simulators, (s^2 - sigma^2) over the error of s^2, with that error, ((mu_4 - sigma^4)/n)^(1/2), from the scatter of the
squares in the sample: forces of one contact, or of twenty, are far from normal.

Scores of one kind are independent. A kind passes if their sum of squares has a chi-square probability above 1e-4 on
both sides, and the largest |z| a probability above 1e-4 given their number. With ten kinds and two probabilities each
a correct program fails a suite once in 500 seeds or less often, whatever the correlations between kinds (Bonferroni).
"""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy import integrate, signal, stats

from eqsim.engine.life import lives
from eqsim.engine.ramps import Run, Scales, moments, simulate
from eqsim.engine.standing import FRESH, flow_ends, standing, thresholds
from eqsim.engine.steady import Steady, steady
from eqsim.engine.streams import TRAJECTORY, key
from eqsim.engine.trajectory import Totals, arguments, predicted_lives, trajectory
from eqsim.ensemble import Drive, Ensemble, lower
from eqsim.errors import InputError
from eqsim.estimate import OBSERVABLES, Estimate, known, z_score
from eqsim.laws.aging import FLOW, Aging, AgingRule
from eqsim.laws.delay import Delay
from eqsim.laws.octaves import Array
from eqsim.laws.stiffness import relative_stiffness
from eqsim.laws.thermal import Thermal, log_hazard
from eqsim.laws.threshold import Gamma
from eqsim.master.flow import Contact
from eqsim.master.reference import Setting, reference, setting
from eqsim.master.transient import Profile, Transient, fluctuations, grid_of, means_of, transient

KINDS = (*OBSERVABLES, "transient", "transient variance", "hazard", "hazard law", "mean", "variance", "covariance")
ALARM = 1e-4
_REL_ERROR = 1e-4
_ENOUGH = 400  # contacts of either state that carry the force, n <f>^2/<f^2>, for a mean over them to be normal
_ENOUGH_SQUARES = 1600  # and for a mean of squares
_GROUPS = 64  # of contacts, whose scatter is the error of a variance
_ROUNDING = 1e-12  # of a threshold that was computed in two ways; as many lives end by heat as close to it
_DEAR = 20  # `langevin` lives take that much longer than others, and stationary ones are found by trying


class Suite(NamedTuple):
    """How many parameter points, how many of them are also tested for fluctuations, contacts and ensembles of these
    tests in turn, and the fewest contacts of a transient, for as long as they take fewer than `lives` lives."""

    points: int
    wide: int
    sizes: tuple[tuple[int, int], ...] = ((20, 2000), (100, 1000), (10_000, 150))
    contacts: int = 200
    lives: float = 1e6


SUITES = {
    "quick": Suite(32, 3),
    "full": Suite(240, 18),
    "verification": Suite(1008, 77, ((20, 10_000), (100, 10_000), (1000, 10_000)), 10_000, 1e8),
}

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

    @property
    def p_overall(self) -> float:
        """Probability of a p-value as small as the smallest of all kinds, or an upper bound of it (Bonferroni)."""
        return overall(
            [p for verdict in self.verdicts if verdict.count for p in (verdict.p_chi_square, verdict.p_largest)]
        )


def sample(count: int, seed: int) -> list[tuple[Ensemble, float]]:
    """Ensembles and velocities over the whole parameter space, the same for the same seed."""
    rng, aging_rng = np.random.default_rng((seed, 1)), np.random.default_rng((seed, 3))  # all else is as without aging
    ages = aging_rng.permutation(count) < count // 3
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
        if ages[index]:
            ensemble = _aging(ensemble, v * law.x_star, aging_rng)
        points.append((ensemble, v * law.x_star))
    return points


def _aging(ensemble: Ensemble, v: float, rng: np.random.Generator) -> Ensemble:
    """The same contacts, aging: D/(v x_*i) from 1e-3 to 10, sometimes infinite, x_*f/x_*i from 0.3 to 10; sometimes
    at T = 0."""
    rules: tuple[AgingRule, AgingRule] = ("langevin", "flow")
    unit, rule = ensemble.thresholds.scale, rules[int(rng.integers(2))]
    rate, final = 10 ** rng.uniform(-3, 1) * v * unit, 10 ** rng.uniform(math.log10(0.3), 1) * unit
    at_once, cold = rng.random() < 0.15, rng.random() < 0.25
    if at_once and (rule == "flow" or ensemble.disorder == "annealed"):
        rate, rule = math.inf, "flow"  # all the same to annealed contacts
    thermal = dataclasses.replace(ensemble.thermal, kT=0.0) if cold else ensemble.thermal
    return dataclasses.replace(ensemble, thermal=thermal, aging=Aging(rule, rate, final))


def _held(ensemble: Ensemble, v: float, found: Steady) -> Ensemble:
    """The same contacts; births of annealed ones that age are held at the stretch C that was `found`."""
    if not ensemble.self_consistent:
        return ensemble
    births: Any = ensemble.births(v, known(found.break_stretch))
    return dataclasses.replace(ensemble, thresholds=births, aging=Aging())


def validate(
    suite: str = "quick",
    *,
    seed: int = 1,
    threads: int = 1,
    wrong: Mutation | None = None,
    part: tuple[int, int] = (0, 1),
    progress: Progress | None = None,
) -> Validation:
    """Run a suite, or of its points only every m-th from the i-th on, `part` = (i, m): the scores of all parts are
    those of the suite. Averages that call themselves unreliable are not scored. `wrong` changes the ensemble the engine
    sees but not the reference's: a suite that then still passes is worthless. Raises InputError for an unknown suite.
    """
    if suite not in SUITES:
        raise InputError(f"suite = {suite!r}: must be one of " + ", ".join(f'"{name}"' for name in SUITES))
    plan = SUITES[suite]
    stride = plan.points // plan.wide if plan.wide else 0
    scores: list[Score] = []
    points = list(enumerate(sample(plan.points, seed)))[part[0] :: part[1]]
    for done, (index, (ensemble, v)) in enumerate(points, 1):
        shown = wrong(ensemble) if wrong else ensemble
        rel_error = 1.0 if shown.fluctuates else _REL_ERROR  # 1.0: the first 65 536 lives will do
        found = steady(shown, v, rel_error=rel_error, seed=seed, threads=threads)
        scores += _averages(ensemble, shown, v, found)
        shown, own = _held(shown, v, found), _stream(seed, index)
        if index % 3 == 0:
            scores += _transient(ensemble, shown, v, own, threads, plan)
        if index % 3 == 1:
            scores += _hazard(ensemble, shown, v, own)
        if stride and index % stride == 2:
            scores += _fluctuations(ensemble, shown, v, own, plan.sizes[index // stride % len(plan.sizes)])
        if progress:
            progress(done, len(points))
    return Validation(suite, seed, scores, [verdict(kind, scores) for kind in KINDS])


def _stream(*numbers: int) -> int:
    """A seed of its own for all that draws."""
    return int(np.random.SeedSequence(numbers).generate_state(1, np.uint64)[0] >> 1)


def overall(p: list[float]) -> float:
    """Of the smallest of several p-values, however they depend on each other: an upper bound (Bonferroni)."""
    return min(1.0, len(p) * min(p, default=1.0))


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


def _averages(ensemble: Ensemble, shown: Ensemble, v: float, found: Steady) -> list[Score]:
    exact, scores = reference(ensemble, v), []
    for name in OBSERVABLES:
        ours, theirs = getattr(found, name), getattr(exact, name)
        sigma = math.hypot(ours.stderr, theirs.stderr)
        if name == "pinned" and ensemble.delay.time == shown.delay.time == 0:
            continue  # 1, exactly
        if not ours.reliable:
            continue  # and says so
        z = z_score(ours, theirs.value, theirs.stderr)
        scores.append(Score(name, ensemble, v, known(ours), known(theirs), sigma, math.inf if z is None else z))
    return scores


def _transient(ensemble: Ensemble, shown: Ensemble, v: float, seed: int, threads: int, plan: Suite) -> list[Score]:
    """Eight ensembles, each asked for F at one displacement of its own, and eight more for its variance."""
    mean = ensemble.thresholds.mean
    cost = predicted_lives(dataclasses.replace(ensemble, count=1), Drive(v, 5 * mean))
    dear = _DEAR if shown.fluctuates else 1
    least = plan.contacts if plan.contacts * cost < plan.lives / dear else 200
    shown = dataclasses.replace(shown, count=int(min(20_000, max(least, 1e6 / dear / cost))))
    if predicted_lives(shown, Drive(v, 5 * mean)) > 1e8 / dear:  # very low velocity: nothing for a test of minutes
        return []
    exact = transient(ensemble, Drive(v, 5 * mean), points=9)
    squares, drag = _squares(ensemble, v, 5 * mean, exact), _drag(ensemble, v)
    scores = []
    for i in range(1, 9):
        level = float(exact.force[i])
        variance = 0.0 if squares is None else float(squares[0, i]) - level**2
        few = shown.count * _carrying(level, variance, float(exact.pinned[i]), drag)
        if not few >= _ENOUGH:
            continue
        drive = Drive(v, 5 * mean * i / 8)
        run = trajectory(shown, drive, points=2, seed=_stream(seed, i), threads=threads)
        sigma = math.hypot(run.force_stderr[1], exact.force_error[i])
        scores.append(_score("transient", ensemble, v, float(run.force[1]), level, sigma))
        if squares is not None and few >= _ENOUGH_SQUARES:
            group = dataclasses.replace(shown, count=shown.count // _GROUPS)
            # a pilot tells how many contacts make the variance: its relative error is as if so many had equal parts
            pilot, groups = (_about(level, group, drive, _stream(seed, i, turn)) for turn in (1, 2))
            if not pilot.mean() ** 2 * _GROUPS >= _ENOUGH_SQUARES * pilot.var(ddof=1) > 0:
                continue
            found = Estimate(float(groups.mean()), float(groups.std(ddof=1)) / math.sqrt(_GROUPS), 0, _GROUPS - 1)
            off = float(squares[1, i]) + 2 * level * float(exact.force_error[i])
            z = z_score(found, variance, off)
            sigma = math.hypot(found.stderr or 0.0, off)
            scores.append(
                Score("transient variance", ensemble, v, known(found), variance, sigma, math.inf if z is None else z)
            )
    return scores


def _drag(ensemble: Ensemble, v: float) -> float:
    """What a detached contact adds to F/k, if there are any."""
    return ensemble.drag(v) * ensemble.thresholds.scale if ensemble.delay.time else 0.0


def _carrying(level: float, variance: float, pinned: float, drag: float) -> float:
    """The share of contacts that make the mean force `level`, as if each of these did as much: <f>^2/<f^2>, f the force
    above the `drag`, which all detached contacts carry alike. Where pinned contacts are few, or detached ones with
    their drag, it is these that make its fluctuations."""
    share = (level - drag) ** 2 / max((level - drag) ** 2 + variance, 1e-300)
    return min(share, pinned, 1.0 - pinned if drag else 1.0)


def _about(level: float, group: Ensemble, drive: Drive, seed: int) -> Array:
    """The variance of F/k per contact about its expectation, at the end of the drive, in each of _GROUPS groups."""
    forces, variances = _forces(group, drive, _GROUPS, seed)
    return np.asarray((variances + (forces - level) ** 2)[:, 1])


def _squares(ensemble: Ensemble, v: float, distance: float, exact: Transient) -> Array | None:
    """E[(force of a contact / k)^2] at the X of a transient and its error, shape (2, points), by the renewal equation
    (derived), as the transient itself: m_2(x) = x^2 E[(k_i/k)^2; x_b > x] takes the place of m. None if the grid does
    not resolve it."""
    s = setting(ensemble, v)
    unit, points = s.law.scale, exact.X.size
    profile, fine, in_step, _ = grid_of(s, distance / unit, points)
    if in_step.any():
        return None
    solved = []
    for step in (2, 1):
        x = fine[::step]
        means = means_of(profile, x, s)
        births = means.breaks + np.diff(means.pinned) / x[1]
        left = np.append(0.0, x[1:] ** 2 * profile.at(x[1:])[2])
        back = signal.fftconvolve(births, np.diff(profile.integral(x, 2)[2]))[: x.size - 1]
        solved.append((left + np.append(0.0, back) + s.drag**2 * (1.0 - means.pinned))[:: 3 - step])
    best, every = (4 * solved[1] - solved[0]) / 3, (in_step.size - 1) // (points - 1)
    error = np.abs(solved[1] - solved[0]) / 3 + profile.error * np.abs(best)
    return np.stack((best, error))[:, ::every] * unit**2


def _hazard(ensemble: Ensemble, shown: Ensemble, v: float, seed: int) -> list[Score]:
    """Integrated hazards at breaking against Exp(1), censored at each contact's own threshold, two ways.

    A life that ends by heat counts 1; the integrated hazard it went through has the same mean, and is the variance of
    the difference. And of the lives that heat would have ended somewhere before the threshold, a fraction
    U = (1 - exp(-Lambda))/(1 - exp(-Lambda(xi))) ends where they did or earlier: U of those it did end is uniform.
    Of `langevin` contacts S(x_b) is uniform, S the mean over paths.
    """
    s = setting(ensemble, v)
    barrier = s.barrier
    if barrier is None and s.aging != "langevin":
        return []
    rng = np.random.default_rng((seed, 2))
    u, clock = rng.random((2, 20_000)) * (1 - 2e-16) + 1e-16
    if s.aging == "flow":  # hazards along paths are quadratures
        u, clock = u[:4000], clock[:4000]
    c = lower(shown, v)
    _, stretch = lives(c, key(seed, TRAJECTORY), 0, u, clock)
    unit = shown.thresholds.scale / ensemble.thresholds.scale
    if barrier is None or s.aging == "langevin":
        return [_law(ensemble, v, Profile(s, np.empty(0)).at(stretch * unit)[0])]
    xi = np.empty(u.size)
    thresholds(c, u, xi)
    end = xi
    if c.aging == FLOW:
        end = np.empty(u.size)
        flow_ends(c, xi, end, np.empty(u.size))
    thermal = stretch < end * (1.0 - _ROUNDING)
    at = np.stack((np.minimum(stretch, end), end)) * unit
    if s.annealed:
        profile = Profile(s, np.empty(0))
        ahead = np.asarray(s.law.sf(at * s.law.scale))
        hazard, total = -np.log(np.clip(profile.at(at.ravel())[0].reshape(at.shape) / ahead, 1e-300, 1.0))
    elif s.aging == "flow":
        hazard, total = _hazard_along(s, xi * unit, at)
    else:
        a = s.b * relative_stiffness(s.stiffness, at[1], s.law.rms / s.law.scale)
        hazard, total = np.exp(log_hazard(barrier, at, at[1], a) + s.log_w)
    mean = float(hazard.sum())
    scores = []
    if mean >= _ENOUGH:
        scores.append(_score("hazard", ensemble, v, float(thermal.sum()), mean, math.sqrt(mean)))
    if thermal.any():
        scores.append(_law(ensemble, v, np.expm1(-hazard[thermal]) / np.expm1(-total[thermal])))
    return scores


def _law(ensemble: Ensemble, v: float, uniform: Array) -> Score:
    """Whether what should be uniform is."""
    distance, p = stats.kstest(uniform, "uniform")
    z = float(stats.norm.isf(np.clip(p, 1e-300, 1 - 1e-16)))  # low if it is too even
    return Score("hazard law", ensemble, v, float(distance), 0.0, 1 / math.sqrt(uniform.size), z)


def _hazard_along(s: Setting, xi: Array, x: Array) -> Array:
    """Integrated hazards to stretches `x` (any, n) of contacts born with thresholds `xi` (n,) that age by `flow`. The
    rate is greatest at the ends of a life, where the nodes crowd."""
    c = Contact(s.stiffness, s.barrier, s.b, s.log_w, s.final, s.alpha, s.law.rms / s.law.scale)
    found = integrate.tanhsinh(
        lambda y, born: c.rate(y, born * c.aged(y)), 0.0, x, args=(xi,), atol=1e-9, rtol=1e-7, maxlevel=12
    )
    return np.asarray(found.integral)


def _fluctuations(ensemble: Ensemble, shown: Ensemble, v: float, seed: int, size: tuple[int, int]) -> list[Score]:
    """Mean, variance and one autocovariance of F/(N k) of stationary ensembles."""
    s = setting(ensemble, v)
    if s.aging != "none" and s.stiffness == "sqrt":  # no reference
        return []
    contacts, ensembles = size
    if shown.fluctuates:
        contacts = min(contacts, 40_000 // ensembles)
    lag = 0.5 * ensemble.thresholds.mean
    shown = dataclasses.replace(shown, count=contacts)
    if predicted_lives(shown, Drive(v, lag)) * ensembles > (2e8 / _DEAR**2 if shown.fluctuates else 2e8):
        return []
    exact, means, drag = fluctuations(ensemble, v, lag, points=2), reference(ensemble, v), _drag(ensemble, v)
    level = known(means.friction)
    # contacts that make the force in all ensembles together, and of these the share that does after the lag
    carry = contacts * ensembles * _carrying(level, float(exact.covariance[0]), known(means.pinned), drag)
    square, product = exact.covariance + (level - drag) ** 2
    try:
        F, _ = _forces(shown, Drive(v, lag, "stationary"), ensembles, seed)
    except InputError:  # lives too rare and too long to be found, which the engine says
        return []
    first, second = (F - level).T
    births = _REL_ERROR * level if ensemble.self_consistent else 0.0  # what the error of C can do
    scores = []
    if carry >= _ENOUGH:
        sigma = math.hypot(float(first.std()) / math.sqrt(ensembles), births)
        scores.append(_score("mean", ensemble, v, float(F[:, 0].mean()), level, sigma))
    for kind, products, value, few in (
        ("variance", first**2, exact.covariance[0], carry),
        ("covariance", first * second, exact.covariance[1], carry * product / square),
    ):
        if few >= _ENOUGH_SQUARES:
            sigma = float(products.std(ddof=1)) / math.sqrt(ensembles)
            scores.append(_score(kind, ensemble, v, float(products.mean()), float(value) / contacts, sigma))
    return scores


def _forces(ensemble: Ensemble, drive: Drive, ensembles: int, seed: int) -> tuple[Array, Array]:
    """F/(N k) at the beginning and the end of the drive's distance, shape (ensembles, 2), and its variance over the
    contacts of each ensemble."""
    c, n, unit = lower(ensemble, drive.velocity), ensemble.count, ensemble.thresholds.scale
    run = Run(drive.over(ensemble) / unit, 2, drive.start == "stationary", False)
    scales = Scales.of(c, run, n, 1, 0.0)
    job = (c, standing(c) if run.stationary else FRESH, run, scales, key(seed, TRAJECTORY))
    drag = ensemble.drag(drive.velocity)
    forces, variances = np.empty((2, ensembles, 2))
    for index in range(ensembles):
        total = Totals(2, 1)
        simulate(*arguments(job, total), index * n, (index + 1) * n)
        force, _, variance = moments(total.deposits, scales, run, n, drag)
        forces[index], variances[index] = force * unit, variance * unit**2
    return forces, variances


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
            "aging": e.aging.rule,
            "aging_rate": e.aging.rate,
            "x_star_final": e.aging.x_star_final if e.aging.rule != "none" else math.nan,
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
