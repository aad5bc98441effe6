"""Add integers to records that contacts share, for four contacts at a time.

The compiler would change the fields of a record one by one, twelve for a life. With
vectors a life at T = 0 takes a quarter less time.
"""

from collections.abc import Callable
from typing import Any

import numba
from llvmlite import ir
from numba.extending import intrinsic

_WHOLE = ir.IntType(64)
_INDEX = ir.IntType(32)


def _shuffled(builder: Any, pair: list[Any], order: list[int]) -> Any:
    """The numbers of two vectors, those of the second counted on, in an order."""
    mask = ir.Constant(ir.VectorType(_INDEX, len(order)), order)
    return builder.shuffle_vector(*pair, mask)


def _transposed(builder: Any, rows: list[Any]) -> list[Any]:
    """Columns of four vectors of four numbers."""
    # of columns 0 and 2, and of 1 and 3
    halves = [
        [_shuffled(builder, rows[k : k + 2], [n, n + 4, n + 2, n + 6]) for k in (0, 2)]
        for n in (0, 1)
    ]
    orders = ([n, n + 1, n + 4, n + 5] for n in (0, 2))
    return [_shuffled(builder, pair, order) for order in orders for pair in halves]


def _vector_at(builder: Any, array: Any, offset: Any, width: int) -> Any:
    """Pointer to `width` neighbouring 64-bit integers of an array, from number `offset`
    on."""
    data = builder.gep(builder.bitcast(array.data, _WHOLE.as_pointer()), [offset])
    return builder.bitcast(data, ir.VectorType(_WHOLE, width).as_pointer())


def _change(operation: str) -> Callable[..., Any]:
    """The definition of an intrinsic that adds ("add") or takes ("sub")."""

    def define(context: Any, records: Any, rows: Any, columns: Any, i: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            def array(kind: Any, value: Any) -> Any:
                return context.make_array(kind)(context, builder, value=value)

            table, numbers = array(records, arguments[0]), array(rows, arguments[1])
            loaded = []
            for k in range(6):
                column = array(columns[k], builder.extract_value(arguments[2], k))
                here = _vector_at(builder, column, arguments[3], 4)
                loaded.append(builder.load(here, align=8))
            quads = _transposed(builder, loaded[:4])
            # the columns 4 and 5 twice, of which half is left
            pairs = _transposed(builder, 2 * loaded[4:])
            pairs = [_shuffled(builder, [pair, pair], [0, 1]) for pair in pairs]
            for lane in range(4):
                number = builder.add(arguments[3], ir.Constant(_WHOLE, lane))
                place = builder.load(builder.gep(numbers.data, [number]))
                for first, width, vectors in ((0, 4, quads), (4, 2, pairs)):
                    field = builder.mul(place, ir.Constant(_WHOLE, 6))
                    field = builder.add(field, ir.Constant(_WHOLE, first))
                    here = _vector_at(builder, table, field, width)
                    old = builder.load(here, align=8)
                    new = getattr(builder, operation)(old, vectors[lane])
                    builder.store(new, here, align=8)
            return context.get_dummy_value()

        return numba.void(records, rows, columns, numba.int64), generate

    return define


# add_rows(records, rows, columns, i) adds columns[k][j], for j from i to i + 3, to
# field k of records[rows[j]]; take_rows takes it from there. Records have six fields of
# 64-bit integers.
add_rows, take_rows = intrinsic(_change("add")), intrinsic(_change("sub"))
