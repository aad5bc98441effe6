"""Ctrl-C, and what batch systems and closed terminals send: one signal ends a command at once, wherever it falls.

Python raises KeyboardInterrupt wherever it happens to be, and drops it in callbacks of compilers and of C code. Here it
is raised again and again until it is heard.
"""

import atexit
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

WHOLE = "interrupted; nothing is half-written"
_SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
_AGAIN, _SOON = 2.0, 0.05  # seconds until an interrupt is raised again, and if it waits or Python dropped it
_stopped: list[int] = []  # the signals that were to end this process
_waiting: list[bool] = []  # not empty: they wait


def listen() -> None:
    """From now on a signal raises KeyboardInterrupt, until `heard`; signals that were ignored remain so."""
    sys.unraisablehook = _dropped
    _give(_stop)


@contextmanager
def undisturbed() -> Iterator[None]:
    """Signals that end a process wait until this is over, and in processes that are started meanwhile. They are blocked
    in this thread; Python answers in this thread also to those that reach another."""
    block: Any = getattr(signal, "pthread_sigmask", lambda *_: None)
    before = block(getattr(signal, "SIG_BLOCK", 0), {signal.SIGINT, signal.SIGTERM})
    _waiting.append(True)
    try:
        yield
    finally:
        block(getattr(signal, "SIG_SETMASK", 0), before)
        _waiting.pop()


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
    signal.setitimer(signal.ITIMER_REAL, _SOON if _waiting else _AGAIN)
    if not _waiting:
        raise KeyboardInterrupt


def _dropped(lost: Any) -> None:
    """Called by Python with an exception that nobody can catch."""
    if not _stopped:
        sys.__unraisablehook__(lost)
    elif issubclass(lost.exc_type, KeyboardInterrupt):
        signal.setitimer(signal.ITIMER_REAL, _SOON)
