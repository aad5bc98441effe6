"""Simulate blocks of contacts in threads or in the workers of an executor, and add up
their integer sums."""

import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, wait
from contextlib import nullcontext
from operator import itemgetter
from typing import Any, NamedTuple, Protocol

import numpy as np

from eqsim.engine.recorder import BATCHES, DEPOSIT, WINDOW, Moments
from eqsim.errors import InputError
from eqsim.model.drive import MOST_SERIES
from eqsim.numerics.tables import Array
from eqsim.numerics.threads import ThreadPool, interruptibly

Progress = Callable[[int], None]
Threads = int | tuple[Executor, int]
_LEAST_BLOCK = 128  # contacts, at least, unless there are fewer
# shares of blocks for each worker of an executor: few, so that tables and sums are
# seldom sent, but several, so that workers end together
_SHARES_PER_WORKER = 4
_MOST_RECORDS = 20_000_000  # of all blocks and replicas: some 1 GB of memory


class Totals:
    """Integer sums of one thread or share of the contacts, in `rows` for `points`
    instants; those of several add up. Forces of replicas at these instants are added,
    too, and stored one by one if they are `kept`."""

    names = ("deposits", "windows", "counts", "replica_sum", "replica_square")

    def __init__(self, rows: int, points: int, replicas: int) -> None:
        self.deposits = np.zeros(rows, DEPOSIT)
        # sums of the ensemble at hand
        self.scratch = np.zeros(rows, DEPOSIT) if replicas > 1 else self.deposits
        self.windows = np.zeros((BATCHES, 2), WINDOW)
        self.counts = np.zeros(2, np.int64)
        self.lives = self.counts[:1]
        self.stop = self.counts[1:]  # anything but 0 stops the kernel
        self.replica_sum = np.zeros(points if replicas > 1 else 0, np.int64)
        self.replica_square = np.zeros_like(self.replica_sum)
        self.kept = replicas * self.replica_sum.size <= MOST_SERIES
        self.forces: list[tuple[int, Array]] = []  # with their replica
        # machine code of the kernel that follows contacts, by what the job calls it
        self.code: dict[int, Callable[..., Any]] = {}

    def close_replica(self, job: "Job", contacts: int, replica: int) -> None:
        """Add the force of the ensemble just simulated, number `replica`, and clear the
        sums for the next one."""
        if self.scratch is self.deposits:
            return
        scale, square = job.replica_scales
        force = job.force(self.scratch, contacts)
        self.replica_sum += np.rint(force * scale).astype(np.int64)
        self.replica_square += np.rint(force**2 * square).astype(np.int64)
        if self.kept:
            self.forces.append((replica, force))
        _integers(self.deposits)[...] += _integers(self.scratch)
        _integers(self.scratch)[...] = 0

    def replica_std(self, job: "Job", replicas: int) -> Array:
        """Standard deviation of the force between several replicas."""
        scale, square = job.replica_scales
        mean_square = (self.replica_sum / scale) ** 2 / replicas
        spread = self.replica_square / square - mean_square
        return np.asarray(np.sqrt(np.maximum(spread, 0.0) / (replicas - 1)))

    def add(self, other: "Totals") -> None:
        self.forces += other.forces
        for name in self.names:
            _integers(getattr(self, name))[...] += _integers(getattr(other, name))

    def __getstate__(self) -> dict[str, Any]:
        """Sums and forces, which are all that comes back from a worker."""
        return {name: getattr(self, name) for name in (*self.names, "forces")}


def _integers(sums: Array) -> Array:
    """The numbers of an array of integers, with names or without."""
    return sums.view(np.int64)


class Job(Protocol):
    """Interface of a run that is simulated in blocks of contacts."""

    @property
    def replica_scales(self) -> tuple[float, float]:
        """Powers of 2 that turn a replica's force, and its square, into integers."""

    def totals(self, replicas: int) -> Totals:
        """Empty sums."""

    def simulate(self, total: Totals, first: int, last: int) -> None:
        """Follow contacts first <= i < last and add up what they leave in its sums."""

    def moments(self, deposits: Array, contacts: int) -> Moments:
        """Mean force, pinned fraction and variance of the force at every instant."""

    def force(self, deposits: Array, contacts: int) -> Array:
        """The mean force of `moments` alone."""


class _Division(NamedTuple):
    """Division of contacts: block i holds those from edges[i] up to edges[i + 1], whole
    ensembles of `contacts` if there are replicas."""

    edges: Sequence[int]
    contacts: int
    replicas: int

    @classmethod
    def of(cls, contacts: int, replicas: int, workers: int, alike: bool) -> "_Division":
        """Make equal blocks, a few for each worker (`alike`), or ever smaller ones, so
        that threads that take them in turn end together."""
        count = contacts * replicas
        if replicas > 1:
            return cls(range(0, count + 1, contacts), contacts, replicas)
        if alike:
            shares = min(_SHARES_PER_WORKER * workers, -(-count // _LEAST_BLOCK))
            return cls([count * i // shares for i in range(shares + 1)], contacts, 1)
        edges, least = [0], min(_LEAST_BLOCK, -(-count // workers))
        while edges[-1] < count:
            rest = count - edges[-1]
            size = max(least, -(-rest // (2 * workers - 1)))
            edges.append(edges[-1] + min(rest, size))
        return cls(edges, contacts, 1)


def _follow_blocks(
    job: Job, blocks: _Division, numbers: Iterable[int], total: Totals | None = None
) -> Totals:
    """Simulate the blocks of these `numbers`, in a thread or a worker of an
    executor."""
    if total is None:
        total = job.totals(blocks.replicas)
    for i in numbers:
        if total.stop[0]:
            break
        job.simulate(total, blocks.edges[i], blocks.edges[i + 1])
        total.close_replica(job, blocks.contacts, i)
    return total


def require_lives(expected: float, max_lives: float) -> None:
    """Raise InputError if a run is expected to take more than `max_lives` lives."""
    if not expected <= max_lives:
        raise InputError(
            f"this run needs about {expected:.3g} lives, more than max_lives = "
            f"{max_lives:.3g}"
        )


def require_records(points: int, blocks: int) -> None:
    """Raise InputError if `points` records of so many blocks of all replicas take too
    much memory."""
    if points * blocks > _MOST_RECORDS:
        raise InputError(
            f"output.points = {points}: records of all blocks and replicas must be <= "
            f"{_MOST_RECORDS:.0e} in number"
        )


def workers_of(threads: Threads) -> int:
    """Number of threads, or of workers of an executor."""
    return threads[1] if isinstance(threads, tuple) else max(1, threads)


class Simulated(NamedTuple):
    """Sums over all contacts of a job, and when they were begun."""

    job: Job
    total: Totals
    moments: Moments
    replicas: int
    threads: int
    begin: float

    @property
    def lives(self) -> int:
        """Lives of contacts that were simulated."""
        return int(self.total.lives[0])

    def columns(self, unit: float) -> dict[str, Any]:
        """Fields of a `records.Record` that follow from these sums, for a `unit` of
        length; the force of every replica only if it was kept."""
        std = forces = None
        if self.replicas > 1:
            std = self.total.replica_std(self.job, self.replicas) * unit
        if self.total.forces:
            ordered = sorted(self.total.forces, key=itemgetter(0))
            forces = np.array([force for _, force in ordered]) * unit
        return {
            "force_replica_std": std,
            "force_replicas": forces,
            "force": self.moments.force * unit,
            "pinned": self.moments.pinned,
            "lives": self.lives,
            "engine_seconds": time.perf_counter() - self.begin,
            "threads": self.threads,
        }


def simulated(
    job: Job, count: int, replicas: int, threads: Threads, progress: Progress | None
) -> Simulated:
    """Follow all contacts of `replicas` ensembles of `count`."""
    interruptibly(job.simulate, job.totals(1), 0, 0)  # compiles, before time counts
    begin, workers = time.perf_counter(), workers_of(threads)
    total = simulate_all(job, count, replicas, threads, progress)
    moments = job.moments(total.deposits, count * replicas)
    return Simulated(job, total, moments, replicas, workers, begin)


def simulate_all(
    job: Job, count: int, replicas: int, threads: Threads, progress: Progress | None
) -> Totals:
    """Hand blocks of contacts (whole ensembles if there are replicas) to threads as
    they become free, or a few shares of them for each worker to an executor."""
    executor = threads[0] if isinstance(threads, tuple) else None
    threads = workers_of(threads)
    blocks = _Division.of(count, replicas, threads, executor is not None)
    every = range(len(blocks.edges) - 1)
    totals = [job.totals(replicas) for _ in range(1 if executor else threads)]
    running: set[Future[Totals]] = set()
    pool = None if executor else ThreadPool(threads)
    with pool or nullcontext():
        try:
            if pool:
                shared = iter(every)  # next() is atomic
                for total in totals:
                    running.add(pool.submit(_follow_blocks, job, blocks, shared, total))
            elif executor:
                shares = min(_SHARES_PER_WORKER * threads, len(every))
                for i in range(shares):
                    running.add(
                        executor.submit(_follow_blocks, job, blocks, every[i::shares])
                    )
            while running:
                done, running = wait(running, timeout=0.1, return_when=FIRST_COMPLETED)
                if pool and pool.stop[0]:
                    raise CancelledError
                for future in done:
                    part = future.result()
                    if executor:
                        totals[0].add(part)
                if progress:
                    progress(int(sum(total.lives[0] for total in totals)))
        except BaseException:
            for total in totals:
                total.stop[0] = 1
            for future in running:
                future.cancel()
            raise
    for other in totals[1:]:
        totals[0].add(other)
    return totals[0]
