"""Comparisons of contacts along a given drive with the master equation, as scores z in
units of the quoted errors. Each function says what it compares.

Thresholds that fluctuate (`langevin`) are plain Monte Carlo, with steps whose bias,
below 1e-3, is part of the quoted error. Their hazard is not known path by path; the
whole law of x_b, S(x_b) uniform, stands in for it. There is no reference for
fluctuations of aging quenched contacts whose stiffness follows their thresholds (sqrt
law), nor for `langevin` contacts and annealed ones that age along programmes. Of
discrete laws the renewal equation in two times says little, as equal thresholds break
together. Births of annealed contacts that age are found once a point, with the steady
averages, and then held.

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

import math
from dataclasses import replace
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
from eqsim.laws.aging import Aging, Unaged
from eqsim.laws.stiffness import relative_stiffness
from eqsim.master import flow
from eqsim.master.profile import profile_of
from eqsim.master.steady import reference, settled
from eqsim.master.transient import Transient, fluctuations, transient
from eqsim.model.drive import Drive, Programme, Segment, Start
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import Reduced, births, drag_of
from eqsim.numerics.streams import TRAJECTORY, key
from eqsim.numerics.tables import Array
from eqsim.validation.comparison import Found, LeftOut, Point, compares
from eqsim.validation.points import Suite

# Displacements of a transient, each with an ensemble of its own.
_DISPLACEMENTS = 8
# Segments of a programme, and those of jitter, which go back and forth.
_SEGMENTS_COMPARED = 4
_JITTER = 8
# Relative error of steady averages.
_REL_ERROR = 1e-4
# Contacts of either state that carry the force, n <f>^2/<f^2>, for a mean over them to
# be normal, and for a mean of squares.
_ENOUGH_CONTACTS = 400
_ENOUGH_SQUARES = 1600
# Share of the sum of squares of 64 normal numbers, of which the largest makes more once
# in fifty times.
_LARGEST_SHARE = 0.2
# Groups of contacts, whose scatter is the error of a variance.
_GROUPS = 64
# Cells of the grid of a transient, times thresholds of a table.
_GRID_CELLS = 120_000
# How far, relatively, below a threshold of a table contacts that have it still live.
_JUST_BELOW = 1e-13
# Contacts of a pilot, at most.
_PILOT = 400_000
# Rounding of a threshold that was computed in two ways; as many lives end by heat as
# close to it.
_THRESHOLD_ROUNDING = 1e-12
# Standard deviation over mean of thresholds, below which references of warm programmes
# take minutes.
_NARROW_LAW = 0.03
# Lives of one comparison, at most.
_MOST_LIVES = 1e8
# How much longer `langevin` lives take than others; stationary ones are found by
# trying.
_DEAR = 20


def compare_driven(point: Point, plan: Suite) -> Found:
    """All comparisons of contacts along a given drive at a point."""
    number, stride = point.number, plan.points // plan.wide if plan.wide else 0
    asked = {
        transients: number % 3 == 0,
        hazards: number % 3 == 1,
        programmes: number % 3 == 2 and _followed(point.ensemble),
        fluctuating: stride and number % stride == 2,
    }
    chosen = [compare for compare, wanted in asked.items() if wanted]
    # the first 65 536 lives of `langevin` contacts will do
    rel_error = 1.0 if point.shown.fluctuates else _REL_ERROR
    try:
        found = steady(
            point.shown,
            Drive(point.velocity),
            rel_error=rel_error,
            seed=point.suite_seed,
            threads=point.threads,
        )
        scores = averages(point, found)
        point = point._replace(shown=_held(point.shown, point.velocity, found))
    except InputError as error:
        scores = point.without((*OBSERVABLES,), "refused", str(error))
        for compare in chosen:
            scores += compare.without(point, "refused", str(error))
        return scores
    return scores + [one for compare in chosen for one in compare(point, plan)]


def _followed(ensemble: Ensemble) -> bool:
    """True if there is a reference along programmes. It takes minutes of quenched
    contacts that heat breaks and whose smooth law is so narrow that steps are very
    short: these are left out."""
    if ensemble.self_consistent or ensemble.fluctuates or ensemble.newborn.active:
        return False
    law, warm = ensemble.thresholds, ensemble.thermal.kT > 0.0
    narrow = not law.steps.size and (law.rms / law.mean) ** 2 - 1.0 < _NARROW_LAW**2
    return not (narrow and warm and ensemble.disorder == "quenched")


def _held(ensemble: Ensemble, v: float, found: Steady) -> Ensemble:
    """The same contacts; births of annealed ones that age are held at the stretch C
    that was `found`."""
    if not ensemble.self_consistent:
        return ensemble
    held = births(ensemble, v, known(found.break_stretch))
    return replace(ensemble, thresholds=held, aging=Aging())


def averages(point: Point, found: Steady) -> Found:
    """Steady averages, to a relative error of 1e-4, or of `langevin` contacts from
    65 536 lives."""
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
        if point.shown.fluctuates and scatter > hidden:
            # what steps may cost is a bound, mostly far from reached
            ours, hidden = replace(ours, stderr=scatter), 0.0
        bound = math.hypot(hidden, theirs.stderr or 0.0)
        scores.append(point.score(name, ours, theirs, bound))
    return scores


class _End(NamedTuple):
    """The end of a drive: mean and variance of the force of one contact, whose errors
    are bounds, and the share of contacts that make the mean (`_carrying`)."""

    drive: Drive | Programme
    mean: Estimate
    variance: Estimate
    carrying: float


def _end_of(
    drive: Drive | Programme, exact: Transient, i: int, drag: float, moved: float = 0.0
) -> _End:
    """The end of a drive, row `i` of a reference along a path that is `moved` by so
    much."""
    assert exact.force_variance is not None
    assert exact.force_variance_error is not None
    mean, error = float(exact.force[i]), float(exact.force_error[i])
    square, off = float(exact.force_variance[i]), float(exact.force_variance_error[i])
    carrying = _carrying(mean, square, float(exact.pinned[i]), drag)
    variance = Estimate(square, off + 2.0 * abs(mean) * moved, 0)
    return _End(drive, Estimate(mean, error + moved, 0), variance, carrying)


def _score_end(
    point: Point,
    end: _End,
    kinds: tuple[str, ...],
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
    if not (min(few, broken) if shown.fluctuates else few) >= _ENOUGH_CONTACTS:
        return point.without(kinds, "few contacts")
    first, pilot, groups = (point.stream(*numbers) for numbers in streams)
    run = trajectory(shown, end.drive, points=2, seed=first, threads=point.threads)
    scores = point.without(kinds[:1], "unreliable")
    if run.force_reliable:
        ours = Estimate(float(run.force[-1]), float(run.force_stderr[-1]), shown.count)
        scores = [point.score(kinds[0], ours, end.mean)]
    group = replace(shown, count=shown.count // _GROUPS)
    enough = min(few, broken) >= _ENOUGH_SQUARES
    if not (enough and _many(_mean_squares(level, group, end.drive, pilot))):
        return scores + point.without(kinds[1:], "few contacts")
    ours = mean_of(_mean_squares(level, group, end.drive, groups), 0, _GROUPS - 1)
    return [*scores, point.score(kinds[1], ours, end.variance)]


def _affordable(
    point: Point, plan: Suite, drive: Drive | Programme, most: int, lives: float
) -> Point:
    """The point with as many contacts as the suite affords along a drive, `most` of
    them or so many `lives`. Raises LeftOut at velocities so low that even few take too
    long."""
    ages = point.shown.aging.rule != "none" and isinstance(drive, Programme)
    dear = _DEAR if point.shown.fluctuates or ages else 1
    cost = predicted_lives(replace(point.shown, count=1), drive)
    least = plan.contacts if plan.contacts * cost < plan.lives / dear else 200
    count = int(min(most, max(least, lives / dear / cost)))
    shown = replace(point.shown, count=count)
    if predicted_lives(shown, drive) > _MOST_LIVES / dear:
        raise LeftOut("too many lives")
    return point._replace(shown=shown)


@compares("transient", "transient variance", each=_DISPLACEMENTS)
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
    # near jumps of F the error is what a few cells of the grid make of it
    steps = ensemble.thresholds.steps.size
    every = max(1, _GRID_CELLS // (_DISPLACEMENTS * max(12, steps))) if steps else 1
    exact = transient(ensemble, whole, points=_DISPLACEMENTS * every + 1, variance=True)
    if exact.force_variance is None or exact.force_variance_error is None:
        raise LeftOut("vague")
    scores: Found = []
    for i in range(1, _DISPLACEMENTS + 1):
        drive = point.drive(distance * i / _DISPLACEMENTS)
        end = _end_of(drive, exact, i * every, _drag(ensemble, v))
        scores += _score_end(sized, end, transients.kinds, ((i,), (i, 1), (i, 2)))
    return scores


class HeldProgramme(NamedTuple):
    """A programme, and the `same` but for segments so slow, or so short and many, that
    they are holds: of each segment of that, where it ends among those of the
    `programme`, and by how much the force differs at most."""

    programme: Programme
    same: Programme
    ends: list[int]
    off: float


def programme_of(point: Point) -> HeldProgramme:
    """Steps, holds and reversals, from a fresh or stationary start: displacements of
    0.2 to 3 mean lives at 0.1 to 10 times the velocity of the point, holds of 0.1 to
    100 lives at that velocity. A third of the holds are crawls at a velocity 1e-25 to
    1e-12 times that of the point, another third the jitter of a recorded drive, eight
    segments back and forth by 1e-18 to 1e-8 lives."""
    rng, v = point.rng(3), point.velocity
    life = known(reference(point.ensemble, Drive(v)).break_stretch)
    speed, length = 10 ** rng.uniform(-1, 1), 10 ** rng.uniform(-0.5, 0.5)
    first = Segment(v * speed, distance=life * length, points=1)
    segments, same, ends, moved = [first], [first], [1], 0.0
    forward = True
    while len(same) < _SEGMENTS_COMPARED:
        kind = rng.choice(["hold", "reversal", "step"])
        if kind == "hold":
            hold = Segment(0.0, time=life / v * 10 ** rng.uniform(-1, 2), points=1)
            pieces = _pieces(hold, life, v, rng)
            moved += max(piece.path for piece in pieces)
            same.append(hold)
        else:
            forward = forward == (kind == "step")
            distance = life * 10 ** rng.uniform(-0.7, 0.5)
            velocity = (1 if forward else -1) * v * 10 ** rng.uniform(-1, 1)
            pieces = [Segment(velocity, distance=distance, points=1)]
            same += pieces
        segments += pieces
        ends.append(len(segments))
    start: Start = "stationary" if rng.random() < 0.5 else "fresh"
    whole, slow = (Programme(tuple(each), start, v) for each in (segments, same))
    return HeldProgramme(whole, slow, ends, moved)


def _pieces(
    hold: Segment, life: float, v: float, rng: np.random.Generator
) -> list[Segment]:
    """A hold as it is, or as segments that all but stand."""
    kind, time = rng.choice(["hold", "crawl", "jitter"]), hold.duration
    if kind == "hold":
        return [hold]
    if kind == "crawl":
        return [Segment(v * 10 ** rng.uniform(-25, -12), time=time, points=1)]
    each = time / _JITTER
    velocity = life * 10 ** rng.uniform(-18, -8) / each
    signs = (1, -1) * (_JITTER // 2)
    return [Segment(sign * velocity, time=each, points=1) for sign in signs]


@compares("programme", "programme variance", each=_SEGMENTS_COMPARED)
def programmes(point: Point, plan: Suite) -> Found:
    """The force at the end of each segment of a programme (steps, holds, crawls,
    jitter, reversals), from an ensemble of its own, and from another its variance."""
    whole, same, ends, moved = programme_of(point)
    sized = _affordable(point, plan, whole, 100_000, 4e6)
    try:
        exact = transient(point.ensemble, same, 2, variance=True)
    except InputError:  # of tails so long that a stationary start has no reference
        whole, same = (replace(one, start="fresh") for one in (whole, same))
        exact = transient(point.ensemble, same, 2, variance=True)
    scores: Found = []
    for i, (segment, last) in enumerate(zip(same.segments, ends, strict=True), 1):
        drag = _drag(point.ensemble, abs(segment.velocity))
        drag = math.copysign(drag, segment.velocity)
        drive = replace(whole, segments=whole.segments[:last])
        end = _end_of(drive, exact, i, drag, moved)
        scores += _score_end(sized, end, programmes.kinds, ((i, 3), (i, 4), (i, 5)))
    return scores


def _many(pilot: Array) -> bool:
    """True if many contacts make the mean of squares of which a pilot found these, in
    _GROUPS groups: its relative error is as if _ENOUGH_SQUARES had equal parts, and is
    not of one group (as with tails so heavy that there is no error)."""
    off = (pilot - pilot.mean()) ** 2
    return bool(
        pilot.mean() ** 2 * _GROUPS >= _ENOUGH_SQUARES * pilot.var(ddof=1) > 0
        and off.max() < _LARGEST_SHARE * off.sum()
    )


def _drag(ensemble: Ensemble, v: float) -> float:
    """The drag of a detached contact over k, if there are any."""
    if not ensemble.delay.time:
        return 0.0
    return drag_of(ensemble, v) * ensemble.thresholds.scale


def _carrying(level: float, variance: float, pinned: float, drag: float) -> float:
    """The share of contacts that make the mean force `level`, as if each of these did
    as much: <f>^2/<f^2>, f the force above the `drag`, which all detached contacts
    carry alike. Where pinned contacts are few, or detached ones with their drag, it is
    these that make its fluctuations."""
    share = (level - drag) ** 2 / max((level - drag) ** 2 + variance, 1e-300)
    return min(share, pinned, 1.0 - pinned if drag else 1.0)


def _mean_squares(
    level: float, group: Ensemble, drive: Drive | Programme, seed: int
) -> Array:
    """The variance of F/k per contact about its expectation, at the end of the drive,
    in each of _GROUPS groups."""
    forces, variances = _forces(group, drive, _GROUPS, seed)
    return np.asarray((variances + (forces - level) ** 2)[:, 1])


@compares("hazard", "hazard law")
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
        raise LeftOut("no reference")
    u, clock = point.rng(2).random((2, 20_000)) * (1 - 2e-16) + 1e-16
    if not (s.aging.closed or s.aging.fluctuates):  # hazards are quadratures
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
    thermal = stretch < end * (1.0 - _THRESHOLD_ROUNDING)
    x = np.stack((np.minimum(stretch, end), end)) * unit
    hazard, total = _integrated(s, xi * unit, x)
    mean, scores = float(hazard.sum()), point.without(hazards.kinds, "few contacts")
    if mean >= _ENOUGH_CONTACTS:
        ours = Estimate(float(thermal.sum()), math.sqrt(mean), u.size)
        scores[0] = point.score("hazard", ours, Estimate(mean, 0.0, 0))
    if thermal.any():
        share = np.expm1(-hazard[thermal]) / np.expm1(-total[thermal])
        scores[1] = point.uniform(share)
    return scores


def _integrated(s: Reduced, xi: Array, x: Array) -> Array:
    """Integrated hazards to stretches `x` (any, n) of contacts born with thresholds
    `xi` (n,)."""
    if s.annealed:
        return _pooled_hazards(s, x)
    if isinstance(s.aging, Unaged):
        a = s.barrier.b * relative_stiffness(s.stiffness, xi, s.rms)
        return np.exp(s.barrier.log_hazard(x, xi, a) + s.barrier.log_w)

    def rate(y: Array, born: Array) -> Array:
        return flow.rate_along(s, y, born)

    # The rate is greatest at the ends of a life, where the nodes crowd.
    accuracy = {"atol": 1e-9, "rtol": 1e-7, "maxlevel": 12}
    found = integrate.tanhsinh(rate, 0.0, x, args=(xi,), **accuracy)
    return np.asarray(found.integral)


def _pooled_hazards(s: Reduced, x: Array) -> Array:
    """Integrated hazards of annealed contacts: -ln of survival over J_c, just below x,
    where a discrete law still has the threshold x."""
    order = np.argsort(x.ravel())
    below = x.ravel()[order] * (1.0 - _JUST_BELOW if s.law.steps.size else 1.0)
    # a threshold that cannot be is no survivor
    ahead = np.maximum(s.law.sf(below * s.law.scale), 1e-300)
    alive, found = profile_of(s).at(below)[0] / ahead, np.empty(x.size)
    found[order] = -np.log(np.clip(alive, 1e-300, 1.0))
    return found.reshape(x.shape)


@compares("mean", "variance", "covariance")
def fluctuating(point: Point, plan: Suite) -> Found:
    """Mean, variance and the autocovariance at half a mean life of F/(N k) of
    stationary ensembles of 20, 100 or 10 000 contacts. Raises InputError where lives
    are too rare and too long to be found."""
    turn = point.number // (plan.points // plan.wide)
    count, ensembles = plan.sizes[turn % len(plan.sizes)]
    ensemble, shown, v = point.ensemble, point.shown, point.velocity
    s = settled(ensemble, v)
    if s.stiffness == "sqrt" and s.aging.stiffens:
        raise LeftOut("no reference")
    most = _MOST_LIVES * 2
    if shown.fluctuates:
        count, most = min(count, 40_000 // ensembles), most / _DEAR**2
    means, drag = reference(ensemble, Drive(v)), _drag(ensemble, v)
    level, lag = known(means.friction), 0.5 * known(means.travel)
    shown = replace(shown, count=count)
    if predicted_lives(shown, point.drive(lag)) * ensembles > most:
        raise LeftOut("too many lives")
    exact = fluctuations(ensemble, point.drive(lag), points=2)
    # contacts that make the force in all ensembles together, and of these the share
    # that does after the lag
    carrying = _carrying(level, float(exact.covariance[0]), known(means.pinned), drag)
    carry = count * ensembles * carrying
    square, product = (exact.covariance + (level - drag) ** 2).tolist()
    if carry < _ENOUGH_CONTACTS:
        raise LeftOut("few contacts")
    at_once = point.drive(1e-6 * lag, "stationary")
    group = replace(shown, count=max(1, min(count * ensembles, _PILOT) // _GROUPS))
    of_squares = carry / _ENOUGH_SQUARES
    if of_squares >= 1.0:
        found = _mean_squares(level, group, at_once, point.stream(1))
        of_squares *= _many(found)
    forces, _ = _forces(shown, point.drive(lag, "stationary"), ensembles, point.seed)
    first, second = (forces - level).T
    # what the error of C can do
    held = _REL_ERROR * level if ensemble.self_consistent else 0.0
    off = math.hypot(held, means.friction.stderr or 0.0)
    values, errors = exact.covariance / count, exact.error / count
    scores: Found = []
    for kind, enough, terms, value, error in (
        ("mean", True, forces[:, 0], level, off),
        ("variance", of_squares >= 1.0, first**2, values[0], errors[0]),
        (
            "covariance",
            of_squares * product >= square,
            first * second,
            values[1],
            errors[1],
        ),
    ):
        if not enough:
            scores += point.without((kind,), "few contacts")
            continue
        theirs = Estimate(float(value), float(error), 0)
        scores.append(point.score(kind, mean_of(terms, ensembles), theirs))
    return scores


def _forces(
    ensemble: Ensemble, drive: Drive | Programme, ensembles: int, seed: int
) -> tuple[Array, Array]:
    """F/(N k) at the beginning and the end of a drive, shape (ensembles, 2), and its
    variance over the contacts of each ensemble."""
    n, unit = ensemble.count, ensemble.thresholds.scale
    job = _job(ensemble, drive, seed)
    forces, variances = np.empty((2, ensembles, 2))
    for index in range(ensembles):
        total = job.totals(1)
        job.simulate(total, index * n, (index + 1) * n)
        force, _, variance = job.moments(total.deposits, n)
        forces[index] = force[[0, -1]] * unit
        variances[index] = variance[[0, -1]] * unit**2
    return forces, variances


def _job(ensemble: Ensemble, drive: Drive | Programme, seed: int) -> Job:
    """Contacts along a drive that are recorded at as few instants as possible."""
    if isinstance(drive, Programme):
        return steps_of(ensemble, drive, drive.grid(2), 1, seed)
    c, v = contacts(ensemble, drive.velocity), drive.velocity
    distance = drive.over(ensemble) / ensemble.thresholds.scale
    run = Run(distance, 2, drive.start == "stationary")
    table = stationary(c) if run.stationary else Fresh()
    scales = Scales.of(c, run, ensemble.count, 1, 0.0)
    stream = key(seed, TRAJECTORY)
    return constant_drive(c, table, run, scales, stream, drag_of(ensemble, v))


DRIVEN_KINDS = (
    *OBSERVABLES,
    *transients.kinds,
    *programmes.kinds,
    *hazards.kinds,
    *fluctuating.kinds,
)
