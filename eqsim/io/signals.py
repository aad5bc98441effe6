"""Ctrl-C, and what batch systems and closed terminals send: one signal ends a command
within a second.

The first signal raises KeyboardInterrupt. Python does so between two instructions of
its main thread only, which may be in a compiler for much longer, and libraries may lose
the exception, in a finaliser or as they catch everything. So a thread waits for
signals, too, and ends a process that does not acknowledge one in time.
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
_SIGNALS = [
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP")
    if hasattr(signal, name)
]
_ANSWER = 0.6  # seconds that a process has to acknowledge a signal: ending it takes a tenth of a second
_LEAVE = 5.0  # seconds that it has after that, to write what is finished
_SHOW_CURSOR = b"\x1b[?25h"  # which progress bars hide


class _Interrupt:
    """Fate of the first signal: its `number`, and whether it was `raised` and
    `acknowledged`."""

    def __init__(self) -> None:
        self.number = 0
        self.raised = False
        self.acknowledged = threading.Event()

    @property
    def code(self) -> int:
        return 128 + (self.number or signal.SIGINT)


_interrupt = _Interrupt()
_deferring: list[None] = []  # an item for each `deferred` block
_undo: list[Callable[[], None]] = []  # of the `undone` blocks


@contextmanager
def interruptible() -> Iterator[None]:
    """Inside, a signal that ends a process, unless it was ignored before, raises
    KeyboardInterrupt, and any further one does nothing; the process ends with 128 + its
    number, whatever becomes of the exception. To be entered before other modules are
    imported, so that what they do at exit is done first."""
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
        if not _interrupt.number or _interrupt.acknowledged.is_set():
            raise
    finally:
        _handle(signal.SIG_IGN)
    if _interrupt.number and not _interrupt.acknowledged.is_set():
        acknowledge()
        print(f"eqsim: {MESSAGE}", file=sys.stderr)
        sys.exit(_interrupt.code)


@contextmanager
def deferred() -> Iterator[None]:
    """Inside, interrupts wait; processes started inside inherit that signals are
    blocked.

    Blocking in this thread is not enough: Python answers here also to signals that
    reach another thread.
    """
    block: Any = getattr(signal, "pthread_sigmask", lambda *_: None)
    before = block(getattr(signal, "SIG_BLOCK", 0), {signal.SIGINT, signal.SIGTERM})
    _deferring.append(None)
    try:
        yield
    finally:
        block(getattr(signal, "SIG_SETMASK", 0), before)
        _deferring.pop()
        if _interrupt.number and not _interrupt.raised and not _deferring:
            _interrupt.raised = True
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
    """Let the process end by itself, in a few seconds; returns the exit code of a
    process that was interrupted."""
    if _interrupt.number:
        _interrupt.acknowledged.set()
    return _interrupt.code


def _handle(handler: Any) -> None:
    if os.name == "posix":
        for number in _SIGNALS:
            if signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, handler)


def _on_signal(number: int, _: Any) -> None:
    if not _interrupt.number:
        _interrupt.number = number
        if not _deferring:
            _interrupt.raised = True
            raise KeyboardInterrupt


def _unraisable(unraisable: Any) -> None:
    """Show an exception that nobody can catch, unless it is the interrupt."""
    if not (_interrupt.number and issubclass(unraisable.exc_type, KeyboardInterrupt)):
        sys.__unraisablehook__(unraisable)


def _watch(arrived: int) -> NoReturn:
    """Wait for a signal, then for the end of the process, and end it if need be."""
    number = os.read(arrived, 1)[0]
    if _interrupt.acknowledged.wait(_ANSWER):
        time.sleep(_LEAVE)
    while _deferring:
        time.sleep(0.01)
    for undo in reversed(_undo):
        with suppress(Exception):
            undo()
    with suppress(OSError):
        if os.isatty(2):
            os.write(2, _SHOW_CURSOR)
        if not _interrupt.acknowledged.is_set():
            os.write(2, f"eqsim: {MESSAGE}\n".encode())
    os._exit(128 + number)


def _leave() -> None:
    """End an interrupted process before Python takes itself apart under threads that
    still compile."""
    if _interrupt.number:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        os._exit(_interrupt.code)
