"""Coupled blocks at T = 0, and rival B, a plain heap in numba for a single block."""

import heapq
import math
from typing import Any

import numba
import numpy as np

from analysis.benchmarks.cases import Sizes
from analysis.benchmarks.driven import per_life
from analysis.benchmarks.jobs import Outcome, interleaved, ratios, speed
from eqsim import Drive, Elastic, Ensemble, elastic_trajectory

STIFFNESS = 0.25  # K_d/(n k)
# name, blocks of 1e6 contacts, and coupling
LATTICES: list[tuple[str, int | tuple[int, int], float]] = [
    ("one block", 1, 0.0),
    ("chain, lambda = 1.3", 10_000, 2.0),
    ("chain, lambda = 4.0", 10_000, 20.0),
    ("chain, lambda = 13", 10_000, 200.0),
    ("sheet, lambda = 0.48", (100, 100), 0.2),
]


@numba.njit
def plain_heap(
    contacts: int, distance: float, seed: int
) -> tuple[float, int]:  # pragma: no cover  # compiled
    """Breaks per avalanche, and breaks, of a slider at the end of a spring, by a single
    heap of all contacts."""
    np.random.seed(seed)  # noqa: NPY002  # the generator that numba has
    heap = [
        (math.sqrt(-math.log(np.random.random() * np.random.random())), i)  # noqa: NPY002
        for i in range(contacts)
    ]
    heapq.heapify(heap)
    xi = np.array([at for at, _ in heap])
    for at, i in heap:
        xi[i] = at
    births, D, breaks, avalanches = 0.0, 0.0, 0, 0
    while True:
        at, i = heap[0]
        needed = at + (at - births / contacts) / STIFFNESS
        if needed > D:
            if needed > distance:
                return breaks / max(avalanches, 1), breaks
            D = needed
            avalanches += 1
        births += xi[i]
        breaks += 1
        xi[i] = math.sqrt(-math.log(np.random.random() * np.random.random()))  # noqa: NPY002
        heapq.heapreplace(heap, (at + xi[i], i))


def time_elastic(sizes: Sizes, threads: int, seed: int) -> list[dict[str, Any]]:
    """Ten times as many contacts as elsewhere, 100 to a block of a chain or a sheet;
    times are compared per break, one thread each, and two replicas on threads."""
    contacts, distance, rows = 10 * sizes.contacts, 0.03 * sizes.distance, []
    for name, blocks, coupling in LATTICES:
        side = max(1, math.isqrt(contacts // 100))
        shape = (
            (side, side)
            if isinstance(blocks, tuple)
            else max(1, blocks * contacts // 10**6)
        )
        elastic = Elastic(shape, coupling, STIFFNESS)
        count = contacts // elastic.count * elastic.count
        ensemble, drive = (
            Ensemble(count=count, stiffness_law="uniform"),
            Drive(1.0, distance, elastic=elastic),
        )

        def run(
            seed: int,
            threads: int = 1,
            ensemble: Ensemble = ensemble,
            drive: Drive = drive,
            count: int = count,
        ) -> Outcome:
            found = elastic_trajectory(
                ensemble, drive, points=2, seed=seed, replicas=threads, threads=threads
            )
            return Outcome(0.0, 0.0, found.lives - threads * count)

        def plain(seed: int, count: int = count) -> Outcome:
            return Outcome(0.0, 0.0, plain_heap(count, distance, seed)[1])

        run(seed)
        plain_heap(10, 1.0, seed)  # compiles
        contenders = {
            "eqsim": run,
            "eqsim, threads": lambda seed, run=run: run(seed, threads),
            "B": plain,
        }
        rounds = interleaved(contenders, sizes.plain_repeats, seed)
        cost = per_life(rounds)
        gain = ratios("threads", cost, "eqsim, threads", "eqsim") | ratios(
            "B", cost, "B", "eqsim"
        )
        rows.append(
            {"job": "avalanches, per break", "case": name}
            | speed(rounds, "eqsim", "")
            | gain
        )
    return rows
