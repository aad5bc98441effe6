"""How eqsim compiles its kernels: no GIL, strict IEEE arithmetic, and a cache that cannot go stale.

Division follows NumPy (x/0 is infinite): Python's exception would be a branch in every division, and no loop with one
vectorises.

numba keys a cached kernel on the file of the outermost function alone, so an edit of a law would leave the old
machine code of every kernel that calls it in use. Here the cache folder carries a digest of all kernel sources.
"""

import hashlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba

_PACKAGE = Path(__file__).parent


def _cache_folder() -> str | None:
    digest = hashlib.sha256()
    for room in ("laws", "engine"):
        for source in sorted((_PACKAGE / room).glob("*.py")):
            digest.update(source.read_bytes())
    name = f"eqsim-kernels-{digest.hexdigest()[:16]}"
    user_cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    own = [Path(numba.config.CACHE_DIR)] if numba.config.CACHE_DIR else []
    for parent in (*own, _PACKAGE / "__pycache__", user_cache):
        try:
            (parent / name).mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=parent / name).close()
        except OSError:
            continue
        return str(parent / name)
    return None


_CACHE = _cache_folder()


def cold() -> bool:
    """Whether the next call has to compile first."""
    return _CACHE is None or not any(Path(_CACHE).rglob("*.nbc"))


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a routine that is called from Python, cached on disk if any of the usual folders can be written."""
    if _CACHE is None:
        return numba.njit(function, nogil=True, error_model="numpy")
    previous, numba.config.CACHE_DIR = numba.config.CACHE_DIR, _CACHE  # read when the function is decorated
    try:
        return numba.njit(function, nogil=True, error_model="numpy", cache=True)
    finally:
        numba.config.CACHE_DIR = previous


def inlined(function: Callable[..., Any]) -> Any:
    """Compile a scalar routine into its callers, so that loops over lanes of contacts can vectorise."""
    return numba.njit(function, forceinline=True, error_model="numpy")


def routine(function: Callable[..., Any]) -> Any:
    """Compile a longer scalar routine that kernels call."""
    return numba.njit(function, error_model="numpy")
