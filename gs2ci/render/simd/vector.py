"""A vector of 16 float32 lanes for Numba kernels: its type, arithmetic, comparison and memory access.

Each operation emits one LLVM instruction on <16 x float>, which LLVM turns into what the host has (one AVX-512
register, two AVX2, four NEON). Kernels so written need no auto-vectoriser and run at the same speed from one compiler
version to the next. Not here: exp and log (`elementary.py`), transposes (`lanes.py`).

In kernels, `a + b`, `a * 2.0`, `1.0 / a` mean what they say; scalars are spread over all lanes. The functions
below read as follows: `array` is a one-dimensional C-contiguous array, an offset counts its elements, and nothing
checks bounds.
"""

import operator
from collections.abc import Callable
from typing import Any, Final

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

LANES: Final = 16

I32: Final = ir.IntType(32)
I64: Final = ir.IntType(64)
FLOAT: Final = ir.FloatType()
VECTOR: Final = ir.VectorType(FLOAT, LANES)
VECTOR_I32: Final = ir.VectorType(I32, LANES)
MASK_BITS: Final = ir.IntType(LANES)
FLAGS: Final = ("contract",)
"""As `gs2ci.core.kernels.FUSED`: multiply-adds may be fused, nothing else is relaxed."""
_FLOAT_ALIGNMENT: Final = 4


class Vec16(types.Type):
    """Numba's name for 16 float32 lanes."""

    def __init__(self) -> None:
        super().__init__(name="Vec16")


vec16: Final = Vec16()


@register_model(Vec16)
class _Vec16Model(models.PrimitiveModel):
    def __init__(self, manager: Any, type_: Vec16) -> None:
        super().__init__(manager, type_, VECTOR)


# ---------------------------------------------------------------------------------------- helpers for intrinsics


def constant(value: float) -> ir.Constant:
    """Spread a number known at compile time over all lanes."""
    return ir.Constant(VECTOR, [float(value)] * LANES)


def constant_i32(value: int) -> ir.Constant:
    """Spread an integer known at compile time over all lanes."""
    return ir.Constant(VECTOR_I32, [int(value)] * LANES)


def spread(builder: ir.IRBuilder, value: Any) -> Any:
    """Turn a float32 or float64 value into a vector; leave a vector as it is."""
    if value.type == VECTOR:
        return value
    if value.type == ir.DoubleType():
        value = builder.fptrunc(value, FLOAT)
    undefined = ir.Constant(VECTOR, ir.Undefined)
    single = builder.insert_element(undefined, value, ir.Constant(I32, 0))
    return builder.shuffle_vector(single, undefined, constant_i32(0))


def call_llvm(builder: ir.IRBuilder, name: str, *args: Any) -> Any:
    """Call an LLVM intrinsic that maps vectors to a vector."""
    function = cgutils.get_or_insert_function(builder.module, ir.FunctionType(VECTOR, [a.type for a in args]), name)
    return builder.call(function, args)


def element_pointer(context: Any, builder: ir.IRBuilder, array_type: Any, array: Any, offset: Any) -> Any:
    """Point at an element of a Numba array."""
    data = context.make_array(array_type)(context, builder, array).data
    return builder.gep(data, [offset])


def load_vector(builder: ir.IRBuilder, pointer: Any) -> Any:
    """Load 16 floats that need not be aligned."""
    return builder.load(builder.bitcast(pointer, VECTOR.as_pointer()), align=_FLOAT_ALIGNMENT)


def store_vector(builder: ir.IRBuilder, value: Any, pointer: Any) -> None:
    """Store 16 floats that need not be aligned."""
    builder.store(value, builder.bitcast(pointer, VECTOR.as_pointer()), align=_FLOAT_ALIGNMENT)


# ----------------------------------------------------------------------------------------------------- arithmetic


# What is for one target stands before what is for all. Else two dozen meanings of "+" (strings, dates, lists, ...) are
# tried, and refused with a message, before each addition of vectors is found.
_TRIED_FIRST: Final = {"target": "CPU"}


def _register_operator(function: Callable[..., Any], instruction: str) -> None:
    scalars = (types.float32, types.float64)
    pairs = [(vec16, vec16), *((vec16, s) for s in scalars), *((s, vec16) for s in scalars)]

    class Template(ConcreteTemplate):
        cases = [signature(vec16, a, b) for a, b in pairs]  # noqa: RUF012  (Numba's protocol)
        metadata = _TRIED_FIRST

    infer_global(function)(Template)

    def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Any:
        del context, sig
        emit = getattr(builder, instruction)
        return emit(spread(builder, args[0]), spread(builder, args[1]), flags=FLAGS)

    for a, b in pairs:
        lower_builtin(function, a, b)(lower)


for _function, _instruction in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _register_operator(_function, _instruction)


class _Negation(ConcreteTemplate):
    cases = [signature(vec16, vec16)]  # noqa: RUF012  (Numba's protocol)
    metadata = _TRIED_FIRST


infer_global(operator.neg)(_Negation)


@lower_builtin(operator.neg, vec16)
def _lower_negation(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Any:
    del context, sig
    return builder.fneg(args[0])


def elementwise(emit: Callable[..., Any], result: Any = vec16) -> Any:
    """Make a kernel function of vectors and scalars from a function that emits LLVM code."""
    arity = emit.__code__.co_argcount - 1

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Any:
        del context, sig
        return emit(builder, *(spread(builder, a) for a in args))

    # Numba counts the parameters of an intrinsic, so each arity needs a function of its own.
    if arity == 1:
        return intrinsic(lambda typing, a: (signature(result, a), generate))
    if arity == 2:
        return intrinsic(lambda typing, a, b: (signature(result, a, b), generate))
    if arity == 3:
        return intrinsic(lambda typing, a, b, c: (signature(result, a, b, c), generate))
    return intrinsic(lambda typing, a, b, x, y: (signature(result, a, b, x, y), generate))


def _emit_minimum(builder: ir.IRBuilder, a: Any, b: Any) -> Any:
    return builder.select(builder.fcmp_ordered("<", a, b), a, b)


def _emit_maximum(builder: ir.IRBuilder, a: Any, b: Any) -> Any:
    return builder.select(builder.fcmp_ordered(">", a, b), a, b)


def _emit_where_ge(builder: ir.IRBuilder, a: Any, b: Any, x: Any, y: Any) -> Any:
    return builder.select(builder.fcmp_ordered(">=", a, b), x, y)


def _emit_any_ge(builder: ir.IRBuilder, a: Any, b: Any) -> Any:
    lanes = builder.bitcast(builder.fcmp_ordered(">=", a, b), MASK_BITS)
    return builder.icmp_unsigned("!=", lanes, ir.Constant(MASK_BITS, 0))


broadcast: Final = elementwise(lambda builder, a: a)
"""broadcast(scalar): the scalar in all lanes."""
minimum: Final = elementwise(_emit_minimum)
"""minimum(a, b), lane by lane; b where a is NaN."""
maximum: Final = elementwise(_emit_maximum)
"""maximum(a, b), lane by lane; b where a is NaN."""
where_ge: Final = elementwise(_emit_where_ge)
"""where_ge(a, b, x, y): x where a >= b, else y, lane by lane."""
any_ge: Final = elementwise(_emit_any_ge, types.boolean)
"""any_ge(a, b): whether a >= b in any lane."""
square_root: Final = elementwise(lambda builder, a: call_llvm(builder, "llvm.sqrt.v16f32", a))
"""square_root(a), correctly rounded."""
floor: Final = elementwise(lambda builder, a: call_llvm(builder, "llvm.floor.v16f32", a))
"""floor(a)."""
ceil: Final = elementwise(lambda builder, a: call_llvm(builder, "llvm.ceil.v16f32", a))
"""ceil(a)."""
fused: Final = elementwise(lambda builder, a, b, c: call_llvm(builder, "llvm.fma.v16f32", a, b, c))
"""fused(a, b, c): a b + c, rounded once; for sums of two products, of which the compiler else chooses which to fuse."""


@intrinsic
def sum_of_lanes(typing: Any, a: Any) -> Any:
    """Add up the lanes of a vector, in pairs, pairs of pairs and so on, whatever the processor."""
    del typing

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Any:
        del context, sig
        value, undefined, half = args[0], ir.Constant(VECTOR, ir.Undefined), LANES // 2
        while half:
            order = [(lane + half) % LANES for lane in range(LANES)]
            folded = builder.shuffle_vector(value, undefined, ir.Constant(VECTOR_I32, order))
            value, half = builder.fadd(value, folded), half // 2
        return builder.extract_element(value, ir.Constant(I32, 0))

    return signature(types.float32, a), generate


# --------------------------------------------------------------------------------------------------------- memory


@intrinsic
def load(typing: Any, array: Any, offset: Any) -> Any:
    """Load 16 consecutive floats."""
    del typing, offset

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Any:
        return load_vector(builder, element_pointer(context, builder, sig.args[0], *args))

    return signature(vec16, array, types.int64), generate


@intrinsic
def store(typing: Any, array: Any, offset: Any, value: Any) -> Any:
    """Store a vector as 16 consecutive floats."""
    del typing, offset, value

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Any:
        store_vector(builder, args[2], element_pointer(context, builder, sig.args[0], args[0], args[1]))
        return context.get_dummy_value()

    return signature(types.none, array, types.int64, vec16), generate


@intrinsic
def store_as_int32(typing: Any, array: Any, offset: Any, value: Any) -> Any:
    """Store a vector of whole numbers as 16 consecutive int32; they must lie within int32."""
    del typing, offset, value

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Any:
        pointer = element_pointer(context, builder, sig.args[0], args[0], args[1])
        whole = builder.fptosi(args[2], VECTOR_I32)
        builder.store(whole, builder.bitcast(pointer, VECTOR_I32.as_pointer()), align=_FLOAT_ALIGNMENT)
        return context.get_dummy_value()

    return signature(types.none, array, types.int64, vec16), generate


@intrinsic
def get(typing: Any, array: Any, offset: Any) -> Any:
    """Read array[offset] without Numba's detour for negative indices (it costs a branch in the inner loop)."""
    del typing, offset

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Any:
        return builder.load(element_pointer(context, builder, sig.args[0], *args))

    return signature(array.dtype, array, types.int64), generate


@intrinsic
def put(typing: Any, array: Any, offset: Any, value: Any) -> Any:
    """Write array[offset] = value without Numba's detour for negative indices."""
    del typing, offset, value

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Any:
        builder.store(args[2], element_pointer(context, builder, sig.args[0], args[0], args[1]))
        return context.get_dummy_value()

    return signature(types.none, array, types.int64, array.dtype), generate


@intrinsic
def prefetch(typing: Any, array: Any, offset: Any) -> Any:
    """Ask for the cache line of array[offset] before it is needed."""
    del typing, offset

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Any:
        pointer = element_pointer(context, builder, sig.args[0], *args)
        pointer = builder.bitcast(pointer, ir.IntType(8).as_pointer())
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(ir.VoidType(), [pointer.type, I32, I32, I32]), "llvm.prefetch.p0"
        )
        for_reading, keep_in_all_levels, data = 0, 3, 1
        builder.call(function, [pointer, *(ir.Constant(I32, k) for k in (for_reading, keep_in_all_levels, data))])
        return context.get_dummy_value()

    return signature(types.none, array, types.int64), generate
