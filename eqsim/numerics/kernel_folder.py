"""Where machine code is kept on disk; without numba, so that it is known before that is imported.

numba keys a cached kernel on the file of the outermost function alone, so an edit of a law would leave the old
machine code of every kernel that calls it in use. Here the folder carries a digest of all kernel sources.
"""

import functools
import hashlib
import os
import tempfile
from pathlib import Path

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
    user_cache = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    homes = [user_cache] if user_cache.is_absolute() else []  # a user whom the machine does not know has none
    for parent in (*([Path(chosen)] if chosen else []), _PACKAGE / "__pycache__", *homes):
        try:
            (parent / name).mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=parent / name).close()
        except OSError:
            continue
        return str(parent / name)
    return None


def is_empty() -> bool:
    """Whether there is a folder, and nothing has been compiled yet."""
    folder = kernel_folder()
    return folder is not None and next(Path(folder).rglob("*.nbc"), None) is None
