"""A second process, which `workflows.ahead` gives work to: numba compiles one kernel at a time in each. It imports what
it needs for longer than it takes to start one, so where nothing has been compiled yet it is started before anything."""

import os
import pickle
import subprocess
import sys
from contextlib import suppress
from typing import Any

from eqsim.numerics import kernel_folder

_COMMAND = "import gc; gc.disable(); from eqsim.workflows import ahead; ahead.main()"


class Second:
    """The process, if one can be had."""

    def __init__(self) -> None:
        self.process: subprocess.Popen[bytes] | None = None
        self.sent = False

    def start(self) -> None:
        """Start it, unless it has been."""
        if self.process is None and sys.executable:
            with suppress(OSError):
                self.process = subprocess.Popen(
                    [sys.executable, "-c", _COMMAND],
                    stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
                )  # fmt: skip

    def send(self, content: bytes) -> None:
        """Give it the pickled work, unless it has some; the pipe stays open for as long as this process lives."""
        self.start()
        if self.process and self.process.stdin and not self.sent:
            self.sent = True
            with suppress(OSError):  # if it was ended by somebody else
                self.process.stdin.write(content)
                self.process.stdin.flush()

    def found(self) -> Any:
        """What it sends when it is done; None if it was given nothing."""
        process = self.process
        if process and process.stdout and self.sent:
            with suppress(Exception):  # if it has found nothing, or was ended by somebody else
                return pickle.load(process.stdout)
        return None

    def end(self) -> None:
        """It is not needed any more."""
        if self.process is not None:
            self.process.kill()
            with suppress(OSError):
                self.process.communicate()


_started: list[Second] = []


def several_processors() -> bool:
    """Whether a second process can run beside this one."""
    return (len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()) != 1


def start_early() -> None:
    """Start a process if nothing has been compiled yet; it ends with this one if nobody takes it."""
    if several_processors() and kernel_folder.is_empty():
        _started.append(Second())
        _started[-1].start()


def take() -> Second:
    """The process that was started early, or a new one."""
    return _started.pop() if _started else Second()
