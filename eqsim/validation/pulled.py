"""Comparisons of a slider that a stage pulls through a spring, where contacts are few,
or where it moves in avalanches:

    hold             pinned share of one or two contacts after a hold of the stage, or of a hundred behind a spring
                     that is all but rigid, against the exact law
    pieces           force or pinned share of 2 to 100 contacts after the same hold, looked at once, against 50 times
    steps            displacement of a slider on 10 to 100 contacts with steps as coarse as allowed, against fine ones
    avalanche        breaks of an avalanche of a quasi-static slider in the mean, against `master.avalanche_sizes`
    single break     fraction of avalanches that are a single break, likewise

The mean field is exact for infinitely many contacts only: a break of one of a few moves
the slider and stretches all others. Without mass and damping the slider is in balance
at any time, N kappa (Y - X) = sum of k_i x_i; in a hold stretches then change at breaks
only, and between them contact i breaks at the constant rate r_i(x_i). With delays much
longer than the hold none is pinned again, and the law of one or two contacts is an
integral over their thresholds (`survivors`, derived), as that of many is behind a
spring so stiff that a break moves the slider by nothing.

Steps are judged by their quoted errors, which hold all that a step four times as long
changes: scores are small. Their order is no matter of a suite; a test of its own knows
it.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from eqsim.engine.records import SliderTrajectory
from eqsim.engine.trajectory import trajectory
from eqsim.estimate import Estimate
from eqsim.laws.aging import Aging
from eqsim.laws.delay import Delay
from eqsim.laws.newborn import Newborn
from eqsim.laws.stiffness import relative_stiffness
from eqsim.laws.threshold import ThresholdLaw
from eqsim.master.avalanche_sizes import load_of, missed_by_few, size_law
from eqsim.model.drive import Programme, Segment, Stage
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.quadrature import gauss_legendre
from eqsim.numerics.tables import Array
from eqsim.validation.comparison import Asked, Found, Point, attempt
from eqsim.validation.points import Suite

HOLD = ("hold",)
PIECES = ("pieces",)
STEPS = ("steps",)
AVALANCHES = ("avalanche", "single break")
KINDS = (*HOLD, *PIECES, *STEPS, *AVALANCHES)

_OCTAVES = range(
    -40, 6
)  # of e = -ln P(xi > .): less than 1e-12 of all thresholds is weaker, 1e-13 stronger
_NODES = {1: 48, 2: 9}  # of Gauss-Legendre in each octave, for one and for two contacts
_CERTAIN = 1e-6  # of a pinned share: by how much a break moves a slider behind an all but rigid spring
_LONGEST = 1e12  # hold, in attempts; beyond, pinned contacts stay
_DENSE = 50  # looks at a hold, against one
_SLIDERS = 2000  # contacts of a slider that slips in avalanches: their cut-off at 4/(1 - rho)^2 breaks is far below
_RUNS = 16  # of such sliders, whose scatter is the error
_GAPS = 1e-4  # by how much the law of sizes may be off where thresholds have gaps
_CARRYING = 400  # breaks that make the force, n <f_s>^2/<f_s^2>, for a mean over them to be normal
# replicas of a single contact, pinned or not, for their mean to be about normal
_FOR_ONE = 50
_RIGID = 100  # contacts behind a spring that is all but rigid


def compared(point: Point, plan: Suite) -> Found:
    """All comparisons of a pulled slider at a point: each kind at its own share of the
    points."""
    index = point.number
    asked: list[Asked] = []
    if index % 24 in (4, 13):
        asked.append((HOLD, holds))
    if index % 13 == 10:
        asked.append((PIECES, pieces))
    if index % 13 == 7:
        asked.append((STEPS, steps))
    if index % 7 == 3:
        asked.append((AVALANCHES, avalanches))
    return attempt(point, plan, asked)


def _plain(ensemble: Ensemble, count: int, delay: Delay) -> Ensemble:
    """So many contacts with the same thresholds, stiffness and heat, without aging and
    viscosity, born unstretched."""
    return dataclasses.replace(
        ensemble, count=count, delay=delay, eta=0.0, aging=Aging(), newborn=Newborn()
    )


# ------------------------------------------------------------------------------------------------------------
# holds


def nodes(law: ThresholdLaw, each: int) -> tuple[Array, Array]:
    """Thresholds and their weights, arrays (n,), for means over the law; `each` in an
    octave of -ln P(xi > .)."""
    if law.steps.size:
        xi, count = np.unique(law.steps, return_counts=True)
        return xi, count / law.steps.size
    x, weight = gauss_legendre(each)
    octave = 2.0 ** np.array(_OCTAVES)[:, None]
    e = (octave * (1.5 + 0.5 * x)).ravel()
    share = (0.5 * octave * weight).ravel() * np.exp(-e)
    return np.asarray(law.inverse_survival(e)), share / share.sum()


def rates(ensemble: Ensemble, xi: Array, stretch: Array) -> Array:
    """Thermal breaking rates, per time, of contacts of those thresholds and stretches
    (any shape), below them."""
    thermal, law = ensemble.thermal, ensemble.thresholds
    if ensemble.disorder == "annealed":  # attempts draw thresholds of their own
        fresh, share = nodes(law, _NODES[1])
        k = ensemble.stiffness * relative_stiffness(
            ensemble.stiffness_law, fresh, law.rms
        )
        at, back = np.unique(stretch, return_inverse=True)
        pooled = [
            float(np.sum(share * _success(thermal.barrier, fresh, k / thermal.kT, x)))
            for x in at
        ]
        return thermal.attempt_frequency * np.array(pooled)[back].reshape(
            np.shape(stretch)
        )
    k = ensemble.stiffness * relative_stiffness(ensemble.stiffness_law, xi, law.rms)
    return thermal.attempt_frequency * _success(
        thermal.barrier, xi, k / thermal.kT, stretch
    )


def _success(barrier: str, xi: Array, k: Array, stretch: Array | float) -> Array:
    """Probability that an attempt breaks a contact (temper11, temper12); `k` over kT."""
    gap = np.clip(1.0 - stretch / xi, 0.0, 1.0)
    height = 0.5 * k * xi**2
    if barrier == "stiff":
        return np.sqrt(gap) * np.exp(-height * gap**1.5)
    return np.where(gap > 0.0, np.exp(-height * gap * (2.0 - gap)), 0.0)


def survivors(ensemble: Ensemble, stage: Stage, each: int) -> Callable[[float], float]:
    """The pinned share as a function of the time of a hold, from a fresh start: of one
    or two contacts, or of many behind a spring that is all but rigid."""
    law, kappa, pull = ensemble.thresholds, stage.stiffness, stage.preload or 0.0
    xi, share = nodes(law, each)
    k = relative_stiffness(ensemble.stiffness_law, xi, law.rms)
    if ensemble.count != 2:
        x = kappa * pull / (kappa + k)
        rate = rates(ensemble, xi, x)
        return lambda time: float(np.sum(share * (x < xi) * np.exp(-rate * time)))
    # a weaker contact, the first index, and a stronger one
    weak, strong = np.meshgrid(xi, xi, indexing="ij")
    both = (
        np.where(weak < strong, 2.0, np.where(weak == strong, 1.0, 0.0))
        * share[:, None]
        * share
    )
    together = 2.0 * kappa * pull / (2.0 * kappa + k[:, None] + k)
    alone = 2.0 * kappa * pull / (2.0 * kappa + k)
    pair = together < weak
    weak_rate, strong_rate = (
        rates(ensemble, weak, together),
        rates(ensemble, strong, together),
    )
    after = rates(ensemble, xi, alone)
    holds_alone = alone < xi

    def pinned(time: float) -> float:
        total = np.where(pair, weak_rate + strong_rate, 0.0)
        left = np.where(pair, 2.0 * np.exp(-total * time), 0.0)
        for goes, last, holds in (
            (weak_rate, after[None, :], holds_alone[None, :]),
            (strong_rate, after[:, None], holds_alone[:, None]),
        ):
            survives = np.where(holds, goes * _between(total, last, time), 0.0)
            left += np.where(pair, survives, 0.0)
        left += np.where(
            ~pair & holds_alone[None, :], np.exp(-after[None, :] * time), 0.0
        )
        return float(np.sum(both * left)) / 2.0

    return pinned


def _between(first: Array, last: Array, time: float) -> Array:
    """int_0^t exp(-first s) exp(-last (t - s)) ds."""
    apart = (first - last) * time
    near = np.abs(apart) < 1e-6
    safe = np.where(near, 1.0, apart)
    slower, faster = np.minimum(first, last) * time, np.abs(safe)
    return (
        time
        * np.exp(-slower)
        * np.where(near, 1.0 - 0.5 * np.abs(apart), -np.expm1(-faster) / faster)
    )


def _hold(
    point: Point, rng: np.random.Generator, kappa: float, tolerance: float
) -> tuple[Stage, float]:
    """A spring that stretches contacts to 0.2 to 0.8 of the mean threshold, and how
    long a hold takes in which about half of those break that hold at first; 0 if they
    stay."""
    stretch = rng.uniform(0.2, 0.8) * point.ensemble.thresholds.mean
    stage = Stage(
        kappa,
        preload=float(f"{stretch * (1.0 + kappa) / kappa:.4g}"),
        tolerance=tolerance,
    )
    pinned = survivors(_plain(point.ensemble, 1, Delay()), stage, _NODES[1])
    aim = pinned(0.0) * rng.uniform(0.3, 0.7)
    low, high = -3.0, math.log10(_LONGEST)
    if pinned(10**high) > aim:
        return stage, 0.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if pinned(10**middle) > aim else (low, middle)
    return stage, float(f"{10**high:.4g}")


def _uniform_if_pooled(ensemble: Ensemble) -> Ensemble:
    """Contacts whose pooled rates take few quadratures: all have the same stretch."""
    return (
        dataclasses.replace(ensemble, stiffness_law="uniform")
        if ensemble.disorder == "annealed"
        else ensemble
    )


def holds(point: Point, plan: Suite) -> Found:
    """The pinned share of one or two contacts after a hold, all detached ones of which
    stay so."""
    ensemble = _uniform_if_pooled(point.ensemble)
    if not ensemble.thermal.kT:
        return []
    point = point._replace(ensemble=ensemble, shown=_uniform_if_pooled(point.shown))
    rng = np.random.default_rng((point.seed, 6))
    stage, time = _hold(point, rng, 10 ** rng.uniform(-1.5, 0.5), plan.tolerance)
    if not time:
        return point.without(HOLD, "few contacts")
    count = int(
        rng.choice([1, 2, _RIGID] if plan.replicas >= _FOR_ONE else [2, _RIGID])
    )
    if count == _RIGID:
        stage, time = _hold(point, rng, 10 ** rng.uniform(6, 12), plan.tolerance)
        if not time:
            return point.without(HOLD, "few contacts")
    waits = Delay(time * 10 ** rng.uniform(6, 12))
    ensemble, shown = (_plain(e, count, waits) for e in (ensemble, point.shown))
    each = _NODES.get(count, _NODES[1])
    value, coarse = (survivors(ensemble, stage, n)(time) for n in (2 * each, each))
    programme = Programme((Segment(0.0, time=time, points=1),), stage=stage)
    run = trajectory(
        shown, programme, points=2, seed=point.stream(6), replicas=plan.replicas
    )
    ours = _last(run.pinned, run.pinned_stderr, plan.replicas)
    if not ours.stderr:
        return point.without(HOLD, "few contacts")
    exact = Estimate(value, abs(value - coarse) + _CERTAIN, 0)
    return [
        point.score(HOLD[0], ours, exact, exact.stderr or 0.0).behind(
            stage, count, time
        )
    ]


def pieces(point: Point, plan: Suite) -> Found:
    """2 to 100 contacts after a hold that is looked at once, and another time often:
    nothing may depend on that."""
    ensemble = _uniform_if_pooled(point.ensemble)
    if not ensemble.thermal.kT:
        return []
    point = point._replace(ensemble=ensemble, shown=_uniform_if_pooled(point.shown))
    rng = np.random.default_rng((point.seed, 7))
    stage, time = _hold(point, rng, 10 ** rng.uniform(-1.5, 0.5), plan.tolerance)
    if not time:
        return point.without(PIECES, "few contacts")
    count = int(rng.choice([2, 5, 10, 30, 100]))
    waits = Delay(
        time * 10 ** float(rng.choice([rng.uniform(-1, 0), rng.uniform(3, 12)]))
    )
    shown = _plain(point.shown, count, waits)
    found = []
    for number, looks in enumerate((1, _DENSE)):
        programme = Programme((Segment(0.0, time=time, points=looks),), stage=stage)
        run = trajectory(
            shown,
            programme,
            points=2,
            seed=point.stream(7, number),
            replicas=plan.replicas,
        )
        found.append(_last(run.pinned, run.pinned_stderr, plan.replicas))
    once, often = found
    if not (once.stderr and often.stderr):
        return point.without(PIECES, "few contacts")
    return [point.score(PIECES[0], once, often, 0.0).behind(stage, count, time)]


def _last(values: Array, errors: Array, replicas: int) -> Estimate:
    """The last of some values with errors from the scatter of replicas."""
    return Estimate(float(values[-1]), float(errors[-1]), replicas, replicas - 1)


# ------------------------------------------------------------------------------------------------------------
# steps


class _Pull(NamedTuple):
    """Displacements of replicas after a pull, (replicas,); what the quoted error of
    their mean has beyond their scatter; the stage and how long it pulls."""

    X: Array
    bias: float
    stage: Stage
    time: float


def _damped(
    point: Point, shown: Ensemble, kappa: float, tolerance: float, replicas: int
) -> _Pull:
    """A slider whose stage moves by 1.5 mean thresholds."""
    v, mean = point.velocity, point.ensemble.thresholds.mean
    stage = Stage(kappa, damping=0.5 * mean / v, tolerance=tolerance)
    programme = Programme((Segment(v, distance=1.5 * mean, points=1),), stage=stage)
    run = trajectory(
        shown, programme, points=2, seed=point.stream(8), replicas=replicas
    )
    assert isinstance(run, SliderTrajectory)
    assert run.X_replicas is not None
    assert run.X_replica_std is not None
    scatter = float(run.X_replica_std[-1]) / math.sqrt(replicas)
    bias = math.sqrt(max(float(run.X_stderr[-1]) ** 2 - scatter**2, 0.0))
    return _Pull(run.X_replicas[:, -1], bias, stage, 1.5 * mean / v)


def steps(point: Point, plan: Suite) -> Found:
    """A damped slider on 10 to 100 contacts: its displacement in steps of the largest
    tolerance and one ten times smaller. With the same random numbers replicas are
    compared one by one, so that what steps cost shows beside their scatter; the error
    is that of the mean difference and what the quoted errors have beyond the scatter of
    replicas."""
    rng, replicas = np.random.default_rng((point.seed, 8)), plan.replicas
    count, kappa = int(rng.choice([10, 30, 100])), float(10 ** rng.uniform(-0.3, 0.7))
    shown = _plain(point.shown, count, Delay())
    loose, tight = (
        _damped(point, shown, kappa, tolerance, replicas) for tolerance in (1e-2, 1e-3)
    )
    bound = math.hypot(loose.bias, tight.bias)
    scatter = float(np.std(loose.X - tight.X, ddof=1)) / math.sqrt(replicas)
    if not math.hypot(scatter, bound):
        return point.without(STEPS, "few contacts")
    ours = Estimate(
        float(loose.X.mean()), math.hypot(scatter, bound), replicas, replicas - 1
    )
    score = point.score(STEPS[0], ours, Estimate(float(tight.X.mean()), 0.0, 0), bound)
    return [score.behind(loose.stage, count, loose.time)]


# -------------------------------------------------------------------------------------------------------
# avalanches


def avalanches(point: Point, plan: Suite) -> Found:
    """Avalanches of sliders that a stage pulls quasi-statically, from a stationary
    start over three mean thresholds."""
    rng = np.random.default_rng((point.seed, 9))
    kappa = float(10 ** rng.uniform(-0.6, 0.6))
    ensemble, shown = (
        dataclasses.replace(
            _plain(e, _SLIDERS, Delay()), thermal=dataclasses.replace(e.thermal, kT=0.0)
        )
        for e in (point.ensemble, point.shown)
    )
    law = ensemble.thresholds
    xi, share = nodes(law, _NODES[1])
    strength = relative_stiffness(ensemble.stiffness_law, xi, law.rms) * xi
    carrying = (
        _SLIDERS
        * _RUNS
        * float(np.sum(share * strength)) ** 2
        / float(np.sum(share * strength**2))
    )
    rho = load_of(law, kappa, ensemble.stiffness_law)
    few = missed_by_few(law, rho, _SLIDERS, ensemble.stiffness_law)
    alone = float(size_law(law, rho, 1, ensemble.stiffness_law)[0])
    programme = Programme(
        (Segment(1.0, distance=3.0 * law.mean, points=1),),
        "stationary",
        1.0,
        Stage(kappa, preload=None),
    )
    if not carrying >= _CARRYING:
        return point.without(AVALANCHES, "few contacts")
    run = trajectory(shown, programme, points=2, seed=point.stream(9), replicas=_RUNS)
    assert isinstance(run, SliderTrajectory)
    assert run.avalanches is not None
    replica, breaks = run.avalanches["replica"], run.avalanches["breaks"]
    events = np.bincount(replica, minlength=_RUNS).astype(float)
    broke = np.bincount(replica, breaks, _RUNS)
    single = np.bincount(replica, breaks == 1, _RUNS)
    stage = programme.stage
    assert stage is not None
    scores: Found = []
    for kind, number, value, missed in (
        (AVALANCHES[0], broke, 1.0 / (1.0 - rho), few.mean),
        (AVALANCHES[1], single, alone, few.single),
    ):
        ratio = float(number.sum() / events.sum())
        residual = (number - ratio * events) / events.mean()
        ours = Estimate(
            ratio, float(np.std(residual, ddof=1)) / math.sqrt(_RUNS), _RUNS, _RUNS - 1
        )
        error = missed * missed / value + _GAPS  # of the second order in 1/n
        score = point.score(kind, ours, Estimate(value + missed, error, 0), error)
        scores.append(score.behind(stage, _SLIDERS, 3.0 * law.mean))
    return scores
