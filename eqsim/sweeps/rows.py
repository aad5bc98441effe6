"""Rows of a sweep: the computation at each point, and the columns that it fills.

A value depends on the id of its point and on nothing else: not on the order, the
workers, restarts or the rest of the grid. Other releases of NumPy, Numba and SciPy, and
processors of different make, draw the same random numbers and round differently: values
agree to 1e-9, and to 1e-6 where thresholds fluctuate.
"""

import time
from collections.abc import Collection
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np

from eqsim.engine.chain_records import ENOUGH_EVENTS, ChainTrajectory
from eqsim.engine.elastic import elastic_trajectory
from eqsim.engine.readings import Forces, shown_by
from eqsim.engine.records import SegmentRecord, SliderTrajectory, observed
from eqsim.engine.steady import steady
from eqsim.engine.trajectory import trajectory
from eqsim.errors import InputError, require_number
from eqsim.estimate import Averages, Estimate, mean_of, z_score
from eqsim.master.avalanche_sizes import averages_of_blocks
from eqsim.master.lifetimes import lifetime
from eqsim.master.steady import reference
from eqsim.master.transient import transient
from eqsim.model.drive import Drive, Programme
from eqsim.model.ensemble import Ensemble
from eqsim.results import RESULTS_VERSION

# Content of a row by column.
RowCells = dict[str, Any]
# What is computed at a point, which decides what its row holds: averages at constant
# velocity; those of coupled blocks in balance; the force along a programme; slips, or
# the late force, of what a stage, a motor or a plate pulls in time; lifetimes.
Run = Literal["averages", "blocks", "programme", "pulled", "forced"]

_TOO_SHORT = "the second half is too short, or not steady"


class Task(NamedTuple):
    """A point as a worker needs it."""

    seed: int
    ensemble: Ensemble
    drive: Drive | Programme
    points: int
    replicas: int


@dataclass(frozen=True)
class Asked:
    """Accuracy that is asked of each point: steady averages to a relative standard
    error, by so many lives at most; or if `transient` averages over the second half of
    the run; and whether references belong to them. Raises InputError unless both
    numbers are positive."""

    rel_error: float = 1e-2
    max_lives: float = 1e10
    transient: bool = False
    exact: bool = True

    def settings(self) -> dict[str, Any]:
        """All of these; `exact` only if it is not the default, as files of earlier
        releases do not have it."""
        every = asdict(self).items()
        return {name: x for name, x in every if name != "exact" or not x}

    def require_effect(self, runs: Collection[Run]) -> None:
        """Raise InputError for what changes nothing where every point is one of these
        runs."""
        if "averages" in runs:
            return
        kind = "blocks" if "blocks" in runs else "a programme or a pulled slider"
        for option, given in (
            (f"--rel-error = {self.rel_error}", self.rel_error != Asked.rel_error),
            ("--transient", self.transient),
        ):
            if given:
                said = f"has no effect on {kind}: a point is the average of its run"
                raise InputError(f"{option}: {said}")

    def __post_init__(self) -> None:
        require_number("--rel-error", self.rel_error, above=0)
        require_number("--max-lives", self.max_lives, above=0)


def run_of(drive: Drive | Programme) -> Run:
    """Name what is computed at a point with such a drive."""
    if drive.elastic:
        return "blocks"
    if isinstance(drive, Drive):
        return "averages"
    if drive.forced:
        return "forced"
    return "pulled" if drive.pulled else "programme"


def compute(
    tasks: list[Task], asked: Asked, threads: int, version: int
) -> list[RowCells]:
    """Compute a batch of points, and return the columns found. Raises InputError if this
    worker's results are not of `version`."""
    if version != RESULTS_VERSION:
        versions = f"results version {RESULTS_VERSION}, not {version}"
        raise InputError(f"a worker runs other code ({versions})")
    return [_point_row(task, asked, threads) for task in tasks]


def _point_row(task: Task, asked: Asked, threads: int) -> RowCells:
    """The columns of a point; of one that fails its status and message."""
    begin, options = time.perf_counter(), RowCells(seed=task.seed, threads=threads)
    options["max_lives"] = asked.max_lives
    sampled = options | {"points": task.points, "replicas": task.replicas}
    try:
        if (drive := task.drive).elastic:
            row = _elastic(task, drive, sampled, asked.exact)
        elif isinstance(drive, Programme):
            row = _programme(task, drive, sampled, asked.exact)
        elif asked.transient:
            run = trajectory(task.ensemble, drive, **sampled)
            row = _averages_row(run.averages, run.lives, [])
        else:
            row = _steady_cells(task, drive, options, asked)
    except MemoryError:  # the machine's fault, not the point's
        raise
    except Exception as error:
        kind = "" if isinstance(error, InputError) else f"{type(error).__name__}: "
        row = {"status": "failed", "message": kind + " ".join(str(error).split())}
    return {**row, "seconds": time.perf_counter() - begin}


def _steady_cells(
    task: Task, drive: Drive, options: RowCells, asked: Asked
) -> RowCells:
    sampled = steady(task.ensemble, drive, rel_error=asked.rel_error, **options)
    missed = f"relative error {asked.rel_error:g} was not reached"
    row = _averages_row(sampled, sampled.lives, [] if sampled.reached else [missed])
    if not asked.exact:
        return row
    try:
        exact = reference(task.ensemble, drive)
    except InputError as error:
        return row | _no_reference(row, error)
    row["reference_method"] = exact.method
    for name, level in exact.averages().items():
        row |= _filled(name, sampled.averages()[name], level)
    return row


def _elastic(
    task: Task, drive: Drive | Programme, options: RowCells, compares: bool
) -> RowCells:
    ensemble, blocks = task.ensemble, drive.elastic
    assert blocks
    run = elastic_trajectory(ensemble, drive, **options)
    reliable = run.friction.reliable and run.size.reliable
    row = _status(run.lives, [] if reliable else [_TOO_SHORT])
    exact = dict[str, Estimate]()
    steady = not blocks.follows_events(ensemble.thermal.active)
    if compares and steady and isinstance(drive, Drive):
        rigid = reference(ensemble, replace(drive, elastic=None))
        exact = averages_of_blocks(ensemble.thresholds, blocks, ensemble.count)
        row["reference_method"], exact["friction"] = rigid.method, rigid.friction
    for name in ("friction", "size", "single"):
        row |= _filled(name, getattr(run, name), exact.get(name))
    return row


def _programme(
    task: Task, programme: Programme, options: RowCells, compares: bool
) -> RowCells:
    run = trajectory(task.ensemble, programme, **options)
    if isinstance(run, ChainTrajectory):
        return _chain_columns(run)
    doubt, slips = "error bars of forces cannot be trusted", RowCells()
    problems: list[str] = []
    if isinstance(run, SliderTrajectory):
        if programme.motor and run.force_replicas is not None:
            return _status(run.lives, []) | _late_force(run)
        if programme.forced:
            return _failure_columns(task, programme, run, compares)
        slips, problems = _slip_columns(run), _few_slips(run)
        if programme.stage is None or len(programme.segments) == 1:
            return slips | _status(run.lives, problems)
        doubt += ": how far X scatters is known from 8 replicas on"
    row = slips | _status(run.lives, problems + [doubt] * (not run.force_reliable))
    exact: tuple[SegmentRecord, ...] = ()
    method = "mean field" if programme.stage else "renewal equation in two times"
    try:
        if not compares:
            raise InputError("not asked for")
        means = transient(task.ensemble, programme, task.points)
        forces = Forces(means.force, means.force_error)
        grid = programme.grid(task.points)._replace(X=means.X)
        exact = shown_by(programme, grid, forces, X_stderr=means.X_error)
        row["reference_method"] = method
    except InputError as error:
        row |= _no_reference(row, error)
    for index, segment in enumerate(run.segments):
        levels = observed(exact[index]) if exact else {}
        for name, ours in observed(segment).items():
            row |= _filled(f"segment_{index}_{name}", ours, levels.get(name))
    return row


def _late_force(run: SliderTrajectory | ChainTrajectory) -> RowCells:
    """Columns of the mean force over the second half of the time of a run, with its
    error from the scatter of replicas; none of a single one."""
    if run.force_replicas is None:
        return {}
    half = 0.5 * run.t[-1]
    t = np.append(half, run.t[run.t > half])
    forces = [np.interp(t, run.t, replica) for replica in run.force_replicas]
    # records are denser in some segments than in others
    each = np.trapezoid(forces, t) / half
    return _filled("friction", mean_of(each, each.size, each.size - 1))


def _chain_columns(run: ChainTrajectory) -> RowCells:
    """Columns of the events of a chain in which all blocks break, as slips, and of the
    mean force."""
    whole = int(np.sum(run.events["blocks"] == run.chain.count))
    row = _status(run.lives, ["few slips"] if 0 < whole < ENOUGH_EVENTS else [])
    row |= _late_force(run) | {"slips": whole} | _filled("period", run.recurrence)
    return row | _filled("drop", run.drop)


def _slip_columns(run: SliderTrajectory) -> RowCells:
    """Columns of the slips of a slider that a stage pulls."""
    row = _filled("period", run.period) | _filled("drop", run.drop)
    return row | {"slips": len(run.slips)}


def _few_slips(run: SliderTrajectory) -> list[str]:
    """The doubt about a run with few slips. Steady sliding, without slips, is no reason
    to distrust a row."""
    few = not run.period.reliable and not run.period.n == run.drop.n == 0
    return ["few slips"] if few else []


def failures_of(run: SliderTrajectory, drive: Programme) -> dict[str, Estimate]:
    """Mean lifetime of bundles that all let go under a force, and the mean force at that
    time if it changes; else empty."""
    lives = run.lifetimes
    if not (drive.forced and np.all(np.isfinite(lives))):
        return {}
    found = {"lifetime": lives}
    if any(segment.force_rate for segment in drive.segments):
        found["strength"] = np.interp(lives, run.t, run.spring)
    if lives.size == 1:
        return {k: Estimate(float(x[0]), None, 1) for k, x in found.items()}
    return {k: mean_of(x, x.size, x.size - 1) for k, x in found.items()}


def _failure_columns(
    task: Task, drive: Programme, run: SliderTrajectory, compares: bool
) -> RowCells:
    """Columns of `failures_of` a run, and the exact lifetime of identical contacts."""
    found = failures_of(run, drive)
    row = _status(run.lives, [] if found else ["some bundles have not let go"])
    exact: dict[str, Estimate] = {}
    try:
        if compares and found:
            exact["lifetime"] = lifetime(task.ensemble, drive, points=2).mean
    except InputError as error:
        row |= _no_reference(row, error)
    for name, ours in found.items():
        row |= _filled(name, ours, exact.get(name))
    return row


def _averages_row(averages: Averages, lives: int, problems: list[str]) -> RowCells:
    """Columns of estimates, and of doubts about their error bars and `problems`."""
    every = averages.averages()
    doubtful = [name for name, e in every.items() if not (e.reliable or e.diverges)]
    if doubtful:
        said = f"error bars of {', '.join(doubtful)} cannot be trusted"
        problems = [said, *problems]
    row = _status(lives, problems)
    for name, e in every.items():
        row |= _filled(name, e)
    return row


def _status(lives: int, problems: list[str]) -> RowCells:
    """Columns of lives and of whether a row can be trusted."""
    status = "unreliable" if problems else "ok"
    return {"lives": lives, "status": status, "message": "; ".join(problems) or None}


def _no_reference(row: RowCells, error: InputError) -> dict[str, str]:
    """The message of a row, with the reason why it has no reference."""
    said = (row["message"], f"no reference: {error}")
    return {"message": "; ".join(filter(None, said))}


def _filled(name: str, ours: Estimate, level: Estimate | None = None) -> RowCells:
    """Columns of an estimate, and of its reference `level` if there is one. The schema
    of the sweep drops columns that it does not have."""
    cells = {
        name: ours.value,
        f"{name}_stderr": ours.stderr,
        f"{name}_dof": ours.dof,
        f"{name}_reliable": ours.reliable,
    }
    if level is None:
        return cells
    z = None
    if level.value is not None:
        z = z_score(ours, level.value, level.stderr or 0.0)
    return cells | {
        f"{name}_reference": level.value,
        f"{name}_reference_error": level.stderr,
        f"{name}_z": z,
    }
