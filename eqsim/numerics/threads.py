"""Threads that Ctrl-C does not have to wait for.

Python answers a signal between two instructions of its main thread. A kernel that runs
for minutes there keeps Ctrl-C waiting, and so does a pool that joins its threads.
Kernels release the GIL, so a main thread that waits for them is interrupted at once.
"""

import threading
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Executor, Future
from queue import Empty, SimpleQueue
from typing import Any, Literal, TypeVar

import numpy as np

from eqsim.numerics.tables import Array

Result = TypeVar("Result")

NEVER = np.zeros(1, np.int64)  # a flag that is never set
# seconds; kernels look at their flag every few milliseconds, compilers never do
_LONGEST_STOP = 0.3
_above = threading.local()  # `pool`: the one that the current thread belongs to


class ThreadPool(Executor):
    """A pool of threads that is left at once when an exception, such as
    KeyboardInterrupt, ends the block that uses it.

    Then the flag `stop`, shape (1,), is no longer 0, for kernels that look at it, in
    pools of these `count` threads as well; what has not begun is cancelled, and later
    results are a CancelledError. Threads that go on for longer than a moment all the
    same, as they compile, are abandoned: they end when they have finished, or with the
    process. Python waits for those of a `ThreadPoolExecutor`.
    """

    def __init__(self, count: int) -> None:
        self.stop = np.zeros(1, np.int64)
        self._below: set[ThreadPool] = set()
        self._parent: ThreadPool | None = getattr(_above, "pool", None)
        if self._parent is not None:
            self._parent._below.add(self)
        self._tasks: SimpleQueue[Any] = SimpleQueue()
        self._threads = [
            threading.Thread(target=self._work, daemon=True) for _ in range(count)
        ]
        for thread in self._threads:
            thread.start()

    def _work(self) -> None:
        _above.pool = self
        while (task := self._tasks.get()) is not None:
            future, function, arguments = task
            if future.set_running_or_notify_cancel():
                try:
                    result = function(*arguments)
                    if self.stop[0]:
                        raise CancelledError
                    future.set_result(result)
                    del result
                except BaseException as error:
                    future.set_exception(error)
            # not to keep results until the next task
            del (task, future, function, arguments)

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:  # type: ignore[override]
        """Call a function in one of the threads."""
        future: Future[Any] = Future()
        self._tasks.put((future, function, arguments))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the threads when nothing is left to do, and wait for that."""
        if cancel_futures:
            try:
                while True:
                    self._tasks.get_nowait()[0].cancel()
            except Empty:
                pass
        for _ in self._threads:
            self._tasks.put(None)
        patience = time.monotonic() + _LONGEST_STOP
        for thread in self._threads:
            thread.join(None if wait else max(0.0, patience - time.monotonic()))
        if self._parent is not None:
            self._parent._below.discard(self)

    def abandon(self) -> None:
        """Tell the threads to stop, and wait for a moment."""
        self._tell()
        self.shutdown(wait=False, cancel_futures=True)

    def _tell(self) -> None:
        self.stop[0] = 1
        for pool in list(self._below):
            pool._tell()

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> Literal[False]:
        self.shutdown() if kind is None else self.abandon()
        return False


def current_stop() -> Array:
    """The flag of the pool that the current thread belongs to; `NEVER` in other
    threads."""
    pool: ThreadPool | None = getattr(_above, "pool", None)
    return NEVER if pool is None else pool.stop


def interruptibly(function: Callable[..., Result], *arguments: Any) -> Result:
    """Call a function that may take seconds to compile in a thread, so that Ctrl-C is
    answered meanwhile."""
    with ThreadPool(1) as thread:
        result: Result = thread.submit(function, *arguments).result()
    return result
