"""Trajectories of sliders that a stage pulls, with errors of finite steps.

Every ensemble is followed a second time in steps four times as long. What that changes
tells how far the finite step may be wrong (`step_error`). Sliders that are always in
balance or slip at an instant are followed break by break instead (`engine.avalanches`),
and those that a force or a motor pulls, or whose contacts wait for heat, event by event
(`engine.events`).
"""

import math
import time
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage

from eqsim.engine import avalanches, events
from eqsim.engine.blocks import Progress, Threads, workers_of
from eqsim.engine.readings import Forces, shown_by, slips_of
from eqsim.engine.records import SliderTrajectory, Slip, by_replica
from eqsim.engine.scatter import pinned_variance, unmet_force
from eqsim.engine.slider import Slider
from eqsim.laws.stiffness import kappa
from eqsim.laws.threshold import Delta
from eqsim.model.drive import Grid, Output, Programme
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import Pull, pull_of
from eqsim.model.slip import least_slip
from eqsim.numerics.tables import Array
from eqsim.numerics.threads import ThreadPool

_ENOUGH_REPLICAS = 8  # whose scatter tells the error of their mean
COARSER = 4  # length of steps of the second run; it records one instant of so many
_TOLD_AFTER_STEPS = 64  # between calls of `progress`
_TOLD_AFTER_LIVES = 1000.0  # of one step, after which `progress` is called at once
_SLIP_NOISE = 6.0  # standard deviations of the force above which a fall of it is a slip

# A slider at an instant of the grid; forces and energies are per contact. `friction` is
# the force of all contacts, `variance` its variance if they were independent, `stored`
# the energy beyond that at first, and `behind` the error of X since steps missed F.
_MOTION = ("X", "stage", "friction", "pinned", "variance")
_ENERGIES = ("work", "stored", "dissipated", "missed")
COURSE = np.dtype([(name, float) for name in (*_MOTION, *_ENERGIES, "behind")])


class _PulledRun(NamedTuple):
    """Record of a replica; avalanches by column if they were followed."""

    course: Array  # `COURSE`
    slips: list[Slip]
    lives: int
    avalanches: dict[str, Array] | None = None
    lifetime: float = math.inf


def _note(slider: Slider, row: np.void) -> None:
    """Record the state of a slider in a row of its course."""
    now, pull = slider.state, slider.pull
    spring = 0.5 * pull.stiffness * (now.Y - now.X) ** 2
    row["X"] = now.X
    row["stage"] = now.Y
    row["friction"] = now.sums.force + slider.drag * (1.0 - now.sums.pinned) * now.V
    row["pinned"] = now.sums.pinned
    row["variance"] = max(now.sums.square - now.sums.force**2, 0.0) / slider.count
    row["work"] = now.work
    row["stored"] = spring + 0.5 * pull.mass * now.V**2 + now.sums.stored
    row["dissipated"] = now.lost + now.damped
    row["missed"] = now.missed
    row["behind"] = slider.behind.distance
    if slider.let_go:
        row["X"] = row["stage"] = math.nan


def _in_steps(slider: Slider, instants: Array, told: Progress) -> _PulledRun:
    """Pull a slider through its programme step by step; `told` gets lives so far."""
    course = np.zeros(instants.size, COURSE)
    _note(slider, course[0])
    states = [slider.state]
    lives = float(slider.count)
    row = 1
    legs = zip(slider.pull.ends, slider.pull.speeds, strict=True)
    for index, (end, speed) in enumerate(legs):
        slider.segment = index
        while row < instants.size and instants[row] <= end:
            until = float(instants[row])
            while slider.state.time < until and not slider.let_go:
                now = slider.step(until, speed)
                states.append(now)
                lives += now.sums.breaks * slider.count
                due = len(states) % _TOLD_AFTER_STEPS == 0
                if due or now.sums.breaks > _TOLD_AFTER_LIVES:
                    told(int(lives))
            _note(slider, course[row])
            row += 1
    course["stored"] -= course["stored"][0]
    t, X, Y = np.array([(now.time, now.X, now.Y) for now in states]).T
    slips = []
    if slider.pull.stiffness:
        slips = _slips(slider.pull, slider.least_slip, course, t, X, Y)
    lifetime = slider.state.time if slider.let_go else math.inf
    return _PulledRun(course, slips, round(lives), lifetime=lifetime)


def _slips(
    pull: Pull, least_slip: float, course: Array, t: Array, X: Array, Y: Array
) -> list[Slip]:
    """Slips in a record, arrays (steps,), beyond what contacts make at X by chance."""
    noise = _SLIP_NOISE * math.sqrt(course["variance"].max())
    least = max(least_slip * pull.stiffness, noise)
    fastest = max(map(abs, pull.speeds))
    return slips_of(t, X, pull.stiffness * (Y - X), least, fastest)


def _break_by_break(slider: Slider, instants: Array, told: Progress) -> _PulledRun:
    """`_in_steps` of a slider that is quasi-static."""
    pull, start, group = slider.pull, slider.state, slider.groups[0]
    if pull.forced:
        times, loads = pull.knots
        stages = pull.force_at(instants)
        stages[0] = 0.0  # before the force acts
    else:
        loaded = np.diff(pull.ends, prepend=0.0) * pull.speeds
        moved = np.interp(instants, [0.0, *pull.ends], np.cumsum([0.0, *loaded]))
        stages = start.Y + moved
        times, loads = instants, stages
    queue = avalanches.queue_of(*group[:4])
    state = np.zeros(1, avalanches.STATE)
    now = state[0]
    now["Y"] = start.Y
    now["force"] = start.sums.force
    now["stiffness"] = start.sums.stiffness
    course = np.zeros(instants.size, COURSE)
    course["stage"] = stages
    found = []
    with ThreadPool(1) as thread:
        for stage, row in zip(stages, course, strict=True):
            way = avalanches.Way(pull.stiffness, float(stage), thread.stop)
            load = avalanches.EVENT, avalanches.load, queue, state, way
            found.append(thread.submit(avalanches.events_of, *load).result())
            xi = queue.threshold[queue.contact]
            pinned = np.isfinite(queue.position)  # the others never form again
            stiffness = kappa(group.laws.springs, xi) * pinned
            stretch = np.where(pinned, now["X"] - queue.position + xi, 0.0)
            square = float(np.mean((stiffness * stretch) ** 2))
            spring = 0.5 * pull.stiffness * (stage - now["X"]) ** 2
            row["X"] = now["X"]
            row["pinned"] = np.mean(pinned)
            row["friction"] = now["force"]
            row["variance"] = max(square - now["force"] ** 2, 0.0) / slider.count
            row["work"] = now["work"]
            row["stored"] = spring + 0.5 * float(np.mean(stiffness * stretch**2))
            row["dissipated"] = now["lost"] + now["slipped"]
            if pull.forced:
                let_go = not pinned.any()
                row["stage"] = row["X"] = math.nan if let_go else now["X"]
            told(int(now["breaks"]))
    course["stored"] -= course["stored"][0]
    course["missed"] = course["work"] - course["stored"] - course["dissipated"]
    bursts = np.concatenate(found)
    t = np.interp(bursts["Y"], loads, times)
    let_go = pull.forced and np.isnan(course["X"][-1])
    lives = slider.count + int(now["breaks"])
    least = slider.least_slip
    run = _of_bursts(pull, least, instants, course, t, bursts, lives)
    return run._replace(lifetime=float(t[-1])) if let_go else run


def _of_bursts(
    pull: Pull,
    least_slip: float,
    instants: Array,
    course: Array,
    t: Array,
    bursts: Array,
    lives: int,
) -> _PulledRun:
    """Run of a slider that jumps when contacts break, at the times `t`."""
    slips = []
    if pull.stiffness and t.size:
        moved = np.stack((bursts["X"], bursts["X"] + bursts["distance"]), axis=1)
        twice = np.repeat(t, 2), moved.ravel(), np.repeat(bursts["Y"], 2)
        record = zip((instants, course["X"], course["stage"]), twice, strict=True)
        whole = (np.concatenate((ends[:1], x, ends[-1:])) for ends, x in record)
        slips = _slips(pull, least_slip, course, *whole)
    columns = {name: bursts[name] for name in ("X", "breaks", "drop", "distance")}
    return _PulledRun(course, slips, lives, {"t": t, **columns})


def _by_events(
    ensemble: Ensemble,
    programme: Programme,
    seed: int,
    instants: Array,
    courses: Array,
    threads: int,
    told: Progress,
) -> list[_PulledRun]:
    """Runs of all replicas event by event. Fills `courses` (replicas, points) of
    `COURSE`."""
    pull, law = pull_of(ensemble, programme), ensemble.thresholds
    least = least_slip(law) / law.scale
    sliders, every = events.follow_events(
        ensemble, programme, seed, instants, courses, threads, told
    )
    ends = np.searchsorted(every["replica"], np.arange(len(courses) + 1))
    runs = []
    for replica, course in enumerate(courses):
        course["stored"] -= course["stored"][0]
        bursts = every[ends[replica] : ends[replica + 1]]
        now = sliders[replica]
        lives, lifetime = ensemble.count + int(now["breaks"]), float(now["lifetime"])
        t = bursts["t"]
        run = _of_bursts(pull, least, instants, course, t, bursts, lives)
        runs.append(run._replace(lifetime=lifetime))
    return runs


def times_of(grid: Grid, pull: Pull, unit: float) -> Array:
    """Instants of a grid as times of a pull, (points,). The last one of each segment is
    its end, to the last bit: a force may jump there."""
    t = grid.t * (pull.pace / unit)
    t[np.append(np.diff(grid.segment) != 0, True)] = pull.ends
    return t


def coarse_instants(segment: Array) -> Array:
    """Instants of a grid that the second run records, of segments `segment` (points,).
    These are the first one, and one in `COARSER` counted from the end of each
    segment."""
    ends = np.flatnonzero(np.append(np.diff(segment) != 0, True))
    from_end = ends[segment] - np.arange(segment.size)
    recorded = from_end % COARSER == 0
    recorded[0] = True
    return np.flatnonzero(recorded)


def step_error(fine: Array, coarse: Array, recorded: Array) -> Array:
    """Bound the error of finite steps in the mean over replicas, (points,). `fine` is a
    quantity of shape (replicas, points), `coarse` the same at the instants `recorded`,
    in steps four times as long. An error of first order in the step is four times as
    large there, and a third of the difference; one of a higher order is less than that.
    The difference has a scatter and may vanish by chance at an instant: its standard
    error is added, and of neighbouring instants the largest counts."""
    changed = coarse - fine[:, recorded]
    replicas = len(changed)
    error = np.mean(changed, axis=0)
    if replicas > 1:
        error = np.hypot(error, np.std(changed, axis=0, ddof=1) / math.sqrt(replicas))
    error = ndimage.maximum_filter1d(np.abs(error) / (COARSER - 1), 3)
    after = np.searchsorted(recorded, np.arange(fine.shape[1]))
    bound = np.maximum(error[np.maximum(after - 1, 0)], error[after])
    bound[0] = 0.0
    return np.asarray(bound)


def _slips_in_units(
    runs: list[_PulledRun], per_time: float, unit: float
) -> tuple[Slip, ...]:
    """Slips of all replicas in the user's units."""
    return tuple(
        replace(
            slip,
            **{name: getattr(slip, name) / per_time for name in ("t", "duration")},
            **{name: getattr(slip, name) * unit for name in ("X", "drop", "distance")},
            replica=replica,
        )
        for replica, run in enumerate(runs)
        for slip in run.slips
    )


def _avalanches_in_units(
    runs: list[_PulledRun], per_time: float, unit: float
) -> dict[str, Array] | None:
    """Avalanches of all replicas by column, in the user's units."""
    found = [run.avalanches for run in runs if run.avalanches is not None]
    if not found:
        return None
    columns = by_replica(found)
    columns["t"] /= per_time
    for name in ("X", "drop", "distance"):
        columns[name] *= unit
    return columns


def _unmet(
    mean: dict[str, Array],
    stiffness: float,
    contacts: int,
    replicas: int,
    delayed: bool,
) -> dict[str, Array]:
    """Changes of the means of replicas by a contact that breaks in none of them: the
    force of a typical one, what the slider moves then, and the pinned share that a
    sample does not tell."""
    force = unmet_force(mean["variance"], mean["friction"], contacts) / replicas
    held = np.maximum(stiffness + mean["pinned"], 1.0 / contacts)
    pinned = np.sqrt(pinned_variance(0.0 * force, contacts * replicas, delayed))
    return {"X": force / held, "friction": force, "pinned": pinned}


def pulled_columns(
    ensemble: Ensemble,
    programme: Programme,
    grid: Grid,
    pull: Pull,
    every: Array,
    again: Array | None = None,
) -> dict[str, Any]:
    """The fields of a `PulledRecord` that follow from the courses of all replicas,
    `every` (replicas, points) of type `COURSE`. `again` holds those in steps four times
    as long at the `coarse_instants`, if steps are finite."""
    replicas, unit = len(every), ensemble.thresholds.scale
    gone = np.isnan(every["X"])  # means of X are over those that hold
    mean = {name: np.mean(every[name], axis=0) for name in COURSE.names or ()}
    for name in ("X", "stage") if gone.any() else ():
        mean[name] = np.ma.array(every[name], mask=gone).mean(axis=0).filled(math.nan)
    delayed = any(kind.contacts.delay.time > 0 for kind in ensemble.kinds)
    unmet = _unmet(mean, pull.stiffness, ensemble.count, replicas, delayed)
    errors = {
        "X": np.zeros(grid.t.size),
        "friction": np.sqrt(mean["variance"]),
        "pinned": np.sqrt(pinned_variance(mean["pinned"], ensemble.count, delayed)),
    }
    X_std = force_std = X_replicas = force_replicas = None
    if replicas > 1:
        std = {name: np.std(every[name], axis=0, ddof=1) for name in errors}
        errors = {name: std[name] / math.sqrt(replicas) for name in errors}
        if gone.any():
            holding = np.ma.array(every["X"], mask=gone)
            std["X"] = holding.std(axis=0, ddof=1).filled(math.nan)
            errors["X"] = std["X"] / np.sqrt(np.maximum(holding.count(axis=0), 1))
        # as a sample does not tell what one contact does that none of the replicas had
        errors = {name: np.maximum(errors[name], unmet[name]) for name in errors}
        X_std, force_std = std["X"] * unit, std["friction"] * unit
        X_replicas, force_replicas = every["X"] * unit, every["friction"] * unit
    scatter = errors["friction"]
    if again is not None:
        behind = np.abs(mean["behind"])  # and of the force, of a mean stiffness <= 1
        recorded = coarse_instants(grid.segment)
        for name in errors:
            missed = step_error(every[name], again[name], recorded)
            missed += 0.0 if name == "pinned" else behind
            errors[name] = np.hypot(errors[name], missed)
    X, force = mean["X"] * unit, mean["friction"] * unit
    X_stderr, stderr = errors["X"] * unit, errors["friction"] * unit
    # equal contacts break within one step, which a coarser one may meet by chance
    in_step = again is not None and any(
        isinstance(kind.contacts.thresholds, Delta)
        and not kind.contacts.changes_at_rest
        for kind in ensemble.kinds
    )
    reliable = replicas >= _ENOUGH_REPLICAS and not in_step
    missed = np.sqrt(np.maximum(errors["friction"] ** 2 - scatter**2, 0.0)) * unit
    parts = force_replicas if reliable else None
    forces = Forces(force, stderr, parts, missed, unmet["friction"] * unit)
    shown = grid._replace(X=X), forces, reliable, X_stderr
    energies = [mean[name] for name in _ENERGIES]
    spring = pull.stiffness * (mean["stage"] - mean["X"])
    if programme.forced:
        spring = pull.force_at(grid.t * (pull.pace / unit))
    elif programme.stage is None:
        spring = mean["friction"]
    return {
        "X": X,
        "t": grid.t,
        "force": force,
        "force_stderr": stderr,
        "force_reliable": reliable,
        "pinned": mean["pinned"],
        "pinned_stderr": errors["pinned"],
        "force_replica_std": force_std,
        "force_replicas": force_replicas,
        "segment": grid.segment,
        "segments": shown_by(programme, *shown),
        "stage": mean["stage"] * unit,
        "spring": spring * unit,
        "X_stderr": X_stderr,
        "X_replica_std": X_std,
        "X_replicas": X_replicas,
        "energy": np.stack(energies, axis=1) * unit**2,
    }


def pulled(
    ensemble: Ensemble,
    programme: Programme,
    output: Output,
    threads: Threads,
    progress: Progress | None,
) -> SliderTrajectory:
    """Simulate `trajectory.trajectory` of a slider that something pulls."""
    grid, replicas, seed = programme.grid(output.points), output.replicas, output.seed
    unit = ensemble.thresholds.scale
    pull = pull_of(ensemble, programme)
    per_time = pull.pace / unit
    instants = times_of(grid, pull, unit)
    recorded = coarse_instants(grid.segment)
    workers = 1 if isinstance(threads, tuple) else workers_of(threads)
    every = np.zeros((replicas, grid.t.size), COURSE)
    runs: list[_PulledRun] = []
    coarse: list[_PulledRun] = []
    begin, lives = 0.0, 0

    def told(more: int) -> None:
        if progress:
            progress(lives + more)

    eventful = events.by_events(ensemble, programme, pull)
    if eventful:
        begin = time.perf_counter()
        runs = _by_events(ensemble, programme, seed, instants, every, workers, told)
        lives = sum(run.lives for run in runs)
    for replica in range(0 if eventful else replicas):
        start = ensemble, programme, seed, replica, workers
        with Slider(*start) as slider:
            begin = begin or time.perf_counter()  # when kernels are compiled
            follow = _break_by_break if slider.quasi_static else _in_steps
            runs.append(follow(slider, instants, told))
        every[replica] = runs[-1].course
        lives += runs[-1].lives
        del slider  # its memory is that of the next one
        if follow is _in_steps:
            with Slider(*start, COARSER) as slider:  # its lives do not count
                coarse.append(_in_steps(slider, instants[recorded], lambda _: told(0)))
    again = np.array([run.course for run in coarse]) if coarse else None
    return SliderTrajectory(
        **pulled_columns(ensemble, programme, grid, pull, every, again),
        lives=lives,
        seed=seed,
        engine_seconds=time.perf_counter() - begin,
        threads=workers,
        slips=_slips_in_units(runs, per_time, unit),
        coarser_slips=_slips_in_units(coarse, per_time, unit) if coarse else None,
        avalanches=_avalanches_in_units(runs, per_time, unit),
        lifetimes=np.array([run.lifetime for run in runs]) / per_time,
    )
