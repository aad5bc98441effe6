"""Imports of modules that are loaded when they are first used, so that `eqsim --help`
and `import eqsim` need neither numba nor matplotlib."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import LazyLoader
from typing import Any


class _Lazy:
    """Finder of eqsim's modules that delays their loading."""

    @staticmethod
    def find_spec(name: str, path: Any, target: Any = None) -> ModuleSpec | None:
        if not path or name[:6] != "eqsim.":
            return None
        spec = PathFinder.find_spec(name, path)
        if spec and spec.loader:
            spec.loader = LazyLoader(spec.loader)
        return spec


@contextmanager
def lazily() -> Iterator[None]:
    """Let modules of eqsim that are imported in the block be loaded when an attribute
    of theirs is first used, as by `lazy import` of Python 3.15."""
    sys.meta_path.insert(0, _Lazy)
    try:
        yield
    finally:
        sys.meta_path.remove(_Lazy)
