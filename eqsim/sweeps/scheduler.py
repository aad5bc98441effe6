"""Sweeps over grids of points: batches of points go to workers, and their rows to a
resumable Parquet dataset."""

import dataclasses
import functools
import math
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
from pathlib import Path
from typing import Any

from eqsim.errors import InputError
from eqsim.io import signals
from eqsim.io.terminal import duration
from eqsim.results import RESULTS_VERSION
from eqsim.sweeps.plan import Plan
from eqsim.sweeps.rows import Asked, compute
from eqsim.sweeps.store import Store
from eqsim.sweeps.workers import Pool, Workers

_FLUSH_SECONDS = 5.0
_BATCH_SECONDS, _MOST_BATCH = (
    0.25,
    64,
)  # a batch of points that a worker computes: as long as this, as many as that
_LOSSES = 3  # so many workers may die at a point before it is given up

Progress = Callable[[int, int], None]
Note = Callable[[str], None]


@dataclasses.dataclass(frozen=True)
class Summary:
    """How a sweep ended: numbers of points by status, found on disk and computed now,
    seconds since the start and summed over the points computed now, the failed points
    (index, id, changes, message), and damaged files."""

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


def sweep(
    plan: Plan,
    out: Path,
    *,
    asked: Asked | None = None,
    workers: Workers | None = None,
    progress: Progress | None = None,
    note: Note | None = None,
    opened: Callable[[Store], None] | None = None,
) -> Summary:
    """Compute all points of a plan into the folder `out`, or those that are not there
    yet.

    Parameters
    ----------
    plan : Plan
        `Plan(file)` of a run file with a [sweep] table.
    out : Path
        Folder of the dataset (`eqsim.sweeps.store`).
    asked, workers : optional
        What is computed at each point (default: steady averages to 1e-2), and who
        computes (default: one process).
    progress, note, opened : callable, optional
        `progress(done, total)` counts the points of this call, `note` is told what to
        expect, and `opened` is given the folder's `Store` once it is there.

    Returns
    -------
    Summary

    Raises
    ------
    InputError
        If the folder or the workers cannot be used, or workers die again and again.
    """
    begin = time.perf_counter()
    asked, note = asked or Asked(), note or (lambda _: None)
    with (
        (workers or Workers()).pool() as pool
    ):  # before there is a folder: a cluster that does not answer leaves none
        store = Store(out, plan, asked)
        if opened:
            opened(store)
        try:
            for path in store.damaged:
                note(f"{path} is damaged; its points are computed again")
            pending = [
                index for index in range(plan.size) if plan.ids[index] not in store.done
            ]
            resumed = plan.size - len(pending)
            sizes = " x ".join(str(len(axis)) for axis in plan.axes)
            note(
                f"{plan.size} points ({sizes})"
                + (f", {resumed} of them on disk" if resumed else "")
            )
            seconds = (
                Scheduler(store, pool, asked, progress, note).run(pending)
                if pending
                else 0.0
            )
            table = store.compact()
        except BaseException:
            signals.acknowledge()
            with signals.deferred():
                store.flush()
            raise
        finally:
            store.close()
    statuses, messages = table["status"].to_pylist(), table["message"].to_pylist()
    count = Counter(statuses)
    failures = [
        {
            "point": index + 1,
            "id": plan.ids[index],
            "changes": plan.changes(index),
            "message": messages[index],
        }
        for index, status in enumerate(statuses)
        if status == "failed"
    ]
    return Summary(
        plan.size, count["ok"], count["unreliable"], count["failed"], resumed, len(pending),
        time.perf_counter() - begin, seconds, failures, store.damaged,
    )  # fmt: skip


class Scheduler:
    """Hands batches of points to workers and their rows to the store."""

    def __init__(
        self,
        store: Store,
        pool: Pool,
        asked: Asked,
        progress: Progress | None,
        note: Note,
    ) -> None:
        self.plan, self.store, self.pool, self.note = store.plan, store, pool, note
        self.work = functools.partial(
            compute, asked=asked, threads=pool.threads, version=RESULTS_VERSION
        )
        self.progress = progress or (lambda *_: None)
        self.running: dict[Future[Any], list[int]] = {}
        self.suspects: deque[int] = (
            deque()
        )  # of having killed a worker; each of these goes alone
        self.losses: Counter[int] = Counter()
        self.deaths, self.done, self.seconds = 0, 0, 0.0
        self.recent: deque[float] = deque(maxlen=64)  # seconds a point took

    def run(self, pending: list[int]) -> float:
        """Compute all; the seconds that points took, summed."""
        queue, total, timed = self._probe(pending), len(pending), False
        while queue or self.running or self.suspects:
            if self.suspects and not self.running:
                self._submit([self.suspects.popleft()])
            elif timed and not self.suspects:
                self._fill(queue)
            self._collect()
            self.store.flush(older=_FLUSH_SECONDS)
            if not timed and not self.running:
                timed = True
                if self.recent and queue:
                    mean, slots = statistics.fmean(self.recent), self.pool.slots()
                    needed = duration(mean * len(queue) / slots)
                    self.note(
                        f"about {needed} to go: {duration(mean)} a point, {slots} workers"
                    )
            self.progress(self.done, total)
        return self.seconds

    def _probe(self, pending: list[int]) -> deque[int]:
        """Submit batches of two from all over the grid, of which the second is timed;
        the points that are left."""
        probes = min(self.pool.slots(), 8, -(-len(pending) // 4))
        chosen = pending[:: -(-len(pending) // (2 * probes))]
        for start in range(0, len(chosen), 2):
            self._submit(chosen[start : start + 2])
        return deque(index for index in pending if index not in chosen)

    def _fill(self, queue: deque[int]) -> None:
        """Two batches for every worker."""
        slots = self.pool.slots()
        while queue and len(self.running) < 2 * slots:
            longest = max(self.recent, default=math.inf)
            share = -(
                -len(queue) // (2 * slots)
            )  # the last batches of a sweep are small
            batch = max(
                1, min(int(_BATCH_SECONDS / max(longest, 1e-9)), _MOST_BATCH, share)
            )
            self._submit([queue.popleft() for _ in range(min(batch, len(queue)))])

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
            self.recent.extend(
                row["seconds"] for row in rows[1:] or rows
            )  # a first one may compile and tabulate
        if broken:
            self._died()

    def _finish(self, index: int, row: dict[str, Any]) -> None:
        self.store.add(index, row)
        self.done += 1
        self.seconds += row["seconds"]

    def _lost(self, batch: list[int], alone: bool) -> None:
        """Try again, each point on its own; one that is alone with every death is to
        blame."""
        for index in batch:
            self.losses[index] += alone
            if self.losses[index] >= _LOSSES:
                message = f"{_LOSSES} workers died at this point (not enough memory?)"
                self._finish(
                    index, {"status": "failed", "message": message, "seconds": 0.0}
                )
            else:
                self.suspects.append(index)

    def _died(self) -> None:
        self.deaths += 1
        if self.deaths > 4 * _LOSSES:
            raise InputError(
                "workers die as soon as they start; finished points are on disk"
            )
        self.pool.renew()
