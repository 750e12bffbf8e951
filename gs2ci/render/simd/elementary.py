"""exp, log and the blending exponential on 16-lane vectors, accurate to float32 rounding or stated otherwise.

All polynomials are derived here from series or interpolation; none is a table of numbers to be believed.
"""

import math
from typing import Any, Final

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.core.typing.templates import signature
from numba.extending import intrinsic

from gs2ci.render.simd.vector import (
    FLAGS,
    VECTOR,
    VECTOR_I32,
    call_llvm,
    constant,
    constant_i32,
    elementwise,
    vec16,
)

LOG2E: Final = 1.0 / math.log(2.0)
LN2: Final = math.log(2.0)

_MANTISSA_BITS: Final = 23
_LARGEST_EXPONENT: Final = 126.0
_EXP2_TAYLOR: Final = tuple(LN2**k / math.factorial(k) for k in range(8))
"""2^f = sum (f ln 2)^k / k!; the first term left out is below 6e-9 for |f| <= 1/2."""
_ATANH_SERIES: Final = tuple(2.0 / (2 * k + 1) for k in range(5))
"""log m = 2 atanh r = sum 2 r^(2k+1) / (2k+1), r = (m - 1)/(m + 1); left out: below 5e-9 of the value."""

_EXP2_HALF: Final = tuple(
    np.polynomial.Chebyshev.interpolate(np.exp2, 5, domain=[-0.5, 0.5])
    .convert(kind=np.polynomial.Polynomial)
    .coef.tolist()
)
"""2^f on [-1/2, 1/2] to 2e-7."""
_TO_WHOLE: Final = 1.5 * 2.0**_MANTISSA_BITS
"""Added to a number below 2^22, this leaves it rounded to a whole one in the last bits of the mantissa."""


def _polynomial(builder: ir.IRBuilder, x: Any, coefficients: tuple[float, ...]) -> Any:
    """Evaluate sum coefficients[k] x^k by Horner's rule."""
    value = constant(coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        value = builder.fadd(builder.fmul(value, x, flags=FLAGS), constant(coefficient), flags=FLAGS)
    return value


def _clamp(builder: ir.IRBuilder, x: Any, low: float, high: float) -> Any:
    x = builder.select(builder.fcmp_ordered(">", x, constant(low)), x, constant(low))
    return builder.select(builder.fcmp_ordered("<", x, constant(high)), x, constant(high))


def _emit_exponential(builder: ir.IRBuilder, x: Any) -> Any:
    power = builder.fmul(x, constant(LOG2E), flags=FLAGS)
    power = _clamp(builder, power, -_LARGEST_EXPONENT, _LARGEST_EXPONENT)
    whole = call_llvm(builder, "llvm.rint.v16f32", power)
    fraction = _polynomial(builder, builder.fsub(power, whole, flags=FLAGS), _EXP2_TAYLOR)
    # Adding to the exponent bits multiplies by a power of two.
    exponent = builder.shl(builder.fptosi(whole, VECTOR_I32), constant_i32(_MANTISSA_BITS))
    return builder.bitcast(builder.add(builder.bitcast(fraction, VECTOR_I32), exponent), VECTOR)


def _emit_logarithm(builder: ir.IRBuilder, x: Any) -> Any:
    # x = m 2^e with m in [sqrt(1/2), sqrt(2)): rounding the exponent at the bits of sqrt(1/2).
    bits = builder.bitcast(x, VECTOR_I32)
    root_half = constant_i32(int(np.float32(math.sqrt(0.5)).view(np.int32)))
    exponent = builder.ashr(builder.sub(bits, root_half), constant_i32(_MANTISSA_BITS))
    mantissa = builder.bitcast(builder.sub(bits, builder.shl(exponent, constant_i32(_MANTISSA_BITS))), VECTOR)
    below, above = (
        builder.fsub(mantissa, constant(1.0), flags=FLAGS),
        builder.fadd(mantissa, constant(1.0), flags=FLAGS),
    )
    r = builder.fdiv(below, above, flags=FLAGS)
    series = _polynomial(builder, builder.fmul(r, r, flags=FLAGS), _ATANH_SERIES)
    whole = builder.fmul(builder.sitofp(exponent, VECTOR), constant(LN2), flags=FLAGS)
    return builder.fadd(builder.fmul(r, series, flags=FLAGS), whole, flags=FLAGS)


def _emit_exp2_blend(builder: ir.IRBuilder, xs: list[Any]) -> list[Any]:
    """Emit it for several vectors, step by step of all, so that none waits for the step before."""
    shifted = [builder.fadd(x, constant(_TO_WHOLE)) for x in xs]
    whole = [builder.fsub(each, constant(_TO_WHOLE)) for each in shifted]
    fractions = [builder.fsub(x, each) for x, each in zip(xs, whole, strict=True)]
    values = [constant(_EXP2_HALF[-1])] * len(xs)
    for coefficient in _EXP2_HALF[-2::-1]:
        values = [builder.fmul(value, f, flags=FLAGS) for value, f in zip(values, fractions, strict=True)]
        values = [builder.fadd(value, constant(coefficient), flags=FLAGS) for value in values]
    shift = constant_i32(_MANTISSA_BITS)
    exponents = [builder.shl(builder.bitcast(each, VECTOR_I32), shift) for each in shifted]
    bits = [
        builder.add(builder.bitcast(value, VECTOR_I32), each) for value, each in zip(values, exponents, strict=True)
    ]
    return [builder.bitcast(each, VECTOR) for each in bits]


@intrinsic
def exp2_blend_4(typing: Any, a: Any, b: Any, c: Any, d: Any) -> Any:
    """Return `exp2_blend` of four vectors; three of them hide what each waits for."""
    del typing, a, b, c, d
    four = types.containers.UniTuple(vec16, 4)

    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Any:
        del sig
        return context.make_tuple(builder, four, _emit_exp2_blend(builder, list(args)))

    return signature(four, vec16, vec16, vec16, vec16), generate


exponential: Final = elementwise(_emit_exponential)
"""exponential(x): e^x; x beyond +-87 is cut there, so the result is always finite and positive."""
logarithm: Final = elementwise(_emit_logarithm)
"""logarithm(x): ln x for positive normal x."""
exp2_blend: Final = elementwise(lambda builder, x: _emit_exp2_blend(builder, [x])[0])
"""exp2_blend(x): 2^x for x in [-126, 0], to 4e-7 of the value, in ten instructions, half of them no multiplications;
lower x give any number."""
