"""Rival B along a programme and behind a spring: plain scalar numba kernels of the same
physics, and their times.

Along a programme one contact after the other is followed through the segments, from
event to event as eqsim does, and only the mean force at the ends of segments is kept.
Behind a spring all contacts are followed in each of as many steps as eqsim takes, of
one length, by an exponential clock that is spent at the rate in the middle of a step.
"""

import math
import statistics
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from analysis.benchmarks.cases import CASES, DELAY, VELOCITY, Case, Sizes
from analysis.benchmarks.jobs import Outcome, Rounds, calls, interleaved, ratios, speed
from analysis.benchmarks.scalar import (
    dawson,
    law_of,
    newborn,
    soft_stretch,
    stiff_stretch,
)
from eqsim import Drive, Programme, ProgrammeTrajectory, Segment, Stage, trajectory
from eqsim.engine.slider import Slider

Array = NDArray[np.float64]

STAGE = Stage(stiffness=0.5, damping=0.1)
PULLED = 4.0  # x_* that the stage moves


@numba.njit
def rate(stiff: bool, xi: float, a: float, x: float) -> float:
    """Rate at which heat breaks a contact of stretch x >= 0."""
    if stiff:
        gap = max(1.0 - x / xi, 0.0)
        return math.sqrt(gap) * math.exp(-a * xi * xi * gap * math.sqrt(gap))
    return math.exp(-a * (xi * xi - x * x))


@numba.njit
def hazard(stiff: bool, xi: float, a: float, y: float) -> float:
    """Integral of the rate over the stretch from 0 to y, of either sign."""
    x = min(abs(y), xi)
    if stiff:
        c = a * xi * xi
        total = (math.exp(-c * (1.0 - x / xi) ** 1.5) - math.exp(-c)) / (1.5 * a * xi)
    else:
        total = (
            math.exp(-a * (xi * xi - x * x)) * dawson(math.sqrt(a) * x) / math.sqrt(a)
        )
    return math.copysign(total, y)


@numba.njit
def stretch(stiff: bool, xi: float, a: float, total: float) -> float:
    """Stretch at which `hazard` is `total`, or xi."""
    size = max(abs(total), 1e-300)
    return math.copysign(
        stiff_stretch(xi, a, size) if stiff else soft_stretch(xi, a, math.log(size)),
        total,
    )


@numba.njit
def at_ends(
    law: tuple[float, bool, bool],
    delay: float,
    velocities: Array,
    times: Array,
    contacts: int,
    seed: int,
) -> tuple[Array, Array, int]:
    """Sums over contacts of the force at the end of each segment and of its square, and
    how many lives there were."""
    np.random.seed(seed)  # noqa: NPY002
    kT, stiff, general = law
    forces, squares, lives = np.zeros(times.size), np.zeros(times.size), 0
    for _ in range(contacts):
        wait, x, kappa, xi, a, clock = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for j in range(times.size):
            left, pace, sign = (
                times[j],
                abs(velocities[j]),
                math.copysign(1.0, velocities[j]),
            )
            while True:
                if wait >= 0.0:  # detached, for `wait` longer
                    if wait > left:
                        wait -= left
                        break
                    left -= wait
                    kappa, xi = newborn(general)
                    clock = (
                        -math.log(1.0 - np.random.random())  # noqa: NPY002
                        if kT > 0.0
                        else math.inf
                    )
                    a, wait, x = kappa / (2.0 * kT) if kT > 0.0 else 0.0, -1.0, 0.0
                    lives += 1
                y, before = sign * x, 0.0
                if pace == 0.0:
                    spent = rate(stiff, xi, a, abs(x)) * left if kT > 0.0 else 0.0
                    lasts = left * clock / spent if spent > 0.0 else math.inf
                elif kT == 0.0:
                    spent, lasts = 0.0, (xi - y) / pace
                else:
                    before = hazard(stiff, xi, a, y) if y != 0.0 else 0.0
                    lasts = (
                        max(stretch(stiff, xi, a, before + clock * pace) - y, 0.0)
                        / pace
                    )
                    spent = (
                        (hazard(stiff, xi, a, y + pace * left) - before) / pace
                        if lasts > left
                        else 0.0
                    )
                if lasts > left:
                    clock, x = max(clock - spent, 0.0), sign * (y + pace * left)
                    break
                left -= lasts
                wait = delay
            if wait < 0.0:
                forces[j] += kappa * x
                squares[j] += (kappa * x) ** 2
    return forces, squares, lives


def along(
    case: Case, programme: Programme, contacts: int, seed: int
) -> tuple[Array, Array, int]:
    """<F>/(N k) at the ends of segments, its standard errors, and the lives that were
    drawn."""
    velocities = np.array([segment.velocity for segment in programme.segments])
    times = np.array([segment.duration for segment in programme.segments])
    delay = DELAY if case.general else 0.0
    total, square, lives = at_ends(
        law_of(case), delay, velocities, times, contacts, seed
    )
    mean = total / contacts
    return mean, np.sqrt((square / contacts - mean**2) / (contacts - 1)), lives


@numba.njit
def steps(
    law: tuple[float, bool, bool],
    delay: float,
    stage: tuple[float, float, float],
    dt: float,
    count: int,
    contacts: int,
    seed: int,
) -> Array:
    """<F>/(N k) after each of `count` steps of a slider without mass; `stage` is
    spring, damping and velocity."""
    np.random.seed(seed)  # noqa: NPY002
    kT, stiff, general = law
    spring, damping, velocity = stage
    wait, x, kappa, xi, clock = np.zeros((5, contacts))
    forces = np.empty(count)
    X, force, dropped, stiffness = 0.0, 0.0, 0.0, 1.0
    for step in range(count):
        # forces balance in the middle of the step, if as much breaks as in the last one
        net = spring * (velocity * dt * (step + 0.5) - X) - force + 0.5 * dropped
        dX = net / (damping / dt + 0.5 * (spring + stiffness))
        expected = force + stiffness * dX
        speed, sign = abs(dX) / dt, math.copysign(1.0, dX)
        force, stiffness = 0.0, 0.0
        for i in range(contacts):
            left = dt
            while True:
                if wait[i] >= 0.0:
                    if wait[i] > left:
                        wait[i] -= left
                        break
                    left -= wait[i]
                    kappa[i], xi[i] = newborn(general)
                    clock[i] = (
                        -math.log(1.0 - np.random.random())  # noqa: NPY002
                        if kT > 0.0
                        else math.inf
                    )
                    x[i], wait[i] = 0.0, -1.0
                lasts = (xi[i] - sign * x[i]) / speed if speed > 0.0 else math.inf
                spent = 0.0
                if kT > 0.0:
                    middle = min(
                        abs(x[i] + 0.5 * sign * speed * min(left, lasts)), xi[i]
                    )
                    spent = rate(stiff, xi[i], kappa[i] / (2.0 * kT), middle)
                    if spent * lasts > clock[i]:
                        lasts = clock[i] / spent
                if lasts > left:
                    x[i] += sign * speed * left
                    clock[i] -= spent * left
                    break
                left -= max(lasts, 0.0)
                wait[i] = delay
            if wait[i] < 0.0:
                force += kappa[i] * x[i]
                stiffness += kappa[i]
        force /= contacts
        stiffness /= contacts
        X, dropped, forces[step] = X + dX, expected - force, force
    return forces


def stepped(case: Case, count: int, contacts: int, seed: int) -> float:
    """Mean of <F>/(N k) over the second half of the time in which `STAGE` moves by
    `PULLED`."""
    pace = 10 * VELOCITY
    stage, dt = (STAGE.stiffness, STAGE.damping, pace), PULLED / pace / count
    forces = steps(
        law_of(case), DELAY if case.general else 0.0, stage, dt, count, contacts, seed
    )
    return float(forces[count // 2 :].mean())


def pulled(
    case: Case, contacts: int, points: int, seed: int, threads: int = 1
) -> tuple[float, int]:
    """The trajectory of `stepped` by eqsim, and the lives that it took."""
    programme = Programme((Segment(10 * VELOCITY, distance=PULLED),), stage=STAGE)
    found = trajectory(
        case.ensemble(contacts), programme, points=points, seed=seed, threads=threads
    )
    late = found.force[points // 2 :]
    return float(np.trapezoid(late)) / (late.size - 1), found.lives


def ten_segments(distance: float) -> Programme:
    """Velocity steps, two holds and two reversals, over a `distance` in all."""
    pace, length = 10 * VELOCITY, 0.125 * distance
    paces = (1.0, 0.0, 10.0, -1.0, 1.0, 0.0, 10.0, -1.0, 1.0, 0.1)
    return Programme(
        tuple(
            Segment(v * pace, distance=length)
            if v
            else Segment(0.0, time=10.0 / VELOCITY)
            for v in paces
        )
    )


def worst(rival: list[tuple[Array, Array]], truth: list[tuple[Array, Array]]) -> float:
    """The score farthest from 0 of the mean forces of all rounds against eqsim's."""
    (value, error), (true, its_error) = (
        (
            np.mean([force for force, _ in rounds], axis=0),
            np.linalg.norm([stderr for _, stderr in rounds], axis=0) / len(rounds),
        )
        for rounds in (rival, truth)
    )
    scores = (value - true) / np.hypot(error, its_error)
    return float(scores[np.argmax(np.abs(scores))])


def time_programmes(sizes: Sizes, threads: int, seed: int) -> list[dict[str, Any]]:
    """A programme of ten segments, as far in all as the constant drive it is compared
    with, per life, and beside rival B, whose time is scaled by contacts."""
    programme, constant = (
        ten_segments(sizes.distance),
        Drive(10 * VELOCITY, sizes.distance),
    )
    rows = []
    for case in (case for case in CASES if case.kT):
        ensemble = case.ensemble(sizes.contacts)
        ends: dict[str, list[tuple[Array, Array]]] = {"eqsim": [], "B": []}

        def run(seed: int, drive: Drive | Programme, threads: int = 1) -> Outcome:
            found = trajectory(
                ensemble,  # noqa: B023
                drive,
                points=sizes.points,
                seed=seed,
                threads=threads,
            )
            if isinstance(found, ProgrammeTrajectory) and threads == 1:
                last = np.append(
                    np.flatnonzero(np.diff(found.segment)), found.t.size - 1
                )
                ends["eqsim"].append((found.force[last], found.force_stderr[last]))  # noqa: B023
            return Outcome(0.0, 0.0, found.lives)

        def rival(seed: int) -> Outcome:
            force, stderr, lives = along(case, programme, sizes.scalar_contacts, seed)  # noqa: B023
            ends["B"].append((force, stderr))  # noqa: B023
            return Outcome(0.0, 0.0, lives)

        contenders = {
            "eqsim": lambda seed: run(seed, programme),
            "eqsim, threads": lambda seed: run(seed, programme, threads),
            "constant": lambda seed: run(seed, constant),
            "B": rival,
        }
        for contender in contenders.values():
            contender(seed + sizes.repeats)  # compiles
        rounds = interleaved(contenders, sizes.repeats, seed)
        row = {"job": "programme of ten segments", "case": case.name} | speed(
            rounds, "eqsim", ""
        )
        row |= ratios("threads", rounds, "eqsim, threads", "eqsim")
        row |= ratios("P", per_life(rounds), "eqsim", "constant")
        row |= ratios("B", rounds, "B", "eqsim", sizes.contacts / sizes.scalar_contacts)
        rows.append(row | {"B_z": worst(ends["B"], ends["eqsim"])})
    return rows


def per_life(rounds: Rounds) -> Rounds:
    """Rounds with seconds per life."""
    return {
        name: [(seconds / max(outcome.lives, 1), outcome) for seconds, outcome in timed]
        for name, timed in rounds.items()
    }


def time_spring(sizes: Sizes, threads: int, seed: int) -> list[dict[str, Any]]:
    """A slider pulled through a spring, steadily and without slips, beside as many
    contact-steps of rival B. Errors of forces are the scatter of the rounds."""
    rows = []
    for case in (CASES[0], CASES[2], CASES[3], CASES[4]):

        def run(seed: int, threads: int = 1, case: Case = case) -> Outcome:
            force, lives = pulled(
                case, sizes.pulled_contacts, sizes.pulled_points, seed, threads
            )
            return Outcome(force, 0.0, lives)

        count = calls(Slider, "step", lambda run=run: run(seed))  # type: ignore[misc]

        def rival(seed: int, case: Case = case, count: int = count) -> Outcome:
            return Outcome(stepped(case, count, sizes.pulled_contacts, seed), 0.0)

        rival(seed)  # compiles
        contenders = {
            "eqsim": run,
            "eqsim, threads": lambda seed, run=run: run(seed, threads),
            "B": rival,
        }
        rounds = interleaved(contenders, sizes.repeats, seed)
        row = {"job": "slider behind a spring", "case": case.name} | speed(
            rounds, "eqsim", ""
        )
        row |= {
            "steps": count,
            "ns_per_step": 1e9 * row["seconds"] / (count * sizes.pulled_contacts),
        }
        row |= ratios("threads", rounds, "eqsim, threads", "eqsim") | ratios(
            "B", rounds, "B", "eqsim"
        )
        forces = {
            name: [found.value for _, found in rounds[name]] for name in ("eqsim", "B")
        }
        if sizes.repeats > 1:
            error = math.sqrt(
                sum(statistics.variance(of) for of in forces.values()) / sizes.repeats
            )
            row["B_z"] = (
                statistics.fmean(forces["B"]) - statistics.fmean(forces["eqsim"])
            ) / error
        rows.append(row)
    return rows
