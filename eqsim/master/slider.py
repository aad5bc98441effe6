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
from typing import Any, NamedTuple

import numpy as np

from eqsim.errors import InputError
from eqsim.master.cohorts import (
    NO_CHOICES,
    Choices,
    History,
    Path,
    advance_all,
    begin,
    empty,
    observe,
    unmade_choices,
    with_room,
)
from eqsim.master.programme import (
    MOST_STEPS,
    Means,
    Numerics,
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
_FEW_STEPS = 6000
# The same of discrete laws, every threshold of which begins cohorts of its own.
_FEW_OF_TABLES = 1000
# By how much F may be missed in a step of the coarsest accuracy, in units of a typical
# threshold.
_MISSED = 1e-4
# Share of it by which r may be missed.
_UNBALANCED = 0.05
# Trials in which r is found.
_TRIES = 8
# Share of the longest step without heat, in which all contacts may break at once.
_LANDED = 1e-4
# Share of the longest step, in which equal thresholds may break that change F by as
# much as may be missed.
_SHARE = 0.1
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
_PIECES = 24
# A mass that next to nothing pulls back: one piece misses 2e-3 of how far it coasts.
_PIECES_OF_A_MASS = 2
# Times of the motion in a step beyond which what runs away is taken to be at infinity.
_RUNAWAY = 30.0
# The shortest step over the whole time: more than rounding.
_RESOLVED = 1e-13
# The first step over the whole time.
_FIRST = 1e-6
# The shortest step over the longest displacement: as in the engine.
_SHORTEST = 1e-9
# Time in which the slider moves at once, over the displacement: as in the engine.
_INSTANT = 1e-12


class TooManySteps(InputError):
    """The mean field of a slider that slips too often."""


class Spring(NamedTuple):
    """Stage and slider, with time in units of the whole programme.

    Attributes
    ----------
    stiffness, damping, drag, mass : float
        Numbers of the equation; `drag` is the damping per detached share.
    in_balance : bool
        Whether the spring balances all other forces at first. Else it has the
        `stretch`.
    stretch, velocity : float
        Of the spring and of the slider at first.
    heat : bool
        Whether heat breaks contacts.
    discrete : bool
        Whether equal thresholds break at once.
    """

    stiffness: float
    damping: float
    drag: float
    mass: float
    in_balance: bool
    stretch: float
    velocity: float
    heat: bool
    discrete: bool


class Balance(NamedTuple):
    """Forces on the slider: stretch of the spring, velocities of slider and stage, F,
    A, pinned, and what breaks do per displacement."""

    stretch: float
    V: float
    speed: float
    force: float
    stiffness: float
    pinned: float
    rho: float


class Motion(NamedTuple):
    """What resists the motion of the slider in a step."""

    mass: float
    damping: float
    stiffness: float


class Slide(NamedTuple):
    """Result at the edges of steps, arrays (edges,): what contacts do, the displacement
    of the stage and the velocity of the slider; how many edges there are; and whether
    they reach the last mark. They do not where there are too many, or where given
    choices do not fit."""

    history: History
    stage: Array
    velocity: Array
    edges: int
    complete: bool


@routine
def moved(
    motion: Motion, net: float, gain: float, V: float, dt: float
) -> tuple[float, float]:
    """Displacement and velocity after dt of what obeys, from X = 0 and X' = V,

        mass X'' + damping X' = net + gain t - stiffness X;

    infinite where nothing holds it. Solved by the method Radau IIA of two stages (L-stable
    and of third order; Hairer and Wanner, 1996, table IV.5.5), in pieces beside which the
    motion is slow; the engine has closed forms, which its first guess is built on."""
    mass, damping, stiffness = motion
    slow = damping + math.sqrt(mass * abs(stiffness))
    fast = abs(stiffness) * dt
    if stiffness <= 0.0 and (fast > _RUNAWAY * slow or damping + mass == 0.0):
        return math.inf, math.inf
    pieces = 1 if mass == 0.0 else _PIECES_OF_A_MASS
    if slow > 0.0:
        most = _PIECES if stiffness > 0.0 else math.inf
        pieces = max(pieces, math.ceil(min(fast / (_PIECE * slow), most)))
    h, X = dt / pieces, 0.0
    inertia, spring = mass / h, stiffness * h
    # of both stages, in the velocities v1 and v2 at h/3 and h
    a11 = damping + 1.5 * inertia + 5.0 / 12.0 * spring
    a12 = 0.5 * inertia - spring / 12.0
    a21 = 0.75 * spring - 4.5 * inertia
    a22 = damping + 2.5 * inertia + 0.25 * spring
    for piece in range(pieces):
        force = net + gain * piece * h - stiffness * X
        f1 = force + gain * h / 3.0 + 2.0 * inertia * V
        f2 = force + gain * h - 2.0 * inertia * V
        determinant = a11 * a22 - a12 * a21
        v1 = (f1 * a22 - f2 * a12) / determinant
        V = (f2 * a11 - f1 * a21) / determinant
        X += h * (0.75 * v1 + 0.25 * V)
    return X, V if mass > 0.0 else X / dt


@routine(inline=True)
def _estimate(spring: Spring, b: Balance, r: float, dt: float) -> tuple[float, float]:
    """Displacement in a step, infinite where nothing holds the slider, and the velocity
    then, where breaks and births change F by r per time."""
    motion = Motion(
        mass=spring.mass,
        damping=spring.damping + spring.drag * (1.0 - b.pinned),
        stiffness=spring.stiffness + b.stiffness + b.rho,
    )
    net = spring.stiffness * b.stretch - b.force
    return moved(motion, net, spring.stiffness * b.speed - r, b.V, dt)


@kernel
def pull(
    contacts: Any,
    path: Path,
    spring: Spring,
    marks: Array,
    speeds: Array,
    tolerance: float,
) -> Slide:
    """Fill `path` from its first edge on. Steps end at `marks` (marks,), up to each of
    which the stage moves at `speeds`, and miss F by `tolerance` about; with given
    choices they are those of `path.t`."""
    t, X, choices, given = path.t, path.X, path.choices, path.choices.given
    rows = np.zeros(
        (6, t.size)
    )  # as arrays of their own they take ten times as long, longer than a short solve
    history, Y, velocity = History(rows[0], rows[1], rows[2], rows[3]), rows[4], rows[5]
    population = empty(contacts.nodes.size, 256 + path.cohorts)
    count, rate = begin(contacts, path, population)
    stiffness = observe(population, count, X[0], history, 0)
    Y[0], velocity[0] = spring.stretch, spring.velocity
    if spring.in_balance:
        damping = spring.damping + spring.drag * (1.0 - history.pinned[0])
        Y[0] = (history.force[0] + damping * spring.velocity) / spring.stiffness
    longest, rho, r, q, a, m, k = (
        _FIRST * marks[marks.size - 1],
        0.0,
        0.0,
        0.0,
        0.0,
        1,
        0,
    )
    halvings = 0  # of the longest displacement in no time
    usual = 0.0  # step before many contacts broke at once, to go on with
    shortest = max(_SHORTEST * path.width, _RESOLVED * marks[marks.size - 1])
    while k < marks.size and m < t.size and path.stop[0] == 0:
        left = marks[k] - t[m - 1]
        b = Balance(
            stretch=Y[m - 1] - X[m - 1],
            V=velocity[m - 1],
            speed=speeds[k],
            force=history.force[m - 1],
            stiffness=stiffness,
            pinned=history.pinned[m - 1],
            rho=rho,
        )
        last, guess, tries, guess_before, missed_before = (
            1.2 * longest >= left,
            r,
            0,
            0.0,
            0.0,
        )
        halvings = (
            choices.halvings[m]
            if given and choices.instant[m]
            else max(halvings - 2, 0)
        )
        dt = left if last else longest
        if given:
            dt, last = t[m] - t[m - 1], t[m] == marks[k]
        while True:
            dX, V = _estimate(spring, b, guess, dt)
            instant = not abs(dX) <= 1.5 * path.width or tries == _TRIES
            if given:
                instant = choices.instant[m]
                if not instant and not abs(dX) <= _FARTHER * path.width:
                    return Slide(history, Y, velocity, m, False)
            elif instant and dt > shortest:
                dt, last, guess, tries = 0.5 * dt, False, r, 0
                continue
            if (
                instant
            ):  # nothing holds the slider: a piece that takes no time, towards balance
                net, held = (
                    spring.stiffness * b.stretch - b.force,
                    spring.stiffness + b.stiffness + rho,
                )
                size = path.width * 0.5**halvings
                if held > 0.0:
                    size = min(
                        size,
                        max(
                            abs(net) / held,
                            (1e-2 if spring.heat else 1e-6) * path.width,
                        ),
                    )
                dX, V = math.copysign(size, net), 0.0
                if not given:
                    dt = max(_INSTANT * size, 1e-15 * marks[marks.size - 1])
            if not given:
                t[m] = marks[k] if last else t[m - 1] + dt
            X[m] = X[m - 1] + dX
            Y[m], velocity[m] = Y[m - 1] + speeds[k] * (t[m] - t[m - 1]), V
            after, full = population, count == population.order.size
            if (
                not given or spring.heat or full
            ):  # a copy, as the step may be tried again
                after = with_room(
                    population, 2 * count if full else population.order.size
                )
            history.force[m], history.pinned[m], history.square[m] = 0.0, 0.0, 0.0
            kept = advance_all(contacts, path, after, history, m, count, rate)
            stiffness = observe(after, kept, X[m], history, m)
            change = history.force[m] - b.force - b.stiffness * dX
            off = max(
                abs(change - rho * dX - r * dt),
                abs(history.pinned[m] - b.pinned - q * dt),
            )
            if spring.heat:
                off *= _BENT
            missed = (
                change / dt - guess
            )  # r obeys an equation, as the slider moves by what it says
            sudden = not (spring.heat or given) and off > 4.0 * tolerance
            least = (
                max(_LANDED, _SHARE * tolerance / off)
                if sudden and spring.discrete
                else _LANDED
            )
            if sudden and abs(dX) > least * path.width:
                # many contacts break at once, or begin to: when and where has to be
                # known, the better the more
                usual = max(usual, dt)
                halvings = math.ceil(math.log2(2.0 * path.width / abs(dX)))
                at_once = instant or dt <= shortest
                dt, last, guess, tries = 0.5 * dt, False, r, _TRIES if at_once else 0
                continue
            if (
                not spring.heat
                or instant
                or (given and (tries == choices.trials[m] or missed == missed_before))
            ):
                break
            if not given and abs(missed) * dt < _UNBALANCED * tolerance:
                if off < 4.0 * tolerance:
                    break
                tries = _TRIES
                continue
            slope = (
                (missed - missed_before) / (guess - guess_before) if tries > 0 else -1.0
            )
            guess_before, missed_before = guess, missed
            guess, tries = guess - missed / slope, tries + 1
        if given and off > _WORSE * tolerance and not instant:
            return Slide(history, Y, velocity, m, False)
        population, count = after, kept
        if not given and choices.trials.size:
            choices.trials[m] = tries
            choices.instant[m] = instant
            choices.halvings[m] = halvings
        q = (history.pinned[m] - b.pinned) / dt
        if spring.mass > 0.0:
            bent = 4.0 * dt * abs(V - b.V - a * dt) * (spring.stiffness + stiffness)
            off, a = max(off, bent), (V - b.V) / dt
        if not instant:
            grown = (
                dt * min(max(0.9 * math.sqrt(tolerance / off), 0.3), 1.5)
                if off > 0.0
                else 1.5 * dt
            )
            longest = max(grown, longest) if last and off < tolerance else grown
            if sudden and spring.discrete:  # they have broken
                longest, usual = max(longest, usual), 0.0
        if spring.heat:
            rho, r = 0.0, 0.0 if instant else change / dt
        else:
            softer = change / dX if dX != 0.0 else 0.0
            if off < 4.0 * tolerance or abs(softer) < abs(
                rho
            ):  # else an atom breaks, which tells nothing
                rho = softer
        k += last
        m += 1
    return Slide(history, Y, velocity, m, k == marks.size)


class Pulled(NamedTuple):
    """Means at the instants of a programme's grid, and where slider and stage are, with
    errors, arrays (points,); lengths in the user's unit. `coarser_X` is of steps about
    twice as long."""

    means: Means
    X: Array
    stage: Array
    X_error: Array
    coarser_X: Array


def pulled_of(ensemble: Ensemble, programme: Programme, grid: Grid) -> Pulled:
    """The mean field of a slider that a stage pulls (derived).

    Raises
    ------
    InputError
        For what has no reference along a programme, and where it takes too many steps.
    """
    unit, time = ensemble.thresholds.scale, float(grid.t[-1])
    task = _task(ensemble, programme, grid)
    spring = task.spring
    rare, kept = _every_other(task)
    fewer, _ = _solved(rare, 1)
    found, steps = _solved(task, 2)
    coarse = found
    off = np.zeros_like(found)
    off[:, kept] = np.abs(np.array(found)[:, kept] - fewer)
    if steps <= (_FEW_OF_TABLES if ensemble.thresholds.steps.size else _FEW_STEPS):
        found, _ = _solved(_with_middles(task), 4)
        off = np.abs(np.array(found) - coarse) + 0.5 * off
    errors = largest_nearby(off, 5 + off.shape[1] // 50)
    missed = _Seen(*(errors + 1e-6 * np.abs(found).max(axis=1, keepdims=True)))
    missed.X[0] = 0.0
    spread = np.maximum(found.square - found.force**2, 0.0)
    means = with_drag(
        np.array((found.force, found.pinned, spread)),
        np.array(missed[:3]),
        drag_of(ensemble, unit / time) * found.velocity,
        unit,
        np.gradient(found.breaks, grid.t) if grid.t.size > 1 else found.breaks,
        spring.drag * missed.velocity,
    )
    X, stage, X_error = (unit * part for part in (found.X, found.stage, missed.X))
    return Pulled(means, X, stage, X_error, coarse.X * unit)


class Steps(NamedTuple):
    """The steps that a solve took, and what it decided in them: another that takes the
    same is a smooth function of parameters."""

    t: Array
    choices: Choices


def force_of(
    ensemble: Ensemble, programme: Programme, grid: Grid, fine: float, most_steps: int = MOST_STEPS,
    steps: Steps | None = None,
) -> Array:  # fmt: skip
    """The force at the instants of a grid by one solve, in the user's unit, shape
    (points,): that with fine = 1 takes a tenth of the time of `pulled_of`, and misses
    about four times as much as that with fine = 2. With `steps`, those of `steps_of`
    for other parameters, it has these where they serve.

    Raises
    ------
    TooManySteps
        If it takes more than `most_steps`.
    InputError
        As `pulled_of` does.
    """
    unit, time = ensemble.thresholds.scale, float(grid.t[-1])
    task = _task(ensemble, programme, grid)
    try:
        found, _ = _solved(task, fine, most_steps, steps)
    except TooManySteps:
        if steps is None:
            raise
        found, _ = _solved(task, fine, most_steps)
    drag = drag_of(ensemble, unit / time) * found.velocity
    return np.asarray((found.force + drag * (1.0 - found.pinned)) * unit)


def steps_of(
    ensemble: Ensemble, programme: Programme, grid: Grid, fine: float, most_steps: int
) -> Steps:
    """The steps of `force_of`, which raises the same errors."""
    choices = unmade_choices(most_steps, most_steps * _FATES)
    noted = Steps(np.full(most_steps, math.inf), choices)
    _, edges = _solved(_task(ensemble, programme, grid), fine, most_steps, noted)
    first = choices.first[: edges + 1].copy()
    if first[-1] > choices.fates.size:
        raise TooManySteps(
            f"drive.stage: {first[-1]} cohorts in {edges} steps of the mean field"
        )
    made = Choices(
        first,
        fates=choices.fates[: first[-1]].copy(),
        trials=choices.trials[:edges].copy(),
        instant=choices.instant[:edges].copy(),
        halvings=choices.halvings[:edges].copy(),
        given=True,
    )
    return Steps(noted.t[:edges].copy(), made)


class _Task(NamedTuple):
    """Task that is solved at any accuracy: marks, speeds up to them, and the marks
    asked for."""

    numerics: Numerics
    spring: Spring
    marks: Array
    speeds: Array
    at: Array


def _task(ensemble: Ensemble, programme: Programme, grid: Grid) -> _Task:
    stage = programme.stage
    assert stage is not None
    contacts, course = course_of(ensemble, programme)
    unit, time = ensemble.thresholds.scale, float(grid.t[-1])
    marks, speeds, at = _marks(grid.t / time, course.ends, course.velocity)
    in_balance = stage.preload is None and course.before > 0.0
    spring = Spring(
        stiffness=stage.stiffness,
        damping=stage.damping / time,
        drag=drag_of(ensemble, unit / time),
        mass=stage.mass / time**2,
        in_balance=in_balance,
        stretch=(stage.preload or 0.0) / unit,
        velocity=course.before,
        heat=contacts.barrier.thermal,
        discrete=contacts.law.steps.size > 0,
    )
    path = float(np.ptp(course.at(np.append(0.0, course.ends))))
    reach = 2.0 * (path + abs(spring.stretch))  # a mass may overshoot
    return _Task(
        numerics_of(contacts, course, reach or math.inf), spring, marks, speeds, at
    )


def _marks(t: Array, ends: Array, velocity: Array) -> tuple[Array, Array, Array]:
    """Times that steps end at, the speed of the stage up to each, and where of these
    the instants `t` are."""
    marks = np.unique(np.concatenate((t, ends)))
    marks = marks[np.append(np.diff(marks) > 1e-12, True)]
    marks = marks[marks > 0.0]
    segment = np.minimum(np.searchsorted(ends, marks * (1.0 - 1e-12)), ends.size - 1)
    return (
        marks,
        velocity[segment],
        np.searchsorted(np.append(0.0, marks), t * (1.0 - 1e-12)),
    )


def _every_other(task: _Task) -> tuple[_Task, Array]:
    """A task without every other instant, and which are left. Steps end at instants, so
    that solves of different accuracy, if they all had the same instants, might take the
    same steps and not differ, whatever they miss."""
    kept = np.unique(np.append(np.arange(0, task.at.size, 2), task.at.size - 1))
    wanted = np.append(True, np.append(np.diff(task.speeds) != 0.0, True))
    wanted[task.at[kept]] = True
    at = (np.cumsum(wanted) - 1)[task.at[kept]]
    return task._replace(
        marks=task.marks[wanted[1:]], speeds=task.speeds[wanted[1:]], at=at
    ), kept


def _with_middles(task: _Task) -> _Task:
    """A task whose steps end in the middle between marks, too."""
    middles = task.marks - 0.5 * np.diff(task.marks, prepend=0.0)
    marks = np.column_stack((middles, task.marks)).ravel()
    return task._replace(marks=marks, speeds=np.repeat(task.speeds, 2), at=2 * task.at)


class _Seen(NamedTuple):
    """A solve, or its errors, at the marks `at`, arrays (points,): what `History` has,
    the displacement of the stage, the velocity of the slider, and X."""

    force: Array
    pinned: Array
    square: Array
    breaks: Array
    stage: Array
    velocity: Array
    X: Array


def _solved(
    task: _Task, fine: float, most_steps: int = MOST_STEPS, steps: Steps | None = None
) -> tuple[_Seen, int]:
    """Solve, and count the edges of steps, too. Raises TooManySteps, also if given
    steps do not serve."""
    numerics, t = task.numerics, np.full(most_steps, math.inf)
    choices = NO_CHOICES
    if steps is not None:
        t, choices = steps
    contacts, path = (
        numerics.contacts(fine),
        numerics.path(t, np.zeros(t.size), fine, choices),
    )
    if choices.given and path.cohorts:
        path = path._replace(cohorts=int(choices.first[2] - choices.first[1]) - 1)
    path.t[0] = 0.0
    tolerance = _MISSED * numerics.typical / fine**2
    with ThreadPool(1) as thread:
        path = path._replace(stop=thread.stop)
        slide = thread.submit(
            pull, contacts, path, task.spring, task.marks, task.speeds, tolerance
        ).result()
    if not slide.complete:
        raise TooManySteps(
            f"drive.stage: takes more than {most_steps} steps of the mean field"
        )
    index = np.searchsorted(path.t[: slide.edges], np.append(0.0, task.marks))[task.at]
    found = (*slide.history, slide.stage, slide.velocity, path.X)
    return _Seen(*(values[index] for values in found)), slide.edges
