"""How eqsim compiles its kernels: no GIL, strict IEEE arithmetic, and a cache that
cannot go stale.

`kernel` compiles a function that Python calls, for the types of its arguments, and
keeps the machine code on disk. `routine` compiles a function into the kernels that
call it. `by_law` makes a routine that has another body for each type of law.

Division follows NumPy (x/0 is infinite): Python's exception would be a branch in every
division, and no loop with one vectorises.
"""

import functools
import hashlib
import typing
from collections.abc import Callable, Hashable
from pathlib import Path
from typing import Any, Protocol, TypeVar, cast

import numba
import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic, overload, register_jitable

from eqsim.numerics.kernel_folder import locked_folder

__all__ = ["by_law", "fma", "kernel", "routine"]

Body = TypeVar("Body", bound=Callable[..., Any])


class Kernel:
    """A function that Python calls, compiled anew for each combination of types.

    A dispatcher of numba keeps one index on disk for all types, which processes that
    save at the same time take from each other. So each combination has a dispatcher and
    a folder of its own here, which a process locks while it compiles or loads.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        functools.update_wrapper(self, function)
        self._function = function
        self._by_kind: dict[Hashable, Callable[..., Any]] = {}
        self.signatures: dict[tuple[Any, ...], Callable[..., Any]] = {}

    def __call__(self, *arguments: Any) -> Any:
        compiled = self._by_kind.get(_kind(arguments))
        if compiled is None:
            compiled = self._load_or_compile(arguments)
        return compiled(*arguments)

    def _load_or_compile(self, arguments: tuple[Any, ...]) -> Callable[..., Any]:
        """The machine code for such arguments; several kinds may have the same types."""
        signature = tuple(map(numba.typeof, arguments))
        digest = hashlib.sha256(f"{numba.__version__} {signature}".encode()).hexdigest()
        function = self._function
        name = f"{function.__module__}.{function.__qualname__}-{digest[:16]}"
        if signature not in self.signatures:
            with locked_folder(name) as folder:
                if signature not in self.signatures:  # no other thread has made it
                    self.signatures[signature] = _compiled(function, signature, folder)
        return self._by_kind.setdefault(_kind(arguments), self.signatures[signature])


def _kind(value: Any) -> Any:
    """What numba's type of a value depends on; numba.typeof takes fifty times longer."""
    if type(value) is np.ndarray:
        flags = value.flags
        if flags.carray:  # C-contiguous, aligned and writeable
            return value.dtype, value.ndim
        order = flags.c_contiguous, flags.f_contiguous
        return value.dtype, value.ndim, order, flags.writeable, flags.aligned
    if isinstance(value, tuple):
        return type(value), *map(_kind, value)
    return type(value)


def _compiled(function: Any, signature: tuple[Any, ...], folder: Path | None) -> Any:
    """A dispatcher for one signature, from a folder or saved there if there is one."""
    options = {"error_model": "numpy", "nogil": True}
    if folder is not None:
        previous = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = str(folder)
        try:
            return numba.njit(signature, cache=True, **options)(function)
        except (OSError, RuntimeError):  # the disk is full, or the folder was removed
            pass
        finally:
            numba.config.CACHE_DIR = previous
    return numba.njit(signature, **options)(function)


def kernel(function: Callable[..., Any]) -> Kernel:
    """Compile a function that Python calls. Kernels cannot call it: they call routines.

    Arguments are arrays, numbers, None, and tuples and NamedTuples of these; a whole
    number is of 64 bits. The machine code is kept on disk if a folder can be written.
    """
    return Kernel(function)


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
    return register_jitable(error_model="numpy", forceinline=inline)(function)


class LawRoutine(Protocol):
    """What `by_law` makes."""

    def __call__(self, law: Any, *arguments: Any) -> Any: ...

    def register(self, law: type) -> Callable[[Body], Body]:
        """A decorator for the body that a law has."""


def by_law(default: Callable[..., Any]) -> LawRoutine:
    """Make a routine that has another body for each type of law, its first argument:
    `functools.singledispatch` for kernels. Laws register theirs with
    `@name.register(Law)`; `default`, which every other law has, may raise TypeError.

    Kernels choose when they are compiled, by the NamedTuple that a law is, so that only
    what is used is compiled.
    """
    bodies: dict[type, Callable[..., Any]] = {}

    @functools.wraps(default)
    def call(law: Any, *arguments: Any) -> Any:
        return bodies.get(type(law), default)(law, *arguments)

    def choose(law: Any, *arguments: Any) -> Any:
        return bodies.get(getattr(law, "instance_class", type(None)), default)

    # Left to LLVM, a body is a call from loops over contacts, which do not vectorise:
    # a life along a programme takes 2.5 times as long.
    options = {"error_model": "numpy", "forceinline": True}
    overload(call, jit_options=options, strict=False)(choose)

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


def _shuffled(builder: Any, a: Any, b: Any, *order: int) -> Any:
    """The numbers of two vectors, those of the second counted on, in an order."""
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(ir.IntType(32), len(order)), list(order)))


def _transposed(builder: Any, rows: Any) -> Any:
    """Columns of four vectors of four numbers."""
    even, odd = (
        [_shuffled(builder, *rows[k : k + 2], n, n + 4, n + 2, n + 6) for k in (0, 2)] for n in (0, 1)
    )  # of lanes 0 and 2, 1 and 3
    return [_shuffled(builder, *pair, n, n + 1, n + 4, n + 5) for n in (0, 2) for pair in (even, odd)]


def _vector_at(builder: Any, array: Any, offset: Any, vector: Any) -> Any:
    """Where a vector of neighbouring numbers of an array begins."""
    return builder.bitcast(builder.gep(array.data, [offset]), vector.as_pointer())


def _move_rows(typing: Any, sums: Any, start: Any, end: Any, number: Any, i: Any) -> Any:
    """Add 1 and the five numbers[:, j], for j from i to i + 3, to the rows start[j] of `sums`, and take them from the
    rows end[j]; all arrays are C-ordered, of 64-bit integers. Columns are turned into rows in vectors of four."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        into, starts, ends, numbers = (
            context.make_array(kind)(context, builder, value=value)
            for kind, value in zip(signature.args[:4], arguments[:4], strict=True)
        )
        whole = ir.IntType(64)
        four, two = ir.VectorType(whole, 4), ir.VectorType(whole, 2)
        width, lanes = (cgutils.unpack_tuple(builder, array.shape)[1] for array in (into, numbers))
        columns = [ir.Constant(four, [1] * 4)]
        for k in range(5):
            offset = builder.add(builder.mul(ir.Constant(whole, k), lanes), arguments[4])
            columns.append(builder.load(_vector_at(builder, numbers, offset, four), align=8))
        rows = zip(_transposed(builder, columns[:4]), _transposed(builder, 2 * columns[4:]), strict=True)
        for lane, (first, last) in enumerate(rows):
            parts = (0, four, first), (4, two, _shuffled(builder, last, last, 0, 1))
            number = builder.add(arguments[4], ir.Constant(whole, lane))
            for which, change in ((starts, builder.add), (ends, builder.sub)):
                row = builder.mul(builder.load(builder.gep(which.data, [number])), width)
                for column, vector, part in parts:
                    place = _vector_at(builder, into, builder.add(row, ir.Constant(whole, column)), vector)
                    builder.store(change(builder.load(place, align=8), part), place, align=8)
        return context.get_dummy_value()

    return types.void(sums, start, end, number, types.int64), generate


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


def _four_cubics(typing: Any, table: Any, row: Any, r: Any, t: Any, i: Any) -> Any:
    """Cubic polynomials in the place of their arguments t[r, j], for j from i to i + 3, with coefficients from the rows
    row[j] of a C-ordered table of four columns. Rows are turned into columns in vectors of four."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        tables, rows, numbers = (
            context.make_array(signature.args[k])(context, builder, value=arguments[k]) for k in (0, 1, 3)
        )
        whole, four = ir.IntType(64), ir.VectorType(ir.DoubleType(), 4)
        found = []
        for lane in range(4):
            j = builder.load(builder.gep(rows.data, [builder.add(arguments[4], ir.Constant(whole, lane))]))
            place = _vector_at(builder, tables, builder.mul(j, ir.Constant(whole, 4)), four)
            found.append(builder.load(place, align=8))
        a, b, c, d = _transposed(builder, found)
        first = builder.mul(arguments[2], cgutils.unpack_tuple(builder, numbers.shape)[1])
        place = _vector_at(builder, numbers, builder.add(first, arguments[4]), four)
        x = builder.load(place, align=8)
        for coefficient in (c, b, a):
            d = builder.fadd(coefficient, builder.fmul(x, d))
        builder.store(d, place, align=8)
        return context.get_dummy_value()

    return types.void(table, row, types.int64, t, types.int64), generate


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


fma, float_of, move_rows = intrinsic(_fma), intrinsic(_float_of), intrinsic(_move_rows)
four_of, four_cubics = intrinsic(_four_of), intrinsic(_four_cubics)
