"""Grids of points: from a run file with a [sweep] table to a Parquet dataset, one row per point.

A folder of results holds `sweep.parquet`, sorted in the order of the grid, and `_sweep.json`, what was asked for. While
a sweep runs its rows are in `_parts/`, in files named by a digest of their content. Names that begin with "_" are not
part of the dataset: `pandas.read_parquet(FOLDER)` reads the table.

Columns (version 1 of the schema, the same for every sweep; null where a column does not apply):

    id                         SHA-256 of parameters, seed and `results_version()`
    disorder ... output.replicas   every key of the run file but the title, as section.key; `thresholds.n` and `x_star`
                               with their defaults filled in
    kind                       "steady" (averages to a relative error) or "transient" (the run's second half)
    status, message            "ok"; "unreliable", error bars not to be trusted or larger than asked for; "failed"
    friction, pinned, break_stretch        each with
      _stderr, _dof, _reliable             its standard error, degrees of freedom (null: normal) and whether to trust it
      _reference, _reference_error         what the master equation says, and the error of the solver (steady)
      _z                                   their difference as a standard-normal score; null if both errors are 0
    reference_method           the solver
    lives                      lives simulated
    seed                       random seed, made from `id` alone
    seconds                    wall time of engine and reference; the only column that differs when a sweep is repeated
    eqsim_version              version of the package

The metadata key `eqsim` holds the run file, the settings, versions and the version of the schema.

A value depends on the id of its point and on nothing else: not on the order, the workers, restarts or the rest of the
grid. The results version stands for the code and the libraries. Processors of different make draw the same random
numbers and round differently: values agree to 1e-9, and to 1e-6 where thresholds fluctuate.
"""

import dataclasses
import functools
import hashlib
import json
import math
import os
import shutil
import statistics
import time
from collections import Counter, deque
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from eqsim.io import storage
from eqsim.errors import InputError, require_number
from eqsim.estimate import OBSERVABLES, z_score
from eqsim.sweep.plan import Plan, Task, entries, results_version, seed_of
from eqsim.io.runfile import RunFile, keys, parameters
from eqsim.io.terminal import duration
from eqsim.sweep.workers import crew

SCHEMA = 1
_TABLE, _MANIFEST, _LOCK, _PARTS = "sweep.parquet", "_sweep.json", "_lock", "_parts"
_FLUSH_ROWS, _FLUSH_SECONDS = 256, 5.0
_BATCH_SECONDS, _MOST_BATCH = 0.25, 64  # a batch of points that a worker computes: as long as this, as many as that
_LOSSES = 3  # so many workers may die at a point before it is given up

Progress = Callable[[int, int], None]
Note = Callable[[str], None]


@dataclasses.dataclass(frozen=True)
class Asked:
    """What is computed at each point: steady averages to `rel_error`, or with `transient` the run's second half; at
    most `max_lives` lives a point. Raises InputError."""

    rel_error: float = 1e-2
    max_lives: float = 1e10
    transient: bool = False

    def __post_init__(self) -> None:
        require_number("--rel-error", self.rel_error, above=0)
        require_number("--max-lives", self.max_lives, above=0)


@dataclasses.dataclass(frozen=True)
class Summary:
    """How a sweep ended: numbers of points by status, found on disk and computed now, seconds since the start and
    summed over the points computed now, the failed points (index, id, changes, message), and damaged files."""

    points: int
    ok: int
    unreliable: int
    failed: int
    resumed: int
    computed: int
    seconds: float
    point_seconds: float
    failures: list[dict[str, Any]]
    damaged: list[str]


# ---- rows ----


def schema() -> Any:
    """The pyarrow schema of the dataset."""
    import pyarrow as pa

    types = {float: pa.float64(), int: pa.int64(), str: pa.string()}
    fields = [("id", pa.string()), *((key, types[kind]) for key, kind in keys().items())]
    fields += [("kind", pa.string()), ("status", pa.string()), ("message", pa.string())]
    for name in OBSERVABLES:
        fields += [(name, pa.float64()), (f"{name}_stderr", pa.float64()), (f"{name}_dof", pa.int64())]
        fields += [(f"{name}_reliable", pa.bool_()), (f"{name}_reference", pa.float64())]
        fields += [(f"{name}_reference_error", pa.float64()), (f"{name}_z", pa.float64())]
    fields += [("reference_method", pa.string()), ("lives", pa.int64()), ("seed", pa.int64())]
    return pa.schema([*fields, ("seconds", pa.float64()), ("eqsim_version", pa.string())])


def compute(tasks: list[Task], asked: Asked, threads: int, version: str) -> list[dict[str, Any]]:
    """What a worker does: the columns of some points that are found by computing. Raises InputError if this worker's
    code is not that of `version`."""
    from eqsim.engine import trajectory  # noqa: F401  # imported before any point is timed
    from eqsim.master import reference  # noqa: F401

    if version != results_version():
        raise InputError(f"a worker runs other code or libraries (results version {results_version()}, not {version})")
    return [_row(task, asked, threads) for task in tasks]


def _row(task: Task, asked: Asked, threads: int) -> dict[str, Any]:
    begin = time.perf_counter()
    try:
        row = (_transient if asked.transient else _steady)(task, asked, threads)
    except MemoryError:  # the machine's fault, not the point's
        raise
    except Exception as error:
        kind = "" if isinstance(error, InputError) else f"{type(error).__name__}: "
        row = {"status": "failed", "message": kind + " ".join(str(error).split())}
    return {**row, "seconds": time.perf_counter() - begin}


def _steady(task: Task, asked: Asked, threads: int) -> dict[str, Any]:
    from eqsim.engine.steady import steady
    from eqsim.master.steady import reference

    ensemble, velocity = task.ensemble, task.drive.velocity
    found = steady(
        ensemble, velocity, rel_error=asked.rel_error, seed=task.seed, threads=threads, max_lives=asked.max_lives
    )
    row, problems = _columns({name: getattr(found, name) for name in OBSERVABLES})
    if not found.reached:
        problems.append(f"relative error {asked.rel_error:g} was not reached")
    status = "unreliable" if problems else "ok"
    try:
        exact = reference(ensemble, velocity)
    except InputError as error:
        problems.append(f"no reference: {error}")
    else:
        row["reference_method"] = exact.method
        for name in OBSERVABLES:
            level = getattr(exact, name)
            row[f"{name}_reference"], row[f"{name}_reference_error"] = level.value, level.stderr
            row[f"{name}_z"] = z_score(getattr(found, name), level.value, level.stderr)
    return {**row, "lives": found.lives, "status": status, "message": "; ".join(problems) or None}


def _transient(task: Task, asked: Asked, threads: int) -> dict[str, Any]:
    from eqsim.engine.trajectory import trajectory

    points, replicas = task.output
    found = trajectory(
        task.ensemble, task.drive, points=points, replicas=replicas, seed=task.seed, threads=threads,
        max_lives=asked.max_lives,
    )  # fmt: skip
    estimates = {"friction": found.friction, "pinned": found.pinned_fraction, "break_stretch": found.break_stretch}
    row, problems = _columns(estimates)
    status = "unreliable" if problems else "ok"
    return {**row, "lives": found.lives, "status": status, "message": "; ".join(problems) or None}


def _columns(estimates: dict[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """Columns of estimates, and what is wrong with them."""
    row: dict[str, Any] = {}
    for name, e in estimates.items():
        row |= {name: e.value, f"{name}_stderr": e.stderr, f"{name}_dof": e.dof, f"{name}_reliable": e.reliable}
    doubtful = [name for name, estimate in estimates.items() if not estimate.reliable]
    return row, [f"error bars of {', '.join(doubtful)} cannot be trusted"] if doubtful else []


# ---- the folder ----


class Store:
    """The folder of a sweep, held by a lock that dies with its process. Raises InputError if it is in use or holds
    something else."""

    def __init__(self, out: Path, plan: Plan, asked: Asked, text: str) -> None:
        storage.check_folder(out)
        self.out, self.plan, self.kind = out, plan, "transient" if asked.transient else "steady"
        theirs = () if (out / _MANIFEST).exists() else (*out.glob("[!._]*"), *out.glob(f"{_PARTS}/*.parquet"))
        if theirs:  # the folder is read as one table
            raise InputError(
                f"--out {out}: holds files of another origin, {theirs[0].name}; must be a folder of its own"
            )
        out.mkdir(parents=True, exist_ok=True)
        self.lock = self._locked()
        try:
            self._agree(asked, text)
            (out / _PARTS).mkdir(exist_ok=True)
            for left in (*out.glob(".eqsim-*"), *(out / _PARTS).glob(".eqsim-*")):
                shutil.rmtree(left) if left.is_dir() else left.unlink()
            settings = {"sweep": plan.file.model_dump(), **dataclasses.asdict(asked)}
            origin = storage.provenance("sweep", settings, text, plan.file.output.seed, plan.folder)
            origin |= {"schema": SCHEMA, "results_version": results_version()}
            self.schema = schema().with_metadata({"eqsim": storage.to_json(origin)})
            self.rows: list[dict[str, Any]] = []
            self.tables: list[Any] = []
            self.done: set[str] = set()
            self.damaged: list[str] = []
            self._load()
        except BaseException:
            self.close()
            raise
        self.flushed = time.monotonic()

    def _locked(self) -> int:
        handle = os.open(self.out / _LOCK, os.O_RDWR | os.O_CREAT, 0o666)  # modulo umask: the folder may be a group's
        try:
            import fcntl

            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            raise InputError(f"--out {self.out}: another sweep is at work in this folder") from None
        except (ImportError, OSError):  # a system or a file system without locks
            pass
        return handle

    def close(self) -> None:
        os.close(self.lock)

    def _agree(self, asked: Asked, text: str) -> None:
        """Note what is asked for, or compare it with what was."""
        plan = self.plan
        names = {plan.file.thresholds.file, plan.file.sweep.get("file")} - {None}
        now = {key: repr(value) for key, value in parameters(plan.file).items()}
        now |= {f"sweep.{key}": repr(value) for key, value in entries(plan.file.sweep)}
        now |= {f"content of {name}": _digest((plan.folder / str(name)).read_bytes()) for name in names}
        now |= {key: repr(value) for key, value in dataclasses.asdict(asked).items()}
        now |= {"schema": str(SCHEMA), "results version": results_version(), "order of axes": repr([*plan.file.sweep])}
        path = self.out / _MANIFEST
        if not path.exists():
            storage.save(path, json.dumps({"asked": now, "points": plan.size, "run_file": text}, indent=2).encode())
            return
        try:
            before = json.loads(path.read_bytes())["asked"]
            changed = [key for key in sorted({*now, *before}) if now.get(key) != before.get(key)]
        except (ValueError, KeyError, TypeError, AttributeError):
            raise InputError(f"{path}: is damaged; this folder cannot be continued") from None
        if changed:
            listed = "; ".join(
                f"{key} was {str(before.get(key, 'absent'))[:80]}, is {now.get(key, 'absent')[:80]}" for key in changed
            )
            raise InputError(f"--out {self.out}: holds another sweep, use another folder: {listed}")

    def _load(self) -> None:
        """The rows on disk; what is damaged is noted and removed."""
        self.parts = sorted((self.out / _PARTS).glob("*.parquet"))
        final = self.out / _TABLE
        self.final = final.exists()
        for path in [final, *self.parts] if self.final else [*self.parts]:
            content = path.read_bytes()
            whole = path == final or path.stem == f"part-{_digest(content)}"
            table = storage.unsealed(content, self.schema) if whole else None
            if table is None:
                self.damaged.append(str(path))
                path.unlink()
                self.final = self.final and path != final
                continue
            self.tables.append(table)
            self.done.update(table["id"].to_pylist())
        self.parts = [path for path in self.parts if path.exists()]
        self.done &= set(self.plan.ids)

    def add(self, index: int, row: dict[str, Any]) -> None:
        """Keep the row of a point; it reaches the disk with `flush`."""
        point_id = self.plan.ids[index]
        known = {"id": point_id, "seed": seed_of(point_id), "kind": self.kind, "eqsim_version": _version()}
        self.rows.append({**parameters(self.plan.at(index)), **row, **known})
        self.done.add(point_id)
        if len(self.rows) >= _FLUSH_ROWS:
            self.flush()

    def flush(self, older: float = 0.0) -> None:
        """Write the rows at hand to a file if the last one is `older` seconds old."""
        if not self.rows or time.monotonic() - self.flushed < older:
            return
        import pyarrow as pa

        table = pa.Table.from_pylist(self.rows, self.schema)
        content = storage.sealed(table)
        path = self.out / _PARTS / f"part-{_digest(content)}.parquet"
        storage.save(path, content)
        self.parts.append(path)
        self.tables.append(table)
        self.rows, self.flushed = [], time.monotonic()

    def kept(self) -> str:
        """Write the rows at hand, also those of a `flush` that was broken off, and say how many points are on disk."""
        self.flush()
        found = {point_id for table in self.tables for point_id in table["id"].to_pylist()} & set(self.plan.ids)
        return f"{len(found)} of {self.plan.size} points are on disk"

    def compact(self) -> Any:
        """All rows in one file, in the order of the grid, each once; a death in between loses and doubles nothing."""
        import pyarrow as pa

        self.flush()
        table = pa.concat_tables(self.tables)
        place = dict(zip(reversed(table["id"].to_pylist()), reversed(range(len(table))), strict=True))  # the first
        table = table.take([place[point_id] for point_id in self.plan.ids]).combine_chunks()
        if self.parts or not self.final:
            storage.save(self.out / _TABLE, storage.sealed(table))
        for path in self.parts:
            path.unlink()
        with suppress(OSError):
            (self.out / _PARTS).rmdir()
        return table


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:32]


@functools.cache
def _version() -> str:
    return storage.versions()["eqsim"]


# ---- the sweep ----


def sweep(
    file: RunFile,
    folder: Path,
    out: Path,
    *,
    asked: Asked | None = None,
    text: str = "",
    workers: int = 1,
    threads: int = 1,
    dask: str | None = None,
    progress: Progress | None = None,
    note: Note | None = None,
    opened: Callable[["Store"], None] = lambda _: None,
) -> Summary:
    """Compute all points of a run file's [sweep] table into the folder `out`, or those that are not there yet.

    Paths in the run file are relative to `folder`; `text` is kept in the metadata. `workers` processes of this machine
    (or those of the cluster whose scheduler is at `dask`) use `threads` threads each; both change speed only.
    `progress(done, total)` counts the points of this call, `note` is told what to expect, and `opened` is given the
    folder's store once it is there. Raises InputError.
    """
    begin = time.perf_counter()
    asked, note = asked or Asked(), note or (lambda _: None)
    plan = Plan(file, folder)
    with crew(workers, dask) as found:  # before there is a folder: a cluster that does not answer leaves none
        store = Store(out, plan, asked, text)
        opened(store)
        try:
            for path in store.damaged:
                note(f"{path} is damaged; its points are computed again")
            pending = [index for index in range(plan.size) if plan.ids[index] not in store.done]
            resumed = plan.size - len(pending)
            sizes = " x ".join(str(len(axis)) for axis in plan.axes)
            note(f"{plan.size} points ({sizes})" + (f", {resumed} of them on disk" if resumed else ""))
            seconds = 0.0
            if pending:
                seconds = _Loop(plan, store, asked, threads, found, progress, note).run(pending)
            table = store.compact()
        except BaseException:
            store.flush()
            raise
        finally:
            store.close()
    columns = table.select(["status", "message"]).to_pydict()
    count = Counter(columns["status"])
    failures = [
        {
            "point": index + 1,
            "id": plan.ids[index],
            "changes": plan.changes(index),
            "message": columns["message"][index],
        }
        for index, status in enumerate(columns["status"])
        if status == "failed"
    ]
    return Summary(
        plan.size, count["ok"], count["unreliable"], count["failed"], resumed, len(pending),
        time.perf_counter() - begin, seconds, failures, store.damaged,
    )  # fmt: skip


class _Loop:
    """Hands batches of points to workers and their rows to the store."""

    def __init__(
        self,
        plan: Plan,
        store: Store,
        asked: Asked,
        threads: int,
        crew: Any,
        progress: Progress | None,
        note: Note,
    ) -> None:
        self.plan, self.store, self.crew, self.note = plan, store, crew, note
        self.work = functools.partial(compute, asked=asked, threads=threads, version=results_version())
        self.progress = progress or (lambda *_: None)
        self.running: dict[Future[Any], list[int]] = {}
        self.suspects: deque[int] = deque()  # of having killed a worker; each of these goes alone
        self.losses: Counter[int] = Counter()
        self.deaths, self.done, self.seconds = 0, 0, 0.0
        self.recent: deque[float] = deque(maxlen=64)  # seconds a point took

    def run(self, pending: list[int]) -> float:
        """Compute all; the seconds that points took, summed."""
        total, slots = len(pending), self.crew.slots()
        probes = min(slots, 8, -(-total // 4))  # batches of two from all over the grid; the second of each is timed
        spread = [round(place) for place in np.linspace(0, total - 1, 2 * probes)] if total > 1 else [0]
        first = list(dict.fromkeys(spread))
        for start in range(0, len(first), 2):
            self._submit([pending[place] for place in first[start : start + 2]])
        chosen = set(first)
        queue = deque(index for place, index in enumerate(pending) if place not in chosen)
        timed = False
        while queue or self.running or self.suspects:
            if timed and not self.suspects:
                slots = self.crew.slots()
                while queue and len(self.running) < 2 * slots:
                    longest = max(self.recent, default=math.inf)
                    share = -(-len(queue) // (2 * slots))  # the last batches of a sweep are small
                    batch = max(1, min(int(_BATCH_SECONDS / max(longest, 1e-9)), _MOST_BATCH, share))
                    self._submit([queue.popleft() for _ in range(min(batch, len(queue)))])
            elif self.suspects and not self.running:
                self._submit([self.suspects.popleft()])
            self._collect()
            self.store.flush(older=_FLUSH_SECONDS)
            if not timed and not self.running:
                timed = True
                if self.recent and queue:
                    mean, slots = statistics.fmean(self.recent), self.crew.slots()
                    left = mean * len(queue) / slots
                    self.note(f"about {duration(left)} to go: {mean * 1e3:.3g} ms a point, {slots} workers")
            self.progress(self.done, total)
        return self.seconds

    def _submit(self, batch: list[int]) -> None:
        tasks = [self.plan.task(index) for index in batch]
        try:
            future = self.crew.pool.submit(self.work, tasks)
        except BrokenExecutor:  # died between two batches
            self._died()
            future = self.crew.pool.submit(self.work, tasks)
        self.running[future] = batch

    def _collect(self) -> None:
        finished, _ = wait(self.running, timeout=0.5, return_when=FIRST_COMPLETED)
        broken = False
        for future in finished:
            batch = self.running.pop(future)
            try:
                rows = future.result()
            except self.crew.lost as error:
                broken |= isinstance(error, BrokenExecutor)
                self._lost(batch, alone=not self.running and len(batch) == 1)
                continue
            except CancelledError:
                raise InputError("the connection to the scheduler was lost; the same command continues") from None
            self.deaths = 0
            for index, row in zip(batch, rows, strict=True):
                self._finish(index, row)
            self.recent.extend(row["seconds"] for row in rows[1:] or rows)  # a first one may compile and tabulate
        if broken:
            self._died()

    def _finish(self, index: int, row: dict[str, Any]) -> None:
        self.store.add(index, row)
        self.done += 1
        self.seconds += row["seconds"]

    def _lost(self, batch: list[int], alone: bool) -> None:
        """Try again, each point on its own; one that is alone with every death is to blame."""
        for index in batch:
            self.losses[index] += alone
            if self.losses[index] >= _LOSSES:
                message = f"{_LOSSES} workers died at this point (not enough memory?)"
                self._finish(index, {"status": "failed", "message": message, "seconds": 0.0})
            else:
                self.suspects.append(index)

    def _died(self) -> None:
        self.deaths += 1
        if self.deaths > 4 * _LOSSES:
            raise InputError("workers die as soon as they start; finished points are on disk")
        self.crew.renew()
