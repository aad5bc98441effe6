"""Compile kernels: without the GIL, in strict IEEE arithmetic, cached on disk by their
sources.

`kernel` compiles a function that Python calls, for the types of its arguments, and
keeps the machine code on disk. `routine` compiles a function into the kernels that
call it. `by_law` makes a routine that has another body for each type of law.

Division follows NumPy (x/0 is infinite): Python's exception would be a branch in every
division, and no loop with one vectorises. Kernels and inlined routines do not count
references to arrays, which would take longer than their work; so they must not make
arrays unless they say so.
"""

import functools
import gc
import hashlib
import typing
from collections.abc import Callable, Hashable
from pathlib import Path
from typing import Any, Protocol, TypeVar, cast

import numba
import numpy as np
from numba.extending import intrinsic, overload, register_jitable

from eqsim.numerics.kernel_folder import locked_folder

__all__ = ["by_law", "fma", "kernel", "routine"]

Body = TypeVar("Body", bound=Callable[..., Any])
_PLAIN = {"error_model": "numpy", "no_cfunc_wrapper": True}
_INLINED = {**_PLAIN, "forceinline": True, "_nrt": False}
_RARELY = 100_000  # objects between collections, a tenth of the time of compiling


class Kernel:
    """A function that Python calls, compiled anew for each combination of types. A
    dispatcher of numba keeps one index on disk for all types, which processes that save
    at the same time take from each other. So each combination has a dispatcher and a
    folder of its own here, which a process locks while it compiles or loads."""

    def __init__(self, function: Callable[..., Any], makes_arrays: bool) -> None:
        functools.update_wrapper(self, function)
        self._function = function
        self._options = {**_PLAIN, "nogil": True, "_nrt": makes_arrays}
        self._by_kind: dict[Hashable, Callable[..., Any]] = {}
        self.signatures: dict[tuple[Any, ...], Callable[..., Any]] = {}

    def __call__(self, *arguments: Any) -> Any:
        return self.compiled_for(*arguments)(*arguments)

    def compiled_for(self, *arguments: Any) -> Callable[..., Any]:
        """The machine code for such arguments. To look it up takes as long as following
        a hundred contacts; calls that have arguments of the same types share it."""
        compiled = self._by_kind.get(_kind(arguments))
        return self._load_or_compile(arguments) if compiled is None else compiled

    def _load_or_compile(self, arguments: tuple[Any, ...]) -> Callable[..., Any]:
        """The machine code for such arguments; several kinds may have the same types."""
        signature = tuple(map(numba.typeof, arguments))
        digest = hashlib.sha256(f"{numba.__version__} {signature}".encode()).hexdigest()
        function, options = self._function, self._options
        name = f"{function.__module__}.{function.__qualname__}-{digest[:16]}"
        if signature not in self.signatures:
            with locked_folder(name) as folder:
                if signature not in self.signatures:  # no other thread has made it
                    compiled = _compiled(function, signature, options, folder)
                    self.signatures[signature] = compiled
        return self._by_kind.setdefault(_kind(arguments), self.signatures[signature])


def _kind(value: Any) -> Any:
    """Key that determines numba's type of a value; numba.typeof takes fifty times
    longer."""
    if type(value) is np.ndarray:
        flags = value.flags
        if flags.carray:  # C-contiguous, aligned and writeable
            return value.dtype, value.ndim
        order = flags.c_contiguous, flags.f_contiguous
        return value.dtype, value.ndim, order, flags.writeable, flags.aligned
    if isinstance(value, tuple):
        return type(value), *map(_kind, value)
    return type(value)


def _compiled(
    function: Any, signature: tuple[Any, ...], options: Any, folder: Path | None
) -> Any:
    """A dispatcher for one signature, from a folder or saved there if there is one."""
    collects = gc.get_threshold()
    gc.set_threshold(_RARELY, *collects[1:])
    try:
        if folder is not None:
            previous = numba.config.CACHE_DIR
            numba.config.CACHE_DIR = str(folder)
            try:
                return numba.njit(signature, cache=True, **options)(function)
            except (OSError, RuntimeError):  # the disk is full, or the folder is gone
                pass
            finally:
                numba.config.CACHE_DIR = previous
        return numba.njit(signature, **options)(function)
    finally:
        gc.set_threshold(*collects)


@typing.overload
def kernel(function: Callable[..., Any]) -> Kernel: ...
@typing.overload
def kernel(*, makes_arrays: bool) -> Callable[[Callable[..., Any]], Kernel]: ...
def kernel(
    function: Callable[..., Any] | None = None, *, makes_arrays: bool = False
) -> Any:
    """Compile a function that Python calls. Kernels cannot call it: they call routines.
    Arguments are arrays, numbers, None, and tuples and NamedTuples of these; a whole
    number is of 64 bits. A kernel that `makes_arrays` says so. The machine code is kept
    on disk if a folder can be written."""
    if function is None:
        return functools.partial(kernel, makes_arrays=makes_arrays)
    return Kernel(function, makes_arrays)


@typing.overload
def routine(function: Callable[..., Any]) -> Any: ...
@typing.overload
def routine(*, inline: bool) -> Callable[[Callable[..., Any]], Any]: ...
def routine(function: Callable[..., Any] | None = None, *, inline: bool = False) -> Any:
    """Compile a function into the kernels that call it; Python, if it calls it,
    interprets it. `inline` leaves no call, so that loops over many contacts can
    vectorise; else LLVM decides."""
    if function is None:
        return functools.partial(routine, inline=inline)
    options = _INLINED if inline else {**_PLAIN, "forceinline": False}
    return register_jitable(**options)(function)


class LawRoutine(Protocol):
    """A routine that `by_law` makes."""

    def __call__(self, law: Any, *arguments: Any) -> Any: ...

    def register(self, law: type) -> Callable[[Body], Body]:
        """A decorator for the body that a law has."""


@typing.overload
def by_law(default: Callable[..., Any]) -> LawRoutine: ...
@typing.overload
def by_law(*, makes_arrays: bool) -> Callable[[Callable[..., Any]], LawRoutine]: ...
def by_law(
    default: Callable[..., Any] | None = None, *, makes_arrays: bool = False
) -> Any:
    """Make a routine that has another body for each type of law, its first argument:
    `functools.singledispatch` for kernels. Laws register theirs with
    `@name.register(Law)`, also for what inherits from them; `default`, which every
    other law has, may raise TypeError. Kernels choose when they are compiled, by the
    NamedTuple that a law is, so that only what is used is compiled. All bodies are
    inlined."""
    if default is None:
        return functools.partial(by_law, makes_arrays=makes_arrays)
    chosen_by_default = default
    bodies: dict[type, Callable[..., Any]] = {}

    def body_of(kind: type) -> Callable[..., Any]:
        return next((bodies[k] for k in kind.__mro__ if k in bodies), chosen_by_default)

    @functools.wraps(default)
    def call(law: Any, *arguments: Any) -> Any:
        return body_of(type(law))(law, *arguments)

    def choose(law: Any, *arguments: Any) -> Any:
        return body_of(getattr(law, "instance_class", type(None)))

    # Left to LLVM, a body is a call from loops over contacts, which do not vectorise:
    # a life along a programme takes 2.5 times as long.
    overload(call, jit_options={**_INLINED, "_nrt": makes_arrays}, strict=False)(choose)

    def register(law: type) -> Callable[[Body], Body]:
        def keep(function: Body) -> Body:
            bodies[law] = function
            return function

        return keep

    made = cast(LawRoutine, call)
    made.register = register  # type: ignore[method-assign]
    return made


def _fma(typing: Any, x: Any, y: Any, z: Any) -> Any:
    """x y + z in kernels, rounded once: one instruction where x y + z are two, and the
    same bits on any processor."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    number = numba.float64
    return number(number, number, number), generate


fma = intrinsic(_fma)
