"""Sweeps over grids of points: batches of points go to workers, and their rows to a
resumable Parquet dataset."""

import functools
import statistics
import time
from collections import Counter, deque
from collections.abc import Callable
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Future,
    wait,
)
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eqsim.errors import InputError
from eqsim.io import signals
from eqsim.io.terminal import LONG_ATTEMPT, duration
from eqsim.results import RESULTS_VERSION
from eqsim.sweeps.plan import Plan
from eqsim.sweeps.rows import Asked, compute
from eqsim.sweeps.store import WORKERS_DIED, Store
from eqsim.sweeps.workers import Pool, Workers

_FLUSH_SECONDS = 5.0
_BATCH_SECONDS = 0.25  # time of a worker for a batch of points, about
_MOST_BATCH = 64  # points of a batch
_FIRST_BATCH = 2  # points of a batch before any is timed; its first one may compile
_LOSSES = 3  # deaths of workers at a point after which it fails

Progress = Callable[[int, int], None]
Note = Callable[[str], None]


@dataclass(frozen=True)
class Summary:
    """End of a sweep: numbers of points by status, of those on disk before (`resumed`)
    and `computed` now; `seconds` since the start, and summed over the points computed
    now; the failed points (number from 1, id, changes, message), and damaged files."""

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

    def told(self, out: Path) -> list[str]:
        """Lines for a terminal about the sweep in the folder `out`."""
        doubtful = f", {self.unreliable} unreliable" if self.unreliable else ""
        failed = f", {self.failed} FAILED" if self.failed else ""
        points = f"{self.points} points: {self.ok} ok{doubtful}{failed}"
        notes = [f"{out}/: sweep.parquet, {points}"]
        if self.computed:
            each = self.point_seconds / self.computed * 1e3
            ran = f"{self.computed} computed in {self.seconds:.1f} s"
            notes.append(f"{ran}, {each:.3g} ms of engine and reference each")
        return notes


def sweep(
    plan: Plan,
    out: Path,
    *,
    asked: Asked | None = None,
    workers: Workers | None = None,
    progress: Progress = lambda *_: None,
    note: Note = lambda _: None,
    opened: Callable[[Store], None] = lambda _: None,
) -> Summary:
    """Compute those points of a plan that the folder `out` (`eqsim.sweeps.store`) does
    not hold yet: by default steady averages to 1e-2, by one process.

    `progress(done, total)` counts the points of this call, `note` is told what to
    expect, and `opened` is given the folder's `Store` once it is there. Raises
    InputError if the folder or the workers cannot be used, or workers die again and
    again.
    """
    begin = time.perf_counter()
    asked = asked or Asked()
    # Workers come before the folder: a cluster that does not answer leaves none.
    with (workers or Workers()).pool() as pool:
        store = Store(out, plan, asked)
        opened(store)
        try:
            for path in store.damaged:
                note(f"{path} is damaged; its points are computed again")
            pending = [i for i, name in enumerate(plan.ids) if name not in store.done]
            resumed = plan.size - len(pending)
            sizes = " x ".join(str(len(axis)) for axis in plan.axes)
            known = f", {resumed} of them on disk" if resumed else ""
            note(f"{plan.size} points ({sizes}){known}")
            seconds = Scheduler(store, pool, asked, progress, note).run(pending)
            table = store.compact()
        except BaseException:
            signals.acknowledge()
            with signals.deferred():
                store.flush()
            raise
        finally:
            store.close()
    rows = table.select(["status", "message"]).to_pylist()
    count = Counter(row["status"] for row in rows)
    failures = [
        {
            "point": index + 1,
            "id": plan.ids[index],
            "changes": plan.changes(index),
            "message": row["message"],
        }
        for index, row in enumerate(rows)
        if row["status"] == "failed"
    ]
    return Summary(
        points=plan.size,
        ok=count["ok"],
        unreliable=count["unreliable"],
        failed=count["failed"],
        resumed=resumed,
        computed=len(pending),
        seconds=time.perf_counter() - begin,
        point_seconds=seconds,
        failures=failures,
        damaged=store.damaged,
    )


class Scheduler:
    """Hands batches of points to workers and their rows to the store.

    When a worker dies its points are tried again, each alone. A point that is alone
    with every one of `_LOSSES` deaths is to blame, and fails; it is tried again when
    the sweep is continued, perhaps with more memory.
    """

    def __init__(
        self, store: Store, pool: Pool, asked: Asked, progress: Progress, note: Note
    ) -> None:
        self.plan, self.store, self.pool = store.plan, store, pool
        self.progress, self.note = progress, note
        self.work = functools.partial(
            compute, asked=asked, threads=pool.threads, version=RESULTS_VERSION
        )
        self.pending: deque[int] = deque()
        self.running: dict[Future[Any], list[int]] = {}
        self.suspects: deque[int] = deque()  # points that may have killed a worker
        self.losses: Counter[int] = Counter()
        self.deaths, self.done, self.seconds = 0, 0, 0.0
        self.recent: deque[float] = deque(maxlen=64)  # seconds that points took

    def run(self, pending: list[int]) -> float:
        """Compute all points; returns the seconds they took, summed."""
        total, told = len(pending), False
        # Points from all over the grid come first: their times foretell the whole.
        first = pending[:: max(1, total // (2 * _FIRST_BATCH * self.pool.slots()))]
        self.pending = deque([*first, *sorted({*pending} - {*first})])
        while self.pending or self.running or self.suspects:
            if not self.suspects:
                self._fill()
            elif not self.running:
                self._submit([self.suspects.popleft()])
            self._collect()
            self.store.flush(older=_FLUSH_SECONDS)
            slots = self.pool.slots()
            if not told and self.pending and len(self.recent) >= slots:
                told, mean = True, statistics.fmean(self.recent)
                needed = mean * len(self.pending) / slots
                pace = f"{duration(mean)} a point, {slots} workers"
                if needed > LONG_ATTEMPT:
                    self.note(f"about {duration(needed)} to go: {pace}")
            self.progress(self.done, total)
        return self.seconds

    def _fill(self) -> None:
        """Submit two batches for every worker, smaller ones at the end of a sweep."""
        slots = self.pool.slots()
        while self.pending and len(self.running) < 2 * slots:
            batch = _FIRST_BATCH
            if self.recent:
                fitting = int(_BATCH_SECONDS / max(1e-9, *self.recent))
                share = -(-len(self.pending) // (2 * slots))
                batch = max(1, min(fitting, share, _MOST_BATCH))
            count = min(batch, len(self.pending))
            self._submit([self.pending.popleft() for _ in range(count)])

    def _submit(self, batch: list[int]) -> None:
        tasks = [self.plan.task(index) for index in batch]
        try:
            future = self.pool.executor.submit(self.work, tasks)
        except BrokenExecutor:  # died between two batches
            self._died()
            future = self.pool.executor.submit(self.work, tasks)
        self.running[future] = batch

    def _collect(self) -> None:
        finished, _ = wait(self.running, timeout=0.5, return_when=FIRST_COMPLETED)
        broken = False
        for future in finished:
            batch = self.running.pop(future)
            try:
                rows = future.result()
            except self.pool.lost as error:
                broken |= isinstance(error, BrokenExecutor)
                self._lost(batch, alone=not self.running and len(batch) == 1)
                continue
            except CancelledError:
                raise InputError(
                    "the connection to the scheduler was lost; the same command continues"
                ) from None
            self.deaths = 0
            for index, row in zip(batch, rows, strict=True):
                self._finish(index, row)
            # The first point of a batch may compile and tabulate.
            self.recent.extend(row["seconds"] for row in rows[1:] or rows)
        if broken:
            self._died()

    def _finish(self, index: int, row: dict[str, Any]) -> None:
        self.store.add(index, row)
        self.done += 1
        self.seconds += row["seconds"]

    def _lost(self, batch: list[int], alone: bool) -> None:
        """Put the points of a batch whose worker died among the suspects."""
        for index in batch:
            self.losses[index] += alone
            if self.losses[index] < _LOSSES:
                self.suspects.append(index)
                continue
            said = f"{_LOSSES} {WORKERS_DIED} (not enough memory?)"
            self._finish(index, {"status": "failed", "message": said, "seconds": 0.0})

    def _died(self) -> None:
        self.deaths += 1
        if self.deaths > 4 * _LOSSES:
            raise InputError(
                "workers die as soon as they start; finished points are on disk"
            )
        self.pool.renew()
