"""Kernels of a run that another process compiles while this one compiles others: numba compiles one at a time. Where
that process has to solve something to compile it, it solves what the run will ask for."""

import os
import pickle
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
from numba.core import event

from eqsim.engine import langevin
from eqsim.engine.blocks import Totals
from eqsim.engine.contacts import contacts
from eqsim.engine.lanes import (
    Lanes,
    Lives,
    break_unstressed,
    draw_thresholds,
    draw_unstressed,
    empty_lanes,
    rough_stretch,
)
from eqsim.engine.recorder import (
    Columns,
    Extent,
    Recorder,
    Run,
    Scales,
    empty_columns,
    follow_path,
    join_uniform_ramps,
    leave_ramps,
    leave_uniform_ramps,
)
from eqsim.engine.simulate import Journey, fill_lanes, live, record_round
from eqsim.engine.stationary import Fresh, Stationary
from eqsim.engine.steady import steady
from eqsim.engine.trajectory import ConstantDrive
from eqsim.errors import InputError
from eqsim.laws.newborn import born_stretched
from eqsim.master.transient import transient
from eqsim.model.drive import Drive, Programme
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.compiled import compile_unless_taken
from eqsim.numerics.streams import TRAJECTORY, key
from eqsim.numerics.threads import interruptibly
from eqsim.workflows.second import Second, several_processors, take

_SCALES = Scales(np.ones(6), np.ones(6), 1.0, 1.0, True, False)  # of nothing


@contextmanager
def compiling_together(ensemble: Ensemble, drive: Drive | Programme, points: int) -> Iterator[Callable[[], Any]]:
    """For as long as the block takes, have a second process compile what its run needs besides, if this one finds
    anything to compile. The cache on disk is where they meet: whoever needs what the other compiles waits for it.
    Yields a function that returns the exact mean along a programme, once that process has it, None if it has not."""
    if not several_processors():
        yield lambda: None
        return
    process = take()
    try:
        with event.install_listener("numba:compile", _Compiling(process, pickle.dumps((ensemble, drive, points)))):
            with suppress(InputError):  # which the run itself shows
                for routine, arguments in _routines(ensemble, drive):
                    compile_unless_taken(routine, arguments)
                if isinstance(drive, Drive):
                    _simulator(ensemble, drive)
            yield process.found
    finally:
        process.end()


def _simulator(ensemble: Ensemble, drive: Drive) -> None:
    """The kernel of a constant drive, for contacts of which none is followed. Raises InputError."""
    c = contacts(ensemble, drive.velocity, ensemble.thresholds.mean if ensemble.self_consistent else None)
    run = Run(1.0, 2, drive.start == "stationary", False)
    job = ConstantDrive(c, _start_of(drive), run, _SCALES, key(0, TRAJECTORY), 0.0)
    interruptibly(job.simulate, job.totals(1), 0, 0)


def _start_of(drive: Drive) -> Fresh | Stationary:
    """A start of the type of the drive's."""
    return Stationary() if drive.start == "stationary" else Fresh()


def _routines(ensemble: Ensemble, drive: Drive | Programme) -> list[tuple[Any, tuple[Any, ...]]]:
    """What kernels of several kinds call, or a large part of one, and arguments of the types that they call it with.
    One is after those that it calls. Raises InputError."""
    every = [drive.velocity] if isinstance(drive, Drive) else [abs(segment.velocity) for segment in drive.segments]
    c = contacts(ensemble, max(every) or 1.0, ensemble.thresholds.mean if ensemble.self_consistent else None)
    total, stream, run = Totals(3, 2, 1), key(0, TRAJECTORY), Run(1.0, 2, False, False)
    sums = (total.scratch, total.batches, total.status)
    recorder = Recorder(run, _SCALES.deposits, _SCALES.batches, *sums, _SCALES.narrow)
    one, row, grid = np.zeros(1), np.zeros(1, np.int64), np.zeros((1, 1))
    columns, lives = Columns(row, row, np.zeros((1, 1), np.int64)), Lives(grid, grid, grid, grid, one)
    lanes = Lanes(row, row, row, np.zeros((1, 1), np.uint64))
    found: list[tuple[Any, tuple[Any, ...]]] = [
        (empty_lanes, ()),
        (empty_columns, ()),
        (join_uniform_ramps, (recorder, one, one, columns, 0)),
        (leave_uniform_ramps, (recorder, one, one, columns, 0)),
        (leave_ramps, (recorder, one, one, lives, 0, columns, 0)),
        (draw_thresholds, (c.thresholds, 0, lives.stretch, row, 0)),
    ]
    if not born_stretched(c.newborn):
        found.append((draw_unstressed, (c.thresholds, True, stream, lanes, lives, 0)))
    laws = langevin.Pinned(c.barrier, c.springs, c.aging, 1.0)
    if c.aging.fluctuates:
        path = langevin.Path(stream, 0, 0, 0, 1.0, 1.0, 1.0)
        found.append((follow_path, (laws, recorder, 0, path, 1.0)))
    if isinstance(drive, Drive):
        journey, start = Journey(one, one, one, one, one, row, one, one, grid), _start_of(drive)
        found.append((record_round, (c, recorder, lanes, lives, journey, columns, (0, 0, 0))))
        found.append((fill_lanes, (c, start, recorder, stream, lanes, journey, (0, 0, 0))))
        found.append((live, (c, recorder, stream, lanes, lives, journey, (0, 0))))
    if c.aging.fluctuates:
        found.append((langevin.lives, (laws, stream, 1.0, row, row, one, one)))
    elif not born_stretched(c.newborn):
        found.append((break_unstressed, (c.aging, c.barrier, c.barrier_table, c.springs, 0, lives, row, 0)))
    return found


class _Compiling(event.Listener):  # type: ignore[misc]
    """Gives the second process its work as soon as anything is compiled."""

    def __init__(self, process: Second, content: bytes) -> None:
        self.process, self.content = process, content

    def on_start(self, _: Any) -> None:
        self.process.send(self.content)

    def on_end(self, _: Any) -> None:
        pass


def _end_with_parent() -> None:
    """End this process when the pipe from the one that started it is closed."""
    os.read(sys.stdin.fileno(), 1)
    os._exit(1)


def main() -> None:
    """The second process: the exact mean along a programme, which takes long enough; else what several kernels call,
    from the other end on, and kernels of steady estimates."""
    ensemble, drive, points = pickle.load(sys.stdin.buffer)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with suppress(InputError):  # which the first one shows
        if isinstance(drive, Programme):
            pickle.dump(transient(ensemble, drive, points), sys.stdout.buffer)
            return
        for routine, arguments in reversed(_routines(ensemble, drive)):
            compile_unless_taken(routine, arguments)
        steady(ensemble, drive, rel_error=1.0)
        Extent.of(contacts(ensemble, drive.velocity, rough_stretch(ensemble, drive.velocity)))
