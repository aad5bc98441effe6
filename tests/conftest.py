"""Kernels are compiled before workers start on all tests, in processes side by side,
and not by every worker anew."""

import gc
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from kernels import LAWS, collect_garbage_rarely

from eqsim.numerics.kernel_folder import kernel_folder


def pytest_configure():
    collect_garbage_rarely()
    # shells have jobs in the background ignore it, and so would processes of tests
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Cases that take seconds, or compile a kernel that few others need, are of the
    verification suite; `slow_cases.txt` names them."""
    slow = set((Path(__file__).parent / "slow_cases.txt").read_text().splitlines())
    for item in items:
        if item.nodeid in slow:
            item.add_marker(pytest.mark.verification)
    collected = {item.nodeid for item in items}
    files = {name.split("::")[0] for name in collected}
    gone = {name for name in slow - collected if name.split("::")[0] in files}
    if gone and not any("::" in argument for argument in config.args):
        raise pytest.UsageError(f"slow_cases.txt: no such case: {min(gone)}")


@pytest.fixture
def not_by_events(monkeypatch):
    """Few contacts behind a spring are followed as many are: in steps, or break by
    break where only a rising force breaks them."""
    monkeypatch.setattr("eqsim.engine.events.MOST_CONTACTS", 0)


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
