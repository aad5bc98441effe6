"""Comparisons of contacts along a given drive with the master equation, as scores z in
units of the quoted errors. Each function says what it compares.

Thresholds that fluctuate (`langevin`) are plain Monte Carlo, with steps whose bias,
below 1e-3, is part of the quoted error. Their hazard is not known path by path; instead
S(x_b), the survival at the stretch where a contact breaks, is tested to be uniform.
There is no reference for fluctuations of aging quenched contacts whose stiffness
follows their thresholds (sqrt law), nor for `langevin` contacts and annealed ones that
age along programmes. With discrete laws equal thresholds break together, and the
renewal equation in two times has large errors. Births of annealed contacts that age are
found once a point, with the steady averages, and then held.

Some quoted errors are bounds: of what all randomisations may miss of a few thresholds,
of tables of laws whose density jumps, of grids where F jumps, because equal thresholds
break together. With them |z| is too small to be normal. A score is even if bounds make
less than a fifth of its error, which is known without its value; uneven ones count
among the largest only: with a bias as large as the bound |z| exceeds any t > 2 less
often than a normal score does. Means and squares are scored if enough contacts make
them (`enough`).

Variances are means of squares about the mean of the master equation. Their scores are
the Y of test suites for stochastic simulators, (s^2 - sigma^2) over the error of s^2,
with that error, ((mu_4 - sigma^4)/n)^(1/2), from the scatter of the squares in the
sample: forces of one contact, or of twenty, are far from normal.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from eqsim.engine.contacts import contacts
from eqsim.engine.langevin import STEP
from eqsim.engine.programme import Steps, constant_drive, steps_of
from eqsim.engine.recorder import Run, Scales
from eqsim.engine.sample import Source, lives
from eqsim.engine.stationary import Fresh, stationary, thresholds, whole_lives
from eqsim.engine.steady import Steady, steady
from eqsim.engine.trajectory import predicted_lives, trajectory
from eqsim.errors import InputError
from eqsim.estimate import OBSERVABLES, Estimate, known, mean_of
from eqsim.laws.aging import Aging
from eqsim.laws.no_thresholds import has_jumps
from eqsim.master.profile import Profile
from eqsim.master.programme import Transient
from eqsim.master.steady import reference, settled
from eqsim.master.survivors import hazard_passed
from eqsim.master.transient import fluctuations, transient
from eqsim.model.drive import Drive, Programme, Segment, Start
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import births, drag_of
from eqsim.numerics.streams import TRAJECTORY, key
from eqsim.numerics.tables import Array
from eqsim.validation.comparison import Found, LeftOut, Point, compares
from eqsim.validation.enough import (
    ENOUGH_CONTACTS,
    ENOUGH_SQUARES,
    GROUPS,
    carrying_share,
    drag_over_k,
    many_contribute,
    squaring_share_at_last,
    squaring_shares_at_first,
)
from eqsim.validation.points import Suite

# Displacements of a transient, each with an ensemble of its own.
_DISPLACEMENTS = 8
# Segments of a programme that are compared.
_SEGMENTS_COMPARED = 4
# Segments of jitter, back and forth in turn.
_JITTER = 8
# Relative error of steady averages.
_REL_ERROR = 1e-4
# Larger ones, for averages that all but vanish, as of contacts born against the motion.
_REL_ERRORS = _REL_ERROR, 1e-3, 1e-2, 1.0
# Lives of steady averages, at most.
_MOST_STEADY = 1e7
# Cells of the grid of a transient, times thresholds of a table.
_GRID_CELLS = 120_000
# Contacts of a pilot run, at most.
_PILOT = 400_000
# Rounding of a threshold that is computed in two ways; a share as small of lives ends by
# heat so close to it.
_THRESHOLD_ROUNDING = 1e-12
# Standard deviation over mean of thresholds, below which references of warm programmes
# take minutes.
_NARROW_LAW = 0.03
# Lives of one comparison, at most.
_MOST_LIVES = 1e8
# Time of a `langevin` life over that of others, and of a stationary one, found by
# rejection, over that of these.
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
    try:
        sampled = _sampled(point)
        scores = averages(point, sampled)
        point = point._replace(shown=_held(point.shown, point.velocity, sampled))
    except InputError as error:
        scores = point.without((*OBSERVABLES,), "refused", str(error))
        for compare in chosen:
            scores += compare.without(point, "refused", str(error))
        return scores
    return scores + [score for compare in chosen for score in compare(point, plan)]


def _sampled(point: Point) -> Steady:
    """Steady averages of the contacts of a point, to the first error that does not take
    too many lives. Raises InputError for contacts that have none."""
    # `langevin` lives are slow: the first 65 536, which any error takes, are enough
    errors = _REL_ERRORS[-1:] if point.shown.fluctuates else _REL_ERRORS
    for rel_error in errors:
        try:
            return steady(
                point.shown,
                Drive(point.velocity),
                rel_error=rel_error,
                seed=point.suite_seed,
                threads=point.threads,
                max_lives=_MOST_STEADY,
            )
        except InputError as error:
            refused = error
    raise refused


def _followed(ensemble: Ensemble) -> bool:
    """True if there is a reference along programmes, and it does not take minutes, as
    for quenched contacts that heat breaks with a smooth law so narrow that steps are
    very short."""
    if ensemble.self_consistent or ensemble.fluctuates or ensemble.newborn.active:
        return False
    law, warm = ensemble.thresholds, ensemble.thermal.active
    narrow = not law.steps.size and (law.rms / law.mean) ** 2 - 1.0 < _NARROW_LAW**2
    return not (narrow and warm and ensemble.disorder == "quenched")


def _held(ensemble: Ensemble, v: float, sampled: Steady) -> Ensemble:
    """The same contacts; births of annealed ones that age are held as they are at the
    mean stretch C at breaking that was `sampled`."""
    if not ensemble.self_consistent:
        return ensemble
    held = births(ensemble, v, known(sampled.break_stretch))
    return replace(ensemble, thresholds=held, aging=Aging())


def averages(point: Point, sampled: Steady) -> Found:
    """Steady averages, to a relative error of 1e-4, or of `langevin` contacts from
    65 536 lives, against the reference."""
    exact = reference(point.ensemble, Drive(point.velocity), variance=True)
    scores: Found = []
    for name, theirs in exact.averages().items():
        ours = getattr(sampled, name)
        if theirs.value is None:
            scores += point.without((name,), "no reference")
            continue
        if name not in exact.shown:
            continue  # born unstretched: travel is the stretch at breaking
        if ours.value == theirs.value and ours.stderr == theirs.stderr == 0.0:
            continue  # pinned without delay: 1, exactly
        if ours.value is None or not ours.reliable:
            reason = "unreliable" if not ours.reliable else "refused"
            scores += point.without((name,), reason)
            continue
        response = abs(known(ours)) * (1.0 - known(ours) if name == "pinned" else 1.0)
        hidden, stderr = sampled.hidden * response, ours.stderr or 0.0
        scatter = math.sqrt(max(stderr**2 - hidden**2, 0.0))
        if point.shown.fluctuates and scatter > hidden:
            # the bound of the bias of steps is mostly far from reached
            ours, hidden = replace(ours, stderr=scatter), 0.0
        bound = math.hypot(hidden, theirs.stderr or 0.0)
        scores.append(point.score(name, ours, theirs, bound))
    return scores


class _End(NamedTuple):
    """The end of a drive: mean and variance of the force of one contact, whose errors
    are bounds, and the shares of contacts that make the mean (`carrying_share`) and, as
    far as they are known, the variance (`squaring_share`)."""

    drive: Drive | Programme
    mean: Estimate
    variance: Estimate
    carrying: float
    squaring: float = 1.0


def _end_of(
    drive: Drive | Programme, exact: Transient, i: int, drag: float, moved: float = 0.0
) -> _End:
    """The end of a drive: row `i` of a reference, whose force may be off by `moved`, the
    path of crawls and jitter that are holds in it."""
    assert exact.force_variance is not None
    assert exact.force_variance_error is not None
    mean, error = float(exact.force[i]), float(exact.force_error[i])
    square, off = float(exact.force_variance[i]), float(exact.force_variance_error[i])
    carrying = carrying_share(mean, square, float(exact.pinned[i]), drag)
    variance = Estimate(square, off + 2.0 * abs(mean) * moved, 0)
    return _End(drive, Estimate(mean, error + moved, 0), variance, carrying)


def _score_end(
    point: Point,
    end: _End,
    kinds: tuple[str, ...],
    streams: tuple[tuple[int, ...], ...],
) -> Found:
    """Score the mean force at the end of a drive, and by other contacts its variance, if
    a pilot run finds enough of them. Force, pilot and variance have random numbers of
    their own, `streams`."""
    shown, level, variance = point.shown, known(end.mean), known(end.variance)
    few = shown.count * end.carrying
    if shown.fluctuates:
        # if nearly all have the same force, the few that have broken make its variance;
        # the law of `langevin` contacts is not known well enough to tell how large it is
        few = min(few, shown.count * variance / max(level**2, 1e-300))
    if not few >= ENOUGH_CONTACTS:
        return point.without(kinds, "few contacts")
    first, pilot, groups = (point.stream(*numbers) for numbers in streams)
    run = trajectory(shown, end.drive, points=2, seed=first, threads=point.threads)
    scores = point.without(kinds[:1], "unreliable")
    if run.force_reliable:
        ours = Estimate(float(run.force[-1]), float(run.force_stderr[-1]), shown.count)
        scores = [point.score(kinds[0], ours, end.mean)]
    group = replace(shown, count=shown.count // GROUPS)
    enough = min(few, shown.count * end.squaring) >= ENOUGH_SQUARES
    if not (
        enough and many_contribute(_mean_squares(level, group, end.drive, pilot)[0])
    ):
        return scores + point.without(kinds[1:], "few contacts")
    squares, lost = _mean_squares(level, group, end.drive, groups)
    ours = mean_of(squares, 0, GROUPS - 1)
    ours = replace(ours, stderr=math.hypot(ours.stderr or 0.0, lost))
    bound = math.hypot(end.variance.stderr or 0.0, lost)
    return [*scores, point.score(kinds[1], ours, end.variance, bound)]


def _affordable(
    point: Point, plan: Suite, drive: Drive | Programme, most: int, lives: float
) -> Point:
    """The point with as many contacts as the suite affords along a drive, at most `most`
    of them, or as many as have so many `lives`. Raises LeftOut if even few contacts have
    too many lives, as at low velocities."""
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
    """The mean force at eight displacements, each of an ensemble of its own, and its
    variance, of others: over five mean thresholds, or over two lives and delays."""
    ensemble, v = point.ensemble, point.velocity
    typical = reference(ensemble, Drive(v))
    distance = 5 * ensemble.thresholds.mean
    if point.seed % 2:
        distance = 2 * (known(typical.travel) + v * ensemble.delay_time(v))
    whole = point.drive(distance)
    sized = _affordable(point, plan, whole, 20_000, 1e6)
    # a grid fine enough for jumps of F, whose error is that of a few cells
    steps = ensemble.thresholds.steps.size * has_jumps(ensemble.thresholds)
    every = max(1, _GRID_CELLS // (_DISPLACEMENTS * max(12, steps))) if steps else 1
    exact = transient(ensemble, whole, points=_DISPLACEMENTS * every + 1, variance=True)
    if exact.force_variance is None or exact.force_variance_error is None:
        raise LeftOut("vague")
    scores, levels = [], exact.force[::every]
    squaring = squaring_shares_at_first(ensemble, whole, levels)
    for i in range(1, _DISPLACEMENTS + 1):
        drive = point.drive(distance * i / _DISPLACEMENTS)
        end = _end_of(drive, exact, i * every, drag_over_k(ensemble, v))
        end = end._replace(squaring=squaring[i])
        scores += _score_end(sized, end, transients.kinds, ((i,), (i, 1), (i, 2)))
    return scores


class HeldProgramme(NamedTuple):
    """A `programme` some of whose holds are crawls or jitter, and the `same` one with
    plain holds. Segment i of `same` ends with the first `ends[i]` segments of the
    `programme`; their forces differ by `off` at most."""

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
    segments, plain, ends, moved = [first], [first], [1], 0.0
    forward = True
    while len(plain) < _SEGMENTS_COMPARED:
        kind = rng.choice(["hold", "reversal", "step"])
        if kind == "hold":
            hold = Segment(0.0, time=life / v * 10 ** rng.uniform(-1, 2), points=1)
            pieces = _pieces(hold, life, v, rng)
            moved += max(piece.path for piece in pieces)
            plain.append(hold)
        else:
            forward = forward == (kind == "step")
            distance = life * 10 ** rng.uniform(-0.7, 0.5)
            velocity = (1 if forward else -1) * v * 10 ** rng.uniform(-1, 1)
            pieces = [Segment(velocity, distance=distance, points=1)]
            plain += pieces
        segments += pieces
        ends.append(len(segments))
    start: Start = "stationary" if rng.random() < 0.5 else "fresh"
    whole, same = (Programme(tuple(each), start, v) for each in (segments, plain))
    return HeldProgramme(whole, same, ends, moved)


def _pieces(
    hold: Segment, life: float, v: float, rng: np.random.Generator
) -> list[Segment]:
    """A hold as it is, or as a crawl or jitter of next to no displacement."""
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
    whole, plain, ends, moved = programme_of(point)
    sized = _affordable(point, plan, whole, 100_000, 4e6)
    try:
        exact = transient(point.ensemble, plain, 2, variance=True)
    except InputError:  # tails may be too long for a stationary start
        whole, plain = (replace(each, start="fresh") for each in (whole, plain))
        exact = transient(point.ensemble, plain, 2, variance=True)
    scores: Found = []
    for i, (segment, last) in enumerate(zip(plain.segments, ends, strict=True), 1):
        drag = drag_over_k(point.ensemble, abs(segment.velocity))
        drag = math.copysign(drag, segment.velocity)
        drive = replace(whole, segments=whole.segments[:last])
        end = _end_of(drive, exact, i, drag, moved)
        scores += _score_end(sized, end, programmes.kinds, ((i, 3), (i, 4), (i, 5)))
    return scores


def _mean_squares(
    level: float, group: Ensemble, drive: Drive | Programme, seed: int
) -> tuple[Array, float]:
    """The variance of F/k per contact about its expectation, at the end of the drive,
    in each of GROUPS groups; and what rounding of sums may have changed it by, which
    is much if the law knows contacts far stronger than any of these."""
    forces, variances, lost = _forces(group, drive, GROUPS, seed)
    squares = variances + (forces - level) ** 2
    return np.asarray(squares[:, 1]), float(lost[:, 1].mean())


@compares("hazard", "hazard law")
def hazards(point: Point, plan: Suite) -> Found:
    """Integrated hazards Lambda at breaking against Exp(1), censored at each contact's
    own threshold xi, in two ways.

    The number of lives that end by heat has the mean of the sum of integrated hazards,
    which is also the variance of their difference. And of lives that end by heat, U =
    (1 - exp(-Lambda))/(1 - exp(-Lambda(xi))) is uniform: the conditional probability to
    end as early. For `langevin` contacts S(x_b) is uniform, S the mean over paths.
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
        return [point.uniform(Profile(s).at(stretch * unit)[0])]
    xi = np.empty(u.size)
    thresholds(c.thresholds, u, xi)
    end = xi
    if not (c.aging.closed or c.aging.fluctuates):
        end = np.empty(u.size)
        whole_lives(c, xi, end, np.empty(u.size))
    thermal = stretch < end * (1.0 - _THRESHOLD_ROUNDING)
    xi, stretch, end = xi * unit, np.minimum(stretch, end) * unit, end * unit
    hazard, total = (hazard_passed(s, 0.0 * xi, x, xi) for x in (stretch, end))
    mean, scores = float(hazard.sum()), point.without(hazards.kinds, "few contacts")
    if mean >= ENOUGH_CONTACTS:
        ours = Estimate(float(thermal.sum()), math.sqrt(mean), u.size)
        scores[0] = point.score("hazard", ours, Estimate(mean, 0.0, 0))
    if thermal.any():
        share = np.expm1(-hazard[thermal]) / np.expm1(-total[thermal])
        scores[1] = point.uniform(share)
    return scores


def of_products(terms: Array, forces: Array, variance: float) -> Estimate:
    """Mean of squares or products of forces about their mean. Its error is that at the
    exact variance, in proportion to which squares scatter: it is not small just where
    these happen to be."""
    found = mean_of(terms, terms.size)
    usual = variance / float(np.mean(forces**2))
    return replace(found, stderr=usual * (found.stderr or 0.0))


@compares("mean", "variance", "covariance")
def fluctuating(point: Point, plan: Suite) -> Found:
    """Mean, variance and the autocovariance at half a mean life of F/(N k) of
    stationary ensembles of 20, 100 or more contacts. Raises InputError where lives
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
    means, drag = reference(ensemble, Drive(v)), drag_over_k(ensemble, v)
    level, lag = known(means.friction), 0.5 * known(means.travel)
    shown = replace(shown, count=count)
    if predicted_lives(shown, point.drive(lag)) * ensembles > most:
        raise LeftOut("too many lives")
    exact = fluctuations(ensemble, point.drive(lag), points=2)
    # contacts that carry the force in all ensembles together
    carrying = carrying_share(
        level, float(exact.covariance[0]), known(means.pinned), drag
    )
    carry = count * ensembles * carrying
    square, product = (exact.covariance + (level - drag) ** 2).tolist()
    if carry < ENOUGH_CONTACTS:
        raise LeftOut("few contacts")
    at_once = point.drive(1e-6 * lag, "stationary")
    group = replace(shown, count=max(1, min(count * ensembles, _PILOT) // GROUPS))
    rare = count * ensembles * squaring_share_at_last(ensemble, v, level)
    of_squares = min(carry, rare) / ENOUGH_SQUARES
    if of_squares >= 1.0:
        of_squares *= many_contribute(
            _mean_squares(level, group, at_once, point.stream(1))[0]
        )
    forces = _forces(shown, point.drive(lag, "stationary"), ensembles, point.seed)[0]
    first, second = (forces - level).T
    # error of the mean, also that of C at which births are held
    held = _REL_ERROR * level if ensemble.self_consistent else 0.0
    off = math.hypot(held, means.friction.stderr or 0.0)
    values, errors = exact.covariance / count, exact.error / count
    scores: Found = []
    for kind, enough, terms, value, error in (
        ("mean", True, forces[:, 0], level, off),
        ("variance", of_squares >= 1.0, first**2, values[0], errors[0]),
        # few contacts may carry the force at both instants
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
        ours = mean_of(terms, ensembles)
        if kind != "mean":
            ours = of_products(terms, first, float(values[0]))
        scores.append(point.score(kind, ours, theirs))
    return scores


def _forces(
    ensemble: Ensemble, drive: Drive | Programme, ensembles: int, seed: int
) -> tuple[Array, Array, Array]:
    """F/(N k) at the beginning and the end of a drive, shape (ensembles, 2), its
    variance over the contacts of each ensemble, and the error of that by rounding."""
    n, unit = ensemble.count, ensemble.thresholds.scale
    job = _job(ensemble, drive, seed)
    forces, variances, lost = np.empty((3, ensembles, 2))
    for index in range(ensembles):
        total = job.totals(1)
        job.simulate(total, index * n, (index + 1) * n)
        found = job.moments(total.deposits, n)
        forces[index] = found.force[[0, -1]] * unit
        variances[index] = found.variance[[0, -1]] * unit**2
        lost[index] = found.lost[[0, -1]] * unit**2
    return forces, variances, lost


def _job(ensemble: Ensemble, drive: Drive | Programme, seed: int) -> Steps:
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


DRIVEN = transients, programmes, hazards, fluctuating
DRIVEN_KINDS = (*OBSERVABLES, *(kind for compare in DRIVEN for kind in compare.kinds))
