"""Moving values between lanes: 16 x 16 transposes in registers, and sums over transposed columns.

Projection works on 16 Gaussians at a time (lanes = Gaussians), blending on 16 pixels (lanes = pixels). These functions
are where one becomes the other.
"""

from typing import Any, Final

from llvmlite import ir
from numba.core import types
from numba.core.typing.templates import signature
from numba.extending import intrinsic

from gs2ci.render.simd.vector import (
    FLAGS,
    I64,
    LANES,
    VECTOR_I32,
    element_pointer,
    load_vector,
    spread,
    store_vector,
    vec16,
)

COLUMNS: Final = types.containers.UniTuple(vec16, LANES)

# A 16 x 16 transpose in four rounds of shuffles, as in AVX-512: pairs, quads, then the 128-bit quarters twice.
_PAIRS_LOW: Final = [x for q in range(0, 16, 4) for x in (q, 16 + q, q + 1, 17 + q)]
_PAIRS_HIGH: Final = [x + 2 for x in _PAIRS_LOW]
_QUADS_LOW: Final = [x for q in range(0, 16, 4) for x in (q, q + 1, 16 + q, 17 + q)]
_QUADS_HIGH: Final = [x + 2 for x in _QUADS_LOW]
_EVEN_QUARTERS: Final = [x for q in (0, 8, 16, 24) for x in range(q, q + 4)]
_ODD_QUARTERS: Final = [x + 4 for x in _EVEN_QUARTERS]


def _shuffle(builder: ir.IRBuilder, a: Any, b: Any, order: list[int]) -> Any:
    return builder.shuffle_vector(a, b, ir.Constant(VECTOR_I32, order))


def _emit_transpose(builder: ir.IRBuilder, rows: list[Any]) -> list[Any]:
    def both(a: Any, b: Any, low: list[int], high: list[int]) -> tuple[Any, Any]:
        return _shuffle(builder, a, b, low), _shuffle(builder, a, b, high)

    pairs: list[Any] = []
    for i in range(0, LANES, 2):
        pairs += both(rows[i], rows[i + 1], _PAIRS_LOW, _PAIRS_HIGH)
    quads: list[Any] = []
    for i in range(0, LANES, 4):
        quads += both(pairs[i], pairs[i + 2], _QUADS_LOW, _QUADS_HIGH)
        quads += both(pairs[i + 1], pairs[i + 3], _QUADS_LOW, _QUADS_HIGH)
    halves: list[Any] = [None] * LANES
    for i in range(4):
        halves[i], halves[4 + i] = both(quads[i], quads[4 + i], _EVEN_QUARTERS, _ODD_QUARTERS)
        halves[8 + i], halves[12 + i] = both(quads[8 + i], quads[12 + i], _EVEN_QUARTERS, _ODD_QUARTERS)
    columns: list[Any] = [None] * LANES
    for i in range(8):
        columns[i], columns[8 + i] = both(halves[i], halves[8 + i], _EVEN_QUARTERS, _ODD_QUARTERS)
    return columns


def _row_pointer(context: Any, builder: ir.IRBuilder, array_type: Any, array: Any, offset: Any, row: int) -> Any:
    offset = builder.add(offset, ir.Constant(I64, LANES * row))
    return element_pointer(context, builder, array_type, array, offset)


@intrinsic
def transpose(typing: Any, rows: Any) -> Any:
    """Turn 16 row vectors into the 16 column vectors."""
    del typing, rows

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Any:
        del sig
        rows = [builder.extract_value(args[0], i) for i in range(LANES)]
        return context.make_tuple(builder, COLUMNS, _emit_transpose(builder, rows))

    return signature(COLUMNS, COLUMNS), generate


@intrinsic
def load_transposed(typing: Any, array: Any, offset: Any) -> Any:
    """Load 16 rows of 16 consecutive floats; return the 16 columns."""
    del typing, offset

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Any:
        array, offset = args
        pointers = [_row_pointer(context, builder, sig.args[0], array, offset, i) for i in range(LANES)]
        rows = [load_vector(builder, pointer) for pointer in pointers]
        return context.make_tuple(builder, COLUMNS, _emit_transpose(builder, rows))

    return signature(COLUMNS, array, types.int64), generate


@intrinsic
def gather_transposed(typing: Any, array: Any, rows: Any, first: Any) -> Any:
    """Load 16 rows of 16 floats, number rows[first] ... rows[first + 15] (int32); return the 16 columns."""
    del typing, first

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Any:
        array, rows, first = args
        loaded = []
        for i in range(LANES):
            place = builder.add(first, ir.Constant(I64, i))
            row = builder.load(element_pointer(context, builder, sig.args[1], rows, place))
            offset = builder.mul(builder.sext(row, I64), ir.Constant(I64, LANES))
            loaded.append(load_vector(builder, element_pointer(context, builder, sig.args[0], array, offset)))
        return context.make_tuple(builder, COLUMNS, _emit_transpose(builder, loaded))

    return signature(COLUMNS, array, rows, types.int64), generate


@intrinsic
def store_rows(typing: Any, array: Any, offset: Any, rows: Any) -> Any:
    """Store 16 vectors as 16 rows of 16 consecutive floats."""
    del typing, offset, rows

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Any:
        for i in range(LANES):
            pointer = _row_pointer(context, builder, sig.args[0], args[0], args[1], i)
            store_vector(builder, builder.extract_value(args[2], i), pointer)
        return context.get_dummy_value()

    return signature(types.none, array, types.int64, COLUMNS), generate


def _weighted_sums(count: int) -> Any:
    sums = types.containers.UniTuple(vec16, count)

    def weighted_sums(typing: Any, columns: Any, weights: Any, offset: Any) -> Any:
        del typing, columns, offset

        def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Any:
            totals: list[Any] = [None] * count
            for k in range(LANES):
                column = builder.extract_value(args[0], k)
                for m in range(count):
                    offset = builder.add(args[2], ir.Constant(I64, LANES * m + k))
                    weight = builder.load(element_pointer(context, builder, sig.args[1], args[1], offset))
                    term = builder.fmul(column, spread(builder, weight), flags=FLAGS)
                    totals[m] = term if totals[m] is None else builder.fadd(totals[m], term, flags=FLAGS)
            return context.make_tuple(builder, sums, totals)

        return signature(sums, COLUMNS, weights, types.int64), generate

    return intrinsic(weighted_sums)


weighted_sums_6: Final = _weighted_sums(6)
"""weighted_sums_6(columns, weights, offset): the six vectors sum_k columns[k] weights[offset + 16 m + k]."""
weighted_sums_3: Final = _weighted_sums(3)
"""weighted_sums_3(columns, weights, offset): the same for three rows of weights."""
