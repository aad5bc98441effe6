"""Mean field of a slider that a stage pulls: the expectation of infinitely many contacts along the X(t) they allow.

The force of all contacts is what the renewal equation in two times says of X so far (`master.programme`), and X obeys

    m X'' + eta_s X' = kappa_s (Y - X) - F - eta_l X' (1 - pinned),

all per N k. In a step F is taken for F + (A + rho) dX + r dt, with A the stiffness of all pinned contacts and rho
(without heat, per dX) or r (with heat, per dt) what breaks and births added in the last step; without a mass X has a
closed form then, with one forces are balanced in the middle of the step. Steps are so short that dX and what this
estimate misses, of F and of the pinned fraction, are small; two accuracies, the second with steps about half as long,
give the result and its error, and a third one where that takes few steps.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage

from eqsim.errors import InputError
from eqsim.master.cohorts import NO_CHOICES, Choices, Path, advance_all, begin, empty, observe, with_room
from eqsim.master.programme import MOST_STEPS, Means, Numerics, course_of, numerics_of
from eqsim.model.drive import Grid, Programme
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import drag_of
from eqsim.numerics.compiled import kernel, routine
from eqsim.numerics.tables import Array
from eqsim.numerics.threads import ThreadPool

_FEW_STEPS = 6000  # of the second accuracy, a few slips
_FEW_OF_TABLES = 1000  # of discrete laws, every threshold of which begins cohorts of its own
_MISSED = 1e-4  # by how much F may be missed in a step of the coarsest accuracy, in units of a typical threshold
_UNBALANCED, _TRIES = 0.05, 8  # share of it by which r may be missed, and in how many trials
_LANDED = 1e-4  # of the longest step without heat, in which all contacts may break at once
_SHARE = 0.1  # of the longest step, in which equal thresholds may break that change F by as much as may be missed
_BENT = 0.125  # of what r changes in a step, what a straight X(t) misses in its middle
_FARTHER, _WORSE = 10.0, 30.0  # than other steps, those given may go, and miss F
_FATES = 128  # of cohorts, in the mean over steps
_RESOLVED = 1e-13  # of the whole time, the shortest step: more than rounding
_FIRST, _SHORTEST, _INSTANT = 1e-6, 1e-9, 1e-12  # of the whole time; of a displacement: as in the engine


class TooManySteps(InputError):
    """The mean field of a slider that slips too often."""


class Spring(NamedTuple):
    """Stage and slider, with time in units of the whole programme: numbers of the equation, damping also per detached
    share; stretch of the spring (NaN: in balance) and velocity at first; largest displacement and missed force of
    a step; whether heat breaks contacts, and whether equal thresholds break at once."""

    stiffness: float
    damping: float
    drag: float
    mass: float
    stretch: float
    velocity: float
    longest: float
    missed: float
    heat: bool
    discrete: bool


class Balance(NamedTuple):
    """Forces on the slider: stretch of the spring, velocities of slider and stage, F, A, pinned, and what breaks do per
    displacement."""

    stretch: float
    V: float
    speed: float
    force: float
    stiffness: float
    pinned: float
    rho: float


@routine(inline=True)
def _relaxed(net: float, gain: float, stiffness: float, damping: float, dt: float) -> float:
    """Displacement after dt of what obeys damping X' = net + gain t - stiffness X, from X = 0."""
    if damping == 0.0:
        return (net + gain * dt) / stiffness if stiffness > 0.0 else math.inf
    w = -stiffness * dt / damping
    if w > 700.0:
        return math.inf
    first = math.expm1(w) / w if abs(w) > 1e-5 else 1.0 + 0.5 * w
    second = (first - 1.0) / w if abs(w) > 1e-3 else 0.5 + w / 6.0 + w * w / 24.0
    return dt / damping * (net * first + gain * dt * second)


@routine(inline=True)
def _estimate(spring: Spring, b: Balance, r: float, dt: float) -> tuple[float, float]:
    """Displacement in a step, infinite where nothing holds the slider, and the velocity then, where breaks and births
    change F by r per time."""
    stiffness, damping = spring.stiffness + b.stiffness + b.rho, spring.damping + spring.drag * (1.0 - b.pinned)
    net, gain = spring.stiffness * b.stretch - b.force, spring.stiffness * b.speed - r
    if spring.mass == 0.0:
        dX = _relaxed(net, gain, stiffness, damping, dt)
        return dX, dX / dt
    theta = 0.5 if dt * dt * (spring.stiffness + b.stiffness) < spring.mass else 1.0
    inertia = spring.mass / (theta * dt * dt)
    held = inertia + damping / dt + 0.5 * stiffness
    dX = (net + 0.5 * gain * dt + inertia * b.V * dt) / held if held > 0.0 else math.inf
    return dX, b.V + (dX / dt - b.V) / theta


@kernel
def pull(c: Any, path: Path, spring: Spring, marks: Array, speeds: Array) -> tuple[Array, int]:
    """Fill `path` from its first edge on, and what is found there, shape (6, edges): elastic force, pinned, mean square
    of the force, breaks so far, and displacement of the stage and velocity of the slider; returns that and how many
    edges there are, -1 if too many, or if given choices do not fit. Steps end at `marks` (marks,), up to each of which
    the stage moves at `speeds`; with given choices they are those of `path.t`."""
    t, X, trials, given = path.t, path.X, path.choices.trials, path.choices.given
    found, p = np.zeros((6, t.size)), empty(c, 256 + path.cohorts)
    count, rate = begin(c, path, p)
    stiffness = observe(p, count, X[0], found, 0)
    found[4, 0], found[5, 0] = spring.stretch, spring.velocity
    if math.isnan(spring.stretch):
        damping = spring.damping + spring.drag * (1.0 - found[1, 0])
        found[4, 0] = (found[0, 0] + damping * spring.velocity) / spring.stiffness
    longest, rho, r, q, a, m, k = _FIRST * marks[marks.size - 1], 0.0, 0.0, 0.0, 0.0, 1, 0
    halvings = 0  # of the longest displacement in no time
    usual = 0.0  # step before many contacts broke at once, to go on with
    shortest = max(_SHORTEST * spring.longest, _RESOLVED * marks[marks.size - 1])
    while k < marks.size and m < t.size and path.stop[0] == 0:
        left = marks[k] - t[m - 1]
        b = Balance(
            found[4, m - 1] - X[m - 1], found[5, m - 1], speeds[k], found[0, m - 1], stiffness, found[1, m - 1], rho
        )
        last, guess, tries, guess_before, missed_before = 1.2 * longest >= left, r, 0, 0.0, 0.0
        halvings = -1 - trials[m] if given and trials[m] < 0 else max(halvings - 2, 0)
        dt = left if last else longest
        if given:
            dt, last = t[m] - t[m - 1], t[m] == marks[k]
        while True:
            dX, V = _estimate(spring, b, guess, dt)
            instant = not abs(dX) <= 1.5 * spring.longest or tries == _TRIES
            if given:
                instant = trials[m] < 0
                if not instant and not abs(dX) <= _FARTHER * spring.longest:
                    return found, -1
            elif instant and dt > shortest:
                dt, last, guess, tries = 0.5 * dt, False, r, 0
                continue
            if instant:  # nothing holds the slider: a piece that takes no time, towards balance
                net, held = spring.stiffness * b.stretch - b.force, spring.stiffness + b.stiffness + rho
                size = spring.longest * 0.5**halvings
                if held > 0.0:
                    size = min(size, max(abs(net) / held, (1e-2 if spring.heat else 1e-6) * spring.longest))
                dX, V = math.copysign(size, net), 0.0
                if not given:
                    dt = max(_INSTANT * size, 1e-15 * marks[marks.size - 1])
            if not given:
                t[m] = marks[k] if last else t[m - 1] + dt
            X[m] = X[m - 1] + dX
            found[4, m], found[5, m] = found[4, m - 1] + speeds[k] * (t[m] - t[m - 1]), V
            after, full = p, count == p.order.size
            if not given or spring.heat or full:  # a copy, as the step may be tried again
                after = with_room(p, 2 * count if full else p.order.size)
            found[:3, m] = 0.0
            kept = advance_all(c, path, after, found, m, (count, rate))
            stiffness = observe(after, kept, X[m], found, m)
            change = found[0, m] - b.force - b.stiffness * dX
            off = max(abs(change - rho * dX - r * dt), abs(found[1, m] - found[1, m - 1] - q * dt))
            if spring.heat:
                off *= _BENT
            missed = change / dt - guess  # r obeys an equation, as the slider moves by what it says
            sudden = not (spring.heat or given) and off > 4.0 * spring.missed
            least = max(_LANDED, _SHARE * spring.missed / off) if sudden and spring.discrete else _LANDED
            if sudden and abs(dX) > least * spring.longest:
                # many contacts break at once, or begin to: when and where has to be known, the better the more
                usual = max(usual, dt)
                halvings = math.ceil(math.log2(2.0 * spring.longest / abs(dX)))
                at_once = instant or dt <= shortest
                dt, last, guess, tries = 0.5 * dt, False, r, _TRIES if at_once else 0
                continue
            if not spring.heat or instant or (given and (tries == trials[m] or missed == missed_before)):
                break
            if not given and abs(missed) * dt < _UNBALANCED * spring.missed:
                if off < 4.0 * spring.missed:
                    break
                tries = _TRIES
                continue
            slope = (missed - missed_before) / (guess - guess_before) if tries > 0 else -1.0
            guess_before, missed_before = guess, missed
            guess, tries = guess - missed / slope, tries + 1
        if given and off > _WORSE * spring.missed and not instant:
            return found, -1
        p, count = after, kept
        if not given and trials.size:
            trials[m] = -1 - halvings if instant else tries
        q = (found[1, m] - found[1, m - 1]) / dt
        if spring.mass > 0.0:
            bent = 4.0 * dt * abs(V - b.V - a * dt) * (spring.stiffness + stiffness)
            off, a = max(off, bent), (V - b.V) / dt
        if not instant:
            grown = dt * min(max(0.9 * math.sqrt(spring.missed / off), 0.3), 1.5) if off > 0.0 else 1.5 * dt
            longest = max(grown, longest) if last and off < spring.missed else grown
            if sudden and spring.discrete:  # they have broken
                longest, usual = max(longest, usual), 0.0
        if spring.heat:
            rho, r = 0.0, 0.0 if instant else change / dt
        else:
            softer = change / dX if dX != 0.0 else 0.0
            if off < 4.0 * spring.missed or abs(softer) < abs(rho):  # else an atom breaks, which tells nothing
                rho = softer
        k += last
        m += 1
    return found, m if k == marks.size else -1


class Pulled(NamedTuple):
    """Means at the instants of a programme's grid, and where slider and stage are, with errors, arrays (points,);
    lengths in the user's unit. `coarser_X` is of steps about twice as long."""

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
    fine, steps = _solved(task, 2)
    coarse = fine
    off = np.zeros_like(fine)
    off[:, kept] = np.abs(fine[:, kept] - fewer)
    if steps <= (_FEW_OF_TABLES if ensemble.thresholds.steps.size else _FEW_STEPS):
        coarse, (fine, _) = fine, _solved(_with_middles(task), 4)
        off = np.abs(fine - coarse) + 0.5 * off
    missed = ndimage.maximum_filter1d(off, 5 + off.shape[1] // 50, axis=1)
    missed += 1e-6 * np.abs(fine).max(axis=1, keepdims=True)
    missed[6, 0] = 0.0
    force, pinned, squares, breaks, Y, V, X = fine
    drag = drag_of(ensemble, unit / time) * V
    total, error = force + drag * (1.0 - pinned), missed[0] + np.abs(drag) * missed[1] + spring.drag * missed[5]
    variance = np.maximum(squares - force**2, 0.0) + drag * (1.0 - pinned) * (drag * pinned - 2.0 * force)
    wrong = missed[2] + drag**2 * missed[1] + 2.0 * np.abs(total) * error
    rate = np.gradient(breaks, grid.t) if grid.t.size > 1 else breaks
    means = Means(total * unit, pinned, rate, error * unit, missed[1], variance * unit**2, wrong * unit**2)
    return Pulled(means, X * unit, Y * unit, missed[6] * unit, coarse[6] * unit)


class Steps(NamedTuple):
    """The steps that a solve took, and what it decided in them: another that takes the same is a smooth function of
    parameters."""

    t: Array
    choices: Choices


def force_of(
    ensemble: Ensemble, programme: Programme, grid: Grid, fine: float, most_steps: int = MOST_STEPS,
    steps: Steps | None = None,
) -> Array:  # fmt: skip
    """The force at the instants of a grid by one solve, in the user's unit, shape (points,): that with fine = 1 takes a
    tenth of the time of `pulled_of`, and misses about four times as much as that with fine = 2. With `steps`, those of
    `steps_of` for other parameters, it has these where they serve.

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
    force, pinned, _, _, _, V, _ = found
    return np.asarray((force + drag_of(ensemble, unit / time) * V * (1.0 - pinned)) * unit)


def steps_of(ensemble: Ensemble, programme: Programme, grid: Grid, fine: float, most_steps: int) -> Steps:
    """The steps of `force_of`, which raises the same errors."""
    choices = Choices(
        np.zeros(most_steps + 1, np.int64),
        np.zeros(most_steps * _FATES, np.int8),
        np.zeros(most_steps, np.int64),
        False,
    )
    noted = Steps(np.full(most_steps, math.inf), choices)
    _, edges = _solved(_task(ensemble, programme, grid), fine, most_steps, noted)
    first = choices.first[: edges + 1].copy()
    if first[-1] > choices.fates.size:
        raise TooManySteps(f"drive.stage: {first[-1]} cohorts in {edges} steps of the mean field")
    fates, trials = choices.fates[: first[-1]].copy(), choices.trials[:edges].copy()
    return Steps(noted.t[:edges].copy(), Choices(first, fates, trials, True))


class _Task(NamedTuple):
    """Task that is solved at any accuracy: marks, speeds up to them, and the marks asked for."""

    numerics: Numerics
    spring: Spring
    marks: Array
    speeds: Array
    at: Array


def _task(ensemble: Ensemble, programme: Programme, grid: Grid) -> _Task:
    stage = programme.stage
    assert stage is not None
    s, course = course_of(ensemble, programme)
    unit, time = ensemble.thresholds.scale, float(grid.t[-1])
    marks, speeds, at = _marks(grid.t / time, course.ends, course.velocity)
    in_balance = stage.preload is None and course.before > 0.0
    spring = Spring(
        stage.stiffness, stage.damping / time, drag_of(ensemble, unit / time), stage.mass / time**2,
        math.nan if in_balance else (stage.preload or 0.0) / unit, course.before, math.nan, math.nan, s.barrier.thermal,
        s.law.steps.size > 0,
    )  # fmt: skip
    stretch = 0.0 if math.isnan(spring.stretch) else abs(spring.stretch)
    reach = 2.0 * (float(np.ptp(course.at(np.append(0.0, course.ends)))) + stretch)  # a mass may overshoot
    return _Task(numerics_of(s, course, reach or math.inf), spring, marks, speeds, at)


def _marks(t: Array, ends: Array, velocity: Array) -> tuple[Array, Array, Array]:
    """Times that steps end at, the speed of the stage up to each, and where of these the instants `t` are."""
    marks = np.unique(np.concatenate((t, ends)))
    marks = marks[np.append(np.diff(marks) > 1e-12, True)]
    marks = marks[marks > 0.0]
    segment = np.minimum(np.searchsorted(ends, marks * (1.0 - 1e-12)), ends.size - 1)
    return marks, velocity[segment], np.searchsorted(np.append(0.0, marks), t * (1.0 - 1e-12))


def _every_other(task: _Task) -> tuple[_Task, Array]:
    """A task without every other instant, and which are left. Steps end at instants, so that solves of different
    accuracy, if they all had the same instants, might take the same steps and not differ, whatever they miss."""
    kept = np.unique(np.append(np.arange(0, task.at.size, 2), task.at.size - 1))
    wanted = np.append(True, np.append(np.diff(task.speeds) != 0.0, True))
    wanted[task.at[kept]] = True
    at = (np.cumsum(wanted) - 1)[task.at[kept]]
    return task._replace(marks=task.marks[wanted[1:]], speeds=task.speeds[wanted[1:]], at=at), kept


def _with_middles(task: _Task) -> _Task:
    """A task whose steps end in the middle between marks, too."""
    middles = task.marks - 0.5 * np.diff(task.marks, prepend=0.0)
    marks = np.column_stack((middles, task.marks)).ravel()
    return task._replace(marks=marks, speeds=np.repeat(task.speeds, 2), at=2 * task.at)


def _solved(task: _Task, fine: float, most_steps: int = MOST_STEPS, steps: Steps | None = None) -> tuple[Array, int]:
    """What is found at the marks `at`, and X, shape (7, points); and in how many steps. Raises TooManySteps, also if
    given steps do not serve."""
    numerics, t = task.numerics, np.full(most_steps, math.inf)
    choices = NO_CHOICES
    if steps is not None:
        t, choices = steps
    c, path = numerics.contacts(fine), numerics.path(t, np.zeros(t.size), fine, choices)
    if choices.given and path.cohorts:
        path = path._replace(cohorts=int(choices.first[2] - choices.first[1]) - 1)
    path.t[0] = 0.0
    spring = task.spring._replace(longest=path.width, missed=_MISSED * numerics.typical / fine**2)
    with ThreadPool(1) as thread:
        path = path._replace(stop=thread.stop)
        found, edges = thread.submit(pull, c, path, spring, task.marks, task.speeds).result()
    if edges < 0:
        raise TooManySteps(f"drive.stage: takes more than {most_steps} steps of the mean field")
    index = np.searchsorted(path.t[:edges], np.append(0.0, task.marks))[task.at]
    return np.concatenate((found[:, index], path.X[None, index])), edges
