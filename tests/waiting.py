"""Waiting for something to happen, but not for ever."""

import time

import psutil

# Seconds from a signal to the end of a process. A second is promised, and a machine
# with nothing else to do takes less than half of one; this is ten times that, for one
# with ten busy processes for each of its processors.
ALLOWED = 5.0


def has_worked(process, seconds, in_kernel=True):
    """True if a thread of a process has worked for so long: one other than the first,
    where kernels run, or else the first."""
    return any(
        one.user_time > seconds and (one.id != process.pid) == in_kernel
        for one in psutil.Process(process.pid).threads()
    )


def once(happens, process=None, seconds=300):
    """What `happens` returns as soon as it is true; a `process` must not end by itself
    before."""
    deadline = time.monotonic() + seconds
    while not (found := happens()):
        assert process is None or process.poll() is None, process.communicate()
        if time.monotonic() > deadline:
            if process:
                process.kill()
            raise TimeoutError(f"still waiting after {seconds} s")
        time.sleep(0.02)
    return found
