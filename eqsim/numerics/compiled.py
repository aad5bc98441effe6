"""How eqsim compiles its kernels: no GIL, strict IEEE arithmetic, and a cache that cannot go stale.

Division follows NumPy (x/0 is infinite): Python's exception would be a branch in every division, and no loop with one
vectorises.

numba keys a cached kernel on the file of the outermost function alone, so an edit of a law would leave the old
machine code of every kernel that calls it in use. Here the cache folder carries a digest of all kernel sources.
"""

import functools
import hashlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol, TypeVar, cast

import numba
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic, overload, register_jitable

Body = TypeVar("Body", bound=Callable[..., Any])
_PACKAGE = Path(__file__).parent.parent


def _cache_folder() -> str | None:
    digest = hashlib.sha256()
    for part in ("numerics", "laws", "engine", "master/cohorts.py", "master/fronts.py", "master/slider.py"):
        path = _PACKAGE / part
        for source in [path] if path.suffix else sorted(path.rglob("*.py")):
            digest.update(source.read_bytes())
    name = f"eqsim-kernels-{digest.hexdigest()[:16]}"
    user_cache = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    own = [Path(numba.config.CACHE_DIR)] if numba.config.CACHE_DIR else []
    homes = [user_cache] if user_cache.is_absolute() else []  # a user whom the machine does not know has none
    for parent in (*own, _PACKAGE / "__pycache__", *homes):
        try:
            (parent / name).mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=parent / name).close()
        except OSError:
            continue
        return str(parent / name)
    return None


_CACHE = _cache_folder()


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a routine that is called from Python, cached on disk if any of the usual folders can be written."""
    if _CACHE is None:
        return numba.njit(function, nogil=True, error_model="numpy")
    previous, numba.config.CACHE_DIR = numba.config.CACHE_DIR, _CACHE  # read when the function is decorated
    try:
        return numba.njit(function, nogil=True, error_model="numpy", cache=True)
    finally:
        numba.config.CACHE_DIR = previous


# Of routines that only kernels call; Python, if it calls them, interprets them. They do not count references, which
# takes long in loops, unless they make arrays.
_INNER = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}


def inlined(function: Callable[..., Any]) -> Any:
    """Compile a routine into its callers, so that loops over lanes of contacts can vectorise. It makes no arrays."""
    return register_jitable(forceinline=True, _nrt=False, **_INNER)(function)


def routine(function: Callable[..., Any]) -> Any:
    """Compile a longer routine that kernels call. It makes no arrays."""
    return register_jitable(_nrt=False, **_INNER)(function)


def maker(function: Callable[..., Any]) -> Any:
    """Compile a routine that kernels call and that makes arrays."""
    return register_jitable(_nrt=True, **_INNER)(function)


class LawRoutine(Protocol):
    """What `by_law` makes."""

    def __call__(self, law: Any, *arguments: Any) -> Any: ...

    def register(self, law: type) -> Callable[[Body], Body]:
        """A decorator for the body that a law has."""


def by_law(default: Callable[..., Any], makes_arrays: bool = False) -> LawRoutine:
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

    overload(call, jit_options={"forceinline": True, "_nrt": makes_arrays, **_INNER}, strict=False)(choose)

    def register(law: type) -> Callable[[Body], Body]:
        def keep(function: Body) -> Body:
            bodies[law] = function
            return function

        return keep

    made = cast(LawRoutine, call)
    made.register = register  # type: ignore[method-assign]
    return made


def _fma(typing: Any, x: Any, y: Any, z: Any) -> Any:
    """x y + z in kernels, rounded once: one instruction where x y + z are two, and the same bits on any processor."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return types.float64(types.float64, types.float64, types.float64), generate


def _row_change(instruction: str, doc: str) -> Any:
    """An intrinsic for the numbers of a row of C-ordered 64-bit integers, up to four in one instruction. Left to
    itself the compiler changes them one by one."""

    def typing(typing: Any, sums: Any, j: Any, column: Any, row: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            array = context.make_array(sums)(context, builder, value=arguments[0])
            columns = cgutils.unpack_tuple(builder, array.shape)[1]
            start = builder.add(builder.mul(arguments[1], columns), arguments[2])
            numbers = cgutils.unpack_tuple(builder, arguments[3])
            for first in range(0, len(numbers), 4):
                part = numbers[first : first + 4]
                vector = ir.VectorType(part[0].type, len(part))
                change = ir.Constant(vector, ir.Undefined)
                for i, number in enumerate(part):
                    change = builder.insert_element(change, number, ir.Constant(ir.IntType(32), i))
                at = builder.gep(array.data, [builder.add(start, ir.Constant(start.type, first))])
                at = builder.bitcast(at, vector.as_pointer())
                builder.store(getattr(builder, instruction)(builder.load(at, align=8), change), at, align=8)
            return context.get_dummy_value()

        numbers = types.UniTuple(types.int64, len(row))  # type: ignore[attr-defined]
        return types.void(sums, types.int64, types.int64, numbers), generate

    typing.__doc__ = doc
    return intrinsic(typing)


add_row = _row_change("add", "Add the tuple `row` to row `j` of `sums` from `column` on.")
take_row = _row_change("sub", "Take the tuple `row` from row `j` of `sums` from `column` on.")


def _four_of(typing: Any, table: Any, j: Any) -> Any:
    """The numbers of row j of a C-ordered table of four columns, in one load. Left to itself the compiler gathers each
    column for many rows at once, which takes twice as long."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = context.make_array(table)(context, builder, value=arguments[0])
        at = builder.gep(array.data, [builder.mul(arguments[1], ir.Constant(arguments[1].type, 4))])
        row = builder.load(builder.bitcast(at, ir.VectorType(ir.DoubleType(), 4).as_pointer()), align=8)
        numbers = [builder.extract_element(row, ir.Constant(ir.IntType(32), i)) for i in range(4)]
        return context.make_tuple(builder, signature.return_type, numbers)

    row = types.UniTuple(types.float64, 4)  # type: ignore[attr-defined]
    return row(table, types.int64), generate


def _float_of(typing: Any, whole: Any) -> Any:
    """The double nearest to an integer of 0 to 2^63, in kernels: where the processor has no instruction that converts
    vectors of 64 bits, from halves in the last bits of 2^84 and of 2^52, whose sum is rounded once."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        double, integer = ir.DoubleType(), ir.IntType(64)
        triple, _, features = context.codegen().magic_tuple()
        if not triple.startswith("x86_64") or "+avx512dq" in features:
            return builder.sitofp(arguments[0], double)

        def above(power: int, half: Any) -> Any:  # 2^power + half of its last bits
            exponent = ir.Constant(integer, (1023 + power) << 52)
            return builder.bitcast(builder.or_(half, exponent), double)

        high = builder.lshr(arguments[0], ir.Constant(integer, 32))
        low = builder.and_(arguments[0], ir.Constant(integer, 2**32 - 1))
        rest = builder.fsub(above(84, high), ir.Constant(double, 2.0**84 + 2.0**52))
        return builder.fadd(rest, above(52, low))

    return types.float64(types.int64), generate


fma, four_of, float_of = intrinsic(_fma), intrinsic(_four_of), intrinsic(_float_of)
