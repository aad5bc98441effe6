"""Waiting for something to happen, but not for ever."""

import time

# Seconds from a signal to the end of a process. A second is promised, and a machine
# with nothing else to do takes less than half of one; this is ten times that, for one
# with ten busy processes for each of its processors.
ALLOWED = 5.0


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
