"""Whole numbers of four contacts at a time, added to records that contacts share.

Left to itself the compiler changes the fields of a record one by one, twelve of them
for a life. In vectors a life at T = 0 takes a quarter less, and one of warm contacts a
fifth less.
"""

from collections.abc import Callable
from typing import Any

import numba
from llvmlite import ir
from numba.extending import intrinsic

_WHOLE = ir.IntType(64)
_INDEX = ir.IntType(32)


def _shuffled(builder: Any, a: Any, b: Any, order: list[int]) -> Any:
    """The numbers of two vectors, those of the second counted on, in an order."""
    return builder.shuffle_vector(
        a, b, ir.Constant(ir.VectorType(_INDEX, len(order)), order)
    )


def _transposed(builder: Any, rows: list[Any]) -> list[Any]:
    """Columns of four vectors of four numbers."""
    # of columns 0 and 2, and of 1 and 3
    halves = [
        [
            _shuffled(builder, rows[k], rows[k + 1], [n, n + 4, n + 2, n + 6])
            for k in (0, 2)
        ]
        for n in (0, 1)
    ]
    return [
        _shuffled(builder, first, last, [n, n + 1, n + 4, n + 5])
        for n in (0, 2)
        for first, last in halves
    ]


def _vector_at(builder: Any, array: Any, offset: Any, width: int) -> Any:
    """Where neighbouring 64-bit integers of an array begin, `offset` of them after its
    own beginning."""
    data = builder.bitcast(array.data, _WHOLE.as_pointer())
    return builder.bitcast(
        builder.gep(data, [offset]), ir.VectorType(_WHOLE, width).as_pointer()
    )


def _change(operation: str) -> Callable[..., Any]:
    """The definition of an intrinsic that adds ("add") or takes ("sub")."""

    def define(context: Any, records: Any, rows: Any, columns: Any, i: Any) -> Any:
        fields = records.dtype.size // 8

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            def array(kind: Any, value: Any) -> Any:
                return context.make_array(kind)(context, builder, value=value)

            table, numbers = array(records, arguments[0]), array(rows, arguments[1])
            loaded = []
            for k in range(len(columns)):
                column = array(columns[k], builder.extract_value(arguments[2], k))
                loaded.append(
                    builder.load(_vector_at(builder, column, arguments[3], 4), align=8)
                )
            parts = [(0, 4, _transposed(builder, loaded[:4]))]
            if len(loaded) > 4:  # two more
                pairs = [
                    _shuffled(builder, row, row, [0, 1])
                    for row in _transposed(builder, 2 * loaded[4:])
                ]
                parts.append((4, 2, pairs))
            for lane in range(4):
                place = builder.gep(
                    numbers.data, [builder.add(arguments[3], ir.Constant(_WHOLE, lane))]
                )
                row = builder.mul(builder.load(place), ir.Constant(_WHOLE, fields))
                for first, width, vectors in parts:
                    here = _vector_at(
                        builder,
                        table,
                        builder.add(row, ir.Constant(_WHOLE, first)),
                        width,
                    )
                    changed = getattr(builder, operation)(
                        builder.load(here, align=8), vectors[lane]
                    )
                    builder.store(changed, here, align=8)
            return context.get_dummy_value()

        return numba.void(records, rows, columns, numba.int64), generate

    return define


# add_rows(records, rows, columns, i) adds columns[k][j], for j from i to i + 3, to
# field k of records[rows[j]]; take_rows takes it from there. Records have fields of
# 64-bit integers, and there are four columns or six.
add_rows, take_rows = intrinsic(_change("add")), intrinsic(_change("sub"))
