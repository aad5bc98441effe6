"""Kernels are compiled before workers start on all tests, in processes side by side,
and not by every worker anew."""

import gc
import subprocess
import sys
from pathlib import Path

from kernels import LAWS, collect_garbage_rarely

from eqsim.numerics.kernel_folder import kernel_folder


def pytest_configure():
    collect_garbage_rarely()


def pytest_collection_finish():
    gc.freeze()  # tests and modules stay until the end


def pytest_sessionstart(session):
    workers = getattr(session.config.option, "numprocesses", None)
    folder = kernel_folder()
    if (
        not workers
        or folder is None
        or not all(Path(arg).is_dir() for arg in session.config.args)
    ):
        return
    done = Path(folder, "for-tests")
    if not done.exists():
        count = min(workers, 4)  # of processes, each of which takes some seconds more
        command, root = (
            [sys.executable, "-m", "tests.kernels"],
            Path(__file__).parent.parent,
        )
        running = [
            subprocess.Popen([*command, *LAWS[i::count]], cwd=root)
            for i in range(count)
        ]
        if not any([process.wait() for process in running]):
            done.touch()
