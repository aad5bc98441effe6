"""Kernels of a run that another process compiles while this one compiles others: numba compiles one at a time."""

import os
import pickle
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from numba.core import event

from eqsim.engine.contacts import contacts
from eqsim.engine.lanes import rough_stretch
from eqsim.engine.recorder import Extent, Run, Scales
from eqsim.engine.stationary import FRESH
from eqsim.engine.steady import steady
from eqsim.engine.trajectory import ConstantDrive
from eqsim.errors import InputError
from eqsim.master.transient import transient
from eqsim.model.drive import Drive, Programme
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.streams import TRAJECTORY, key

_COMMAND = "from eqsim.workflows import ahead; ahead.main()"


@contextmanager
def compiling_together(ensemble: Ensemble, drive: Drive | Programme) -> Iterator[None]:
    """For as long as the block takes, have a second process compile what its run needs besides, if this one finds
    anything to compile. The cache on disk is where they meet: whoever needs what the other compiles waits for it."""
    if (len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()) == 1:
        yield
        return
    helper = _Helper(pickle.dumps((ensemble, drive)))
    try:
        with event.install_listener("numba:compile", helper):
            if isinstance(drive, Drive):
                with suppress(InputError):  # which the run itself shows
                    _simulator(ensemble, drive)
            yield
    finally:
        helper.end()


def _simulator(ensemble: Ensemble, drive: Drive) -> None:
    """The kernel of a constant drive, for contacts of which none is followed. Raises InputError."""
    c = contacts(ensemble, drive.velocity, ensemble.thresholds.mean if ensemble.self_consistent else None)
    run = Run(1.0, 2, drive.start == "stationary", False)
    scales = Scales.within(Extent(1.0, 1.0, 0.0, 1.0, 1.0, True), run, 1, 1, 0.0)
    job = ConstantDrive(c, FRESH, run, scales, key(0, TRAJECTORY), 0.0)
    job.simulate(job.totals(1), 0, 0)


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
                    stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                )  # fmt: skip
                assert self.process.stdin
                with self.process.stdin as pipe:
                    pipe.write(self.content)

    def on_end(self, _: Any) -> None:
        pass

    def end(self) -> None:
        """It is not needed any more."""
        if self.process is not None:
            self.process.kill()
            self.process.wait()


def main() -> None:
    """The second process: kernels of steady estimates, or of the exact mean along a programme."""
    ensemble, drive = pickle.loads(sys.stdin.buffer.read())
    with suppress(InputError):  # which the first one shows
        if isinstance(drive, Programme):
            transient(ensemble, drive, 2)
        else:
            steady(ensemble, drive, rel_error=1.0)
            Extent.of(contacts(ensemble, drive.velocity, rough_stretch(ensemble, drive.velocity)))
