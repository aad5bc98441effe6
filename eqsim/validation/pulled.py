"""Comparisons of a slider that a stage pulls through a spring, where contacts are few,
or where it moves in avalanches. Each function says what it compares.

The mean field is exact for infinitely many contacts only: a break of one of a few moves
the slider and stretches all others. Without mass and damping the slider is in balance
at any time, N kappa (Y - X) = sum of k_i x_i; in a hold stretches then change at breaks
only, and between them contact i breaks at the constant rate r_i(x_i). With delays much
longer than the hold none is pinned again, and the law of one or two contacts is an
integral over their thresholds (`pinned_in_hold`, derived), as that of many is behind a
spring so stiff that a break moves the slider by nothing.

Steps are scored by their quoted errors, which include all that a step four times as
long changes, so that scores are small. Another test finds their order.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import optimize, special

from eqsim.engine.records import SliderTrajectory
from eqsim.engine.trajectory import trajectory
from eqsim.estimate import Estimate, known, mean_of
from eqsim.laws.aging import Aging
from eqsim.laws.delay import Delay
from eqsim.laws.newborn import Newborn
from eqsim.laws.no_thresholds import NoThresholds
from eqsim.laws.stiffness import relative_stiffness
from eqsim.laws.thermal import Thermal
from eqsim.laws.threshold import Delta
from eqsim.master.annealed import successful_attempts
from eqsim.master.avalanche_sizes import load_of, missed_by_few, nodes_of, size_law
from eqsim.master.lifetimes import lifetime
from eqsim.master.quenched import kappa_of
from eqsim.model.drive import Programme, Segment, Stage
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import Reduced, reduced
from eqsim.numerics.tables import Array
from eqsim.validation.comparison import Found, LeftOut, Point, compares
from eqsim.validation.points import Suite

# Gauss-Legendre nodes in each octave of -ln P(xi > .), for one and for two contacts.
_PER_OCTAVE = {1: 48, 2: 9}
# Error of a pinned share from the motion of an all but rigid slider when contacts break.
_MOVED_BY_BREAK = 1e-6
# Shortest hold, in attempts; contacts that break before leave nothing to compare.
_SHORTEST_HOLD = 1e-3
# Longest hold, in attempts; beyond, pinned contacts stay.
_LONGEST_HOLD = 1e12
# Records of a hold, compared with one record at its end.
_LOOKS = 50
# Contacts of a slider that slips in avalanches: far more than their cut-off at
# 4/(1 - rho)^2 breaks.
_AVALANCHING = 2000
# Sliders that slip in avalanches, whose scatter is the error.
_SLIDERS = 16
# Error of the law of sizes where thresholds have gaps.
_GAPS = 1e-4
# Breaks that make the force, n <f_s>^2/<f_s^2>, for a mean over them to be normal.
_CARRYING = 400
# Replicas of a single contact, pinned or not, for their mean to be about normal.
_REPLICAS_OF_ONE = 50
# Clusters whose mean lifetime is compared.
_CLUSTERS = 2000
# Contacts behind a spring that is all but rigid.
_RIGID = 100


def compare_pulled(point: Point, plan: Suite) -> Found:
    """All comparisons of a pulled slider at a point: each kind at its own share of the
    points."""
    number, warm = point.number, point.ensemble.thermal.active
    asked = {
        holds: warm and number % 24 in (4, 13),
        pieces: warm and number % 13 == 10,
        steps: number % 13 == 7,
        avalanches: number % 7 == 3,
        lifetimes: warm and number % 9 == 1,
    }
    chosen = (compare for compare, wanted in asked.items() if wanted)
    return [one for compare in chosen for one in compare(point, plan)]


def _bare(ensemble: Ensemble, count: int, delay: Delay) -> Ensemble:
    """`count` contacts with the same thresholds, stiffness and temperature, and this
    delay; without aging and viscosity, born unstretched."""
    ensemble = replace(ensemble, eta=0.0, aging=Aging(), newborn=Newborn())
    return replace(ensemble, count=count, delay=delay)


def _slide(
    ensemble: Ensemble, programme: Programme, seed: int, replicas: int
) -> SliderTrajectory:
    """Replicas of a pulled slider."""
    run = trajectory(ensemble, programme, points=2, seed=seed, replicas=replicas)
    assert isinstance(run, SliderTrajectory)
    return run


# ------------------------------------------------------------------------------- holds


def rates(contacts: Reduced, xi: Array, stretch: Array) -> Array:
    """Thermal breaking rates, per time, of contacts at a velocity of one length unit per
    time, with thresholds `xi` and stretches (any shape); beyond a threshold that at it.
    """
    if contacts.annealed:
        x, back = np.unique(stretch, return_inverse=True)
        return successful_attempts(contacts, x)[back].reshape(stretch.shape)
    a = contacts.barrier.b * kappa_of(contacts, xi)
    log_rate = contacts.barrier.log_rate(np.minimum(stretch, xi), xi, a)
    return np.exp(contacts.barrier.log_w + log_rate)


def pinned_in_hold(
    ensemble: Ensemble, stage: Stage, each: int
) -> Callable[[float], float]:
    """The pinned share as a function of the time of a hold, from a fresh start: of one
    or two contacts, or of many behind a spring that is all but rigid; by quadrature with
    `each` nodes in an octave."""
    law, kappa = ensemble.thresholds, stage.stiffness
    pull = (stage.preload or 0.0) / law.scale
    contacts = reduced(ensemble, law.scale)
    xi, share = nodes_of(law, each)
    k = kappa_of(contacts, xi)
    if ensemble.count != 2:
        x = kappa * pull / (kappa + k)
        rate = rates(contacts, xi, x)
        return lambda time: float(np.sum(share * (x < xi) * np.exp(-rate * time)))
    # a weaker contact, the first index, and a stronger one
    weak, strong = np.meshgrid(xi, xi, indexing="ij")
    ordered = np.where(weak < strong, 2.0, np.where(weak == strong, 1.0, 0.0))
    both = ordered * np.outer(share, share)
    together = 2.0 * kappa * pull / (2.0 * kappa + k[:, None] + k)
    alone = 2.0 * kappa * pull / (2.0 * kappa + k)
    pair, holds_alone = together < weak, alone < xi
    weak_rate = rates(contacts, weak, together)
    strong_rate = rates(contacts, strong, together)
    after = rates(contacts, xi, alone)

    def pinned(time: float) -> float:
        total = np.where(pair, weak_rate + strong_rate, 0.0)
        left = np.where(pair, 2.0 * np.exp(-total * time), 0.0)
        for goes, last, holds in (
            (weak_rate, after[None, :], holds_alone[None, :]),
            (strong_rate, after[:, None], holds_alone[:, None]),
        ):
            # int_0^t exp(-total s) exp(-last (t - s)) ds
            first = np.exp(-np.minimum(total, last) * time)
            apart = special.exprel(-np.abs(total - last) * time)
            left += np.where(pair & holds, goes * time * first * apart, 0.0)
        last = ~pair & holds_alone[None, :]
        left += np.where(last, np.exp(-after[None, :] * time), 0.0)
        return float(np.sum(both * left)) / 2.0

    return pinned


def _hold(
    point: Point, rng: np.random.Generator, kappa: float, tolerance: float
) -> Point:
    """The point with a spring that stretches contacts to 0.2 to 0.8 of the mean
    threshold, and a hold in which about half of the contacts pinned at first break.
    Raises LeftOut if they stay, or break too soon."""
    ensemble, shown = map(_alike_if_pooled, (point.ensemble, point.shown))
    point = point._replace(ensemble=ensemble, shown=shown)
    stretch = rng.uniform(0.2, 0.8) * point.ensemble.thresholds.mean
    preload = float(f"{stretch * (1.0 + kappa) / kappa:.4g}")
    stage = Stage(kappa, preload=preload, tolerance=tolerance)
    pinned = pinned_in_hold(_bare(ensemble, 1, Delay()), stage, _PER_OCTAVE[1])
    aim = pinned(0.0) * rng.uniform(0.3, 0.7)
    if not pinned(_LONGEST_HOLD) <= aim < pinned(_SHORTEST_HOLD):
        raise LeftOut("few contacts")
    low, high = math.log10(_SHORTEST_HOLD), math.log10(_LONGEST_HOLD)
    log = optimize.brentq(lambda log: pinned(10**log) - aim, low, high, xtol=1e-11)
    return point._replace(stage=stage, time=float(f"{10**log:.4g}"))


def _alike_if_pooled(ensemble: Ensemble) -> Ensemble:
    """The same contacts, but annealed ones of uniform stiffness: all have the same
    stretch, so that pooled rates take few quadratures."""
    if ensemble.disorder == "annealed":
        return replace(ensemble, stiffness_law="uniform")
    return ensemble


def _pinned(point: Point, waits: Delay, looks: int, seed: int, plan: Suite) -> Estimate:
    """The pinned share at the end of a hold with so many records (`looks`)."""
    hold = Segment(0.0, time=point.time, points=looks)
    shown = _bare(point.shown, point.contacts, waits)
    run = _slide(shown, Programme((hold,), stage=point.stage), seed, plan.replicas)
    value, error = float(run.pinned[-1]), float(run.pinned_stderr[-1])
    return Estimate(value, error, plan.replicas, plan.replicas - 1)


def _of_share(found: Estimate, share: float) -> Estimate:
    """The pinned share that was found, with its error at the exact `share`: a share p
    scatters as p (1 - p), and the error is not small just where few contacts happen to
    be pinned. As quoted if none is, or all are."""
    scatter = known(found) * (1.0 - known(found))
    if not scatter:
        return found
    usual = math.sqrt(share * (1.0 - share) / scatter)
    return replace(found, stderr=usual * (found.stderr or 0.0))


@compares("hold")
def holds(point: Point, plan: Suite) -> Found:
    """The pinned share after a hold of the stage, against the exact law: of one or two
    contacts, or of a hundred behind a spring that is all but rigid; none is pinned
    again. Shares of few contacts are skewed, and their own scatter follows them: by it
    a single contact would score beyond 4.3 up to eleven times as often as it should."""
    rng = point.rng(6)
    held = _hold(point, rng, 10 ** rng.uniform(-1.5, 0.5), plan.tolerance)
    counts = [1, 2, _RIGID] if plan.replicas >= _REPLICAS_OF_ONE else [2, _RIGID]
    held = held._replace(contacts=int(rng.choice(counts)))
    if held.contacts == _RIGID:
        held = _hold(held, rng, 10 ** rng.uniform(6, 12), plan.tolerance)
    assert held.stage is not None
    waits = Delay(held.time * 10 ** rng.uniform(6, 12))
    ours = _pinned(held, waits, 1, held.stream(6), plan)
    ensemble = _bare(held.ensemble, held.contacts, waits)
    each = _PER_OCTAVE.get(held.contacts, _PER_OCTAVE[1])
    value, coarse = (
        pinned_in_hold(ensemble, held.stage, n)(held.time) for n in (2 * each, each)
    )
    exact = Estimate(value, abs(value - coarse) + _MOVED_BY_BREAK, 0)
    return [held.score("hold", _of_share(ours, value), exact)]


@compares("pieces")
def pieces(point: Point, plan: Suite) -> Found:
    """The pinned share of 2 to 100 contacts after a hold with one record, and with many:
    it must not depend on their number. Shares are counts of contacts and may coincide. A
    score of 0 would be too good to be true: they then differ by what rounding to whole
    contacts hides, 1/sqrt(12) of one."""
    rng = point.rng(7)
    held = _hold(point, rng, 10 ** rng.uniform(-1.5, 0.5), plan.tolerance)
    held = held._replace(contacts=int(rng.choice([2, 5, 10, 30, 100])))
    longer = float(rng.choice([rng.uniform(-1, 0), rng.uniform(3, 12)]))
    waits = Delay(held.time * 10**longer)
    once, often = (
        _pinned(held, waits, looks, held.stream(7, number), plan)
        for number, looks in enumerate((1, _LOOKS))
    )
    one = 1.0 / (held.contacts * plan.replicas)
    if abs(known(once) - known(often)) < 0.5 * one:  # rounding of means differs
        once = replace(once, value=known(often) + one / math.sqrt(12.0))
    return [held.score("pieces", once, often, 0.0)]


# ------------------------------------------------------------------------------- steps


class _Pull(NamedTuple):
    """Displacements of replicas after a pull, (replicas,), and the part of the quoted
    error of their mean that is not scatter."""

    X: Array
    bias: float


@compares("steps")
def steps(point: Point, plan: Suite) -> Found:
    """A damped slider on 10 to 100 contacts whose stage moves by 1.5 mean thresholds:
    its displacement in steps of the largest tolerance and one ten times smaller. With
    the same random numbers replicas are compared one by one, so that errors of steps
    show beside their scatter; the error is that of the mean difference and the part of
    the quoted errors that is not scatter."""
    rng, n, v = point.rng(8), plan.replicas, point.velocity
    count, kappa = int(rng.choice([10, 30, 100])), float(10 ** rng.uniform(-0.3, 0.7))
    shown = _bare(point.shown, count, Delay())
    mean = point.ensemble.thresholds.mean
    stage, pulls = Stage(kappa, damping=0.5 * mean / v, tolerance=1e-2), list[_Pull]()
    segments = (Segment(v, distance=1.5 * mean, points=1),)
    for tolerance in (1e-2, 1e-3):
        programme = Programme(segments, stage=replace(stage, tolerance=tolerance))
        run = _slide(shown, programme, point.stream(8), n)
        assert run.X_replicas is not None
        assert run.X_replica_std is not None
        scatter = float(run.X_replica_std[-1]) / math.sqrt(n)
        bias = math.sqrt(max(float(run.X_stderr[-1]) ** 2 - scatter**2, 0.0))
        pulls.append(_Pull(run.X_replicas[:, -1], bias))
    loose, tight = pulls
    bound = math.hypot(loose.bias, tight.bias)
    scatter = float(np.std(loose.X - tight.X, ddof=1)) / math.sqrt(n)
    error = math.hypot(scatter, bound)
    if not error:
        raise LeftOut("few contacts")
    point = point._replace(stage=stage, contacts=count, time=1.5 * mean / v)
    ours = Estimate(float(loose.X.mean()), error, n, n - 1)
    return [point.score("steps", ours, Estimate(float(tight.X.mean()), 0.0, 0), bound)]


# -------------------------------------------------------------------------- avalanches


@compares("avalanche", "single break")
def avalanches(point: Point, plan: Suite) -> Found:
    """Breaks of an avalanche in the mean, and the fraction of single breaks, of sliders
    that a stage pulls quasi-statically over three mean thresholds from a stationary
    start, against `master.avalanche_sizes`."""
    kappa = float(10 ** point.rng(9).uniform(-0.6, 0.6))
    law, stiffness = point.ensemble.thresholds, point.ensemble.stiffness_law
    if isinstance(law, NoThresholds):
        raise LeftOut("no thresholds")
    xi, share = nodes_of(law, _PER_OCTAVE[1])
    strength = relative_stiffness(stiffness, xi, law.rms / law.scale) * xi
    mean, square = float(np.sum(share * strength)), float(np.sum(share * strength**2))
    if not _AVALANCHING * _SLIDERS * mean**2 / square >= _CARRYING:
        raise LeftOut("few contacts")
    rho = load_of(law, kappa, stiffness)
    few = missed_by_few(law, rho, _AVALANCHING, stiffness)
    alone = float(size_law(law, rho, 1, stiffness)[0])
    shown = _bare(point.shown, _AVALANCHING, Delay())
    shown = replace(shown, thermal=Thermal())
    stage, distance = Stage(kappa, preload=None), 3.0 * law.mean
    segments = (Segment(1.0, distance=distance, points=1),)
    programme = Programme(segments, "stationary", 1.0, stage)
    run = _slide(shown, programme, point.stream(9), _SLIDERS)
    assert run.avalanches is not None
    replica, breaks = run.avalanches["replica"], run.avalanches["breaks"]
    events = np.bincount(replica, minlength=_SLIDERS).astype(float)
    broke = np.bincount(replica, breaks, _SLIDERS)
    single = np.bincount(replica, breaks == 1, _SLIDERS)
    point = point._replace(stage=stage, contacts=_AVALANCHING, time=distance)
    scores: Found = []
    for kind, number, value, missed in (
        ("avalanche", broke, 1.0 / (1.0 - rho), few.mean),
        ("single break", single, alone, few.single),
    ):
        ratio = float(number.sum() / events.sum())
        residual = (number - ratio * events) / events.mean()
        stderr = float(np.std(residual, ddof=1)) / math.sqrt(_SLIDERS)
        ours = Estimate(ratio, stderr, _SLIDERS, _SLIDERS - 1)
        error = missed * missed / value + _GAPS  # of the second order in 1/n
        scores.append(point.score(kind, ours, Estimate(value + missed, error, 0)))
    return scores


# ------------------------------------------------------------------------------- creep


@compares("lifetime")
def lifetimes(point: Point, plan: Suite) -> Found:
    """The mean lifetime of a cluster of 1 to 10 contacts with equal thresholds, without
    re-attachment, under a constant force, against the chain of their breaks."""
    rng, law = point.rng(10), Delta(point.ensemble.thresholds.mean)
    count = int(rng.choice([1, 2, 5, 10]))
    force = float(f"{rng.uniform(0.2, 0.8) * law.x_star:.4g}")
    # of equal thresholds both ensembles are the same, and quenched ones take no steps
    cluster, shown = (
        replace(_bare(one, count, Delay(math.inf)), thresholds=law, disorder="quenched")
        for one in (point.ensemble, point.shown)
    )
    exact = lifetime(cluster, Programme((Segment(force=force, time=1.0),)), points=2)
    mean = known(exact.mean)
    if not 0.0 < mean < _LONGEST_HOLD:
        raise LeftOut("few contacts")
    creep = Programme((Segment(force=force, time=float(f"{50.0 * mean:.4g}")),))
    run = _slide(shown, creep, point.stream(10), _CLUSTERS)
    point = point._replace(ensemble=cluster, contacts=count, time=run.t[-1])
    ours = mean_of(run.lifetimes, _CLUSTERS, _CLUSTERS - 1)
    return [point.score("lifetime", ours, exact.mean)]


PULLED = holds, pieces, steps, avalanches, lifetimes
PULLED_KINDS = tuple(kind for compare in PULLED for kind in compare.kinds)
