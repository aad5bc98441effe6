"""The rows of a sweep's dataset, one per point.

Columns (version 2 of the schema, the same for every sweep; null where a column does not
apply):

    id                         SHA-256 of parameters, seed and `RESULTS_VERSION`
    disorder ... output.replicas   every key of the run file but the title, as section.key; `thresholds.n` and `x_star`
                               with their defaults filled in
    kind                       "steady" (averages to a relative error), "transient" (the run's second half; of coupled
                               blocks always) or "programme" (its segments or slips;
                               averages are null)
    status, message            "ok"; "unreliable", error bars not to be trusted or larger than asked for; "failed"
    each of `OBSERVABLES`, with
      _stderr, _dof, _reliable             its standard error, degrees of freedom (null: normal) and whether to trust it
      _reference, _reference_error         what the master equation says, and the error of the solver (steady)
      _z                                   their difference as a standard-normal score; null if both errors are 0
    of each segment of a programme, with _stderr, _reference, _reference_error and _z:
    segment_0_end, _peak, _at                force at its end, that which differs most from its beginning, and where
    segment_0_direct, _evolution, _memory    of a velocity step
    friction_force, shear_stress, friction_coefficient    what friction is at the interface, if the run file says so,
                               with _stderr and _reference; the stress is in Pa where
                               the units are known
    size, single               of coupled blocks, with _stderr, _reference and _z: breaks per avalanche and the fraction
                               of single breaks; `friction` is then that over
                               displacement
    slips, period, drop        of a slider that a stage pulls: how many, mean time between them, mean drop of the force
    reference_method           the solver
    lives                      lives simulated
    seed                       random seed, made from `id` alone
    seconds                    wall time of engine and reference; the only column that differs when a sweep is repeated
    eqsim_version              version of the package

A value depends on the id of its point and on nothing else: not on the order, the
workers, restarts or the rest of the grid. Other releases of NumPy, Numba and SciPy, and
processors of different make, draw the same random numbers and round differently: values
agree to 1e-9, and to 1e-6 where thresholds fluctuate.
"""

import time
from dataclasses import dataclass, replace
from typing import Any

from eqsim.engine import steady as steady_engine
from eqsim.engine.elastic import elastic_trajectory
from eqsim.engine.records import SegmentRecord, SliderTrajectory, shown_by
from eqsim.engine.trajectory import trajectory
from eqsim.errors import InputError, require_number
from eqsim.estimate import OBSERVABLES, Averages, Estimate, z_score
from eqsim.io.runfile import RunFile, keys
from eqsim.io.units import Quantity, quantities
from eqsim.master.avalanche_sizes import missed_by_few, size_law
from eqsim.master.steady import reference
from eqsim.master.transient import transient
from eqsim.model.drive import Drive, Programme
from eqsim.model.ensemble import Ensemble
from eqsim.results import RESULTS_VERSION
from eqsim.sweeps.plan import Task

SCHEMA = 2
_OF_SEGMENT = ("end", "peak", "at")  # observables of any segment
_OF_STEP = ("direct", "evolution", "memory")  # and of a velocity step


@dataclass(frozen=True)
class Asked:
    """What is computed at each point.

    Parameters
    ----------
    rel_error, max_lives : float
        Relative standard error of steady averages, and most lives a point. Raises
        InputError unless both are positive.
    transient : bool
        The second half of the run's distance instead of steady averages.
    """

    rel_error: float = 1e-2
    max_lives: float = 1e10
    transient: bool = False

    def __post_init__(self) -> None:
        require_number("--rel-error", self.rel_error, above=0)
        require_number("--max-lives", self.max_lives, above=0)


def schema(file: RunFile) -> Any:
    """The pyarrow schema of the dataset of a run file's sweep."""
    import pyarrow as pa

    number, integer, text = pa.float64(), pa.int64(), pa.string()
    others = {"dof": integer, "reliable": pa.bool_()}
    exact = ("reference", "reference_error", "z")

    def columns(name: str, *ends: str) -> dict[str, Any]:
        return {name: number} | {
            f"{name}_{end}": others.get(end, number) for end in ("stderr", *ends)
        }

    types = {float: number, int: integer, str: text}
    fields = {"id": text, **{key: types[kind] for key, kind in keys(file).items()}}
    fields |= {"kind": text, "status": text, "message": text}
    for name in OBSERVABLES:
        fields |= columns(name, "dof", "reliable", *exact)
    for one in _quantities(file, Ensemble()):
        fields |= columns(one.column, "reference")
    for name in ("size", "single") if file["elastic"] else ():
        fields |= columns(name, "reference", "z")
    pulled = file["drive.stage"]
    if pulled:
        fields |= {"slips": integer, **columns("period"), **columns("drop")}
    for index in range(0 if pulled else len(file["drive.programme"] or [])):
        for name in (*_OF_SEGMENT, *_OF_STEP):
            fields |= columns(f"segment_{index}_{name}", *exact)
    fields |= {"reference_method": text, "lives": integer, "seed": integer}
    fields |= {"seconds": number, "eqsim_version": text}
    return pa.schema(list(fields.items()))


def _quantities(file: RunFile, ensemble: Ensemble) -> tuple[Quantity, ...]:
    """What friction is at the interface, where there are averages."""
    programmed = file["drive.programme"] or file["drive.stage"]
    return () if programmed else quantities(ensemble, file.units, file.interface)


def physical(file: RunFile, row: dict[str, Any]) -> dict[str, float]:
    """The columns of a point that say what its friction is at the interface; none of a
    point that failed."""
    if row.get("friction") is None or not _quantities(file, Ensemble()):
        return {}
    return {
        one.column + end: row[f"friction{end}"] * one.factor
        for one in _quantities(file, file.ensemble)
        for end in ("", "_stderr", "_reference")
        if row.get(f"friction{end}") is not None
    }


def compute(
    tasks: list[Task], asked: Asked, threads: int, version: int
) -> list[dict[str, Any]]:
    """What a worker does: the columns of some points that are found by computing.
    Raises InputError if this worker's results are not of `version`."""
    if version != RESULTS_VERSION:
        raise InputError(
            f"a worker runs other code (results version {RESULTS_VERSION}, not {version})"
        )
    return [_row(task, asked, threads) for task in tasks]


def _row(task: Task, asked: Asked, threads: int) -> dict[str, Any]:
    begin = time.perf_counter()
    try:
        if isinstance(drive := task.drive, Programme):
            row = _programme(task, drive, asked, threads)
        elif drive.elastic:
            row = _elastic(task, drive, asked, threads)
        elif asked.transient:
            found = trajectory(task.ensemble, drive, **_options(task, asked, threads))
            row = _columns(found.averages, found.lives, [])
        else:
            row = _steady(task, drive, asked, threads)
    except MemoryError:  # the machine's fault, not the point's
        raise
    except Exception as error:
        kind = "" if isinstance(error, InputError) else f"{type(error).__name__}: "
        row = {"status": "failed", "message": kind + " ".join(str(error).split())}
    return {**row, "seconds": time.perf_counter() - begin}


def _options(task: Task, asked: Asked, threads: int) -> dict[str, Any]:
    """Arguments that all trajectories take."""
    return {
        "points": task.points,
        "replicas": task.replicas,
        "seed": task.seed,
        "threads": threads,
        "max_lives": asked.max_lives,
    }


def _steady(task: Task, drive: Drive, asked: Asked, threads: int) -> dict[str, Any]:
    found = steady_engine.steady(
        task.ensemble,
        drive,
        rel_error=asked.rel_error,
        seed=task.seed,
        threads=threads,
        max_lives=asked.max_lives,
    )
    missed = f"relative error {asked.rel_error:g} was not reached"
    row = _columns(found, found.lives, [] if found.reached else [missed])
    try:
        exact = reference(task.ensemble, drive)
    except InputError as error:
        return row | _no_reference(row, error)
    row["reference_method"] = exact.method
    for name, level in exact.averages().items():
        row |= _beside(name, found.averages()[name], level)
    return row


def _elastic(task: Task, drive: Drive, asked: Asked, threads: int) -> dict[str, Any]:
    ensemble, blocks = task.ensemble, drive.elastic
    assert blocks
    found = elastic_trajectory(ensemble, drive, **_options(task, asked, threads))
    exact, friction = reference(ensemble, replace(drive, elastic=None)), found.friction
    reliable = friction.reliable and found.size.reliable
    row: dict[str, Any] = {
        "lives": found.lives,
        "status": "ok" if reliable else "unreliable",
        "message": None if reliable else "the second half is too short, or not steady",
        "reference_method": exact.method,
        **_estimated("friction", friction),
        **_beside("friction", friction, exact.friction),
        **_estimated("size", found.size),
        **_estimated("single", found.single),
    }
    law = ensemble.thresholds
    if law.steps.size:  # equal thresholds break together: no law of sizes is known
        return row
    few = missed_by_few(law, blocks.load, blocks.contacts_per_block(ensemble.count))
    single = float(size_law(law, blocks.load, 1)[0])
    size = Estimate(blocks.mean_size, abs(few.mean), 0)
    row |= _beside("size", found.size, size)
    return row | _beside("single", found.single, Estimate(single, abs(few.single), 0))


def _programme(
    task: Task, programme: Programme, asked: Asked, threads: int
) -> dict[str, Any]:
    found = trajectory(task.ensemble, programme, **_options(task, asked, threads))
    row: dict[str, Any] = {"lives": found.lives, "status": "ok", "message": None}
    if not found.force_reliable:
        said = "error bars of forces cannot be trusted"
        row |= {"status": "unreliable", "message": said}
    if isinstance(found, SliderTrajectory):
        return row | _slips(found)
    exact: tuple[SegmentRecord, ...] = ()
    try:
        means = transient(task.ensemble, programme, task.points)
        grid = programme.grid(task.points)
        exact = shown_by(programme, grid, means.force, means.force_error)
        row["reference_method"] = "renewal equation in two times"
    except InputError as error:
        row |= _no_reference(row, error)
    for index, segment in enumerate(found.segments):
        levels = _of_segment(exact[index]) if exact else {}
        for name, ours in _of_segment(segment).items():
            row |= _estimated(f"segment_{index}_{name}", ours)
            if name in levels:
                row |= _beside(f"segment_{index}_{name}", ours, levels[name])
    return row


def _slips(found: SliderTrajectory) -> dict[str, Any]:
    """How a slider that a stage pulls slips; its forces are not asked for."""
    period, drop = found.period, found.drop
    few = not period.reliable and not period.n == drop.n == 0
    return {
        "status": "unreliable" if few else "ok",
        "message": "few slips" if few else None,
        "slips": len(found.slips),
        **_estimated("period", period),
        **_estimated("drop", drop),
    }


def _of_segment(segment: SegmentRecord) -> dict[str, Estimate]:
    """The observables of a segment, and of a velocity step if it is one."""
    found = {name: getattr(segment, name) for name in _OF_SEGMENT}
    found |= {name: getattr(segment.step, name, None) for name in _OF_STEP}
    return {name: estimate for name, estimate in found.items() if estimate}


def _columns(averages: Averages, lives: int, problems: list[str]) -> dict[str, Any]:
    """Columns of estimates, and what is wrong with them besides `problems`."""
    row: dict[str, Any] = {"lives": lives}
    doubtful = []
    for name, e in averages.averages().items():
        row |= _estimated(name, e)
        doubtful += [name] * (not (e.reliable or e.diverges))
    if doubtful:
        said = f"error bars of {', '.join(doubtful)} cannot be trusted"
        problems = [said, *problems]
    row["status"] = "unreliable" if problems else "ok"
    return row | {"message": "; ".join(problems) or None}


def _no_reference(row: dict[str, Any], error: InputError) -> dict[str, str]:
    """The message of a row without a reference."""
    said = (row["message"], f"no reference: {error}")
    return {"message": "; ".join(filter(None, said))}


def _estimated(name: str, e: Estimate) -> dict[str, Any]:
    """Columns of an estimate; the schema leaves out those that it has not."""
    return {
        name: e.value,
        f"{name}_stderr": e.stderr,
        f"{name}_dof": e.dof,
        f"{name}_reliable": e.reliable,
    }


def _beside(name: str, ours: Estimate, level: Estimate) -> dict[str, Any]:
    """Columns of a reference, and how far our estimate is from it."""
    z = None
    if level.value is not None:
        z = z_score(ours, level.value, level.stderr or 0.0)
    return {
        f"{name}_reference": level.value,
        f"{name}_reference_error": level.stderr,
        f"{name}_z": z,
    }
