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
from typing import TYPE_CHECKING, Any

from eqsim.errors import InputError, require_number
from eqsim.estimate import OBSERVABLES, Averages, Estimate, known, z_score
from eqsim.io.runfile import RunFile, keys
from eqsim.io.units import Quantity, quantities
from eqsim.model.drive import Drive, Programme
from eqsim.model.ensemble import Ensemble
from eqsim.results import RESULTS_VERSION
from eqsim.sweeps.plan import Task

if TYPE_CHECKING:
    from eqsim.engine.records import SegmentRecord, SliderTrajectory

SCHEMA = 2
_SHOWN = ("end", "peak", "at", "direct", "evolution", "memory")  # of a segment


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

    number, integer, text, truth = pa.float64(), pa.int64(), pa.string(), pa.bool_()
    types = {float: number, int: integer, str: text}
    fields = {"id": text, **{key: types[kind] for key, kind in keys(file).items()}}
    fields |= {"kind": text, "status": text, "message": text}
    for name in OBSERVABLES:
        fields |= {
            name: number,
            f"{name}_stderr": number,
            f"{name}_dof": integer,
            f"{name}_reliable": truth,
        }
        fields |= {
            f"{name}_reference": number,
            f"{name}_reference_error": number,
            f"{name}_z": number,
        }
    for one in _quantities(file, Ensemble()):
        fields |= {
            one.column: number,
            f"{one.column}_stderr": number,
            f"{one.column}_reference": number,
        }
    for name in ("size", "single") if file["elastic"] else ():
        fields |= {
            name: number,
            f"{name}_stderr": number,
            f"{name}_reference": number,
            f"{name}_z": number,
        }
    if file["drive.stage"]:
        fields |= {
            "slips": integer,
            "period": number,
            "period_stderr": number,
            "drop": number,
            "drop_stderr": number,
        }
    for index in range(
        0 if file["drive.stage"] else len(file["drive.programme"] or [])
    ):
        for name in (f"segment_{index}_{shown}" for shown in _SHOWN):
            fields |= {
                name: number,
                f"{name}_stderr": number,
                f"{name}_reference": number,
            }
            fields |= {f"{name}_reference_error": number, f"{name}_z": number}
    fields |= {
        "reference_method": text,
        "lives": integer,
        "seed": integer,
        "seconds": number,
        "eqsim_version": text,
    }
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
    found = {}
    for one in _quantities(file, file.ensemble):
        for end in ("", "_stderr", "_reference"):
            value = row.get(f"friction{end}")
            if value is not None:
                found[one.column + end] = value * one.factor
    return found


def compute(
    tasks: list[Task], asked: Asked, threads: int, version: int
) -> list[dict[str, Any]]:
    """What a worker does: the columns of some points that are found by computing.
    Raises InputError if this worker's results are not of `version`."""
    from eqsim.engine import trajectory  # noqa: F401  # imported before any point is timed
    from eqsim.master import steady  # noqa: F401

    if version != RESULTS_VERSION:
        raise InputError(
            f"a worker runs other code (results version {RESULTS_VERSION}, not {version})"
        )
    return [_row(task, asked, threads) for task in tasks]


def _row(task: Task, asked: Asked, threads: int) -> dict[str, Any]:
    begin = time.perf_counter()
    try:
        if isinstance(task.drive, Programme):
            row = _programme(task, task.drive, asked, threads)
        elif task.drive.elastic:
            row = _elastic(task, task.drive, asked, threads)
        else:
            row = (_transient if asked.transient else _steady)(
                task, task.drive, asked, threads
            )
    except MemoryError:  # the machine's fault, not the point's
        raise
    except Exception as error:
        kind = "" if isinstance(error, InputError) else f"{type(error).__name__}: "
        row = {"status": "failed", "message": kind + " ".join(str(error).split())}
    return {**row, "seconds": time.perf_counter() - begin}


def _steady(task: Task, drive: Drive, asked: Asked, threads: int) -> dict[str, Any]:
    from eqsim.engine.steady import steady
    from eqsim.master.steady import reference

    found = steady(
        task.ensemble,
        drive,
        rel_error=asked.rel_error,
        seed=task.seed,
        threads=threads,
        max_lives=asked.max_lives,
    )
    problems = (
        [] if found.reached else [f"relative error {asked.rel_error:g} was not reached"]
    )
    row = _columns(found, found.lives, problems)
    try:
        exact = reference(task.ensemble, drive)
    except InputError as error:
        return row | {
            "message": "; ".join(
                filter(None, (row["message"], f"no reference: {error}"))
            )
        }
    row["reference_method"] = exact.method
    for name, level in exact.averages().items():
        row |= {
            f"{name}_reference": level.value,
            f"{name}_reference_error": level.stderr,
            f"{name}_z": None,
        }
        if level.value is None:
            continue
        row[f"{name}_z"] = z_score(
            found.averages()[name], known(level), level.stderr or 0.0
        )
    return row


def _transient(task: Task, drive: Drive, asked: Asked, threads: int) -> dict[str, Any]:
    from eqsim.engine.trajectory import trajectory

    found = trajectory(
        task.ensemble, drive, points=task.points, replicas=task.replicas, seed=task.seed, threads=threads,
        max_lives=asked.max_lives,
    )  # fmt: skip
    return _columns(found.averages, found.lives, [])


def _elastic(task: Task, drive: Drive, asked: Asked, threads: int) -> dict[str, Any]:
    from eqsim.engine.elastic import elastic_trajectory
    from eqsim.master.avalanche_sizes import missed_by_few, size_law
    from eqsim.master.steady import reference

    found = elastic_trajectory(
        task.ensemble, drive, points=task.points, replicas=task.replicas, seed=task.seed, threads=threads,
        max_lives=asked.max_lives,
    )  # fmt: skip
    exact, e = reference(task.ensemble, replace(drive, elastic=None)), found.friction
    doubtful = not (e.reliable and found.size.reliable)
    row: dict[str, Any] = {
        "lives": found.lives, "status": "unreliable" if doubtful else "ok", "reference_method": exact.method,
        "message": "the second half is too short, or not steady" if doubtful else None,
        "friction": e.value, "friction_stderr": e.stderr, "friction_dof": e.dof, "friction_reliable": e.reliable,
        "friction_reference": exact.friction.value, "friction_reference_error": exact.friction.stderr,
        "friction_z": z_score(e, known(exact.friction), exact.friction.stderr or 0.0),
    }  # fmt: skip
    elastic = drive.elastic
    assert elastic
    for name, estimate in (("size", found.size), ("single", found.single)):
        row |= {name: estimate.value, f"{name}_stderr": estimate.stderr}
    if (
        task.ensemble.thresholds.steps.size
    ):  # equal thresholds break together: no law is known
        return row
    single = float(size_law(task.ensemble.thresholds, elastic.load, 1)[0])
    contacts = elastic.contacts_per_block(task.ensemble.count)
    few = missed_by_few(task.ensemble.thresholds, elastic.load, contacts)
    laws = (
        ("size", found.size, elastic.mean_size, few.mean),
        ("single", found.single, single, few.single),
    )
    for name, estimate, law, missed in laws:
        row |= {
            f"{name}_reference": law,
            f"{name}_z": z_score(estimate, law, abs(missed)),
        }
    return row


def _programme(
    task: Task, programme: Programme, asked: Asked, threads: int
) -> dict[str, Any]:
    from eqsim.engine.records import SliderTrajectory, shown_by
    from eqsim.engine.trajectory import trajectory
    from eqsim.master.transient import transient

    found = trajectory(
        task.ensemble, programme, points=task.points, replicas=task.replicas, seed=task.seed, threads=threads,
        max_lives=asked.max_lives,
    )  # fmt: skip
    row: dict[str, Any] = {"lives": found.lives, "status": "ok", "message": None}
    if not found.force_reliable:
        row |= {
            "status": "unreliable",
            "message": "error bars of forces cannot be trusted",
        }
    if isinstance(found, SliderTrajectory):
        return row | _slips(found)
    exact: tuple[SegmentRecord, ...] = ()
    try:
        means = transient(task.ensemble, programme, task.points)
        exact = shown_by(
            programme, programme.grid(task.points), means.force, means.force_error
        )
        row["reference_method"] = "renewal equation in two times"
    except InputError as error:
        row["message"] = "; ".join(
            filter(None, (row["message"], f"no reference: {error}"))
        )
    for index, segment in enumerate(found.segments):
        for shown in _SHOWN:
            name, ours = f"segment_{index}_{shown}", _shown(segment, shown)
            level = _shown(exact[index], shown) if exact else None
            if ours:
                row |= {name: ours.value, f"{name}_stderr": ours.stderr}
            if ours and level and level.value is not None:
                row |= {
                    f"{name}_reference": level.value,
                    f"{name}_reference_error": level.stderr,
                }
                row[f"{name}_z"] = z_score(ours, level.value, level.stderr or 0.0)
    return row


def _slips(found: "SliderTrajectory") -> dict[str, Any]:
    """How a slider that a stage pulls slips; its forces are not asked for."""
    period, drop = found.period, found.drop
    problem = None if period.reliable or period.n == drop.n == 0 else "few slips"
    return {
        "status": "unreliable" if problem else "ok",
        "message": problem,
        "slips": len(found.slips),
        "period": period.value,
        "period_stderr": period.stderr,
        "drop": drop.value,
        "drop_stderr": drop.stderr,
    }


def _shown(segment: "SegmentRecord", name: str) -> Estimate | None:
    """An observable of a segment, of a velocity step if it is one."""
    return getattr(
        segment if name in ("end", "peak", "at") else segment.step, name, None
    )


def _columns(averages: Averages, lives: int, problems: list[str]) -> dict[str, Any]:
    """Columns of estimates, and what is wrong with them besides `problems`."""
    row: dict[str, Any] = {"lives": lives}
    for name, e in averages.averages().items():
        row |= {
            name: e.value,
            f"{name}_stderr": e.stderr,
            f"{name}_dof": e.dof,
            f"{name}_reliable": e.reliable,
        }
    every = averages.averages().items()
    doubtful = ", ".join(
        name for name, estimate in every if not (estimate.reliable or estimate.diverges)
    )
    problems = [f"error bars of {doubtful} cannot be trusted"] * bool(
        doubtful
    ) + problems
    return row | {
        "status": "unreliable" if problems else "ok",
        "message": "; ".join(problems) or None,
    }
