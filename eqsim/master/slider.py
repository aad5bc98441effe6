"""Mean field of a slider that a stage pulls: the expectation of infinitely many
contacts along the X(t) they allow.

The force of all contacts is what the renewal equation in two times says of X so far
(`master.programme`), and X obeys

    m X'' + eta_s X' = kappa_s (Y - X) - F - eta_l X' (1 - pinned),

all per N k. In a step F is taken for F + (A + rho) dX + r dt, with A the stiffness of
all pinned contacts and rho (without heat, per dX) or r (with heat, per dt) what breaks
and births added in the last step, for which X is found by an implicit Runge-Kutta
method (the engine has closed forms). Steps are so short that dX and what this
estimate misses, of F and of the pinned fraction, are small; two accuracies, the second
with steps about half as long, give the result and its error, and a third one where that
takes few steps.
"""

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from eqsim.errors import InputError
from eqsim.master.cohorts import (
    NO_CHOICES,
    Choices,
    CohortPath,
    History,
    advance_all,
    begin,
    empty,
    observe,
    unmade_choices,
    with_room,
)
from eqsim.master.programme import (
    MOST_STEPS,
    Numerics,
    Transient,
    course_of,
    numerics_of,
    with_drag,
)
from eqsim.model.drive import Grid, Programme
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import drag_of
from eqsim.numerics.compiled import kernel, routine
from eqsim.numerics.quadrature import largest_nearby
from eqsim.numerics.tables import Array
from eqsim.numerics.threads import ThreadPool

# Steps of the second accuracy, those of a few slips, up to which a third one is solved
# for.
_STEPS_OF_FEW_SLIPS = 6000
# The same of discrete laws, every threshold of which begins cohorts of its own.
_STEPS_OF_DISCRETE = 1000
# By how much F may be missed in a step of the coarsest accuracy, in units of a typical
# threshold.
_MISSED = 1e-4
# Share of it by which r may be missed.
_UNBALANCED = 0.05
# Trials in which r is found.
_TRIALS = 8
# Share of the longest step without heat, in which all contacts may break at once.
_ALL_AT_ONCE = 1e-4
# Share of the longest step, in which equal thresholds may break that change F by as
# much as may be missed.
_EQUAL_AT_ONCE = 0.1
# What a straight X(t) misses in the middle of a step, over what r changes in it.
_BENT = 0.125
# How much farther than others given steps may go, and how much worse they may miss F.
_FARTHER = 10.0
_WORSE = 30.0
# Cohorts whose fates there is room for, in the mean over steps.
_FATES = 128
# A piece of a step in units of the time of the motion, and pieces at most where that is
# stable: faster motions have ended within a step.
_PIECE = 0.0625
_MOST_PIECES = 24
# A mass that next to nothing pulls back: one piece misses 2e-3 of how far it coasts.
_PIECES_OF_A_MASS = 2
# Times of the motion in a step beyond which what runs away is taken to be at infinity.
_RUNAWAY = 30.0
# The shortest step over the whole time: more than rounding.
_LEAST_STEP = 1e-13
# The first step over the whole time.
_FIRST_OF_ALL = 1e-6
# The shortest step over the longest displacement: as in the engine.
_STEP_PER_WIDTH = 1e-9
# Time in which the slider moves at once, over the displacement: as in the engine.
_TIME_AT_ONCE = 1e-12


class TooManySteps(InputError):
    """The mean field of a slider that slips too often."""


class Spring(NamedTuple):
    """Stage and slider, with time in units of the whole programme: numbers of the
    equation, `drag` being the damping per detached share; whether the spring balances
    all other forces at first, or else its stretch, and the velocity then; whether heat
    breaks contacts; and whether equal thresholds break at once."""

    stiffness: float
    damping: float
    drag: float
    mass: float
    in_balance: bool
    stretch: float
    velocity: float
    heat: bool
    discrete: bool


class Slide(NamedTuple):
    """Means at the edges of steps, shape (6, edges), as in `Solution`, but for X; how
    many edges there are; and whether they reach the last mark. They do not where there
    are too many, or where given choices do not fit."""

    means: Array
    edges: int
    complete: bool


@routine
def displaced(
    mass: float,
    damping: float,
    stiffness: float,
    net: float,
    gain: float,
    V: float,
    dt: float,
) -> tuple[float, float]:
    """Displacement and velocity after dt of what obeys, from X = 0 and X' = V,

        mass X'' + damping X' = net + gain t - stiffness X;

    infinite where nothing holds it. Solved by the method Radau IIA of two stages
    (L-stable and of third order; Hairer and Wanner, 1996, table IV.5.5), in pieces
    beside which the motion is slow; the engine has closed forms."""
    slow = damping + math.sqrt(mass * abs(stiffness))
    fast = abs(stiffness) * dt
    if stiffness <= 0.0 and (fast > _RUNAWAY * slow or damping + mass == 0.0):
        return math.inf, math.inf
    pieces = 1 if mass == 0.0 else _PIECES_OF_A_MASS
    if slow > 0.0:
        most = _MOST_PIECES if stiffness > 0.0 else math.inf
        pieces = max(pieces, math.ceil(min(fast / (_PIECE * slow), most)))
    h, X = dt / pieces, 0.0
    inertia, spring = mass / h, stiffness * h
    # of both stages, in the velocities v1 and v2 at h/3 and h
    a11 = damping + 1.5 * inertia + 5.0 / 12.0 * spring
    a12 = 0.5 * inertia - spring / 12.0
    a21 = 0.75 * spring - 4.5 * inertia
    a22 = damping + 2.5 * inertia + 0.25 * spring
    determinant = a11 * a22 - a12 * a21
    for piece in range(pieces):
        force = net + gain * piece * h - stiffness * X
        f1 = force + gain * h / 3.0 + 2.0 * inertia * V
        f2 = force + gain * h - 2.0 * inertia * V
        v1 = (f1 * a22 - f2 * a12) / determinant
        V = (f2 * a11 - f1 * a21) / determinant
        X += h * (0.75 * v1 + 0.25 * V)
    return X, V if mass > 0.0 else X / dt


@kernel
def pull(
    contacts: Any,
    path: CohortPath,
    spring: Spring,
    marks: Array,
    speeds: Array,
    tolerance: float,
) -> Slide:
    """Fill `path` from its first edge on. Steps end at `marks` (marks,), up to each of
    which the stage moves at `speeds`, and miss F by `tolerance` about; with given
    choices they are those of `path.t`."""
    t, X, choices, given = path.t, path.X, path.choices, path.choices.given
    # arrays of their own take ten times as long, longer than a short solve
    means = np.zeros((6, t.size))
    history = History(means[0], means[1], means[2], means[3])
    Y, velocity, whole = means[4], means[5], marks[-1]
    cohorts = empty(contacts.nodes.size, 256 + path.cohorts)
    count, rate = begin(contacts, path, cohorts)
    stiffness = observe(cohorts, count, X[0], history, 0)
    Y[0], velocity[0] = spring.stretch, spring.velocity
    if spring.in_balance:
        damping = spring.damping + spring.drag * (1.0 - history.pinned[0])
        Y[0] = (history.force[0] + damping * spring.velocity) / spring.stiffness
    # of the last step: what breaks and births changed F by, per dX (rho) and per time
    # (r), the change of the pinned share per time (q), and the acceleration
    rho, r, q, acceleration = 0.0, 0.0, 0.0, 0.0
    longest = _FIRST_OF_ALL * whole
    shortest = max(_STEP_PER_WIDTH * path.width, _LEAST_STEP * whole)
    halvings = 0  # of the longest displacement in no time
    usual = 0.0  # step before many contacts broke at once, to go on with
    m, k = 1, 0
    while k < marks.size and m < t.size and path.stop[0] == 0:
        force, pinned, V0 = history.force[m - 1], history.pinned[m - 1], velocity[m - 1]
        net = spring.stiffness * (Y[m - 1] - X[m - 1]) - force
        damping = spring.damping + spring.drag * (1.0 - pinned)
        held, A = spring.stiffness + stiffness + rho, stiffness
        last = 1.2 * longest >= marks[k] - t[m - 1]
        dt, halvings = marks[k] - t[m - 1] if last else longest, max(halvings - 2, 0)
        if given:
            dt, last = t[m] - t[m - 1], t[m] == marks[k]
            halvings = choices.steps[m].halvings
        guess, tries, guess_before, missed_before = r, 0, 0.0, 0.0
        while True:
            gain = spring.stiffness * speeds[k] - guess
            dX, V = displaced(spring.mass, damping, held, net, gain, V0, dt)
            instant = not abs(dX) <= 1.5 * path.width or tries == _TRIALS
            if given:
                instant = choices.steps[m].instant
                if not instant and not abs(dX) <= _FARTHER * path.width:
                    return Slide(means, m, False)
            elif instant and dt > shortest:
                dt, last, guess, tries = 0.5 * dt, False, r, 0
                continue
            if instant:
                # nothing holds the slider: a piece in no time, towards balance
                size = path.width * 0.5**halvings
                if held > 0.0:
                    least = (1e-2 if spring.heat else 1e-6) * path.width
                    size = min(size, max(abs(net) / held, least))
                dX, V = math.copysign(size, net), 0.0
                if not given:
                    dt = max(_TIME_AT_ONCE * size, 1e-15 * whole)
            if not given:
                t[m] = marks[k] if last else t[m - 1] + dt
            X[m] = X[m - 1] + dX
            Y[m], velocity[m] = Y[m - 1] + speeds[k] * (t[m] - t[m - 1]), V
            after, rows = cohorts, cohorts.order.size
            # a copy, as the step may be tried again
            if not given or spring.heat or count == rows:
                after = with_room(cohorts, 2 * count if count == rows else rows)
            kept = advance_all(contacts, path, after, history, m, count, rate)
            stiffness = observe(after, kept, X[m], history, m)
            change = history.force[m] - force - A * dX
            off = abs(change - rho * dX - r * dt)
            off = max(off, abs(history.pinned[m] - pinned - q * dt))
            if spring.heat:
                off *= _BENT
            # r obeys an equation, as the slider moves by what it says
            missed = change / dt - guess
            sudden = not (spring.heat or given) and off > 4.0 * tolerance
            least = _ALL_AT_ONCE
            if sudden and spring.discrete:
                least = max(least, _EQUAL_AT_ONCE * tolerance / off)
            if sudden and abs(dX) > least * path.width:
                # many contacts break at once, or begin to: when and where has to be
                # known, the better the more
                usual = max(usual, dt)
                halvings = math.ceil(math.log2(2.0 * path.width / abs(dX)))
                tries = _TRIALS if instant or dt <= shortest else 0
                dt, last, guess = 0.5 * dt, False, r
                continue
            if not spring.heat or instant:
                break
            if given and (tries == choices.steps[m].trials or missed == missed_before):
                break
            if not given and abs(missed) * dt < _UNBALANCED * tolerance:
                if off < 4.0 * tolerance:
                    break
                tries = _TRIALS
                continue
            slope = -1.0
            if tries > 0:
                slope = (missed - missed_before) / (guess - guess_before)
            guess_before, missed_before = guess, missed
            guess, tries = guess - missed / slope, tries + 1
        if given and off > _WORSE * tolerance and not instant:
            return Slide(means, m, False)
        cohorts, count = after, kept
        if not given and m < choices.steps.size:
            decision = choices.steps[m]
            decision.t = t[m]
            decision.trials = tries
            decision.instant = instant
            decision.halvings = halvings
        q = (history.pinned[m] - pinned) / dt
        if spring.mass > 0.0:
            bent = 4.0 * dt * abs(V - V0 - acceleration * dt)
            off = max(off, bent * (spring.stiffness + stiffness))
            acceleration = (V - V0) / dt
        if not instant:
            grown = 1.5 * dt
            if off > 0.0:
                grown = dt * min(max(0.9 * math.sqrt(tolerance / off), 0.3), 1.5)
            longest = max(grown, longest) if last and off < tolerance else grown
            if sudden and spring.discrete:  # they have broken
                longest, usual = max(longest, usual), 0.0
        if spring.heat:
            r = 0.0 if instant else change / dt
        else:
            softer = change / dX if dX != 0.0 else 0.0
            # else an atom breaks, which tells nothing
            if off < 4.0 * tolerance or abs(softer) < abs(rho):
                rho = softer
        k += last
        m += 1
    return Slide(means, m, k == marks.size)


class Solution(NamedTuple):
    """A solve, or its errors, at the instants asked for, arrays (points,): what
    `History` has, the displacement of the stage, the velocity of the slider, and X;
    lengths in units of the law's scale, time in units of the whole programme."""

    force: Array
    pinned: Array
    square: Array
    breaks: Array
    stage: Array
    velocity: Array
    X: Array


def pulled_of(ensemble: Ensemble, programme: Programme, grid: Grid) -> Transient:
    """The mean field of a slider that a stage pulls (derived). Raises InputError for
    what has no reference along a programme, and where it takes too many steps."""
    unit, time = ensemble.thresholds.scale, float(grid.t[-1])
    best, _, missed = solutions_of(ensemble, programme, grid)
    spread = np.maximum(best.square - best.force**2, 0.0)
    values = np.array((best.force, best.pinned, spread))
    drag = drag_of(ensemble, unit / time)
    breaks = np.gradient(best.breaks, grid.t) if grid.t.size > 1 else best.breaks
    forces = drag * best.velocity, drag * missed.velocity
    means = with_drag(grid, values, np.array(missed[:3]), *forces, unit, breaks)
    X, stage, X_error = unit * np.array((best.X, best.stage, missed.X))
    return replace(means, X=X, stage=stage, X_error=X_error)


def solutions_of(
    ensemble: Ensemble, programme: Programme, grid: Grid
) -> tuple[Solution, Solution, Solution]:
    """The best solution, one of steps about twice as long, and the errors of the best.
    Raises InputError as `pulled_of` does."""
    task = task_of(ensemble, programme, grid)
    # Steps end at instants, so that solves of different accuracy, if they all had the
    # same instants, might take the same steps and not differ, whatever they miss.
    kept = np.unique(np.append(np.arange(0, task.t.size, 2), task.t.size - 1))
    fewer, _ = solved(task._replace(t=task.t[kept]), 1)
    best, steps = solved(task, 2)
    coarse = best
    off = np.zeros_like(best)
    off[:, kept] = np.abs(np.array(best)[:, kept] - fewer)
    discrete = ensemble.thresholds.steps.size > 0
    if steps <= (_STEPS_OF_DISCRETE if discrete else _STEPS_OF_FEW_SLIPS):
        best, _ = solved(task._replace(halved=True), 4)
        off = np.abs(np.array(best) - coarse) + 0.5 * off
    errors = largest_nearby(off, 5 + off.shape[1] // 50)
    errors += 1e-6 * np.abs(best).max(axis=1, keepdims=True)
    errors[-1, 0] = 0.0  # of X
    return best, coarse, Solution(*errors)


def force_of(
    ensemble: Ensemble,
    programme: Programme,
    grid: Grid,
    fine: float,
    most_steps: int = MOST_STEPS,
    choices: Choices = NO_CHOICES,
) -> Array:
    """The force at the instants of a grid by one solve, in the user's unit, shape
    (points,): that with fine = 1 takes a tenth of the time of `pulled_of`, and misses
    about four times as much as that with fine = 2. It repeats `choices`, those of
    `choices_of` for other parameters, where they serve. Raises TooManySteps if it takes
    more than `most_steps`, and InputError as `pulled_of` does."""
    unit, time = ensemble.thresholds.scale, float(grid.t[-1])
    task = task_of(ensemble, programme, grid)
    try:
        best, _ = solved(task, fine, most_steps, choices)
    except TooManySteps:
        if not choices.given:
            raise
        best, _ = solved(task, fine, most_steps)
    drag = drag_of(ensemble, unit / time) * best.velocity
    return np.asarray((best.force + drag * (1.0 - best.pinned)) * unit)


def choices_of(
    ensemble: Ensemble, programme: Programme, grid: Grid, fine: float, most_steps: int
) -> Choices:
    """What `force_of`, which raises the same errors, decides."""
    noted = unmade_choices(most_steps, most_steps * _FATES)
    _, edges = solved(task_of(ensemble, programme, grid), fine, most_steps, noted)
    steps = noted.steps[: edges + 1].copy()
    fates = int(steps["first"][edges])
    if fates > noted.fates.size:
        raise TooManySteps(
            f"drive.stage: {fates} cohorts in {edges} steps of the mean field"
        )
    return Choices(steps, noted.fates[:fates].copy(), True)


class PulledTask(NamedTuple):
    """Task that is solved at any accuracy, with the instants asked for; steps end
    there, and if `halved` in the middle between these, too."""

    numerics: Numerics
    spring: Spring
    t: Array
    halved: bool = False


def task_of(ensemble: Ensemble, programme: Programme, grid: Grid) -> PulledTask:
    """The task of a stage, lengths in units of the law's scale. Raises InputError."""
    stage = programme.stage
    assert stage is not None
    contacts, course = course_of(ensemble, programme)
    unit, time = ensemble.thresholds.scale, float(grid.t[-1])
    spring = Spring(
        stiffness=stage.stiffness,
        damping=stage.damping / time,
        drag=drag_of(ensemble, unit / time),
        mass=stage.mass / time**2,
        in_balance=stage.preload is None and course.before > 0.0,
        stretch=(stage.preload or 0.0) / unit,
        velocity=course.before,
        heat=contacts.barrier.thermal,
        discrete=contacts.law.steps.size > 0,
    )
    path = float(np.ptp(course.at(np.append(0.0, course.ends))))
    reach = 2.0 * (path + abs(spring.stretch))  # a mass may overshoot
    numerics = numerics_of(contacts, course, reach or math.inf)
    return PulledTask(numerics, spring, grid.t / time)


def solved(
    task: PulledTask,
    fine: float,
    most_steps: int = MOST_STEPS,
    choices: Choices = NO_CHOICES,
) -> tuple[Solution, int]:
    """Solve, and count the edges of steps, too. Raises TooManySteps, also if given
    steps do not serve."""
    numerics, ends = task.numerics, task.numerics.course.ends
    t = np.full(most_steps, math.inf)
    if choices.given:
        t = choices.steps["t"][:-1].copy()
    path = numerics.path(t, np.zeros(t.size), fine, choices)
    if choices.given and path.cohorts:
        first = choices.steps["first"]
        path = path._replace(cohorts=int(first[2] - first[1]) - 1)
    path.t[0] = 0.0
    # steps end at marks, up to each of which the stage has a speed
    marks = np.unique(np.concatenate((task.t, ends)))
    marks = marks[(marks > 0.0) & np.append(np.diff(marks) > 1e-12, True)]
    if task.halved:
        marks = np.union1d(marks, marks - 0.5 * np.diff(marks, prepend=0.0))
    segment = np.minimum(np.searchsorted(ends, marks * (1.0 - 1e-12)), ends.size - 1)
    contacts, speeds = numerics.contacts(fine), numerics.course.velocity[segment]
    tolerance = _MISSED * numerics.typical / fine**2
    with ThreadPool(1) as thread:
        path = path._replace(stop=thread.stop)
        slide = thread.submit(
            pull, contacts, path, task.spring, marks, speeds, tolerance
        ).result()
    if not slide.complete:
        raise TooManySteps(
            f"drive.stage: takes more than {most_steps} steps of the mean field"
        )
    seen = np.append(0.0, marks)
    seen = seen[np.searchsorted(seen, task.t * (1.0 - 1e-12))]
    index = np.searchsorted(path.t[: slide.edges], seen)
    return Solution(*np.vstack((slide.means, path.X))[:, index]), slide.edges
