"""The comparisons made at one parameter point: each difference between contacts and the
master equation as a score z in units of the quoted errors,

    friction, pinned, break_stretch    steady averages, rel_error 1e-4 (of `langevin` contacts from 65 536 lives)
    transient                          F(X) from a fresh start, every X from its own ensemble, over 5 mean thresholds
                                       or 2 lives and delays
    transient variance                 variance over contacts of the force of one, at the same X
    programme, programme variance      the same at the ends of steps, holds, crawls, jitter and reversals of a programme
    hazard                             the integrated hazard at breaking is Exp(1): events less hazard, over its root
    hazard law                         the whole law of it, by Kolmogorov and Smirnov, as the normal score of p
    mean, variance, covariance         stationary F/(N k) at N = 20, 100, 10 000, the covariance at half a mean life

Thresholds that fluctuate (`langevin`) are plain Monte Carlo, with steps whose bias is
below 1e-3, which is part of the quoted error: it does little to scores from 65 536
lives, most of which are good to 1e-3 to 5e-3 without it, and counts where they are
better, because thresholds hardly move. Their hazard is not known path by path; the
whole law of x_b, S(x_b) uniform, stands in for it. Fluctuations of aging quenched
contacts whose stiffness follows their thresholds (sqrt law) have no reference, nor have
`langevin` contacts and annealed ones that age along programmes; of discrete laws the
renewal equation in two times says little, as equal thresholds break together. Births of
annealed contacts that age are found once a point, with the steady averages, and then
held.

Some quoted errors are bounds: what all randomisations may miss of a few thresholds,
tables of laws whose density jumps, grids where F jumps, because equal thresholds break
together. With them |z| is too small to be normal. A score is even if bounds make less
than a fifth of its error, which is known without its value; uneven ones count among the
largest only: with a bias as large as the bound |z| exceeds any t > 2 less often than a
normal score does. Means are scored if as many as 400 contacts carry the force, squares
if a pilot says that 1600 do and that no small part of them makes the error, as with
heavy tails.

Variances are taken about the master's mean, as means of squares. Their scores are the Y
of a test suite of stochastic simulators, (s^2 - sigma^2) over the error of s^2, with
that error, ((mu_4 - sigma^4)/n)^(1/2), from the scatter of the squares in the sample:
forces of one contact, or of twenty, are far from normal.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import integrate

from eqsim.engine.blocks import Job
from eqsim.engine.contacts import contacts
from eqsim.engine.langevin import STEP
from eqsim.engine.programme import constant_drive, steps_of
from eqsim.engine.recorder import Run, Scales
from eqsim.engine.sample import Source, lives
from eqsim.engine.stationary import Fresh, stationary, thresholds, whole_lives
from eqsim.engine.steady import Steady, steady
from eqsim.engine.trajectory import predicted_lives, trajectory
from eqsim.errors import InputError
from eqsim.estimate import OBSERVABLES, Estimate, known, mean_of
from eqsim.laws.aging import Aging, Flow, Logarithmic, Unaged
from eqsim.laws.stiffness import relative_stiffness
from eqsim.master import flow
from eqsim.master.profile import profile_of
from eqsim.master.steady import reference, settled
from eqsim.master.transient import Fluctuations, Transient, fluctuations, transient
from eqsim.model.drive import Drive, Programme, Segment, Start
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import Reduced, births, drag_of
from eqsim.numerics.streams import TRAJECTORY, key
from eqsim.numerics.tables import Array
from eqsim.validation.comparison import Asked, Found, Point, attempt
from eqsim.validation.points import Suite

_EACH = 8  # displacements, each with an ensemble of its own
_TRANSIENT = ("transient", "transient variance")
_PROGRAMME, _SEGMENTS = ("programme", "programme variance"), 4
_HAZARD, _FLUCTUATIONS = ("hazard", "hazard law"), ("mean", "variance", "covariance")
KINDS = (*OBSERVABLES, *_TRANSIENT, *_PROGRAMME, *_HAZARD, *_FLUCTUATIONS)
_REL_ERROR = 1e-4
_JITTER = 8  # segments that go back and forth
_ENOUGH = 400  # contacts of either state that carry the force, n <f>^2/<f^2>, for a mean over them to be normal
_ENOUGH_SQUARES = 1600  # and for a mean of squares
_ONE = 0.2  # of the sum of squares of so many normal numbers, the largest makes more once in fifty times
_GROUPS = 64  # of contacts, whose scatter is the error of a variance
_CELLS = 120_000  # of the grid of a transient, times thresholds of a table
_BELOW = 1e-13  # a threshold of a table, relative: contacts that have it still live
_PILOT = 400_000  # contacts, at most
_ROUNDING = 1e-12  # of a threshold that was computed in two ways; as many lives end by heat as close to it
_NARROW = 0.03  # standard deviation over mean of thresholds, below which references of warm programmes take minutes
_MOST_LIVES = 1e8  # of one comparison
_DEAR = 20  # `langevin` lives take that much longer than others, and stationary ones are found by trying


def compared(point: Point, plan: Suite) -> Found:
    """All comparisons at a point."""
    index = point.number
    stride = plan.points // plan.wide if plan.wide else 0
    asked: list[Asked] = []
    if index % 3 == 0:
        asked.append((_EACH * _TRANSIENT, transients))
    if index % 3 == 1:
        asked.append((_HAZARD, hazards))
    follows = not (point.ensemble.self_consistent or point.ensemble.fluctuates)
    follows = follows and not point.ensemble.newborn.active  # else no reference
    if index % 3 == 2 and follows and not _dear_along_programmes(point.ensemble):
        asked.append((_SEGMENTS * _PROGRAMME, programmes))
    if stride and index % stride == 2:
        asked.append((_FLUCTUATIONS, fluctuating))
    # the first 65 536 lives of `langevin` contacts will do
    rel_error = 1.0 if point.shown.fluctuates else _REL_ERROR
    drive = Drive(point.velocity)
    try:
        found = steady(
            point.shown,
            drive,
            rel_error=rel_error,
            seed=point.suite_seed,
            threads=point.threads,
        )
        scores = averages(point, found)
        point = point._replace(shown=_held(point.shown, point.velocity, found))
    except InputError as error:
        kinds = (*OBSERVABLES, *(kind for kinds, _ in asked for kind in kinds))
        return point.without(kinds, "refused", str(error))
    return scores + attempt(point, plan, asked)


def _dear_along_programmes(ensemble: Ensemble) -> bool:
    """True of quenched contacts that heat breaks and whose smooth law is so narrow that
    steps are very short."""
    law = ensemble.thresholds
    narrow = not law.steps.size and (law.rms / law.mean) ** 2 - 1.0 < _NARROW**2
    return narrow and ensemble.thermal.kT > 0.0 and ensemble.disorder == "quenched"


def _held(ensemble: Ensemble, v: float, found: Steady) -> Ensemble:
    """The same contacts; births of annealed ones that age are held at the stretch C
    that was `found`."""
    if not ensemble.self_consistent:
        return ensemble
    return dataclasses.replace(
        ensemble,
        thresholds=births(ensemble, v, known(found.break_stretch)),
        aging=Aging(),
    )


def averages(point: Point, found: Steady) -> Found:
    """Steady averages."""
    exact = reference(point.ensemble, Drive(point.velocity), variance=True).averages()
    scores: Found = []
    for name, ours in found.averages().items():
        theirs = exact[name]
        if name not in found.shown or theirs.value is None:
            continue
        if ours.stderr == theirs.stderr == 0.0:
            continue  # pinned without delay: 1, exactly
        if not ours.reliable:  # and says so
            scores += point.without((name,), "unreliable")
            continue
        response = abs(known(ours)) * (1.0 - known(ours) if name == "pinned" else 1.0)
        hidden, stderr = found.hidden * response, ours.stderr or 0.0
        scatter = math.sqrt(max(stderr**2 - hidden**2, 0.0))
        if (
            point.shown.fluctuates and scatter > hidden
        ):  # what steps may cost is a bound, mostly far from reached
            ours, hidden = dataclasses.replace(ours, stderr=scatter), 0.0
        scores.append(
            point.score(name, ours, theirs, math.hypot(hidden, theirs.stderr or 0.0))
        )
    return scores


class _End(NamedTuple):
    """What a drive leads to: mean and variance of the force of one contact, whose
    errors are bounds, and the share of contacts that make the mean (`_carrying`)."""

    drive: Drive | Programme
    mean: Estimate
    variance: Estimate
    carrying: float


def _end(drive: Drive | Programme, exact: Transient, i: int, drag: float) -> _End:
    """The end of a drive, row `i` of a reference along it."""
    assert exact.force_variance is not None
    assert exact.force_variance_error is not None
    mean = Estimate(float(exact.force[i]), float(exact.force_error[i]), 0)
    square, off = float(exact.force_variance[i]), float(exact.force_variance_error[i])
    carrying = _carrying(known(mean), square, float(exact.pinned[i]), drag)
    return _End(drive, mean, Estimate(square, off, 0), carrying)


def _score_end(
    point: Point,
    end: _End,
    kinds: tuple[str, str],
    streams: tuple[tuple[int, ...], ...],
) -> Found:
    """Score the mean force at the end of a drive, and by other contacts its variance,
    for which a pilot tells whether there are enough; each draws from its own stream."""
    shown, level, variance = point.shown, known(end.mean), known(end.variance)
    few = shown.count * end.carrying
    # few that have broken make the variance if all others have the same force; the law
    # of `langevin` contacts is not known well enough to say how large it is
    broken = shown.count * variance / max(level**2, 1e-300)
    if isinstance(end.drive, Programme):
        broken = math.inf
    if not (min(few, broken) if shown.fluctuates else few) >= _ENOUGH:
        return point.without(kinds, "few contacts")
    own, pilot, groups = (point.stream(*numbers) for numbers in streams)
    run = trajectory(shown, end.drive, points=2, seed=own, threads=point.threads)
    scores = point.without(kinds[:1], "unreliable")
    if run.force_reliable:
        ours = Estimate(float(run.force[-1]), float(run.force_stderr[-1]), shown.count)
        scores = [point.score(kinds[0], ours, end.mean, end.mean.stderr or 0.0)]
    group = dataclasses.replace(shown, count=shown.count // _GROUPS)
    if min(few, broken) < _ENOUGH_SQUARES or not _many(
        _about(level, group, end.drive, pilot)
    ):
        return scores + point.without(kinds[1:], "few contacts")
    squares = _about(level, group, end.drive, groups)
    ours = mean_of(squares, 0, _GROUPS - 1)
    off = end.variance.stderr or 0.0
    return [*scores, point.score(kinds[1], ours, end.variance, off)]


def _affordable(
    point: Point, plan: Suite, drive: Drive | Programme, most: int, lives: float
) -> Point | None:
    """The point with as many contacts as the suite affords along a drive, `most` of
    them or so many `lives`; None at velocities so low that even few take too long."""
    dear = 1
    ages = point.shown.aging.rule != "none"
    if point.shown.fluctuates or (ages and isinstance(drive, Programme)):
        dear = _DEAR
    cost = predicted_lives(dataclasses.replace(point.shown, count=1), drive)
    least = plan.contacts if plan.contacts * cost < plan.lives / dear else 200
    count = int(min(most, max(least, lives / dear / cost)))
    shown = dataclasses.replace(point.shown, count=count)
    if predicted_lives(shown, drive) > _MOST_LIVES / dear:
        return None
    return point._replace(shown=shown)


def transients(point: Point, plan: Suite) -> Found:
    """Eight ensembles, each asked for F at one displacement of its own, and eight more
    for its variance: over five mean thresholds, or over two lives and delays."""
    ensemble, v = point.ensemble, point.velocity
    typical = reference(ensemble, Drive(v))
    distance = 5 * ensemble.thresholds.mean
    if point.seed % 2:
        distance = 2 * (known(typical.travel) + v * ensemble.delay.time)
    whole = point.drive(distance)
    sized = _affordable(point, plan, whole, 20_000, 1e6)
    if sized is None:
        return point.without(_EACH * _TRANSIENT, "too many lives")
    # near jumps of F the error is what a few cells of the grid make of it
    steps = ensemble.thresholds.steps.size
    every = max(1, _CELLS // (_EACH * max(12, steps))) if steps else 1
    exact = transient(ensemble, whole, points=_EACH * every + 1, variance=True)
    if exact.force_variance is None or exact.force_variance_error is None:
        return point.without(_EACH * _TRANSIENT, "vague")
    scores: Found = []
    for i in range(1, _EACH + 1):
        drive = point.drive(distance * i / _EACH)
        end = _end(drive, exact, i * every, _drag(ensemble, v))
        scores += _score_end(sized, end, _TRANSIENT, ((i,), (i, 1), (i, 2)))
    return scores


class Course(NamedTuple):
    """A programme, and the `same` but for segments so slow, or so short and many, that
    they are holds: of each segment of that, where it ends among those of the
    `programme`, and by how much the force differs at most."""

    programme: Programme
    same: Programme
    ends: list[int]
    off: float


def programme_of(point: Point) -> Course:
    """Steps, holds and reversals, from a fresh or stationary start: displacements of
    0.2 to 3 mean lives at 0.1 to 10 times the velocity of the point, holds of 0.1 to
    100 lives at that velocity. A third of the holds are crawls at a velocity 1e-25 to
    1e-12 times that of the point, another third the jitter of a recorded drive, eight
    segments back and forth by 1e-18 to 1e-8 lives."""
    rng, v = np.random.default_rng((point.seed, 3)), point.velocity
    life = known(reference(point.ensemble, Drive(v)).break_stretch)
    first = Segment(
        v * 10 ** rng.uniform(-1, 1),
        distance=life * 10 ** rng.uniform(-0.5, 0.5),
        points=1,
    )
    segments, same, ends, moved = [first], [first], [1], 0.0
    while len(same) < _SEGMENTS:
        kind = rng.choice(["hold", "reversal", "step"])
        if kind == "hold":
            hold = Segment(0.0, time=life / v * 10 ** rng.uniform(-1, 2), points=1)
            pieces = _pieces(hold, life, v, rng)
            moved += max(piece.path for piece in pieces)
            segments += pieces
            same.append(hold)
        else:
            forward = (
                next(segment.velocity for segment in reversed(same) if segment.velocity)
                > 0
            )
            sign = 1 if forward == (kind == "step") else -1
            distance = life * 10 ** rng.uniform(-0.7, 0.5)
            segment = Segment(
                sign * v * 10 ** rng.uniform(-1, 1), distance=distance, points=1
            )
            segments.append(segment)
            same.append(segment)
        ends.append(len(segments))
    start: Start = "stationary" if rng.random() < 0.5 else "fresh"
    return Course(
        Programme(tuple(segments), start, v),
        Programme(tuple(same), start, v),
        ends,
        moved,
    )


def _pieces(
    hold: Segment, life: float, v: float, rng: np.random.Generator
) -> list[Segment]:
    """A hold as it is, or as segments that all but stand."""
    kind, time = rng.choice(["hold", "crawl", "jitter"]), hold.duration
    if kind == "hold":
        return [hold]
    if kind == "crawl":
        return [Segment(v * 10 ** rng.uniform(-25, -12), time=time, points=1)]
    step = life * 10 ** rng.uniform(-18, -8)
    return [
        Segment((-1) ** i * step / (time / _JITTER), time=time / _JITTER, points=1)
        for i in range(_JITTER)
    ]


def programmes(point: Point, plan: Suite) -> Found:
    """The end of each segment of a programme, from an ensemble of its own, and from
    another its variance."""
    whole, same, ends, moved = programme_of(point)
    sized = _affordable(point, plan, whole, 100_000, 4e6)
    if sized is None:
        return point.without(_SEGMENTS * _PROGRAMME, "too many lives")
    try:
        exact = transient(point.ensemble, same, 2, variance=True)
    except InputError:  # of tails so long that a stationary start has no reference
        whole, same = (dataclasses.replace(one, start="fresh") for one in (whole, same))
        exact = transient(point.ensemble, same, 2, variance=True)
    scores: Found = []
    for i in range(1, _SEGMENTS + 1):
        velocity = same.segments[i - 1].velocity
        drag = math.copysign(_drag(point.ensemble, abs(velocity)), velocity)
        drive = dataclasses.replace(whole, segments=whole.segments[: ends[i - 1]])
        end = _end(drive, exact, i, drag)
        end = end._replace(
            mean=_vaguer(end.mean, moved),
            variance=_vaguer(end.variance, 2.0 * abs(known(end.mean)) * moved),
        )
        scores += _score_end(sized, end, _PROGRAMME, ((i, 3), (i, 4), (i, 5)))
    return scores


def _vaguer(exact: Estimate, bound: float) -> Estimate:
    """The same value with a larger error."""
    return dataclasses.replace(exact, stderr=(exact.stderr or 0.0) + bound)


def _many(pilot: Array) -> bool:
    """Whether many contacts make the mean of squares of which a pilot found these, in
    _GROUPS groups: its relative error is as if _ENOUGH_SQUARES had equal parts, and is
    not of one group (as with tails so heavy that there is no error)."""
    off = (pilot - pilot.mean()) ** 2
    return bool(
        pilot.mean() ** 2 * _GROUPS >= _ENOUGH_SQUARES * pilot.var(ddof=1) > 0
        and off.max() < _ONE * off.sum()
    )


def _drag(ensemble: Ensemble, v: float) -> float:
    """What a detached contact adds to F/k, if there are any."""
    return (
        drag_of(ensemble, v) * ensemble.thresholds.scale if ensemble.delay.time else 0.0
    )


def _carrying(level: float, variance: float, pinned: float, drag: float) -> float:
    """The share of contacts that make the mean force `level`, as if each of these did
    as much: <f>^2/<f^2>, f the force above the `drag`, which all detached contacts
    carry alike. Where pinned contacts are few, or detached ones with their drag, it is
    these that make its fluctuations."""
    share = (level - drag) ** 2 / max((level - drag) ** 2 + variance, 1e-300)
    return min(share, pinned, 1.0 - pinned if drag else 1.0)


def _about(level: float, group: Ensemble, drive: Drive | Programme, seed: int) -> Array:
    """The variance of F/k per contact about its expectation, at the end of the drive,
    in each of _GROUPS groups."""
    forces, variances = _forces(group, drive, _GROUPS, seed)
    return np.asarray((variances + (forces - level) ** 2)[:, 1])


def hazards(point: Point, plan: Suite) -> Found:
    """Integrated hazards at breaking against Exp(1), censored at each contact's own
    threshold, two ways.

    A life that ends by heat counts 1; the integrated hazard it went through has the
    same mean, and is the variance of the difference. And of the lives that heat would
    have ended somewhere before the threshold, a fraction U = (1 - exp(-Lambda))/(1 -
    exp(-Lambda(xi))) ends where they did or earlier: U of those it did end is uniform.
    Of `langevin` contacts S(x_b) is uniform, S the mean over paths.
    """
    s = settled(point.ensemble, point.velocity)
    if not (s.barrier.thermal or s.aging.fluctuates):
        return []  # no hazard
    if s.newborn.active:
        return point.without(_HAZARD, "contacts born stretched")
    u, clock = (
        np.random.default_rng((point.seed, 2)).random((2, 20_000)) * (1 - 2e-16) + 1e-16
    )
    if not (
        s.aging.closed or s.aging.fluctuates
    ):  # hazards along paths are quadratures
        u, clock = u[:4000], clock[:4000]
    c = contacts(point.shown, point.velocity)
    stretch = lives(c, Source(key(point.seed, TRAJECTORY), 0, STEP), u, clock).travel
    unit = point.shown.thresholds.scale / point.ensemble.thresholds.scale
    if s.aging.fluctuates:
        return [point.uniform(profile_of(s).at(stretch * unit)[0])]
    xi = np.empty(u.size)
    thresholds(c.thresholds, u, xi)
    end = xi
    if not (c.aging.closed or c.aging.fluctuates):
        end = np.empty(u.size)
        whole_lives(c, xi, end, np.empty(u.size))
    thermal = stretch < end * (1.0 - _ROUNDING)
    hazard, total = _integrated(
        s, xi * unit, np.stack((np.minimum(stretch, end), end)) * unit
    )
    mean = float(hazard.sum())
    scores: Found = []
    if mean >= _ENOUGH:
        ours = Estimate(float(thermal.sum()), math.sqrt(mean), u.size)
        scores.append(point.score("hazard", ours, Estimate(mean, 0.0, 0), 0.0))
    if thermal.any():
        scores.append(
            point.uniform(np.expm1(-hazard[thermal]) / np.expm1(-total[thermal]))
        )
    done = [score.kind for score in scores]
    return scores + point.without(
        tuple(kind for kind in _HAZARD if kind not in done), "few contacts"
    )


def _integrated(s: Reduced, xi: Array, x: Array) -> Array:
    """Integrated hazards to stretches `x` (any, n) of contacts born with thresholds
    `xi` (n,)."""
    return _pooled(s, x) if s.annealed else _INTEGRATED[type(s.aging)](s, xi, x)


def _pooled(s: Reduced, x: Array) -> Array:
    """Of annealed contacts: -ln of survival over J_c, just below x, where a discrete
    law still has the threshold x."""
    below = (
        np.sort(x.ravel()) * (1.0 - _BELOW) if s.law.steps.size else np.sort(x.ravel())
    )
    ahead = np.maximum(
        s.law.sf(below * s.law.scale), 1e-300
    )  # a threshold that cannot be is no survivor
    alive = profile_of(s).at(below)[0] / ahead
    found = np.empty(x.size)
    found[np.argsort(x.ravel())] = -np.log(np.clip(alive, 1e-300, 1.0))
    return found.reshape(x.shape)


def _closed(s: Reduced, xi: Array, x: Array) -> Array:
    """Of thresholds that stay."""
    a = s.barrier.b * relative_stiffness(s.stiffness, xi, s.rms)
    return np.exp(s.barrier.log_hazard(x, xi, a) + s.barrier.log_w)


def _along(s: Reduced, xi: Array, x: Array) -> Array:
    """Of thresholds that age in a known way. The rate is greatest at the ends of a
    life, where the nodes crowd."""

    def rate(y: Array, born: Array) -> Array:
        return flow.rate_along(s, y, born)

    found = integrate.tanhsinh(
        rate, 0.0, x, args=(xi,), atol=1e-9, rtol=1e-7, maxlevel=12
    )
    return np.asarray(found.integral)


_INTEGRATED: dict[type, Callable[[Reduced, Array, Array], Array]] = {
    Unaged: _closed,
    Flow: _along,
    Logarithmic: _along,
}


def fluctuating(point: Point, plan: Suite) -> Found:
    """Mean, variance and one autocovariance of F/(N k) of stationary ensembles. Raises
    InputError where lives are too rare and too long to be found."""
    count, ensembles = plan.sizes[
        point.number // (plan.points // plan.wide) % len(plan.sizes)
    ]
    ensemble, shown, v = point.ensemble, point.shown, point.velocity
    s = settled(ensemble, v)
    if s.stiffness == "sqrt" and s.aging.stiffens:
        return point.without(_FLUCTUATIONS, "no reference")
    most = _MOST_LIVES * 2
    if shown.fluctuates:
        count, most = min(count, 40_000 // ensembles), most / _DEAR**2
    means, drag = reference(ensemble, Drive(v)), _drag(ensemble, v)
    level, lag = known(means.friction), 0.5 * known(means.travel)
    shown = dataclasses.replace(shown, count=count)
    if predicted_lives(shown, point.drive(lag)) * ensembles > most:
        return point.without(_FLUCTUATIONS, "too many lives")
    exact = fluctuations(ensemble, point.drive(lag), points=2)
    # contacts that make the force in all ensembles together, and of these the share
    # that does after the lag
    carrying = _carrying(level, float(exact.covariance[0]), known(means.pinned), drag)
    carry = count * ensembles * carrying
    square, product = (exact.covariance + (level - drag) ** 2).tolist()
    if carry < _ENOUGH:
        return point.without(_FLUCTUATIONS, "few contacts")
    at_once = point.drive(1e-6 * lag, "stationary")
    pilot = max(1, min(count * ensembles, _PILOT) // _GROUPS)
    group = dataclasses.replace(shown, count=pilot)
    of_squares = carry / _ENOUGH_SQUARES
    if of_squares >= 1.0 and not _many(_about(level, group, at_once, point.stream(1))):
        of_squares = 0.0
    forces, _ = _forces(shown, point.drive(lag, "stationary"), ensembles, point.seed)
    first, second = (forces - level).T
    # what the error of C can do
    held = _REL_ERROR * level if ensemble.self_consistent else 0.0
    off = math.hypot(held, means.friction.stderr or 0.0)
    scores: Found = []
    for kind, enough, terms, value, error in (
        ("mean", True, forces[:, 0], level, off),
        ("variance", of_squares >= 1.0, first**2, *_over(exact, 0, count)),
        (
            "covariance",
            of_squares * product >= square,
            first * second,
            *_over(exact, 1, count),
        ),
    ):
        if enough:
            ours = mean_of(terms, ensembles)
            scores.append(point.score(kind, ours, Estimate(value, error, 0), error))
        else:
            scores += point.without((kind,), "few contacts")
    return scores


def _over(exact: Fluctuations, row: int, count: int) -> tuple[float, float]:
    """A covariance of the force of `count` contacts, and its error."""
    return float(exact.covariance[row]) / count, float(exact.error[row]) / count


def _forces(
    ensemble: Ensemble, drive: Drive | Programme, ensembles: int, seed: int
) -> tuple[Array, Array]:
    """F/(N k) at the beginning and the end of a drive, shape (ensembles, 2), and its
    variance over the contacts of each ensemble."""
    n, unit, job = (
        ensemble.count,
        ensemble.thresholds.scale,
        _job(ensemble, drive, seed),
    )
    forces, variances = np.empty((2, ensembles, 2))
    for index in range(ensembles):
        total = job.totals(1)
        job.simulate(total, index * n, (index + 1) * n)
        force, _, variance = job.moments(total.deposits, n)
        forces[index], variances[index] = (
            force[[0, -1]] * unit,
            variance[[0, -1]] * unit**2,
        )
    return forces, variances


def _job(ensemble: Ensemble, drive: Drive | Programme, seed: int) -> Job:
    """Contacts along a drive that are recorded at as few instants as possible."""
    if isinstance(drive, Programme):
        return steps_of(ensemble, drive, drive.grid(2), 1, seed)
    c = contacts(ensemble, drive.velocity)
    run = Run(
        drive.over(ensemble) / ensemble.thresholds.scale, 2, drive.start == "stationary"
    )
    table = stationary(c) if run.stationary else Fresh()
    scales = Scales.of(c, run, ensemble.count, 1, 0.0)
    return constant_drive(
        c, table, run, scales, key(seed, TRAJECTORY), drag_of(ensemble, drive.velocity)
    )
