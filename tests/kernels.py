"""Routines that only kernels call, as functions that tests can call: compiled, as in a
kernel.

    python -m tests.kernels BARRIER-AGING ...

compiles the kernels of such contacts into the cache; `LAWS` are those that many of the
default tests have. What few of them need is compiled when they run.
"""

import functools
import gc
import sys
from dataclasses import replace

import numba

from eqsim import (
    Aging,
    Drive,
    Ensemble,
    Programme,
    Segment,
    Stage,
    Thermal,
    steady,
    trajectory,
    transient,
)

# those that take longest come first
LAWS = [
    *("soft-langevin", "soft-flow", "soft-none"),
    *("mechanical-none", "annealed-none", "stiff-none"),
]


@functools.cache
def compiled(routine):
    def call(*arguments):
        return routine(*arguments)

    call.__name__ = routine.__name__  # pytest names cases after it
    return numba.njit(call, error_model="numpy")


def collect_garbage_rarely():
    """Look for cycles of objects less often than Python does by default: while kernels
    are compiled, that takes a tenth of the time."""
    gc.set_threshold(100_000, 20, 10)


def compile_kernels(barrier, aging):
    """By a steady estimate and a trajectory of next to nothing."""
    contacts = Ensemble(
        thermal=Thermal(
            0.0 if barrier == "mechanical" else 1.0,
            barrier="stiff" if barrier == "stiff" else "soft",
        ),
        aging=Aging() if aging == "none" else Aging(aging, 0.1, 2.0),
        count=64,  # as most tests have, at least: fewer are recorded one by one, by another kernel
        disorder="annealed" if barrier == "annealed" else "quenched",
    )
    steady(contacts, Drive(1.0), rel_error=1.0)
    trajectory(contacts, Drive(1.0, 1.0), points=2)
    if barrier not in ("mechanical", "soft"):
        return
    start = "stationary" if aging == "none" else "fresh"
    trajectory(contacts, Drive(1.0, 1.0, start), points=2)
    if aging != "flow":
        programme = Programme([Segment(1.0, distance=1.0)], start, 1.0)
        trajectory(contacts, programme, points=2)
        if aging == "none":
            transient(contacts, programme, 2)
            pulled = Programme(
                [Segment(1.0, distance=1.0)], stage=Stage(1.0, damping=1.0)
            )
            trajectory(contacts, pulled, points=2)
            if barrier == "mechanical":
                transient(contacts, pulled, 2)
                trajectory(contacts, replace(pulled, stage=Stage(1.0)), points=2)


if __name__ == "__main__":
    collect_garbage_rarely()
    for laws in sys.argv[1:]:
        compile_kernels(*laws.split("-"))
