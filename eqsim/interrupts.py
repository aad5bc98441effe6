"""Ctrl-C, and what batch systems and closed terminals send: one signal ends a command at once, wherever it falls.

Python raises KeyboardInterrupt wherever it happens to be, and drops it in callbacks of compilers and of C code. Here it
is raised again and again until it is heard.
"""

import atexit
import os
import signal
import sys
from contextlib import suppress
from typing import Any

_SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
_AGAIN, _SOON = 2.0, 0.05  # seconds until an interrupt is raised again, and if Python says that it was dropped
_stopped: list[int] = []  # the signals that were to end this process


def listen() -> None:
    """From now on a signal raises KeyboardInterrupt, until `heard`; signals that were ignored remain so."""
    sys.unraisablehook = _dropped
    _give(_stop)


def heard() -> int:
    """The exit code of a process that was interrupted; from now on signals are ignored."""
    _give(signal.SIG_IGN)
    return 128 + (_stopped or [signal.SIGINT])[0]


def unheard() -> bool:
    """Whether a signal came that nobody has `heard`."""
    return bool(_stopped) and signal.getsignal(signal.SIGALRM) is _stop


def leave(code: Any) -> None:
    """End a process that was interrupted or fails with exit code 2 without waiting for its threads, which may have long
    to go, or complain about a pool that was broken off."""
    _give(signal.SIG_IGN)
    if _stopped or code == 2:
        with suppress(OSError):
            sys.stdout.flush()
        atexit._run_exitfuncs()
        os._exit(128 + _stopped[0] if _stopped else 2)


def _give(handler: Any) -> None:
    if os.name == "posix":
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number in [number for number in _SIGNALS if signal.getsignal(number) != signal.SIG_IGN]:
            signal.signal(number, handler)
        signal.signal(signal.SIGALRM, handler)


def _stop(number: int, _: Any) -> None:
    if number != signal.SIGALRM:
        _stopped.append(number)
    signal.setitimer(signal.ITIMER_REAL, _AGAIN)
    raise KeyboardInterrupt


def _dropped(lost: Any) -> None:
    """Called by Python with an exception that nobody can catch."""
    if not _stopped:
        sys.__unraisablehook__(lost)
    elif issubclass(lost.exc_type, KeyboardInterrupt):
        signal.setitimer(signal.ITIMER_REAL, _SOON)
