"""Mean field of a slider that a stage, a force or a motor pulls: the limit of infinitely
many contacts.

The force F of the contacts follows from X so far by the renewal equation in two times
(`master.programme`), and with Y, the displacement of the stage, X obeys

    m X'' + eta_s X' = kappa_s (Y - X) + f(t) - F - eta_l X' (1 - pinned),

all per N k. Contacts of several kinds share X; their forces add up by their shares of the
stiffness. A motor that moves at u (1 - F/s) is a force s beside a damping s/u; behind
a spring it moves Y. In a step F changes by about (A + rho) dX + r dt: A is the
stiffness of all pinned contacts, and rho (without heat, per dX) or r (with heat, per
dt) is the change by breaks and births in the last step. X is then found by an implicit
Runge-Kutta method (the engine has closed forms). Steps are so short that dX and the errors of this
estimate, in F and in the pinned fraction, are small. Two accuracies, the second with
steps about half as long, give the result and its error; where they take few steps there
is a third.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import Akima1DInterpolator

from eqsim.errors import InputError
from eqsim.estimate import Estimate
from eqsim.laws.no_thresholds import has_jumps
from eqsim.master.cohorts import (
    NO_CHOICES,
    Choices,
    CohortPath,
    History,
    Kinds,
    Total,
    advance_kinds,
    begin_kinds,
    unmade_choices,
)
from eqsim.master.idle import means_missed
from eqsim.master.programme import (
    MOST_STEPS,
    Course,
    Numerics,
    Transient,
    course_of,
    numerics_of,
    with_drag,
)
from eqsim.model.drive import Grid, Programme
from eqsim.model.ensemble import Ensemble, Kind
from eqsim.model.reduced import Pull, drag_of, pull_of
from eqsim.numerics.compiled import kernel, routine
from eqsim.numerics.quadrature import largest_nearby
from eqsim.numerics.tables import Array
from eqsim.numerics.threads import ThreadPool

# Most steps of the second accuracy, those of a few slips, for a third one to be solved.
_STEPS_OF_FEW_SLIPS = 6000
# The same for discrete laws, each threshold of which begins cohorts of its own.
_STEPS_OF_DISCRETE = 1000
# Instants asked for at which steps end of contacts that heat breaks, whose means are
# smooth in between; at others they are interpolated.
_MARKS = 200
# Least error of such an interpolation over its largest: near points of inflection the
# difference that tells it vanishes; sines of random phases on 20 to 80 steps need .01.
_BETWEEN = 0.02
# Error of F allowed in a step of the coarsest accuracy, in typical thresholds.
_FORCE_TOLERANCE = 1e-4
# Error of F that a guess of r may cause, over that error: in a step X(t) is straight,
# which costs more, and the next step begins with the true force.
_RATE_TOLERANCE = 2.0
# A response of r to its guess, or its inverse, beyond which it is not used again.
_ODD = 4.0
# Most trials in which r is found.
_TRIALS = 8
# Pinned share below which a slider under a force has let go. Of heavy tails some hold
# far beyond all others.
_LET_GO = 1e-6
# Shortest step over the longest in which F may change by more than it should because
# cohorts are joined.
_ROUGH = 0.1
# Most growth of a step: where one of two up to a mark is short enough, one is tried.
_GROWTH = 1.7
# Damping that stands for a motor without a velocity.
_STANDS = 1e100
# Share of the largest displacement, in which without heat all contacts may break.
_ALL_AT_ONCE = 1e-4
# Share of the largest displacement, in which equal thresholds may break that change F
# by the error allowed.
_EQUAL_AT_ONCE = 0.1
# Error of a straight X(t) in the middle of a step, over the change of r in the step.
_BENT = 0.125
# Largest displacement in a repeated step over that in others.
_FARTHER = 10.0
# Largest error of F in a repeated step over that allowed.
_WORSE = 30.0
# Cohorts per step, in the mean, whose fates can be noted.
_FATES = 128
# Length of a piece of a step in units of the time of the motion.
_PIECE = 0.0625
# Most pieces of a step where the motion is stable: a faster one ends within the step.
_MOST_PIECES = 24
# Fewest pieces of a step with a mass: with one a coasting mass misses 2e-3 of its way.
_PIECES_OF_A_MASS = 2
# Length of a step in times of the motion, beyond which an unstable motion ends at
# infinity.
_RUNAWAY = 30.0
# The shortest step over the whole time: more than rounding.
_LEAST_STEP = 1e-13
# The first step over the whole time.
_FIRST_OF_ALL = 1e-6
# The shortest step over the longest displacement: as in the engine.
_STEP_PER_WIDTH = 1e-9
# Most steps in a row that take almost no time while heat breaks contacts: longer ones
# do not come again.
_MOST_AT_ONCE = 2000
# Time in which the slider moves at once, over the displacement: as in the engine.
_TIME_AT_ONCE = 1e-12


class TooManySteps(InputError):
    """Error of a mean field with too many steps, as the slider slips too often."""


class Spring(NamedTuple):
    """Stage and slider, with time in units of the whole programme. `drag` is the
    damping per detached share. At first the spring balances all other forces if
    `in_balance`, and else has the `stretch`; the slider has the `velocity`. `heat`: it
    breaks contacts; `discrete`: equal thresholds may break at once. `unit`: the least
    scale of thresholds. `stall`: force at which the motor stops that moves the stage."""

    stiffness: float
    damping: float
    drag: float
    mass: float
    in_balance: bool
    stretch: float
    velocity: float
    heat: bool
    discrete: bool
    unit: float
    stall: float = math.inf


class Way(NamedTuple):
    """Marks at which steps end, and up to each of these the speed of the stage, the
    force at the mark and its change per time, and a motor's damping of the slider;
    arrays (marks,)."""

    marks: Array
    speeds: Array
    forces: Array
    rates: Array
    dampings: Array


class Slide(NamedTuple):
    """Totals of contacts, displacement of the stage and velocity at the edges of steps,
    arrays (edges,); the number of edges; and whether they reach the last mark, or the
    slider has let go. They do not where steps are too many, or where given choices do
    not fit."""

    total: Total
    stage: Array
    velocity: Array
    edges: int
    complete: bool
    lost: bool


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
    """Displacement and velocity after dt of a slider that from X = 0, X' = V obeys

        mass X'' + damping X' = net + gain t - stiffness X;

    infinite where nothing holds it. Solved by the method Radau IIA of two stages
    (L-stable and of third order; Hairer and Wanner, 1996, table IV.5.5), in pieces
    that are short beside the time of the motion."""
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
    # linear equations of both stages for the velocities v1 and v2 at h/3 and h
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


class Balance(NamedTuple):
    """Slider at the beginning of a step: force of the contacts, what it lacks to be in
    balance, damping, stiffness of contacts and breaks, and velocity; and the change of
    F by heat per time in the step."""

    force: float
    net: float
    damping: float
    elastic: float
    V: float
    heat: float


@routine
def driven(
    spring: Spring, now: Balance, speed: float, rate: float, dt: float
) -> tuple[float, float]:
    """Displacement and velocity after dt of a slider whose stage, or its motor without
    a load, moves at `speed` and whose force changes by `rate` per time. Behind a motor
    with c = s/|u|

        c Y' = sign(u) s - kappa (Y - X),    D X' = kappa (Y - X) - F.

    Without Y this is the equation of a mass c D/kappa (derived), and without D of a
    damping alone; then X first jumps into balance."""
    gain, held = spring.stiffness * speed + rate - now.heat, now.elastic
    if spring.stall == math.inf or speed == 0.0:
        held += spring.stiffness
        return displaced(spring.mass, now.damping, held, now.net, gain, now.V, dt)
    c, jump, V = spring.stall / abs(speed), 0.0, 0.0
    if now.damping > 0.0:
        V = now.net / now.damping
    else:
        jump = now.net / (spring.stiffness + held)
    c_held = c / spring.stiffness
    net = math.copysign(spring.stall, speed) - now.force - held * jump
    net -= c_held * now.heat
    damping = c + c_held * held + now.damping
    if damping <= 0.0:
        return math.inf, math.inf
    dX, V = displaced(c_held * now.damping, damping, held, net, -now.heat, V, dt)
    return jump + dX, V


@kernel(makes_arrays=True)
def pull(
    kinds: Kinds, path: CohortPath, spring: Spring, way: Way, tolerance: float
) -> Slide:
    """Solve for the motion of the slider, and fill its `path` and those of `kinds`,
    with the same times and choices of steps, from the first edge on. Steps end at the
    marks of `way` and miss F by about `tolerance`; given choices have the steps of
    `path.t`. The motion ends where a slider under a force lets go."""
    t, X, choices, given = path.t, path.X, path.choices, path.choices.given
    marks, lost = way.marks, False
    # five arrays instead of one take ten times as long, longer than a short solve
    means = np.zeros((5, t.size))
    total = Total(means[0], means[1], means[2])
    Y, velocity, whole = means[3], means[4], marks[-1]
    states = begin_kinds(kinds, total)
    Y[0], velocity[0] = spring.stretch, spring.velocity
    if spring.in_balance:
        damping = spring.damping + spring.drag * (1.0 - total.pinned[0])
        Y[0] = (total.force[0] + damping * spring.velocity) / spring.stiffness
    # in the last step: change of F by breaks and births, per dX (rho) and per time (r),
    # change of the pinned share per time (q), and acceleration
    rho, r, q, acceleration = 0.0, 0.0, 0.0, 0.0
    bend = 0.0  # change of r per time between the last two steps
    response = -1.0  # change of what r misses its guess by, per change of the guess
    longest = _FIRST_OF_ALL * whole
    shortest = max(_STEP_PER_WIDTH * path.width, _LEAST_STEP * whole)
    halvings = 0  # of the largest displacement in a step that takes no time
    usual = 0.0  # step before many contacts broke at once, to resume with
    in_a_row = 0  # steps that take almost no time
    m, k = 1, 0  # edge and mark ahead
    while k < marks.size and m < t.size and path.stop[0] == 0:
        if spring.heat and in_a_row > _MOST_AT_ONCE:
            break
        force, pinned, V0 = total.force[m - 1], total.pinned[m - 1], velocity[m - 1]
        net = spring.stiffness * (Y[m - 1] - X[m - 1]) - force
        net += way.forces[k] + way.rates[k] * (t[m - 1] - marks[k])
        damping = spring.damping + way.dampings[k] + spring.drag * (1.0 - pinned)
        if pinned < _LET_GO and spring.stiffness + damping + spring.mass == 0.0:
            lost = True
            break
        A = total.stiffness[m - 1]
        held = spring.stiffness + A + rho
        # steps up to the mark are even, as r is noisy where their length changes
        equal = max(math.ceil((marks[k] - t[m - 1]) / longest - 0.2), 1)
        last = equal == 1
        dt, halvings = (marks[k] - t[m - 1]) / equal, max(halvings - 2, 0)
        if given:
            dt, last = t[m] - t[m - 1], t[m] == marks[k]
            halvings = choices.steps[m].halvings
        tries, guess_before, missed_before = 0, 0.0, 0.0
        dt_before = t[m - 1] - t[m - 2] if m > 1 else 0.0
        guess = r + 0.5 * bend * (dt + dt_before)
        while True:
            now = Balance(force, net, damping, A + rho, V0, guess)
            dX, V = driven(spring, now, way.speeds[k], way.rates[k], dt)
            # a motor on a rigid substrate moves against its damping, not to balance
            rough = tries == _TRIALS and way.dampings[k] > 0.0
            unsettled = tries == _TRIALS and not rough
            instant = not abs(dX) <= 1.5 * path.width
            if given:
                instant = choices.steps[m].instant
                if not instant and not abs(dX) <= _FARTHER * path.width:
                    return Slide(total, Y, velocity, m, False, False)
            elif ((instant or unsettled) and dt > shortest) or (
                rough and dt > _ROUGH * longest
            ):
                dt, last, tries = 0.5 * dt, False, 0
                guess = r + 0.5 * bend * (dt + dt_before)
                continue
            else:
                # a damping or a mass holds the slider in a step that cannot be shorter
                held_back = spring.heat and damping + spring.mass > 0.0
                instant = instant or (unsettled and not held_back)
            if instant:
                # nothing holds the slider: it moves towards balance in no time
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
            velocity[m] = V
            after = advance_kinds(kinds, states, total, m, X[m])
            Y[m] = Y[m - 1] + way.speeds[k] * (t[m] - t[m - 1])
            if spring.stall < math.inf:
                viscous = spring.damping + spring.drag * (1.0 - total.pinned[m])
                load = force + damping * V0 + total.force[m] + viscous * V
                slower = 0.5 * load * abs(way.speeds[k]) / spring.stall
                Y[m] -= slower * (t[m] - t[m - 1])
            change = total.force[m] - force - A * dX
            # error of the estimate, of F or of the pinned share
            off = abs(change - rho * dX - r * dt)
            off = max(off, spring.unit * abs(total.pinned[m] - pinned - q * dt))
            if spring.heat:
                off *= _BENT
            # r has to agree with the guess, by which the slider moved
            missed = change / dt - guess
            sudden = not (spring.heat or given) and off > 4.0 * tolerance
            least = _ALL_AT_ONCE
            if sudden and spring.discrete:
                least = max(least, _EQUAL_AT_ONCE * tolerance / off)
            if sudden and abs(dX) > least * path.width:
                # many contacts break at once, or begin to: the more they are, the
                # better their time and place must be known
                usual = max(usual, dt)
                halvings = math.ceil(math.log2(2.0 * path.width / abs(dX)))
                tries = _TRIALS if instant or dt <= shortest else 0
                dt, last, guess = 0.5 * dt, False, r
                continue
            if not spring.heat or instant or rough or unsettled:
                break
            if given and (tries == choices.steps[m].trials or missed == missed_before):
                break
            if not given and abs(missed) * dt < _RATE_TOLERANCE * tolerance:
                if off < 4.0 * tolerance:
                    break
                tries = _TRIALS
                continue
            if tries > 0:
                response = (missed - missed_before) / (guess - guess_before)
            elif not -_ODD < response < -1.0 / _ODD:
                response = -1.0
            guess_before, missed_before = guess, missed
            guess, tries = guess - missed / response, tries + 1
        if given and off > _WORSE * tolerance and not instant:
            return Slide(total, Y, velocity, m, False, False)
        states = after
        in_a_row = 0 if dt > shortest else in_a_row + 1
        if not given and m < choices.steps.size:
            decision = choices.steps[m]
            decision.t = t[m]
            decision.trials = tries
            decision.instant = instant
            decision.halvings = halvings
        q = (total.pinned[m] - pinned) / dt
        if spring.mass > 0.0:
            bent = 4.0 * dt * abs(V - V0 - acceleration * dt)
            off = max(off, bent * (spring.stiffness + total.stiffness[m]))
            acceleration = (V - V0) / dt
        if not instant:
            grown = _GROWTH * dt
            if off > 0.0:
                grown = dt * min(max(0.9 * math.sqrt(tolerance / off), 0.3), _GROWTH)
            longest = max(grown, longest) if last and off < tolerance else grown
            if sudden and spring.discrete:  # they have broken
                longest, usual = max(longest, usual), 0.0
        if spring.heat:
            r_before, r = r, 0.0 if instant else change / dt
            bend = 0.0
            if dt_before > 0.0 and not instant:
                bend = 2.0 * (r - r_before) / (dt + dt_before)
        else:
            softer = change / dX if dX != 0.0 else 0.0
            # else equal thresholds broke, which says nothing of the next step
            if off < 4.0 * tolerance or abs(softer) < abs(rho):
                rho = softer
        k += last
        m += 1
    return Slide(total, Y, velocity, m, k == marks.size or lost, lost)


class Solution(NamedTuple):
    """Means at the instants asked for, or their errors, arrays (points,): those of
    `History`, the displacement of the stage, the velocity of the slider, X, which is
    not a number once the slider has let go, and the time at which it does so, if it
    does. Lengths are in units of the law's scale, time in units of the whole
    programme."""

    force: Array
    pinned: Array
    square: Array
    breaks: Array
    stage: Array
    velocity: Array
    X: Array
    end: Array


def pulled_of(ensemble: Ensemble, programme: Programme, grid: Grid) -> Transient:
    """Solve for the mean field of a slider that a stage, a force or a motor pulls
    (derived). Raises
    InputError for what has no reference along a programme, and where steps are too
    many."""
    unit, time = ensemble.thresholds.scale, float(grid.t[-1])
    best, _, missed = solutions_of(ensemble, programme, grid)
    spread = np.maximum(best.square - best.force**2, 0.0)
    values = np.array((best.force, best.pinned, spread))
    drag = drag_of(ensemble, unit / time)
    breaks = np.gradient(best.breaks, grid.t) if grid.t.size > 1 else best.breaks
    forces = drag * best.velocity, drag * missed.velocity
    means = with_drag(grid, values, np.array(missed[:3]), *forces, unit, breaks)
    if drag and ensemble.populations:  # shared by kinds that differ in what is pinned
        means = replace(means, force_variance=None, force_variance_error=None)
    X, stage, X_error = unit * np.array((best.X, best.stage, missed.X))
    end = None
    if not math.isnan(best.end[0]):
        end = Estimate(best.end[0] * time, missed.end[0] * time, 0)
    stage = stage if programme.stage else None
    return replace(means, X=X, stage=stage, X_error=X_error, lifetime=end)


def solutions_of(
    ensemble: Ensemble, programme: Programme, grid: Grid
) -> tuple[Solution, Solution, Solution]:
    """The best solution, one of steps about twice as long, and the errors of the best.
    Raises InputError as `pulled_of` does."""
    task = task_of(ensemble, programme, grid)
    smooth = task.spring.heat and not (task.spring.discrete or programme.motor)
    if smooth and programme.stage is not None:
        task = task._replace(apart=math.ceil(task.t.size / _MARKS))
    # Steps end at instants, so that solves of different accuracy, if they all had the
    # same instants, might take the same steps and not differ, whatever they miss.
    kept = np.unique(np.append(np.arange(0, task.t.size, 2), task.t.size - 1))
    fewer = solved(task._replace(t=task.t[kept]), 1).solution
    best, steps, bent = solved(task, 2)
    coarse = best
    off = np.zeros_like(best)
    off[:, kept] = np.abs(np.array(best)[:, kept] - fewer)
    if task.apart > 1:  # also of instants at which no step ends
        off = largest_nearby(off, 3)
    laws = [part.kind.contacts.thresholds for part in task.parts]
    discrete = any(law.steps.size for law in laws)
    if steps <= (_STEPS_OF_DISCRETE if discrete else _STEPS_OF_FEW_SLIPS):
        best, _, bent = solved(task._replace(halved=True), 4)
        off = np.abs(np.array(best) - coarse) + 0.5 * off
    # X where one solution has let go before another is not known
    unsure = np.isnan(off) & ~np.isnan(np.array(best))
    errors = largest_nearby(np.nan_to_num(off), 5 + off.shape[1] // 20)
    errors += bent
    errors += 1e-6 * np.abs(np.nan_to_num(best)).max(axis=1, keepdims=True)
    for kind, numerics, scale in task.parts:
        shift, segments = numerics.course.shift, numerics.course.ends.size
        if not shift:
            continue
        # as if each step missed F by more than its tolerance; all breaks are this kind's
        moved = np.diff(best.breaks) / kind.share, np.diff(best.X) / scale
        missed = means_missed(numerics.ensemble, shift, segments, *moved)
        square = min(len(task.parts), 2) * kind.square * scale**2
        missed *= np.array([[kind.weight * scale], [kind.share], [square]])
        errors[:3] += missed
        errors *= 1.0 + missed[0] / (_FORCE_TOLERANCE * task.typical / 16.0)
    errors[unsure] = math.inf
    errors[Solution._fields.index("X"), 0] = 0.0
    return best, coarse, Solution(*errors)


def force_of(
    ensemble: Ensemble,
    programme: Programme,
    grid: Grid,
    fine: float,
    most_steps: int = MOST_STEPS,
    choices: Sequence[Choices] = (),
) -> Array:
    """The force at the instants of a grid by one solve, in the user's unit, shape
    (points,). With fine = 1 it takes a tenth of the time of `pulled_of`, and its error
    is about four times that with fine = 2. It repeats `choices`, those of `choices_of`
    for other parameters, if they fit. Raises TooManySteps if it takes more than
    `most_steps`, and InputError as `pulled_of` does."""
    unit, time = ensemble.thresholds.scale, float(grid.t[-1])
    task = task_of(ensemble, programme, grid)
    try:
        best = solved(task, fine, most_steps, choices).solution
    except TooManySteps:
        if not choices:
            raise
        best = solved(task, fine, most_steps).solution
    drag = drag_of(ensemble, unit / time) * best.velocity
    return np.asarray((best.force + drag * (1.0 - best.pinned)) * unit)


def choices_of(
    ensemble: Ensemble, programme: Programme, grid: Grid, fine: float, most_steps: int
) -> list[Choices]:
    """Decisions of `force_of` for each kind of contacts, to be repeated; raises the same
    errors."""
    task, found = task_of(ensemble, programme, grid), []
    noted = [unmade_choices(most_steps, most_steps * _FATES) for _ in task.parts]
    edges = solved(task, fine, most_steps, noted).edges
    for one in noted:
        steps = one.steps[: edges + 1].copy()
        fates = int(steps["first"][edges])
        if fates > one.fates.size:
            raise TooManySteps(
                f"drive.stage: {fates} cohorts in {edges} steps of the mean field"
            )
        found.append(Choices(steps, one.fates[:fates].copy(), True))
    return found


class Part(NamedTuple):
    """Contacts of a kind, how to resolve them, and the unit of their law over that of
    the slider."""

    kind: Kind
    numerics: Numerics
    unit: float


class PulledTask(NamedTuple):
    """Task that is solved at any accuracy: kinds of contacts, and the course in units of
    the slider. Steps end at one in `apart` of the instants `t` asked for, and if
    `halved` in the middle between these, too."""

    parts: Sequence[Part]
    course: Course
    spring: Spring
    t: Array
    halved: bool = False
    pull: Pull | None = None
    apart: int = 1

    @property
    def typical(self) -> float:
        """Typical threshold, over which forces of all kinds are judged."""
        return sum(kind.weight * x.typical * unit for kind, x, unit in self.parts)

    @property
    def width(self) -> float:
        """Largest displacement in a step of the coarsest accuracy."""
        return min(part.numerics.width * part.unit for part in self.parts)


def task_of(ensemble: Ensemble, programme: Programme, grid: Grid) -> PulledTask:
    """The task of a stage, a force or a motor, lengths in units of the law's scale.
    Raises InputError."""
    stage, pull = programme.stage, pull_of(ensemble, programme)
    unit, time = ensemble.thresholds.scale, float(grid.t[-1])
    preload = (programme.stage.preload if programme.stage else 0.0) or 0.0
    parts = []
    for kind in ensemble.kinds:
        contacts, course = course_of(kind.contacts, programme)
        scale = kind.contacts.thresholds.scale / unit
        path = float(np.ptp(course.at(np.append(0.0, course.ends))))
        # a mass may overshoot
        reach = 2.0 * (path + abs(preload / unit) / scale)
        numerics = numerics_of(contacts, course, reach or math.inf)
        parts.append(Part(kind, numerics, scale))
    course, scale = parts[0].numerics.course, parts[0].unit
    course = course._replace(
        velocity=course.velocity * scale, before=course.before * scale
    )
    laws = [part.numerics.ensemble for part in parts]
    if programme.rebinding == "shared":
        raise InputError('drive.rebinding = "shared": has no mean field')
    spring = Spring(
        stiffness=0.0,
        damping=0.0,
        drag=drag_of(ensemble, unit / time),
        mass=0.0,
        in_balance=False,
        stretch=0.0,
        velocity=course.before,
        heat=any(contacts.barrier.thermal for contacts in laws),
        discrete=any(has_jumps(contacts.law) for contacts in laws),
        unit=min(part.unit for part in parts),
    )
    if stage is not None:
        if stage.mass and pull.motor:
            said = "must be 0 with drive.stall_force, for a mean field"
            raise InputError(f"drive.stage.mass = {stage.mass:g}: {said}")
        spring = spring._replace(
            stiffness=stage.stiffness,
            damping=stage.damping / time,
            mass=stage.mass / time**2,
            in_balance=stage.preload is None and course.before > 0.0,
            stretch=preload / unit,
            stall=pull.stall,
        )
    return PulledTask(parts, course, spring, grid.t / time, pull=pull)


def _way(task: PulledTask, marks: Array) -> Way:
    """Pull on the slider up to each of the marks, shape (marks,)."""
    ends, speeds = task.course.ends, task.course.velocity
    nothing = np.zeros(ends.size)
    forces, rates, dampings, pull = nothing, nothing, nothing, task.pull
    if pull and not pull.stiffness:
        forces, rates = np.array((pull.forces, pull.force_rates))
        rates = rates * pull.ends[-1]
        forces = forces + rates * np.diff(ends, prepend=0.0)
        if pull.motor:
            moving = speeds != 0.0
            forces = np.sign(speeds) * pull.stall
            dampings = np.full(ends.size, _STANDS)
            dampings[moving] = pull.stall / np.abs(speeds[moving])
        speeds = nothing
    i = np.minimum(np.searchsorted(ends, marks * (1.0 - 1e-12)), ends.size - 1)
    at_marks = forces[i] + rates[i] * (marks - ends[i])
    return Way(marks, speeds[i], at_marks, rates[i], dampings[i])


class Solved(NamedTuple):
    """A solution, its number of edges of steps, and by how much means that are
    interpolated may be wrong, shape (means, points)."""

    solution: Solution
    edges: int
    bent: Array


def solved(
    task: PulledTask,
    fine: float,
    most_steps: int = MOST_STEPS,
    choices: Sequence[Choices] = (),
) -> Solved:
    """Solve at the accuracy `fine`. Raises TooManySteps, also if given choices do not
    fit."""
    ends, t = task.course.ends, np.full(most_steps, math.inf)
    choices = choices or [NO_CHOICES] * len(task.parts)
    if choices[0].given:
        t = choices[0].steps["t"][:-1].copy()
    t[0] = 0.0
    kinds: Any = None
    for (kind, numerics, scale), made in zip(
        task.parts[::-1], choices[::-1], strict=True
    ):
        path = numerics.path(t, np.zeros(t.size), fine, made)
        if made.given and path.cohorts:
            first = made.steps["first"]
            path = path._replace(cohorts=int(first[2] - first[1]) - 1)
        contacts, history = numerics.contacts(fine), History(*np.zeros((4, t.size)))
        kinds = Kinds(contacts, path, history, scale, kind.share, kind.weight, kinds)
    path = path._replace(X=np.zeros(t.size), width=task.width / fine)
    # steps end at marks, up to each of which the stage has a speed
    marks = np.unique(np.concatenate((task.t[:: task.apart], task.t[-1:], ends)))
    marks = marks[(marks > 0.0) & np.append(np.diff(marks) > 1e-12, True)]
    if task.halved:
        marks = np.union1d(marks, marks - 0.5 * np.diff(marks, prepend=0.0))
    way, tolerance = _way(task, marks), _FORCE_TOLERANCE * task.typical / fine**2
    with ThreadPool(1) as thread:
        path = path._replace(stop=thread.stop)
        slide = thread.submit(pull, kinds, path, task.spring, way, tolerance).result()
    if not slide.complete:
        said = f"or {_MOST_AT_ONCE} in a row that take no time, of the mean field"
        raise TooManySteps(f"drive: takes more than {most_steps} steps, {said}")
    end = path.t[slide.edges - 1] if slide.lost else math.nan
    force, pinned, _ = slide.total
    square, breaks = force**2, np.zeros(t.size)
    for kind, _, scale in task.parts:
        own = kinds.history
        square += kind.square * scale**2 * (own.square - own.force**2)
        breaks += kind.share * own.breaks
        kinds = kinds.others
    moves = slide.stage, slide.velocity, path.X, np.full(t.size, end)
    rows = np.vstack((force, pinned, square, breaks, *moves))
    if task.apart > 1:  # never of a slider that lets go
        means, bent = _between(
            path.t[: slide.edges], rows[:-1, : slide.edges], ends, task.t
        )
        never = np.full(task.t.size, math.nan)
        bent = np.vstack((bent, np.zeros(task.t.size)))
        return Solved(Solution(*np.vstack((means, never))), slide.edges, bent)
    seen = np.append(0.0, marks)
    seen = seen[np.searchsorted(seen, task.t * (1.0 - 1e-12))]
    index = np.searchsorted(path.t[: slide.edges], seen)
    gone = index == slide.edges
    found = rows[:, np.where(gone, slide.edges - 1, index)]
    if slide.lost:
        found[:, gone] = np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, math.nan, end]]).T
    return Solved(Solution(*found), slide.edges, np.zeros_like(found))


def _between(edges: Array, means: Array, ends: Array, t: Array) -> tuple[Array, Array]:
    """Means at instants t, shape (means, points), between edges of steps, and how far
    they may be wrong: by what interpolations between every other edge miss at the
    rest. Velocities jump at the `ends` of segments."""
    found, bent = np.zeros((2, means.shape[0], t.size))
    first = begin = 0
    for end in ends:
        last = int(np.searchsorted(edges, end * (1.0 - 1e-12)))
        stop = int(np.searchsorted(t, end * (1.0 + 1e-12), side="right"))
        piece, inside = slice(first, last + 1), slice(begin, stop)
        x, y = edges[piece], means[:, piece]
        at = np.clip(t[inside], x[0], x[-1])
        found[:, inside] = Akima1DInterpolator(x, y, axis=1)(at)
        missed = np.zeros_like(y)
        for start in (0, 1):
            kept = np.unique([0, *range(start, x.size, 2), x.size - 1])
            rough = Akima1DInterpolator(x[kept], y[:, kept], axis=1)(x)
            missed = np.maximum(missed, np.abs(rough - y))
        missed = largest_nearby(missed, 9)
        missed += _BETWEEN * missed.max(axis=1, keepdims=True)
        bent[:, inside] = [np.interp(at, x, row) for row in missed]
        first, begin = last, stop
    return found, bent
