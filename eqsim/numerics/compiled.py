"""How eqsim compiles its kernels: no GIL, strict IEEE arithmetic, and a cache that cannot go stale.

Division follows NumPy (x/0 is infinite): Python's exception would be a branch in every division, and no loop with one
vectorises.
"""

import functools
import typing
from collections.abc import Callable
from typing import Any, Protocol, TypeVar, cast

import numba
from numba.extending import intrinsic, overload, register_jitable

from eqsim.numerics.kernel_folder import kernel_folder

Body = TypeVar("Body", bound=Callable[..., Any])
_CACHE = kernel_folder()


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function that Python calls, cached on disk if any of the usual folders can be written."""
    options = {"error_model": "numpy", "nogil": True}
    if _CACHE is None:
        return numba.njit(function, **options)
    previous, numba.config.CACHE_DIR = numba.config.CACHE_DIR, _CACHE  # read when the function is decorated
    try:
        return numba.njit(function, cache=True, **options)
    finally:
        numba.config.CACHE_DIR = previous


@typing.overload
def routine(function: Callable[..., Any]) -> Any: ...
@typing.overload
def routine(*, inline: bool) -> Callable[[Callable[..., Any]], Any]: ...
def routine(function: Any = None, *, inline: bool = False) -> Any:
    """Compile a function into the kernels that call it; Python, if it calls it, interprets it. `inline` leaves no call,
    so that loops over many contacts can vectorise; else LLVM decides."""
    if function is None:
        return functools.partial(routine, inline=inline)
    return register_jitable(_nrt=False, error_model="numpy", forceinline=inline)(function)


class LawRoutine(Protocol):
    """What `by_law` makes."""

    def __call__(self, law: Any, *arguments: Any) -> Any: ...

    def register(self, law: type) -> Callable[[Body], Body]:
        """A decorator for the body that a law has."""


def by_law(default: Callable[..., Any]) -> LawRoutine:
    """A kernel routine with a body for each type of law, its first argument, as `functools.singledispatch` has them:
    laws register theirs with `@name.register(Law)`. `default`, which every other law has, may raise TypeError.

    Kernels choose when they are compiled, by the NamedTuple that a law is, so that only what is used is compiled.
    """
    bodies: dict[type, Callable[..., Any]] = {}

    @functools.wraps(default)
    def call(law: Any, *arguments: Any) -> Any:
        return bodies.get(type(law), default)(law, *arguments)

    def choose(law: Any, *arguments: Any) -> Any:
        return bodies.get(getattr(law, "instance_class", type(None)), default)

    overload(call, jit_options={"_nrt": False, "error_model": "numpy", "forceinline": True}, strict=False)(choose)

    def register(law: type) -> Callable[[Body], Body]:
        def keep(function: Body) -> Body:
            bodies[law] = function
            return function

        return keep

    made = cast(LawRoutine, call)
    made.register = register  # type: ignore[method-assign]
    return made


def _fma(context: Any, x: Any, y: Any, z: Any) -> Any:
    """x y + z in kernels, rounded once: one instruction where x y + z are two, and the same bits on any processor."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return numba.float64(numba.float64, numba.float64, numba.float64), generate


fma = intrinsic(_fma)
