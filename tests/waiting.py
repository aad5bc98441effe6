"""Waiting for something to happen, but not for ever."""

import time


def once(happens, process=None, seconds=300):
    """What `happens` returns as soon as it is true; a `process` must not end by itself before."""
    deadline = time.monotonic() + seconds
    while not (found := happens()):
        assert process is None or process.poll() is None, process.communicate()
        if time.monotonic() > deadline:
            if process:
                process.kill()
            raise TimeoutError(f"still waiting after {seconds} s")
        time.sleep(0.02)
    return found
