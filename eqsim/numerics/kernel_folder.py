"""Folders for machine code on disk, locked and checked.

numba keys a cached kernel on the file of the outermost function alone, so an edit of a
law would leave the old machine code of every kernel that calls it in use. Here the
folder carries a digest of all kernel sources.

The files of numba's cache are not protected from processes that write at the same time,
that end between two files, or from a disk that loses part of one. Here a process locks
the folder of what it compiles or loads, and files are used only if their checksum was
written after them.
"""

import functools
import hashlib
import os
import shutil
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from filelock import FileLock

_PACKAGE = Path(__file__).parent.parent
# Folders and files below eqsim/ with compiled code, and with what it is compiled from.
KERNEL_SOURCES = (
    "numerics",
    "laws",
    "engine",
    "master/cohorts.py",
    "master/fronts.py",
    "master/slider.py",
)
# Seconds that a process waits for another one that compiles the same kernel, several
# times as long as any takes; then it compiles for itself.
_PATIENCE = 120.0
# Seconds between two looks at a lock, too short to be noticed.
_LOOK = 0.05
_one_thread = threading.RLock()
# When this process began what it compiles, loads or waits for.
_begins: list[float] = []


# It has no parameters, and sources that are edited while a process runs are not those
# that it has imported.
@functools.cache
def kernel_folder() -> str | None:
    """The first of the usual folders that can be written; None if none can."""
    digest = hashlib.sha256()
    for part in KERNEL_SOURCES:
        path = _PACKAGE / part
        for source in [path] if path.suffix else sorted(path.rglob("*.py")):
            digest.update(source.read_bytes())
    name = f"eqsim-kernels-{digest.hexdigest()[:16]}"
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    parents = [Path(chosen)] if chosen else []
    parents.append(_PACKAGE / "__pycache__")
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    if os.path.isabs(home):  # a user whom the machine does not know has none
        parents.append(Path(home))
    for parent in parents:
        try:
            (parent / name).mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=parent / name) as probe:
                probe.write(bytes(4096))  # more than a full disk takes
        except OSError:
            continue
        return str(parent / name)
    return None


@contextmanager
def locked_folder(name: str) -> Iterator[Path | None]:
    """Keep a folder for machine code to this thread of this process. It holds what was
    saved whole, or nothing. None, and other threads wait all the same, if nothing can
    be kept: no folder can be written or locked, or another process takes too long."""
    with ExitStack() as held:
        held.enter_context(_one_thread)
        _begins.append(time.monotonic())
        held.callback(_begins.pop)
        folder, checksum = None, b""
        with suppress(OSError, NotImplementedError):
            parent = kernel_folder()
            if parent is not None:
                lock = FileLock(Path(parent, f"{name}.lock"))
                held.enter_context(lock.acquire(timeout=_PATIENCE, poll_interval=_LOOK))
                checksum = _emptied_unless_whole(Path(parent, name))
                folder = Path(parent, name)
        yield folder
        if folder is not None:
            with suppress(OSError):
                found = _checksum(folder)
                if found != checksum:
                    _note(folder).write_bytes(found)


def compiling_since() -> float | None:
    """The time.monotonic() at which this process began to compile, load or wait for the
    kernel it needs now; None if it needs none."""
    return next(iter(_begins), None)


def _emptied_unless_whole(folder: Path) -> bytes:
    """The checksum of a folder, removing first what was not saved whole."""
    checksum = _checksum(folder)
    if not _note(folder).exists() or _note(folder).read_bytes() != checksum:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        return b""
    return checksum


def _checksum(folder: Path) -> bytes:
    """A digest of the names and the contents of all files in a folder."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            digest.update(path.name.encode())
            digest.update(path.read_bytes())
    return digest.hexdigest().encode()


def _note(folder: Path) -> Path:
    """The file beside a folder that holds its checksum."""
    return folder.with_name(f"{folder.name}.sha256")
