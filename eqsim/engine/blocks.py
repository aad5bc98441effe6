"""Blocks of contacts, handed to threads or to the workers of an executor: integer sums
that simply add up."""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, wait
from contextlib import nullcontext
from typing import NamedTuple, Protocol

import numpy as np

from eqsim.engine.recorder import BATCHES, DEPOSIT, WINDOW, Moments
from eqsim.model.drive import MOST_SERIES
from eqsim.numerics.tables import Array
from eqsim.numerics.threads import ThreadPool

Progress = Callable[[int], None]
Threads = int | tuple[Executor, int]
_BLOCK = 128  # contacts, at least, unless there are fewer
_SHARES = 4  # for each worker of an executor: few enough that tables and sums travel seldom, and workers end together


class Totals:
    """Integer sums of one thread or share of the contacts, in `rows` for `points`
    instants; those of several simply add up. Of replicas the forces at these instants
    are noted, and one by one if they are `kept`."""

    names = ("deposits", "windows", "counts", "replica_sum", "replica_square")

    def __init__(self, rows: int, points: int, replicas: int) -> None:
        self.deposits = np.zeros(rows, DEPOSIT)
        self.scratch = (
            np.zeros(rows, DEPOSIT) if replicas > 1 else self.deposits
        )  # of the ensemble at hand
        self.windows = np.zeros((BATCHES, 2), WINDOW)
        self.counts = np.zeros(2, np.int64)
        self.lives = self.counts[:1]
        self.stop = self.counts[1:]  # anything but 0 stops the kernel
        self.replica_sum = np.zeros(points if replicas > 1 else 0, np.int64)
        self.replica_square = np.zeros_like(self.replica_sum)
        self.kept = replicas * self.replica_sum.size <= MOST_SERIES
        self.forces: list[tuple[int, Array]] = []  # with their replica

    def close_replica(self, job: "Job", contacts: int, replica: int) -> None:
        """Note the force of the ensemble just simulated, the `replica`, and clear the
        sums for the next one."""
        if self.scratch is self.deposits:
            return
        force, (scale, square) = (
            job.moments(self.scratch, contacts).force,
            job.replica_scales,
        )
        self.replica_sum += np.rint(force * scale).astype(np.int64)
        self.replica_square += np.rint(force**2 * square).astype(np.int64)
        if self.kept:
            self.forces.append((replica, force))
        _integers(self.deposits)[...] += _integers(self.scratch)
        _integers(self.scratch)[...] = 0

    def replica_std(self, job: "Job", replicas: int) -> Array | None:
        """Standard deviation of the force between replicas; None if there is one."""
        if replicas == 1:
            return None
        scale, square = job.replica_scales
        spread = (
            self.replica_square / square - (self.replica_sum / scale) ** 2 / replicas
        )
        return np.asarray(np.sqrt(np.maximum(spread, 0.0) / (replicas - 1)))

    def replica_forces(self) -> Array | None:
        """The force of every replica, shape (replicas, points); None if there is one,
        or if they were not kept."""
        return (
            np.array(
                [force for _, force in sorted(self.forces, key=lambda one: one[0])]
            )
            if self.forces
            else None
        )

    def add(self, other: "Totals") -> None:
        self.forces += getattr(other, "forces", [])  # those of workers stay there
        for name in self.names:
            _integers(getattr(self, name))[...] += _integers(getattr(other, name))

    def __getstate__(self) -> dict[str, Array]:
        """Sums, which are all that comes back from a worker."""
        return {name: getattr(self, name) for name in self.names}


def _integers(sums: Array) -> Array:
    """The numbers of an array of integers, with names or without."""
    return sums.view(np.int64)


class Job(Protocol):
    """A run, as those see it who follow a block of its contacts."""

    @property
    def replica_scales(self) -> tuple[float, float]:
        """Powers of 2 that turn the force of a replica, and its square, into integers."""

    def totals(self, replicas: int) -> Totals:
        """Sums of nothing yet."""

    def simulate(self, total: Totals, first: int, last: int) -> None:
        """Follow contacts first <= i < last and add up what they leave in its sums."""

    def moments(self, deposits: Array, contacts: int) -> Moments:
        """Mean force, pinned fraction and variance of the force at every instant."""


class _Blocks(NamedTuple):
    """How contacts are divided: block i is those from edges[i] up to edges[i + 1],
    whole ensembles of `contacts` if there are replicas."""

    edges: Sequence[int]
    contacts: int
    replicas: int

    @classmethod
    def of(cls, contacts: int, replicas: int, workers: int, alike: bool) -> "_Blocks":
        """`alike`, a few for each worker, or ever smaller ones, so that those who take
        them in turn end together."""
        count = contacts * replicas
        if replicas > 1:
            return cls(range(0, count + 1, contacts), contacts, replicas)
        if alike:
            shares = min(_SHARES * workers, -(-count // _BLOCK))
            return cls([count * i // shares for i in range(shares + 1)], contacts, 1)
        edges, least = [0], min(_BLOCK, -(-count // workers))
        while edges[-1] < count:
            rest = count - edges[-1]
            edges.append(
                edges[-1] + min(rest, max(least, -(-rest // (2 * workers - 1))))
            )
        return cls(edges, contacts, 1)


def _follow(
    job: Job, blocks: _Blocks, which: Iterable[int], total: Totals | None = None
) -> Totals:
    """Simulate some blocks, in a thread or in a worker of an executor."""
    if total is None:  # a worker sends back sums only
        total = job.totals(blocks.replicas)
        total.kept = False
    for i in which:
        if total.stop[0]:
            break
        job.simulate(total, blocks.edges[i], blocks.edges[i + 1])
        total.close_replica(job, blocks.contacts, i)
    return total


def workers_of(threads: Threads) -> int:
    """How many there are."""
    return threads[1] if isinstance(threads, tuple) else max(1, threads)


def simulate_all(
    job: Job, count: int, replicas: int, threads: Threads, progress: Progress | None
) -> Totals:
    """Hand blocks of contacts (whole ensembles if there are replicas) to threads as
    they become free, or a few shares of them for each worker to an executor."""
    executor, threads = (
        threads if isinstance(threads, tuple) else (None, max(1, threads))
    )
    blocks = _Blocks.of(count, replicas, threads, executor is not None)
    every = range(len(blocks.edges) - 1)
    totals = [job.totals(replicas) for _ in range(1 if executor else threads)]
    running: set[Future[Totals]] = set()
    pool = None if executor else ThreadPool(threads)
    with pool or nullcontext():
        try:
            if pool:
                shared = iter(every)  # next() is atomic
                running = {
                    pool.submit(_follow, job, blocks, shared, total) for total in totals
                }
            elif executor:
                shares = min(_SHARES * threads, len(every))
                running = {
                    executor.submit(_follow, job, blocks, every[i::shares])
                    for i in range(shares)
                }
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
