"""Limits of a run: `python -m analysis.limits` prints peak memory and time per
life, each case in a process of its own, for more and more contacts, points and lives of
a contact."""

import os
import resource
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import NamedTuple

from eqsim import Drive, Ensemble, Thermal, trajectory

CASES = [
    (10**4, 0.5, 101), (10**6, 0.5, 101), (10**8, 0.5, 101),
    (10**4, 10.0, 10**3), (10**4, 10.0, 10**5), (10**4, 10.0, 10**7),
    (256, 1e3, 101), (256, 1e4, 101), (256, 1e5, 101),
]  # fmt: skip


class Measured(NamedTuple):
    """Lives of a run, nanoseconds per life and thread, peak memory of its process in
    MB."""

    lives: int
    ns_per_life: float
    megabytes: float


def run(contacts: int, distance: float, points: int) -> Measured:
    """Warm soft contacts (kT = 0.1 k x_*^2, v = 0.01 omega x_*) over `distance` x_*."""
    ensemble = Ensemble(thermal=Thermal(kT=0.1), count=contacts)
    result = trajectory(
        ensemble,
        Drive(0.01, distance),
        points=points,
        threads=os.cpu_count() or 1,
        max_lives=1e12,
    )
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (
        1 if sys.platform == "darwin" else 1024
    )
    return Measured(
        result.lives,
        1e9 * result.engine_seconds * result.threads / result.lives,
        peak / 1e6,
    )


def measure(contacts: int, distance: float, points: int) -> Measured:
    """`run` in a process of its own, whose memory is that of this run."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        return pool.submit(run, contacts, distance, points).result()


if __name__ == "__main__":
    print(
        f"{'contacts':>12}{'distance/x_*':>14}{'points':>12}{'lives':>12}"
        f"{'ns/life':>12}{'peak MB':>10}"
    )
    for case in CASES:
        lives, ns, megabytes = measure(*case)
        print(
            f"{case[0]:12,}{case[1]:14g}{case[2]:12,}{lives:12.3g}"
            f"{ns:12.4g}{megabytes:10.0f}",
            flush=True,
        )
