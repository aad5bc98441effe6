"""How eqsim compiles its kernels: no GIL, strict IEEE arithmetic, and a cache that cannot go stale.

Division follows NumPy (x/0 is infinite): Python's exception would be a branch in every division, and no loop with one
vectorises.
"""

import functools
import hashlib
import os
import pickle
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar, cast

import numba
from llvmlite import binding as llvm
from llvmlite import ir
from numba import _dynfunc
from numba.core import cgutils, event, types
from numba.core.caching import CompileResultCacheImpl
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder, compile_result
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import register_pass
from numba.core.serialize import dumps
from numba.core.typed_passes import NativeLowering
from numba.extending import intrinsic, overload, register_jitable

from eqsim.numerics.kernel_folder import kernel_folder

Body = TypeVar("Body", bound=Callable[..., Any])
_CACHE = kernel_folder()
_PATIENCE = 120.0  # seconds that a process waits for another one that compiles the same kernel


class TakenError(Exception):
    """Another process compiles what is asked for."""


class Files:
    """What is compiled, on disk, a file for each routine and signature, instead of numba's, which keeps one index for
    all signatures of a routine: processes that compile at the same time lose or mix up what others write there.

    A process that has to compile holds a lock until it has saved; others wait for it and then load, or raise TakenError
    unless they are `patient`. What is damaged, or cannot be written, is compiled again.
    """

    patient = True

    def __init__(self, numbas: Any) -> None:
        self._folder, self._name = Path(numbas._cache_path), numbas._index_name.removesuffix(".nbi")
        self._stamp = numba.__version__, numbas._source_stamp
        self._locks: dict[Path, int] = {}

    def path(self, key: Any) -> Path:
        """Where the machine code of a signature is."""
        digest = hashlib.sha256(repr((self._stamp, key)).encode()).hexdigest()
        return self._folder / f"{self._name}.{digest[:24]}.nbc"

    def load(self, key: Any) -> Any:
        """What was saved, or None: then this process has to compile it."""
        path = self.path(key)
        found = self._read(path, key)
        if found is None and self._alone(path):
            found = self._read(path, key)  # written since
            if found is not None:
                self._release(path)
        return found

    def save(self, key: Any, data: Any) -> None:
        """Keep machine code, all or nothing, if the disk takes it."""
        path, content = self.path(key), dumps((key, data))
        with suppress(OSError):
            handle, name = tempfile.mkstemp(dir=self._folder, suffix=".tmp")
            try:
                with os.fdopen(handle, "wb") as file:
                    file.write(hashlib.sha256(content).digest() + content)
                os.replace(name, path)
            except BaseException:
                os.unlink(name)
                raise
        self._release(path)

    @staticmethod
    def _read(path: Path, key: Any) -> Any:
        try:
            content = path.read_bytes()
            if hashlib.sha256(content[32:]).digest() != content[:32]:
                return None
            of, data = pickle.loads(content[32:])
        except (OSError, pickle.PickleError, EOFError, AttributeError, ImportError, IndexError):
            return None
        return data if of == key else None

    def _alone(self, path: Path) -> bool:
        """Whether the lock is new, after waiting for another process that may have had it."""
        if path in self._locks:  # what was to be compiled failed
            return False
        try:
            import fcntl

            path.parent.mkdir(parents=True, exist_ok=True)
            handle = os.open(path.with_suffix(".lock"), os.O_RDWR | os.O_CREAT, 0o666)
        except (ImportError, OSError):  # a system or a folder without locks: more than one may compile
            return False
        self._locks[path] = handle
        with event.trigger_event("numba:compile", data={}):  # for those who show what is going on
            end = time.monotonic() + _PATIENCE
            while time.monotonic() < end:
                try:
                    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                except BlockingIOError:  # held by another process
                    if not self.patient:
                        self._release(path)
                        raise TakenError from None
                    time.sleep(0.05)
                except OSError:  # a file system without locks
                    break
        return True

    def _release(self, path: Path) -> None:
        handle = self._locks.pop(path, None)
        if handle is not None:
            os.close(handle)


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a routine that is called from Python, cached on disk if any of the usual folders can be written."""
    return _cached(function)


def _cached(function: Callable[..., Any], **more: Any) -> Any:
    options = {"error_model": "numpy", "pipeline_class": _Compiler, "no_cpython_wrapper": True, **more}
    if _CACHE is None:
        return numba.njit(function, **options)
    previous, numba.config.CACHE_DIR = numba.config.CACHE_DIR, _CACHE  # read when the function is decorated
    try:
        made = numba.njit(function, cache=True, **options)
    finally:
        numba.config.CACHE_DIR = previous
    made._cache._cache_file = Files(made._cache._cache_file)
    return made


class _Library(JITCodeLibrary):  # type: ignore[misc]
    """LLVM code of a routine with that of its `parts`. What it `needs` of numba's and of shared routines, which is
    optimised already, is taken in by the kernel at the end; numba would do so in each routine on the way there, and
    optimise it each time."""

    def __init__(self, codegen: Any, name: str) -> None:
        super().__init__(codegen, name)
        self.parts: list[_Part] = []
        self.needs: list[Any] = []

    def add_linking_library(self, library: Any) -> None:
        if isinstance(library, _Part):
            self.parts.append(library)
            self.needs += library.needs
        else:
            self.needs.append(library)

    def finalize(self) -> None:
        for part in dict.fromkeys(self.parts):
            self._final_module.link_in(part.own(), preserve=True)
        super().finalize()


class _Part(_Library):
    """Of a routine that others take in. numba would make machine code of it, too, that nobody calls."""

    def _finalize_final_module(self) -> None:
        self._finalized = True

    def own(self) -> Any:
        """Its code without what it needs."""
        return super()._get_module_for_linking()

    def _get_module_for_linking(self) -> Any:  # for callers that numba compiles in its own way
        module = self.own().clone()
        for one in dict.fromkeys(self.needs):
            module.link_in(one._get_module_for_linking(), preserve=True)
        return module


class _Kernel(_Library):
    """Of a kernel, and machine code."""

    def finalize(self) -> None:
        self._own = {one.name for one in self._final_module.functions if not one.is_declaration}
        self._linking_libraries += self.needs  # after all that refer to them: else the linker drops them
        super().finalize()

    def _optimize_final_module(self) -> None:
        """Nobody else calls the rest: LLVM then drops arguments that are not read, of which calls would push dozens. It
        gets names of its own: who else has such a routine would be linked to this one, which takes other arguments.
        """
        for one in list(self._final_module.functions):
            done = one.is_declaration or one.linkage == llvm.Linkage.internal or one.name in self._own
            if one.name.startswith("_Z") and not done:  # not what numba counts references by
                one.linkage, one.name = llvm.Linkage.internal, f"{one.name}.part"
        super()._optimize_final_module()


class _Shared(_Kernel):
    """Of a shared routine, with all it needs and without machine code."""

    def _finalize_final_module(self) -> None:
        self._finalized = True

    def serialize_using_object_code(self) -> Any:
        return self.name, self._final_module.as_bitcode()


class _SharedOnDisk(CompileResultCacheImpl):  # type: ignore[misc]
    """How a shared routine is read from disk; numba would make machine code."""

    def rebuild(self, context: Any, kept: Any) -> Any:
        (name, code), fndesc, environment, signature, *_ = kept
        library = _Shared(context.codegen(), name)
        library._final_module, library._finalized = llvm.parse_bitcode(code), True
        return compile_result(
            target_context=context, typing_context=context.typing_context, signature=signature, fndesc=fndesc,
            library=library, environment=environment, entry_point=_named(fndesc, environment), objectmode=False,
            lifted=(),
        )  # fmt: skip


def _named(fndesc: Any, environment: Any) -> Any:
    """What numba finds a routine by, where it would have the compiled function."""
    return _dynfunc.make_function(fndesc.lookup_module(), "", "", 0, environment, ())


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(NativeLowering):  # type: ignore[misc]
    _name = "eqsim_lowering"

    def run_pass(self, state: Any) -> bool:
        for flag, value in state.pipeline.flags.items():
            setattr(state.flags, flag, value)
        state.library = state.pipeline.library(state.targetctx.codegen(), state.func_id.func_qualname)
        if not state.flags.no_compile:
            state.library.enable_object_caching()
            return super().run_pass(state)
        super().run_pass(state)
        made = state.cr
        if state.pipeline.apart:
            state.library.own().get_function(made.fndesc.llvm_func_name).add_function_attribute("noinline")
        name = _named(made.fndesc, made.env)
        state.targetctx.insert_user_function(name, made.fndesc, [state.library])
        state.cr = made._replace(cfunc=name)
        return True


class _Compiler(CompilerBase):  # type: ignore[misc]
    """numba's own; but all have the same flags, those of `register_jitable`, until it has come to LLVM code: numba
    compiles a routine again for callers of other flags."""

    flags: ClassVar[dict[str, bool]] = {"release_gil": True, "no_cpython_wrapper": False, "no_cfunc_wrapper": True}
    library: ClassVar[type[_Library]] = _Kernel
    apart: ClassVar[bool] = False  # never taken into its callers

    def define_pipelines(self) -> list[Any]:
        manager = DefaultPassBuilder.define_nopython_pipeline(self.state)
        manager.passes = [(_Lowering if one is NativeLowering else one, text) for one, text in manager.passes]
        manager.finalize()
        return [manager]


class _PartCompiler(_Compiler):
    flags: ClassVar[dict[str, bool]] = {"no_compile": True, "no_cfunc_wrapper": True}
    library: ClassVar[type[_Library]] = _Part


class _ApartCompiler(_PartCompiler):
    apart: ClassVar[bool] = True


class _InlineCompiler(_PartCompiler):
    flags: ClassVar[dict[str, bool]] = _PartCompiler.flags | {"forceinline": True}


class _SharedCompiler(_PartCompiler):
    library: ClassVar[type[_Library]] = _Shared


class _InlineSharedCompiler(_InlineCompiler):
    library: ClassVar[type[_Library]] = _Shared


# Of routines that only kernels call; Python, if it calls them, interprets them. They do not count references, which
# takes long in loops, unless they make arrays.
_PART = {"error_model": "numpy", "pipeline_class": _PartCompiler}
_INLINE = {"error_model": "numpy", "pipeline_class": _InlineCompiler}


def inlined(function: Callable[..., Any]) -> Any:
    """Compile a routine into its callers, so that loops over lanes of contacts can vectorise. It makes no arrays."""
    return register_jitable(_nrt=False, **_INLINE)(function)


def routine(function: Callable[..., Any]) -> Any:
    """Compile a longer routine that kernels call. It makes no arrays."""
    return register_jitable(_nrt=False, **_PART)(function)


def apart(function: Callable[..., Any]) -> Any:
    """`routine`, of one that is seldom called: as a part of its caller LLVM does ahead of time, every time, what no
    condition keeps it from."""
    return register_jitable(_nrt=False, error_model="numpy", pipeline_class=_ApartCompiler)(function)


def maker(function: Callable[..., Any]) -> Any:
    """Compile a routine that kernels call and that makes arrays."""
    return register_jitable(_nrt=True, **_PART)(function)


def shared(function: Callable[..., Any]) -> Any:
    """`routine`, of a longer one, of which LLVM code is cached on disk, so that not each kernel compiles it, or not the
    same process."""
    return _shared(function, _SharedCompiler, False)


def shared_inlined(function: Callable[..., Any]) -> Any:
    """`inlined` likewise."""
    return _shared(function, _InlineSharedCompiler, False)


def shared_maker(function: Callable[..., Any]) -> Any:
    """`maker` likewise."""
    return _shared(function, _SharedCompiler, True)


def _shared(function: Any, compiler: type[_Compiler], makes_arrays: bool) -> Any:
    made = _cached(function, pipeline_class=compiler, _nrt=makes_arrays)
    if _CACHE is not None:
        made._cache._impl = _SharedOnDisk(function)
    function.dispatcher, function._numba_type_ = made, types.Dispatcher(made)
    return function


def compile_unless_taken(routine: Any, arguments: tuple[Any, ...]) -> None:
    """Compile a shared routine for arguments of such types, unless it is on disk or another process does it."""
    if _CACHE is None:
        return
    made, signature = routine.dispatcher, tuple(map(numba.typeof, arguments))
    files = made._cache._cache_file
    if files.path(made._cache._index_key(signature, made.targetctx.codegen())).exists():
        return
    with global_compiler_lock:  # no other thread asks for it meanwhile
        files.patient = False
        try:
            with suppress(TakenError):
                made.compile(signature)
        finally:
            files.patient = True


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

    overload(call, jit_options={"_nrt": makes_arrays, **_INLINE}, strict=False)(choose)

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
