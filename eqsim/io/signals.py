"""Ctrl-C, and what batch systems and closed terminals send: one signal ends a command at once, wherever it arrives.

Python raises KeyboardInterrupt wherever it happens to be, and loses it in finalisers, in callbacks of C code and in
libraries that catch everything. Here it is raised again until it is acknowledged.
"""

import atexit
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

MESSAGE = "interrupted; nothing is half-written"
_SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
_RETRY, _SOON = 2.0, 0.05  # seconds until an interrupt is raised again, and if it was deferred or Python lost it
_received: list[int] = []  # the signals that were to end this process
_deferring: list[bool] = []  # not empty inside `deferred`


@contextmanager
def interruptible() -> Iterator[None]:
    """Inside, the signals that end a process raise KeyboardInterrupt, unless they were ignored before.

    Afterwards a process that was interrupted, or fails with exit code 2, exits without waiting for its threads, which
    may have long to go, and without complaints about a pool of workers that was broken off.
    """
    sys.unraisablehook = _lost
    _handle(_interrupt)
    code: Any = None
    try:
        yield
    except SystemExit as end:
        code = end.code
        raise
    finally:
        if _received and signal.getsignal(signal.SIGALRM) is _interrupt:  # and nobody has acknowledged it
            print(f"eqsim: {MESSAGE}", file=sys.stderr)
        _handle(signal.SIG_IGN)
        if _received or code == 2:
            with suppress(OSError):
                sys.stdout.flush()
            atexit._run_exitfuncs()
            os._exit(128 + _received[0] if _received else 2)


@contextmanager
def deferred() -> Iterator[None]:
    """Inside, interrupts wait; processes started inside inherit that signals are blocked.

    Blocking in this thread is not enough: Python answers here also to signals that reach another thread.
    """
    block: Any = getattr(signal, "pthread_sigmask", lambda *_: None)
    before = block(getattr(signal, "SIG_BLOCK", 0), {signal.SIGINT, signal.SIGTERM})
    _deferring.append(True)
    try:
        yield
    finally:
        block(getattr(signal, "SIG_SETMASK", 0), before)
        _deferring.pop()


def acknowledge() -> int:
    """Ignore all further signals; returns the exit code of a process that was interrupted."""
    _handle(signal.SIG_IGN)
    return 128 + (_received or [signal.SIGINT])[0]


def _handle(handler: Any) -> None:
    if os.name == "posix":
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number in [*(number for number in _SIGNALS if signal.getsignal(number) != signal.SIG_IGN), signal.SIGALRM]:
            signal.signal(number, handler)


def _interrupt(number: int, _: Any) -> None:
    if number != signal.SIGALRM:
        _received.append(number)
    signal.setitimer(signal.ITIMER_REAL, _SOON if _deferring else _RETRY)
    if not _deferring:
        raise KeyboardInterrupt


def _lost(unraisable: Any) -> None:
    """Called by Python with an exception that nobody can catch."""
    if not _received:
        sys.__unraisablehook__(unraisable)
    elif issubclass(unraisable.exc_type, KeyboardInterrupt):
        signal.setitimer(signal.ITIMER_REAL, _SOON)
