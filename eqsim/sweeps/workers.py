"""Workers: a thread or processes of this machine, or a dask.distributed cluster."""

import json
import logging
import math
import multiprocessing
import os
import re
import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
)
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from eqsim.errors import InputError, require_package
from eqsim.io.signals import deferred
from eqsim.numerics.threads import ThreadPool

# Workers have one thread for linear algebra: sums must not depend on the cores.
_ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
_ADDRESS = r"((tcp|tls|ucx|wss?)://)?([^][:/]+|\[[^][/]+\]):\d+"


@dataclass(frozen=True)
class Workers:
    """Choice of workers, which changes speed and never a number: `count` processes of
    this machine (0: this process itself) with so many `threads` each, or a
    dask.distributed cluster; `dask` is the address of its scheduler, or a scheduler
    file."""

    count: int = 1
    threads: int = 1
    dask: str | None = None

    @contextmanager
    def pool(self) -> Iterator["Pool"]:
        """The workers for the time of a `with` block, ended at once if it raises.
        Raises InputError."""
        local = Processes if self.count else Here
        pool: Pool = local(self.count) if self.dask is None else Cluster(self.dask)
        pool.threads = self.threads
        try:
            yield pool
        except BaseException:
            pool.close(hurry=True)
            raise
        pool.close(hurry=False)

    @contextmanager
    def executor(self) -> Iterator[Executor | None]:
        """The executor of a `fixed_pool`, or None for a single worker, which is this
        process. Raises InputError."""
        with ExitStack() as stack:
            several = self.count != 1
            yield stack.enter_context(self.fixed_pool()).executor if several else None

    @contextmanager
    def fixed_pool(self) -> Iterator["Pool"]:
        """A `pool` for work that cannot go on without one of its workers: InputError if
        one is lost."""
        where = "--workers" if self.dask is None else f"--dask {self.dask}"
        with self.pool() as pool:
            pool.check()
            lost: tuple[type[BaseException], ...]
            lost = (*pool.lost, OSError, CancelledError)
            try:
                yield pool
            except lost as error:
                if isinstance(error, OSError) and self.dask is None:
                    raise
                said = ": ".join(filter(None, (type(error).__name__, str(error))))
                raise InputError(
                    f"{where}: a worker was lost, perhaps for want of memory ({said})"
                ) from None


class Pool:
    """Workers behind an `executor`, which raises one of `lost` when a worker dies."""

    executor: Executor
    lost: tuple[type[BaseException], ...] = (BrokenExecutor, MemoryError)
    threads = 1  # of each worker

    def slots(self) -> int:
        """Count the workers that can compute at once."""
        return 1

    def check(self) -> None:
        """Raise InputError unless workers are there now, all with this version of
        eqsim."""

    def renew(self) -> None:
        """Replace workers that died."""

    def close(self, hurry: bool) -> None:
        """End the workers, in a hurry whatever they are doing."""
        raise NotImplementedError


class Here(Pool):
    """A thread of this process."""

    def __init__(self, count: int) -> None:
        self.executor: ThreadPool = ThreadPool(max(count, 1))

    def close(self, hurry: bool) -> None:
        self.executor.abandon() if hurry else self.executor.shutdown()


class Processes(Pool):
    """Worker processes of this machine."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.others = set(multiprocessing.active_children())
        self.environment = {name: os.environ.get(name) for name in _ONE_THREAD}
        # Libraries of workers read these when they start.
        os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
        self.renew()

    def slots(self) -> int:
        return self.count

    def renew(self) -> None:
        context = multiprocessing.get_context("spawn")
        with deferred():
            self.executor = _Executor(self.count, context, initializer=_enlist)

    def close(self, hurry: bool) -> None:
        if hurry:
            for child in set(multiprocessing.active_children()) - self.others:
                child.kill()
        self.executor.shutdown(wait=not hurry, cancel_futures=True)
        for name, value in self.environment.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


class _Executor(ProcessPoolExecutor):
    """A process pool that can be interrupted and killed.

    Its workers start as work comes, and inherit blocked signals: Ctrl-C goes to all
    processes of a terminal, and one that is still starting would answer with a
    traceback. Futures cannot be cancelled: when workers are killed, Python 3.11
    stumbles over a cancelled future, and the process may never end.
    """

    def submit(self, *args: Any, **kwargs: Any) -> Future[Any]:
        with deferred():
            future = super().submit(*args, **kwargs)
        future.cancel = lambda: False  # type: ignore[method-assign]
        return future


def _enlist() -> None:
    """Make a worker leave Ctrl-C to its parent, and end with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT, signal.SIGTERM})
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent:
            parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


class Cluster(Pool):
    """The workers of a dask.distributed cluster, which replaces those that die;
    `address` of its scheduler, or of a scheduler file."""

    def __init__(self, address: str) -> None:
        distributed = require_package("dask", "distributed")
        self.lost = (distributed.KilledWorker, MemoryError)
        self.option, where = f"--dask {address}", address
        if Path(address).is_file():
            with suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
                where = str(json.loads(Path(address).read_bytes())["address"])
        if not re.fullmatch(_ADDRESS, where):
            said = "HOST:PORT of a scheduler or a file in which one wrote its address"
            raise InputError(f"{self.option}: must be {said}")
        # A lost cluster is told in one line.
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
        try:
            self.client = distributed.Client(where, timeout=15, set_as_default=False)
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise InputError(f"{self.option}: no scheduler answers ({error})") from None
        self.executor = self.client.get_executor(pure=False)
        self.counted, self.known = -math.inf, 0

    def slots(self) -> int:
        now = time.monotonic()
        if now - self.counted > 1.0:
            self.counted, self.known = now, sum(self.client.nthreads().values())
        return max(1, self.known)

    def check(self) -> None:
        ours = version("eqsim")
        try:
            self.client.wait_for_workers(1, timeout=10)
            found = set(map(str, self.client.run(version, "eqsim").values()))
        except PackageNotFoundError:
            raise InputError(
                f"{self.option}: eqsim is not installed on its workers"
            ) from None
        except OSError:
            raise InputError(f"{self.option}: it has no workers") from None
        if found != {ours}:
            said = f"its workers have eqsim {', '.join(sorted(found))}, not {ours}"
            raise InputError(f"{self.option}: {said}")

    def close(self, hurry: bool) -> None:
        self.executor.shutdown(wait=not hurry)
        self.client.close(timeout=0.5 if hurry else 5)
