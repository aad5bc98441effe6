"""Parameter points of a suite, by a seeded sampler.

In a third of the points thresholds drift, from x_*f/x_*i = 0.01 to 100, and have gamma
laws with n from 0 to 10. The others have, in turn, gamma laws; tables of 2 to 12
thresholds over up to four decades, of two, and of a single one; samples of up to 500;
lognormal laws (sigma 0.1 to 2), Weibull laws (shape 0.4 to 10: at low ones the density
is infinite at 0) and Pareto laws (exponent 3.05 to 10: a finite third moment); uniform,
triangular and log-Laplace laws, whose densities have jumps and kinks; beta laws with
infinite densities at both ends; histograms with gaps; and narrow laws (standard
deviation over mean 1e-3 to 0.02); some bonds have none. A third of the quenched ones among these grow as the
logarithm of their age, by 1e-3 to 3 per e-fold, from 1e-6 to 100 x_*/v on. Velocities
are 1e-4 to 100 omega x_*, temperatures 0 or 0.01 to 3 k x_*^2 (of the mean threshold
where there is no x_*), delays 0 or 1e-3 to 1e3 mean lives. Of larger suites a
share of the contacts that heat breaks are those of a laboratory, with e^9 to e^40
attempts in a slip of x_*, and barriers from there up to 1e9 kT.
"""

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import stats

from eqsim.engine.contacts import contacts
from eqsim.engine.sample import typical_lives
from eqsim.errors import InputError
from eqsim.laws.aging import RULES, Aging
from eqsim.laws.aging.base import Drift
from eqsim.laws.barrier import BARRIERS
from eqsim.laws.barrier.pooled import has_thin_tail
from eqsim.laws.delay import DELAYS, PARAMETERS, Delay
from eqsim.laws.named import Lognormal
from eqsim.laws.newborn import Newborn
from eqsim.laws.no_thresholds import NoThresholds
from eqsim.laws.thermal import Pathway, Thermal
from eqsim.laws.threshold import Delta, Distribution, Gamma, Table, ThresholdLaw
from eqsim.model.ensemble import Ensemble

# Laws of thresholds that do not drift, in turn.
DRAWN_LAWS = (
    *("gamma", "few", "lognorm", "sample", "weibull_min", "two", "pareto", "histogram"),
    *("uniform", "arcsine", "triang", "loglaplace", "few", "delta", "narrow"),
)

# Ranges of the shape of laws of SciPy.
_SHAPES = {
    "lognorm": (0.1, 2.0),
    "weibull_min": (0.4, 10.0),
    "pareto": (3.05, 10.0),
    "loglaplace": (3.1, 20.0),
}


class Suite(NamedTuple):
    """Size of a suite: `points` parameter points, `wide` of which are also tested for
    fluctuations, with `sizes` (contacts, ensembles) in turn; at least so many `contacts`
    in a transient unless they take more than `lives` lives; and `replicas` of sliders on
    a few contacts behind a spring, whose steps in holds have a `tolerance`; and the
    share of `solids`, contacts of a laboratory. Or it is of `chains` of blocks alone.
    """

    points: int
    wide: int
    sizes: tuple[tuple[int, int], ...] = ((20, 2000), (100, 1000), (2000, 1000))
    contacts: int = 200
    lives: float = 1e6
    replicas: int = 24
    tolerance: float = 1e-4
    solids: float = 0.0
    chains: int = 0


SUITES = {
    "quick": Suite(32, 6, replicas=12, tolerance=1e-3),
    "full": Suite(240, 18, replicas=60, solids=0.25),
    "interface": Suite(0, 0, chains=16),
    "verification": Suite(
        *(1008, 91, ((20, 10_000), (100, 10_000), (1000, 10_000)), 10_000, 2e7, 200),
        solids=0.25,
    ),
}


class Part(NamedTuple):
    """Every `step`-th point, from number `first` on; by default all."""

    first: int = 0
    step: int = 1


WHOLE = Part()


def sample(
    count: int, seed: int, part: Part = WHOLE, solids: float = 0.0
) -> Iterator[tuple[int, Ensemble, float]]:
    """Index, ensemble and velocity of the points of a seed, all over the parameter
    space, a share of them `solids`; of all points or of a `part` of them."""
    first, step = part
    rng, laws, aging, growing, newborn, waits, high = (
        np.random.default_rng((seed, stream)) for stream in (1, 4, 3, 5, 6, 7, 8)
    )
    ages = aging.permutation(count) < count // 3
    others = laws.permutation(np.flatnonzero(~ages)).tolist()
    kinds = dict(zip(others, itertools.cycle(DRAWN_LAWS), strict=False))
    barriers = tuple(BARRIERS)
    for index in range(count):
        v = 10 ** rng.uniform(-4, 2)
        kT = 0.0 if index % 10 == 9 else 10 ** rng.uniform(-2, 0.5)
        delay = 0.0 if rng.random() < 0.4 else 10 ** rng.uniform(-3, 3)  # in lives
        kind, unit = kinds.get(index, "gamma"), 10 ** rng.uniform(-0.5, 0.5)
        law = _drawn_thresholds(kind, unit, laws)
        unit = law.scale
        ensemble = Ensemble(
            law,
            _heat(barriers[index // 2 % len(barriers)], kT, unit),
            _drawn_delay(bool(rng.integers(2)), waits),
            stiffness_law=("sqrt", "uniform")[index // 4 % 2],
            disorder=("quenched", "annealed")[index % 2],
            eta=float(rng.choice([0.0, 10 ** rng.uniform(-2, 0) / v])),
        )
        if ages[index]:
            ensemble = _aging(ensemble, v * unit, aging)
        elif ensemble.disorder == "quenched" and growing.random() < 1 / 3:
            beta, slid = 10 ** growing.uniform(-3, 0.5), 10 ** growing.uniform(-6, 2)
            grows = Aging("logarithmic", beta=beta, cutoff_time=slid / v)
            ensemble = replace(ensemble, aging=grows)
        elif newborn.random() < 1 / 4:
            ensemble = _stretched_at_birth(ensemble, newborn)
        if ensemble.thermal.active and high.random() < solids:
            heat = _heat_of_solids(ensemble.thermal.barrier, v, unit, high)
            ensemble = replace(ensemble, thermal=heat)
        if index % 3 == 0 and _may_lack_thresholds(ensemble):
            ensemble = replace(ensemble, thresholds=NoThresholds(unit))
        if not _has_mean_rates(ensemble):
            ensemble = replace(ensemble, stiffness_law="uniform")
        if index not in range(first, count, step):
            continue  # before lives are sampled, which takes time
        if delay:
            time = delay * typical_life(ensemble, v * unit) / (v * unit)
            ensemble = replace(ensemble, delay=replace(ensemble.delay, time=time))
        yield index, ensemble, v * unit


def _drawn_delay(random: bool, rng: np.random.Generator) -> Delay:
    """A law of delays, fixed unless `random`; the delay is 0 so far."""
    if not random:
        return Delay()
    law = str(rng.choice([name for name in DELAYS if name != "fixed"]))
    name, least, most = PARAMETERS.get(law, ("", 1.0, 1.0))
    given = {name: float(np.exp(rng.uniform(np.log(least), np.log(most))))}
    return Delay(0.0, law, **(given if name else {}))


def _heat(barrier: str, kT: float, unit: float) -> Thermal:
    """Heat at kT, over k unit^2. Rates of bonds rise by as much up to a stretch of
    `unit` as those of others, to about 1."""
    if not kT or not BARRIERS[barrier].by_force:
        return Thermal(kT * unit**2, 1.0, barrier if kT else "soft")
    rate, force = math.exp(-0.5 / kT), 2.0 * kT * unit
    if barrier == "bell":
        return Thermal(barrier=barrier, off_rate=rate, force_scale=force)
    catch, slip = Pathway(1.0, 0.3 * unit), Pathway(rate, force)
    return Thermal(barrier=barrier, catch=catch, slip=slip)


def _heat_of_solids(
    barrier: str, v: float, unit: float, rng: np.random.Generator
) -> Thermal:
    """Heat that breaks contacts at a small part of their attempts. Off-rates of bonds
    come to about v/unit at a stretch between a half and twice of `unit`; a catch
    pathway may break three, or next to none, before."""
    log_attempts = rng.uniform(9.0, 40.0)
    if not BARRIERS[barrier].by_force:
        b = math.exp(rng.uniform(math.log(log_attempts), math.log(1e9)))
        attempts = v * math.exp(log_attempts)
        return Thermal(0.5 * unit**2 / b, attempts, barrier)
    rate, force = v * math.exp(-log_attempts), unit / log_attempts
    force *= rng.uniform(0.5, 2.0)
    if barrier == "bell":
        return Thermal(barrier=barrier, off_rate=rate, force_scale=force)
    closing = 10 ** rng.uniform(-3.0, -1.0)
    catch = Pathway(rng.uniform(0.0, 3.0) * v / closing, closing * unit)
    return Thermal(barrier=barrier, catch=catch, slip=Pathway(rate, force))


def _may_lack_thresholds(ensemble: Ensemble) -> bool:
    by_force = BARRIERS[ensemble.thermal.barrier].by_force
    fractions = ensemble.newborn.active and ensemble.newborn.of == "threshold"
    return by_force and not ensemble.aging.active and not fractions


def _has_mean_rates(ensemble: Ensemble) -> bool:
    """False for annealed bonds that are refused, as rare strong ones break too fast."""
    pooled = ensemble.disorder == "annealed" and ensemble.stiffness_law == "sqrt"
    by_force = BARRIERS[ensemble.thermal.barrier].by_force
    return not (pooled and by_force) or has_thin_tail(ensemble.thresholds)


def _drawn_thresholds(kind: str, unit: float, rng: np.random.Generator) -> ThresholdLaw:
    """A law of thresholds, `unit` wide, in numbers of four digits: few of them, some
    several times as likely, over up to four decades; a sample of up to 500; shapes of
    SciPy's laws."""
    if kind == "gamma":
        orders = [0.0, 0.5, 1.0, 2.5, rng.uniform(0, 10), rng.uniform(0, 10)]
        return Gamma(float(orders[rng.integers(6)]), unit)
    if kind == "delta":
        return Delta(*_brief(unit))
    if kind == "two":
        both = _brief(unit, unit * 10 ** rng.uniform(0.01, 2))
        return Table(np.repeat(both, rng.integers(1, 6, 2)))
    if kind == "narrow":
        width, scale = _brief(10 ** rng.uniform(-3, -1.7), unit)
        if rng.random() < 0.5:
            return Lognormal(width, scale)
        return Gamma(float(round(0.25 / width**2)), scale)
    if kind == "few":
        middle, half = math.log10(unit), rng.uniform(0.05, 4) / 2
        steps = 10 ** rng.uniform(middle - half, middle + half, rng.integers(2, 13))
        times = rng.integers(1, 4, steps.size) if rng.random() < 0.5 else 1
        return Table(np.repeat(_brief(*steps), times))
    if kind == "sample":
        size = round(10 ** rng.uniform(1.3, 2.7))
        return Table(_brief(*unit * rng.lognormal(0.0, rng.uniform(0.1, 0.8), size)))
    if kind == "histogram":
        bins = int(rng.integers(2, 11))
        # with gaps
        heights = np.append(rng.integers(0, 10, bins - 1), 1 + rng.integers(10))
        first = rng.choice([0.0, 0.2, 1.0])
        widths = np.append(0.0, np.cumsum(rng.uniform(0.1, 1.0, bins)))
        edges = _brief(*unit * (first + widths))
        law = stats.rv_histogram((heights, edges), density=True)
        law.histogram = heights, edges  # for `law_text`
        return Distribution(law)
    scale, low = _brief(unit, rng.uniform(0.05, 0.95) * unit)
    if kind == "uniform":
        return Distribution(stats.uniform(low, scale))
    if kind == "arcsine":
        shapes = [0.5, 0.5]
        if rng.random() < 0.5:
            shapes = _brief(*rng.uniform(0.4, 0.9, 2))
        return Distribution(stats.beta(*shapes, loc=low, scale=scale))
    if kind == "triang":
        peak = _brief(rng.uniform(0.0, 1.0))
        return Distribution(stats.triang(*peak, loc=low, scale=scale))
    least, most = _SHAPES[kind]
    shape = _brief(float(np.exp(rng.uniform(math.log(least), math.log(most)))))
    return Distribution(getattr(stats, kind)(*shape, scale=scale))


def _stretched_at_birth(ensemble: Ensemble, rng: np.random.Generator) -> Ensemble:
    """The same contacts, with thresholds of a gamma law (references of others take
    long), born stretched by up to about a typical one, along the motion or against it.
    """
    unit = ensemble.thresholds.scale
    thresholds = Gamma(float(rng.choice([0.0, 0.5, 1.0, 2.5])), unit)
    (size,), kind = _brief(10 ** rng.uniform(-1.5, 0)), rng.integers(6)
    sign = float(rng.choice([-1.0, 1.0]))
    low, high = sorted(_brief(*rng.uniform(-1.0, 1.0, 2)))
    laws = (
        Newborn("delta", stretch=sign * size * unit),
        Newborn("uniform", low=low * size * unit, high=high * size * unit),
        Newborn("exponential", mean=0.3 * size * unit),
        Newborn("normal", mean=0.3 * sign * size * unit, std=0.3 * size * unit),
        Newborn("delta", "threshold", stretch=0.9 * sign * size),
        Newborn("uniform", "threshold", low=low, high=high),
    )
    return replace(ensemble, thresholds=thresholds, newborn=laws[kind])


def _brief(*numbers: float) -> list[float]:
    """Numbers rounded to four digits."""
    return [float(f"{number:.4g}") for number in numbers]


def _aging(ensemble: Ensemble, v: float, rng: np.random.Generator) -> Ensemble:
    """The same contacts, aging by drift: x_*f/x_*i from 0.01 to 100, D over v and the
    lesser of x_*i and x_*f from 1e-3 to 10, sometimes infinite; sometimes at T = 0."""
    rules = tuple(rule for rule, law in RULES.items() if issubclass(law, Drift))
    unit, rule = ensemble.thresholds.scale, rules[int(rng.integers(len(rules)))]
    final = 10 ** rng.uniform(-2, 2) * unit
    rate = 10 ** rng.uniform(-3, 1) * v * min(unit, final)
    at_once, cold = rng.random() < 0.15, rng.random() < 0.25
    if at_once and (ensemble.disorder == "annealed" or not RULES[rule].fluctuates):
        rate, rule = math.inf, "flow"  # annealed contacts do not tell rules apart
    if cold:
        ensemble = replace(ensemble, thermal=Thermal())
    return replace(ensemble, aging=Aging(rule, rate, final))


def typical_life(ensemble: Ensemble, v: float) -> float:
    """About the mean travel of a life, with births of annealed contacts that age as of
    lives as long as the mean threshold; the mean threshold where lives cannot be
    sampled."""
    mean = ensemble.thresholds.mean
    try:
        travel = typical_lives(contacts(ensemble, v, mean)).travel
    except InputError:
        return mean
    return float(travel.mean()) * ensemble.thresholds.scale


def law_text(law: ThresholdLaw) -> str:
    """The Python expression that makes a law of `sample`, with eqsim's names and
    scipy.stats as stats."""
    if isinstance(law, Table):
        return f"Table({law.steps.tolist()})"
    if not isinstance(law, Distribution):
        return repr(law)
    frozen = law.frozen
    if isinstance(frozen, stats.rv_histogram):
        heights, edges = (np.asarray(part).tolist() for part in frozen.histogram)
        return f"Distribution(stats.rv_histogram(({heights}, {edges}), density=True))"
    shape = [repr(value) for value in frozen.args]
    shape += [f"{name}={value!r}" for name, value in frozen.kwds.items()]
    return f"Distribution(stats.{frozen.dist.name}({', '.join(shape)}))"
