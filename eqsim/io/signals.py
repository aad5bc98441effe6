"""Interrupts: Ctrl-C, a batch system or a closed terminal ends a command in a second.

The first signal raises KeyboardInterrupt. Python does so between two instructions of
its main thread only, which may be in a compiler for much longer, and libraries may lose
the exception in a finaliser, or where they catch everything. A thread therefore waits
for signals, too, and ends a process that does not acknowledge one in time.
"""

import atexit
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, NoReturn

MESSAGE = "interrupted; nothing is half-written"
_SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")
_ANSWER = 0.6  # seconds to acknowledge a signal; ending takes another 0.1 s
_LEAVE = 5.0  # seconds after that to write finished results
_SHOW_CURSOR = b"\x1b[?25h"  # progress bars hide it

_first_signal = 0  # its number; 0 before one has come
_acknowledged = threading.Event()
_deferring: list[None] = []  # an item for each `deferred` block
_undo: list[Callable[[], None]] = []  # functions to call, of the active `undone` blocks


@contextmanager
def interruptible() -> Iterator[None]:
    """Let the first signal raise KeyboardInterrupt, and later ones do nothing.

    The process ends with 128 + the number of the signal, whatever becomes of the
    exception. A signal that was ignored before stays so. Enter this before other
    modules are imported, so that what they do at exit is done first.
    """
    if os.name == "posix":
        sys.unraisablehook = _unraisable
        atexit.register(_leave)
        arrived, wake = os.pipe()
        os.set_blocking(wake, False)
        _handle(_on_signal)
        signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
        threading.Thread(target=_watch, args=(arrived,), daemon=True).start()
    try:
        yield
    except BaseException:
        if not _first_signal or _acknowledged.is_set():
            raise
    finally:
        _handle(signal.SIG_IGN)
    if _first_signal and not _acknowledged.is_set():
        print(f"eqsim: {MESSAGE}", file=sys.stderr)
        sys.exit(acknowledge())


@contextmanager
def deferred() -> Iterator[None]:
    """Let interrupts wait for the end of the block; processes started in it inherit
    that signals are blocked.

    Blocking in this thread is not enough: Python handles signals here that reach any
    other thread.
    """
    block: Any = getattr(signal, "pthread_sigmask", lambda *_: None)
    mask = block(getattr(signal, "SIG_BLOCK", 0), {signal.SIGINT, signal.SIGTERM})
    before = _first_signal
    _deferring.append(None)
    try:
        yield
    finally:
        block(getattr(signal, "SIG_SETMASK", 0), mask)
        _deferring.pop()
        if _first_signal != before and not _deferring:
            raise KeyboardInterrupt


@contextmanager
def undone(undo: Callable[[], None]) -> Iterator[None]:
    """Call `undo` at the end of the block, or before the process is ended in it."""
    _undo.append(undo)
    try:
        yield
    finally:
        _undo.remove(undo)
        undo()


def acknowledge() -> int:
    """Let an interrupted process end by itself, in a few seconds; its exit code."""
    if _first_signal:
        _acknowledged.set()
    return 128 + (_first_signal or signal.SIGINT)


def _handle(handler: Any) -> None:
    for name in _SIGNALS if os.name == "posix" else ():
        number = getattr(signal, name)
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, handler)


def _on_signal(number: int, _: Any) -> None:
    global _first_signal
    if not _first_signal:
        _first_signal = number
        if not _deferring:
            raise KeyboardInterrupt


def _unraisable(unraisable: Any) -> None:
    """Show an exception that nobody can catch, unless it is the interrupt."""
    if not (_first_signal and issubclass(unraisable.exc_type, KeyboardInterrupt)):
        sys.__unraisablehook__(unraisable)


def _watch(arrived: int) -> NoReturn:
    """Wait for a signal, then for the end of the process, and end it if need be."""
    number = os.read(arrived, 1)[0]
    if _acknowledged.wait(_ANSWER):
        time.sleep(_LEAVE)
    while _deferring:
        time.sleep(0.01)
    for undo in reversed(_undo):
        with suppress(Exception):
            undo()
    with suppress(OSError):
        if os.isatty(2):
            os.write(2, _SHOW_CURSOR)
        if not _acknowledged.is_set():
            os.write(2, f"eqsim: {MESSAGE}\n".encode())
    os._exit(128 + number)


def _leave() -> None:
    """End an interrupted process before Python shuts down under compiling threads."""
    if _first_signal:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        os._exit(acknowledge())
