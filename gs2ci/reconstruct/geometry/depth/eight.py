"""The inner step of the plane sweep: eight features of a pixel in one vector register.

Numba unrolls a loop of eight into scalar code, which is four times as slow; so the vector code is generated here. The
eight are summed in the same order on every processor. Here: that step alone. Not here: the loops around it (`kernels`).
"""

from typing import Any, Final

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.typing.templates import signature
from numba.extending import intrinsic

FEATURES: Final = 8
"""Features of a pixel are padded with zeros to eight, which fill one vector register."""

_I32: Final = ir.IntType(32)
_I64: Final = ir.IntType(64)
_EIGHT: Final = ir.VectorType(ir.FloatType(), FEATURES)


def _shuffled(builder: ir.IRBuilder, vector: Any, order: list[int]) -> Any:
    indices = ir.Constant(ir.VectorType(_I32, len(order)), order)
    return builder.shuffle_vector(vector, ir.Constant(vector.type, ir.Undefined), indices)


def _pointer(context: Any, builder: ir.IRBuilder, array_type: Any, array: Any, element: Any) -> Any:
    return builder.gep(context.make_array(array_type)(context, builder, array).data, [element])


def _eight(context: Any, builder: ir.IRBuilder, array_type: Any, array: Any, pixel: Any) -> Any:
    """Load the features of a pixel."""
    element = builder.mul(pixel, ir.Constant(_I64, FEATURES))
    pointer = _pointer(context, builder, array_type, array, element)
    return builder.load(builder.bitcast(pointer, _EIGHT.as_pointer()), align=types.float32.bitwidth // 8)


@intrinsic
def differ(typing: Any, reference: Any, view: Any, aim: Any, column: Any, corner: Any, width: Any) -> Any:
    """Sum the absolute differences between a pixel's features and those of a view at an interpolated place.

    differ(reference, view, aim, column, corner, width), all arrays C-contiguous float32, nothing checked: reference
    features of a row, [W, 8]; those of the view, [H * W, 8]; weights of the four pixels around each place, [4 or more,
    W]; which pixel of the row; the flat index of the first of the four in the view; W.
    """
    del typing

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Any:
        reference, view, aim, column, corner, width = args
        corner = builder.sext(corner, _I64) if corner.type.width < _I64.width else corner
        below = builder.add(corner, width)
        one = ir.Constant(_I64, 1)
        total: Any = None
        for k, pixel in enumerate((corner, builder.add(corner, one), below, builder.add(below, one))):
            place = builder.add(builder.mul(width, ir.Constant(_I64, k)), column)
            weight = builder.load(_pointer(context, builder, sig.args[2], aim, place))
            first = builder.insert_element(ir.Constant(_EIGHT, ir.Undefined), weight, ir.Constant(_I32, 0))
            weights = _shuffled(builder, first, [0] * FEATURES)
            term = builder.fmul(weights, _eight(context, builder, sig.args[1], view, pixel), flags=("contract",))
            total = term if total is None else builder.fadd(total, term, flags=("contract",))
        apart = builder.fsub(total, _eight(context, builder, sig.args[0], reference, column))
        absolute = cgutils.get_or_insert_function(builder.module, ir.FunctionType(_EIGHT, [_EIGHT]), "llvm.fabs.v8f32")
        summed = builder.call(absolute, [apart])
        for half in (4, 2, 1):
            low, high = list(range(half)), list(range(half, 2 * half))
            summed = builder.fadd(_shuffled(builder, summed, low), _shuffled(builder, summed, high))
        return builder.extract_element(summed, ir.Constant(_I32, 0))

    return signature(types.float32, reference, view, aim, types.int64, corner, types.int64), generate
