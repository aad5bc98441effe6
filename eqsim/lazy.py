"""Imports of modules that are loaded when they are first used, so that `eqsim --help`
and `import eqsim` need neither numba nor matplotlib."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import LazyLoader
from typing import Any


class _Lazy:
    """Finds modules of eqsim where Python does."""

    @staticmethod
    def find_spec(name: str, path: Any, target: Any = None) -> ModuleSpec | None:
        found = (
            PathFinder.find_spec(name, path) if path and name[:6] == "eqsim." else None
        )
        if found and found.loader:
            found.loader = LazyLoader(found.loader)
        return found


@contextmanager
def lazily() -> Iterator[None]:
    """Let modules of eqsim that are imported in the block be loaded when an attribute
    of theirs is first used, as by `lazy import` of Python 3.15."""
    sys.meta_path.insert(0, _Lazy)
    try:
        yield
    finally:
        sys.meta_path.remove(_Lazy)
