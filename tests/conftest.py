"""Kernels are compiled before workers start, in two processes side by side, and not by every worker anew."""

import subprocess
import sys
from pathlib import Path

from eqsim.numerics import compiled

SET_UP = "from eqsim import Aging, Drive, Ensemble, Thermal, steady, trajectory\n"
COMPILES = [
    SET_UP + "steady(Ensemble(), 1.0, plain=True); trajectory(Ensemble(count=1), Drive(1.0, 1.0, 'stationary'))",
    SET_UP + "contacts = Ensemble(aging=Aging('langevin', 0.1, 2.0), count=1); steady(contacts, 1.0, rel_error=1.0); "
    "trajectory(contacts, Drive(1.0, 1.0)); steady(contacts, 1.0, rel_error=1.0, plain=True)",
]


def pytest_sessionstart(session):
    if not getattr(session.config.option, "numprocesses", None) or compiled._CACHE is None:
        return
    done = Path(compiled._CACHE) / "for-tests"
    if not done.exists():
        running = [subprocess.Popen([sys.executable, "-c", code]) for code in COMPILES]
        if not any([process.wait() for process in running]):
            done.touch()
