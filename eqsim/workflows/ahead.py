"""Kernels of a run that another process compiles while this one compiles others: numba compiles one at a time. Where
that process has to solve something to compile it, it solves what the run will ask for."""

import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numba
import numpy as np
from numba.core import event

from eqsim.engine.blocks import Totals
from eqsim.engine.contacts import contacts
from eqsim.engine.lanes import Lives, rough_stretch
from eqsim.engine.recorder import (
    Extent,
    Recorder,
    Run,
    Scales,
    empty_columns,
    join_uniform_ramps,
    leave_ramps,
    leave_uniform_ramps,
)
from eqsim.engine.stationary import Fresh, Stationary
from eqsim.engine.steady import steady
from eqsim.engine.trajectory import ConstantDrive
from eqsim.errors import InputError
from eqsim.master.transient import transient
from eqsim.model.drive import Drive, Programme
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.streams import TRAJECTORY, key

_SCALES = Scales(np.ones(6), np.ones(6), 1.0, 1.0, True, False)  # of nothing
_COMMAND = "import gc; gc.disable(); from eqsim.workflows import ahead; ahead.main()"


@contextmanager
def compiling_together(ensemble: Ensemble, drive: Drive | Programme, points: int) -> Iterator[Callable[[], Any]]:
    """For as long as the block takes, have a second process compile what its run needs besides, if this one finds
    anything to compile. The cache on disk is where they meet: whoever needs what the other compiles waits for it.
    Yields a function that returns the exact mean along a programme, once that process has it, None if it has not."""
    if (len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()) == 1:
        yield lambda: None
        return
    helper = _Helper(pickle.dumps((ensemble, drive, points)))
    try:
        with event.install_listener("numba:compile", helper):
            if isinstance(drive, Drive):
                with suppress(InputError):  # which the run itself shows
                    _simulator(ensemble, drive)
            yield helper.found
    finally:
        helper.end()


def _simulator(ensemble: Ensemble, drive: Drive) -> None:
    """The kernel of a constant drive, for contacts of which none is followed. Raises InputError."""
    c = contacts(ensemble, drive.velocity, ensemble.thresholds.mean if ensemble.self_consistent else None)
    run = Run(1.0, 2, drive.start == "stationary", False)
    start = Stationary() if run.stationary else Fresh()
    job = ConstantDrive(c, start, run, _SCALES, key(0, TRAJECTORY), 0.0)
    job.simulate(job.totals(1), 0, 0)


def _recording() -> None:
    """The routines with which kernels of all laws record."""
    total, one, row = Totals(2, 1), np.zeros(1), np.zeros((1, 1))
    sums = (total.scratch, total.batches, total.status)
    recorder = Recorder(Run(1.0, 2, False, False), _SCALES.deposits, _SCALES.batches, *sums, _SCALES.narrow)
    columns, lives = empty_columns(), Lives(row, row, row, row)
    for routine, arguments in (
        (join_uniform_ramps, (recorder, one, one, columns, 0)),
        (leave_uniform_ramps, (recorder, one, one, columns, 0)),
        (leave_ramps, (recorder, one, one, lives, 0, columns, 0)),
    ):
        routine.compile(tuple(map(numba.typeof, arguments)))


class _Helper(event.Listener):  # type: ignore[misc]
    """Starts the process as soon as anything is compiled."""

    def __init__(self, content: bytes) -> None:
        self.content = content
        self.process: subprocess.Popen[bytes] | None = None

    def on_start(self, _: Any) -> None:
        if self.process is None and sys.executable:
            with suppress(OSError):  # no process to be had: this one compiles all
                self.process = subprocess.Popen(
                    [sys.executable, "-c", _COMMAND],
                    stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
                )  # fmt: skip
                assert self.process.stdin
                with self.process.stdin as pipe:
                    pipe.write(self.content)

    def on_end(self, _: Any) -> None:
        pass

    def found(self) -> Any:
        """What the process sends when it is done, or None."""
        with suppress(Exception):  # if it has found nothing, or was ended by somebody else
            return pickle.load(self.process.stdout) if self.process and self.process.stdout else None
        return None

    def end(self) -> None:
        """It is not needed any more."""
        if self.process is not None:
            self.process.kill()
            self.process.wait()


def main() -> None:
    """The second process: what kernels record with, and kernels of steady estimates, or of the exact mean along a
    programme."""
    ensemble, drive, points = pickle.loads(sys.stdin.buffer.read())
    with suppress(InputError):  # which the first one shows
        _recording()
        if isinstance(drive, Programme):
            pickle.dump(transient(ensemble, drive, points), sys.stdout.buffer)
        else:
            steady(ensemble, drive, rel_error=1.0)
            Extent.of(contacts(ensemble, drive.velocity, rough_stretch(ensemble, drive.velocity)))
