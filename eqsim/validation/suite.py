"""The engine against the master equation: a verdict a sceptic would accept.

A suite draws parameter points with a seeded sampler and compares, point by point, what particles estimate with what the
master equation says, each difference as a score z in units of the quoted errors:

    friction, pinned, break_stretch    steady averages, rel_error 1e-4 (of `langevin` contacts from 65 536 lives)
    transient                          F(X) from a fresh start, every X from its own ensemble, over 5 mean thresholds
                                       or 2 lives and delays
    transient variance                 variance over contacts of the force of one, at the same X
    hazard                             the integrated hazard at breaking is Exp(1): events less hazard, over its root
    hazard law                         the whole law of it, by Kolmogorov and Smirnov, as the normal score of p
    mean, variance, covariance         stationary F/(N k) at N = 20, 100, 10 000, the covariance at half a mean life

A third of the points age, from x_*f/x_*i = 0.01 to 100, and have gamma laws with n from 0 to 10. The others have tables
of 2 to 12 thresholds over up to four decades, samples of up to 500, lognormal, Weibull, Pareto (a finite third moment)
and uniform laws, histograms with gaps, and gamma laws. Velocities are 1e-4 to 100 omega x_*, temperatures 0 or 0.01 to
3 k x_*^2 (of the mean threshold where there is no x_*), delays 0 or 1e-3 to 1e3 mean lives.

Thresholds that fluctuate (`langevin`) are plain Monte Carlo, with steps whose bias is below 1e-3, which is part of the
quoted error: it does little to scores from 65 536 lives, most of which are good to 1e-3 to 5e-3 without it, and counts
where they are better, because thresholds hardly move. Their hazard is not known path by path; the whole law of x_b,
S(x_b) uniform, stands in for it. Fluctuations of aging quenched contacts whose stiffness follows their thresholds (sqrt
law) have no reference. Births of annealed contacts that age are found once a point, with the steady averages, and then
held.

Some quoted errors are bounds: what all randomisations may miss of a few thresholds, tables of laws whose density jumps,
grids where F jumps, because equal thresholds break together. With them |z| is too small to be normal. A score is even
if bounds make less than a fifth of its error, which is known without its value; uneven ones count among the largest
only: with a bias as large as the bound |z| exceeds any t > 2 less often than a normal score does. Means are scored if
as many as 400 contacts carry the force, squares if a pilot says that 1600 do and that no small part of them makes the
error, as with heavy tails.

What is asked for and not scored is counted by reason: refused by the program, called unreliable by it, or too vague, an
error that leaves nothing to compare; too few contacts, too many lives, no reference. A suite in which the program
declines (the first three) more of a kind than is scored does not pass.

Variances are taken about the master's mean, as means of squares. Their scores are the Y of a test suite of stochastic
simulators, (s^2 - sigma^2) over the error of s^2, with that error, ((mu_4 - sigma^4)/n)^(1/2), from the scatter of the
squares in the sample: forces of one contact, or of twenty, are far from normal.

Scores of one kind are independent. A kind passes if the sum of squares of even ones has a chi-square probability above
1e-4 on both sides, and the largest |z| a probability above 1e-4 given their number. With ten kinds and two
probabilities each a correct program fails a suite once in 500 seeds or less often, whatever the correlations between
kinds (Bonferroni).
"""

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy import integrate, ndimage, signal, stats

from eqsim.engine.lanes import lives, typical_lives
from eqsim.engine.recorder import Run, Scales, moments, simulate
from eqsim.engine.stationary import FRESH, flow_ends, standing, thresholds
from eqsim.engine.steady import Steady, steady
from eqsim.numerics.streams import TRAJECTORY, key
from eqsim.engine.trajectory import Totals, arguments, predicted_lives, trajectory
from eqsim.model.ensemble import Drive, Ensemble, lower
from eqsim.errors import InputError
from eqsim.estimate import OBSERVABLES, Estimate, known, z_score
from eqsim.laws.aging import FLOW, Aging, AgingRule
from eqsim.laws.delay import Delay
from eqsim.numerics.tables import Array
from eqsim.laws.stiffness import relative_stiffness
from eqsim.laws.thermal import Thermal, log_hazard
from eqsim.laws.threshold import Distribution, Gamma, Table, ThresholdLaw
from eqsim.master.flow import Contact
from eqsim.master.steady import Setting, reference, setting
from eqsim.master.transient import Profile, Transient, fluctuations, grid_of, means_of, transient

_EACH = 8  # displacements, each with an ensemble of its own
_TRANSIENT = ("transient", "transient variance")
_HAZARD, _FLUCTUATIONS = ("hazard", "hazard law"), ("mean", "variance", "covariance")
KINDS = (*OBSERVABLES, *_TRANSIENT, *_HAZARD, *_FLUCTUATIONS)
LAWS = ("gamma", "few", "lognorm", "sample", "weibull_min", "few", "pareto", "histogram", "uniform")  # without aging
DECLINED = ("refused", "unreliable", "vague")
REASONS = (*DECLINED, "few contacts", "too many lives", "no reference")
ALARM = 1e-4
_REL_ERROR = 1e-4
_ENOUGH = 400  # contacts of either state that carry the force, n <f>^2/<f^2>, for a mean over them to be normal
_ENOUGH_SQUARES = 1600  # and for a mean of squares
_ONE = 0.2  # of the sum of squares of so many normal numbers, the largest makes more once in fifty times
_GROUPS = 64  # of contacts, whose scatter is the error of a variance
_SHARE = 0.2  # of a quoted error that may be a bound: scatter then makes 98 % of it
_VAGUE = 0.1  # a bound, relative to what it bounds, that leaves nothing to compare
_CELLS = 120_000  # of the grid of a transient, times thresholds of a table
_BELOW = 1e-13  # a threshold of a table, relative: contacts that have it still live
_PILOT = 400_000  # contacts, at most
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
    "quick": Suite(32, 6),
    "full": Suite(240, 18),
    "verification": Suite(1008, 91, ((20, 10_000), (100, 10_000), (1000, 10_000)), 10_000, 1e8),
}

Mutation = Callable[[Ensemble], Ensemble]
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Score:
    """One comparison: its kind, the ensemble and velocity, what the engine and the master said, and z; `even` if sigma
    is scatter, so that z is normal; elsewhere bounds add to it, and z is small.

    Of a hazard law these are the distance of Kolmogorov and Smirnov, 0, and n^(-1/2) of n lives."""

    kind: str
    ensemble: Ensemble
    velocity: float
    value: float
    reference: float
    sigma: float
    z: float
    even: bool = True


class Unscored(NamedTuple):
    """A comparison that was asked for and not made, and why: one of `REASONS`, and what the program said."""

    kind: str
    ensemble: Ensemble
    velocity: float
    reason: str
    message: str = ""


Found = list[Score | Unscored]


@dataclass(frozen=True)
class Verdict:
    """Of the `count` scores of a kind, `even` of which make its chi-square: both probabilities, the largest |z|, and
    whether it passes."""

    kind: str
    count: int
    even: int
    chi_square: float
    p_chi_square: float
    largest: float
    p_largest: float
    passed: bool


@dataclass(frozen=True)
class Validation:
    """All scores of a suite, the verdict on each kind, and what was left out."""

    suite: str
    seed: int
    scores: list[Score]
    verdicts: list[Verdict]
    unscored: list[Unscored]

    @property
    def passed(self) -> bool:
        return all(verdict.passed for verdict in self.verdicts) and not self.declined

    @property
    def declined(self) -> list[str]:
        """Kinds of which the program refused more than was scored."""
        left = left_out(self.unscored)
        return [verdict.kind for verdict in self.verdicts if declined(verdict.kind, verdict.count, left)]

    @property
    def p_overall(self) -> float:
        """Probability of a p-value as small as the smallest of all kinds, or an upper bound of it (Bonferroni)."""
        return overall(
            [p for verdict in self.verdicts if verdict.count for p in (verdict.p_chi_square, verdict.p_largest)]
        )


def left_out(unscored: list[Unscored]) -> dict[str, dict[str, int]]:
    """How many comparisons were not made, by kind and reason."""
    found: dict[str, dict[str, int]] = {}
    for one in unscored:
        of = found.setdefault(one.kind, {})
        of[one.reason] = of.get(one.reason, 0) + 1
    return found


def sample(count: int, seed: int, part: tuple[int, int] = (0, 1)) -> Iterator[tuple[int, Ensemble, float]]:
    """Index, ensemble and velocity of points over the whole parameter space, the same for the same seed; of every m-th
    from the i-th on, `part` = (i, m)."""
    rng, laws, aging = (np.random.default_rng((seed, stream)) for stream in (1, 4, 3))
    ages = aging.permutation(count) < count // 3
    kinds = dict(zip(laws.permutation(np.flatnonzero(~ages)).tolist(), itertools.cycle(LAWS), strict=False))
    for index in range(count):
        v = 10 ** rng.uniform(-4, 2)
        kT = 0.0 if index % 10 == 9 else 10 ** rng.uniform(-2, 0.5)
        delay = 0.0 if rng.random() < 0.4 else 10 ** rng.uniform(-3, 3)  # in lives
        law = _thresholds(kinds.get(index, "gamma"), 10 ** rng.uniform(-0.5, 0.5), laws)
        unit = law.scale
        ensemble = Ensemble(
            law,
            Thermal(kT * unit**2, 1.0, ("soft", "stiff")[index // 2 % 2]),
            Delay(0.0, ("fixed", "exponential")[int(rng.integers(2))]),
            stiffness_law=("sqrt", "uniform")[index // 4 % 2],
            disorder=("quenched", "annealed")[index % 2],
            eta=float(rng.choice([0.0, 10 ** rng.uniform(-2, 0) / v])),
        )
        if ages[index]:
            ensemble = _aging(ensemble, v * unit, aging)
        if index % part[1] != part[0]:
            continue  # lives take time
        if delay:
            time = delay * typical_life(ensemble, v * unit) / (v * unit)
            ensemble = dataclasses.replace(ensemble, delay=Delay(time, ensemble.delay.law))
        yield index, ensemble, v * unit


def _thresholds(kind: str, unit: float, rng: np.random.Generator) -> ThresholdLaw:
    """A law of thresholds, `unit` wide, in numbers of four digits: few of them, some several times as likely, over up
    to four decades; a sample of up to 500; shapes of SciPy's laws."""
    if kind == "gamma":
        n = [0.0, 0.5, 1.0, 2.5, rng.uniform(0, 10), rng.uniform(0, 10)][rng.integers(6)]
        return Gamma(float(n), unit)
    if kind == "few":
        low, decades = math.log10(unit), rng.uniform(0.05, 4)
        steps = 10 ** rng.uniform(low - decades / 2, low + decades / 2, rng.integers(2, 13))
        return Table(np.repeat(_brief(steps), rng.integers(1, 4, steps.size) if rng.random() < 0.5 else 1))
    if kind == "sample":
        size = round(10 ** rng.uniform(1.3, 2.7))
        return Table(_brief(unit * rng.lognormal(0.0, rng.uniform(0.1, 0.8), size)))
    if kind == "histogram":
        bins = int(rng.integers(2, 11))
        heights = np.append(rng.integers(0, 10, bins - 1), 1 + rng.integers(10))  # with gaps
        edges = _brief(unit * (rng.choice([0.0, 0.2, 1.0]) + np.append(0.0, np.cumsum(rng.uniform(0.1, 1.0, bins)))))
        return Distribution(stats.rv_histogram((heights, edges), density=True))
    scale, low = (float(x) for x in _brief(np.array([unit, rng.uniform(0.05, 0.95) * unit])))
    if kind == "uniform":
        return Distribution(stats.uniform(low, scale))
    least, most = {"lognorm": (0.1, 1.2), "weibull_min": (0.7, 10.0), "pareto": (3.1, 10.0)}[kind]
    shape = float(_brief(np.exp(rng.uniform(math.log(least), math.log(most)))))
    return Distribution(getattr(stats, kind)(shape, scale=scale))


def _brief(x: Array) -> Array:
    """Rounded to four digits."""
    return np.vectorize(lambda number: float(f"{number:.4g}"))(x)


def law_text(law: ThresholdLaw) -> str:
    """The Python expression that makes a law of `sample`, with eqsim's names and scipy.stats as stats."""
    if isinstance(law, Table):
        return f"Table({law.steps.tolist()})"
    if not isinstance(law, Distribution):
        return repr(law)
    frozen = law.frozen
    if isinstance(frozen, stats.rv_histogram):
        heights, edges = (np.asarray(part).tolist() for part in frozen._histogram)
        return f"Distribution(stats.rv_histogram(({heights}, {edges}), density=True))"
    shape = [*map(repr, frozen.args), *(f"{name}={value!r}" for name, value in frozen.kwds.items())]
    return f"Distribution(stats.{frozen.dist.name}({', '.join(shape)}))"


def typical_life(ensemble: Ensemble, v: float) -> float:
    """About the mean stretch at breaking; births of annealed contacts that age are those of lives as long as the mean
    threshold, which is also the answer where there is no telling."""
    mean = ensemble.thresholds.mean
    try:
        _, stretch = typical_lives(lower(ensemble, v, mean))
    except InputError:
        return mean
    return float(stretch.mean()) * ensemble.thresholds.scale


def _aging(ensemble: Ensemble, v: float, rng: np.random.Generator) -> Ensemble:
    """The same contacts, aging: x_*f/x_*i from 0.01 to 100, D over v and the lesser of x_*i and x_*f from 1e-3 to 10,
    sometimes infinite; sometimes at T = 0."""
    rules: tuple[AgingRule, AgingRule] = ("langevin", "flow")
    unit, rule = ensemble.thresholds.scale, rules[int(rng.integers(2))]
    final = 10 ** rng.uniform(-2, 2) * unit
    rate = 10 ** rng.uniform(-3, 1) * v * min(unit, final)
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
    those of the suite. Averages that call themselves unreliable, and what is refused, are not scored but counted.
    `wrong` changes the ensemble the engine sees but not the reference's: a suite that then still passes is worthless.
    Raises InputError for an unknown suite.
    """
    if suite not in SUITES:
        raise InputError(f"suite = {suite!r}: must be one of " + ", ".join(f'"{name}"' for name in SUITES))
    plan = SUITES[suite]
    total = len(range(part[0], plan.points, part[1]))
    found: Found = []
    for done, (index, ensemble, v) in enumerate(sample(plan.points, seed, part), 1):
        shown = wrong(ensemble) if wrong else ensemble
        found += _compared(_Point(index, ensemble, shown, v, _stream(seed, index)), plan, seed, threads)
        if progress:
            progress(done, total)
    scores = [one for one in found if isinstance(one, Score)]
    unscored = [one for one in found if isinstance(one, Unscored)]
    return Validation(suite, seed, scores, [verdict(kind, scores) for kind in KINDS], unscored)


class _Point(NamedTuple):
    """A point of the parameter space: its number, the ensemble, the one that the engine is shown, and a seed."""

    number: int
    ensemble: Ensemble
    shown: Ensemble
    velocity: float
    seed: int


def _compared(point: _Point, plan: Suite, seed: int, threads: int) -> Found:
    """All comparisons at a point."""
    index, ensemble, shown, v, own = point
    stride = plan.points // plan.wide if plan.wide else 0
    rel_error = 1.0 if shown.fluctuates else _REL_ERROR  # 1.0: the first 65 536 lives will do
    parts: list[tuple[tuple[str, ...], Callable[[], Found]]] = []
    if index % 3 == 0:
        parts.append((_EACH * _TRANSIENT, lambda: _transient(ensemble, shown, v, own, threads, plan)))
    if index % 3 == 1:
        parts.append((_HAZARD, lambda: _hazard(ensemble, shown, v, own)))
    if stride and index % stride == 2:
        size = plan.sizes[index // stride % len(plan.sizes)]
        parts.append((_FLUCTUATIONS, lambda: _fluctuations(ensemble, shown, v, own, size)))
    try:
        averages = steady(shown, v, rel_error=rel_error, seed=seed, threads=threads)
        shown = _held(shown, v, averages)
        found = _averages(ensemble, shown, v, averages)
    except InputError as error:
        asked = (*OBSERVABLES, *(kind for kinds, _ in parts for kind in kinds))
        return _all(asked, ensemble, v, "refused", str(error))
    for kinds, part in parts:
        try:
            found += part()
        except InputError as error:
            found += _all(kinds, ensemble, v, "refused", str(error))
    return found


def _all(kinds: tuple[str, ...], ensemble: Ensemble, v: float, reason: str, message: str = "") -> Found:
    """None of these comparisons made."""
    return [Unscored(kind, ensemble, v, reason, message) for kind in kinds]


def _stream(*numbers: int) -> int:
    """A seed of its own for all that draws."""
    return int(np.random.SeedSequence(numbers).generate_state(1, np.uint64)[0] >> 1)


def overall(p: list[float]) -> float:
    """Of the smallest of several p-values, however they depend on each other: an upper bound (Bonferroni)."""
    return min(1.0, len(p) * min(p, default=1.0))


def declined(kind: str, scores: int, left: dict[str, dict[str, int]]) -> bool:
    """Whether the program would not do, or not be trusted with, more comparisons of a kind than were made."""
    return sum(left.get(kind, {}).get(reason, 0) for reason in DECLINED) > scores


def verdict(kind: str, scores: list[Score]) -> Verdict:
    """Chi-square of the even scores of a kind, and largest |z| of all."""
    of_kind = [score for score in scores if score.kind == kind]
    if not of_kind:
        return Verdict(kind, 0, 0, 0.0, 1.0, 0.0, 1.0, True)
    z = np.array([score.z for score in of_kind])
    even = z[[score.even for score in of_kind]]
    total, largest = float(np.sum(even**2)), float(np.abs(z).max())
    p_square = 2 * min(stats.chi2.cdf(total, even.size), stats.chi2.sf(total, even.size)) if even.size else 1.0
    p_largest = -math.expm1(z.size * math.log1p(-min(2 * stats.norm.sf(largest), 1 - 1e-16)))
    passed = bool(p_square > ALARM and p_largest > ALARM)
    return Verdict(kind, z.size, even.size, total, float(p_square), largest, p_largest, passed)


def _score(
    kind: str, ensemble: Ensemble, v: float, ours: Estimate, exact: float, error: float, bound: float
) -> Score | Unscored:
    """An estimate against an exact value with its error; of both quoted errors, so much is a `bound`."""
    sigma, z = math.hypot(ours.stderr or 0.0, error), z_score(ours, exact, error)
    even = bound <= _SHARE * sigma
    if not even and bound > _VAGUE * abs(exact):
        return Unscored(kind, ensemble, v, "vague")
    return Score(kind, ensemble, v, known(ours), exact, sigma, math.inf if z is None else z, even)


def _averages(ensemble: Ensemble, shown: Ensemble, v: float, found: Steady) -> Found:
    exact = reference(ensemble, v)
    scores: Found = []
    for name in OBSERVABLES:
        ours, theirs = getattr(found, name), getattr(exact, name)
        if name == "pinned" and ensemble.delay.time == shown.delay.time == 0:
            continue  # 1, exactly
        if not ours.reliable:  # and says so
            scores.append(Unscored(name, ensemble, v, "unreliable"))
            continue
        response = known(ours) * (1.0 - known(ours) if name == "pinned" else 1.0)
        hidden = found.hidden * response
        scatter = math.sqrt(max(ours.stderr**2 - hidden**2, 0.0))
        if shown.fluctuates and scatter > hidden:  # what steps may cost is a bound, mostly far from reached
            ours, hidden = dataclasses.replace(ours, stderr=scatter), 0.0
        bound = math.hypot(hidden, theirs.stderr)
        scores.append(_score(name, ensemble, v, ours, known(theirs), theirs.stderr, bound))
    return scores


def _transient(ensemble: Ensemble, shown: Ensemble, v: float, seed: int, threads: int, plan: Suite) -> Found:
    """Eight ensembles, each asked for F at one displacement of its own, and eight more for its variance: over five mean
    thresholds, or over two lives and delays."""
    typical = reference(ensemble, v)
    distance = 5 * ensemble.thresholds.mean
    if seed % 2:
        distance = 2 * (known(typical.break_stretch) + v * ensemble.delay.time)
    cost = predicted_lives(dataclasses.replace(ensemble, count=1), Drive(v, distance))
    dear = _DEAR if shown.fluctuates else 1
    least = plan.contacts if plan.contacts * cost < plan.lives / dear else 200
    shown = dataclasses.replace(shown, count=int(min(20_000, max(least, 1e6 / dear / cost))))
    if predicted_lives(shown, Drive(v, distance)) > 1e8 / dear:  # very low velocity: nothing for a test of minutes
        return _all(_EACH * _TRANSIENT, ensemble, v, "too many lives")
    # near jumps of F the error is what a few cells of the grid make of it
    steps = ensemble.thresholds.steps.size
    every = max(1, _CELLS // (_EACH * max(12, steps))) if steps else 1
    exact = transient(ensemble, Drive(v, distance), points=_EACH * every + 1)
    squares, drag = _squares(ensemble, v, distance, exact), _drag(ensemble, v)
    if squares is None:
        return _all(_EACH * _TRANSIENT, ensemble, v, "vague")
    scores: Found = []
    for i in range(1, _EACH + 1):
        level, off = float(exact.force[i * every]), float(exact.force_error[i * every])
        variance = float(squares[0, i * every]) - level**2
        few = shown.count * _carrying(level, variance, float(exact.pinned[i * every]), drag)
        # few that have broken make the variance if all others have the same force; the law of `langevin` contacts is
        # not known well enough to say how large it is
        broken = shown.count * variance / max(level**2, 1e-300)
        if not (min(few, broken) if shown.fluctuates else few) >= _ENOUGH:
            scores += _all(_TRANSIENT, ensemble, v, "few contacts")
            continue
        drive = Drive(v, distance * i / _EACH)
        run = trajectory(shown, drive, points=2, seed=_stream(seed, i), threads=threads)
        ours = Estimate(float(run.force[1]), float(run.force_stderr[1]), shown.count)
        if run.force_reliable:
            scores.append(_score("transient", ensemble, v, ours, level, off, off))
        else:
            scores += _all(_TRANSIENT[:1], ensemble, v, "unreliable")
        group = dataclasses.replace(shown, count=shown.count // _GROUPS)
        # a pilot tells how many contacts make the variance: its relative error is as if so many had equal parts
        if min(few, broken) < _ENOUGH_SQUARES or not _many(_about(level, group, drive, _stream(seed, i, 1))):
            scores += _all(_TRANSIENT[1:], ensemble, v, "few contacts")
            continue
        groups = _about(level, group, drive, _stream(seed, i, 2))
        ours = Estimate(float(groups.mean()), float(groups.std(ddof=1)) / math.sqrt(_GROUPS), 0, _GROUPS - 1)
        off = float(squares[1, i * every]) + 2 * level * off
        scores.append(_score("transient variance", ensemble, v, ours, variance, off, off))
    return scores


def _many(pilot: Array) -> bool:
    """Whether many contacts make the mean of squares of which a pilot found these, in _GROUPS groups: its relative
    error is as if _ENOUGH_SQUARES had equal parts, and is not of one group (as with tails so heavy that there is no
    error)."""
    off = (pilot - pilot.mean()) ** 2
    return bool(pilot.mean() ** 2 * _GROUPS >= _ENOUGH_SQUARES * pilot.var(ddof=1) > 0 and off.max() < _ONE * off.sum())


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
    best, cells = (4 * solved[1] - solved[0]) / 3, in_step.size - 1
    error = ndimage.maximum_filter1d(np.abs(solved[1] - solved[0]), cells // 20) + profile.error * np.abs(best)
    if profile.steps:  # jumps, as in the transient itself
        error += ndimage.maximum_filter1d(solved[0], 5) - ndimage.minimum_filter1d(solved[0], 5)
    every = cells // (points - 1)
    return np.stack((best, error))[:, ::every] * unit**2


def _hazard(ensemble: Ensemble, shown: Ensemble, v: float, seed: int) -> Found:
    """Integrated hazards at breaking against Exp(1), censored at each contact's own threshold, two ways.

    A life that ends by heat counts 1; the integrated hazard it went through has the same mean, and is the variance of
    the difference. And of the lives that heat would have ended somewhere before the threshold, a fraction
    U = (1 - exp(-Lambda))/(1 - exp(-Lambda(xi))) ends where they did or earlier: U of those it did end is uniform.
    Of `langevin` contacts S(x_b) is uniform, S the mean over paths.
    """
    s = setting(ensemble, v)
    barrier = s.barrier
    if barrier is None and s.aging != "langevin":
        return []  # no hazard
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
        hazard, total = _hazard_pooled(s, at)
    elif s.aging == "flow":
        hazard, total = _hazard_along(s, xi * unit, at)
    else:
        a = s.b * relative_stiffness(s.stiffness, at[1], s.law.rms / s.law.scale)
        hazard, total = np.exp(log_hazard(barrier, at, at[1], a) + s.log_w)
    mean = float(hazard.sum())
    scores: Found = []
    if mean >= _ENOUGH:
        ours = Estimate(float(thermal.sum()), math.sqrt(mean), u.size)
        scores.append(_score("hazard", ensemble, v, ours, mean, 0.0, 0.0))
    if thermal.any():
        scores.append(_law(ensemble, v, np.expm1(-hazard[thermal]) / np.expm1(-total[thermal])))
    done = [score.kind for score in scores]
    return scores + _all(tuple(kind for kind in _HAZARD if kind not in done), ensemble, v, "few contacts")


def _hazard_pooled(s: Setting, x: Array) -> Array:
    """Integrated hazards of annealed contacts to stretches `x`, any shape: -ln of survival over J_c, just below x,
    where a discrete law still has the threshold x."""
    below = np.sort(x.ravel()) * (1.0 - _BELOW) if s.law.steps.size else np.sort(x.ravel())
    ahead = np.maximum(s.law.sf(below * s.law.scale), 1e-300)  # a threshold that cannot be is no survivor
    alive = Profile(s, np.empty(0)).at(below)[0] / ahead
    found = np.empty(x.size)
    found[np.argsort(x.ravel())] = -np.log(np.clip(alive, 1e-300, 1.0))
    return found.reshape(x.shape)


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


def _fluctuations(ensemble: Ensemble, shown: Ensemble, v: float, seed: int, size: tuple[int, int]) -> Found:
    """Mean, variance and one autocovariance of F/(N k) of stationary ensembles. Raises InputError where lives are too
    rare and too long to be found."""
    s = setting(ensemble, v)
    if s.aging != "none" and s.stiffness == "sqrt":
        return _all(_FLUCTUATIONS, ensemble, v, "no reference")
    contacts, ensembles = size
    if shown.fluctuates:
        contacts = min(contacts, 40_000 // ensembles)
    means, drag = reference(ensemble, v), _drag(ensemble, v)
    level, lag = known(means.friction), 0.5 * known(means.break_stretch)
    shown = dataclasses.replace(shown, count=contacts)
    if predicted_lives(shown, Drive(v, lag)) * ensembles > (2e8 / _DEAR**2 if shown.fluctuates else 2e8):
        return _all(_FLUCTUATIONS, ensemble, v, "too many lives")
    exact = fluctuations(ensemble, v, lag, points=2)
    # contacts that make the force in all ensembles together, and of these the share that does after the lag
    carry = contacts * ensembles * _carrying(level, float(exact.covariance[0]), known(means.pinned), drag)
    square, product = (exact.covariance + (level - drag) ** 2).tolist()
    of_squares = carry / _ENOUGH_SQUARES
    enough = {"mean": carry / _ENOUGH, "variance": of_squares, "covariance": of_squares * product / square}
    drive, at_once = Drive(v, lag, "stationary"), Drive(v, 1e-6 * lag, "stationary")
    group = dataclasses.replace(shown, count=max(1, min(contacts * ensembles, _PILOT) // _GROUPS))
    if enough["variance"] >= 1.0 and not _many(_about(level, group, at_once, _stream(seed, 1))):
        enough["variance"] = enough["covariance"] = 0.0
    if enough["mean"] < 1.0:
        return _all(_FLUCTUATIONS, ensemble, v, "few contacts")
    F, _ = _forces(shown, drive, ensembles, seed)
    first, second = (F - level).T
    births = _REL_ERROR * level if ensemble.self_consistent else 0.0  # what the error of C can do
    scores: Found = []
    for kind, terms, value, error in (
        ("mean", F[:, 0], level, math.hypot(births, means.friction.stderr or 0.0)),
        ("variance", first**2, float(exact.covariance[0]) / contacts, float(exact.error[0]) / contacts),
        ("covariance", first * second, float(exact.covariance[1]) / contacts, float(exact.error[1]) / contacts),
    ):
        if enough[kind] < 1.0:
            scores += _all((kind,), ensemble, v, "few contacts")
            continue
        ours = Estimate(float(terms.mean()), float(terms.std(ddof=1)) / math.sqrt(ensembles), ensembles)
        scores.append(_score(kind, ensemble, v, ours, value, error, error))
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
        e = score.ensemble
        row = {
            "kind": score.kind,
            "disorder": e.disorder,
            "barrier": e.thermal.barrier,
            "stiffness_law": e.stiffness_law,
            "thresholds": law_text(e.thresholds),
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
            "even": score.even,
        }
        for name, value in row.items():
            table.setdefault(name, []).append(value)
    return table
