"""Compute with lanes of LANES doubles, each a few vector registers of the processor.

Lanes are loaded from addresses, so an operand may be anywhere, in a row of the interpreter or in the
caller's arrays, and nothing is copied; whole-lane vectors need no checks for overlap.
"""

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.datamodel import models
from numba.extending import intrinsic, register_model

from gtau.model.interpreter.instructions import FOLLOWER, LANES, WIDE

compiled: Any = numba.njit(nogil=True, error_model="numpy")

_DOUBLE = ir.DoubleType()
_LANE = ir.VectorType(_DOUBLE, LANES)
_intrinsic: Any = intrinsic


class _LaneType(types.Type):
    """Numba type of a lane while it is in the processor's registers."""

    def __init__(self) -> None:
        super().__init__(name=f"Lane{LANES}")


_lane = _LaneType()


@register_model(_LaneType)
class _LaneModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _LANE)


def _operation(operands: int, compute: Callable[..., Any]) -> Any:
    """Make a function of the given lanes that returns a lane."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return compute(builder, *arguments)

    signature = _lane(*[_lane] * operands)
    if operands == 1:
        return _intrinsic(lambda typing, a: (signature, code))
    if operands == 2:
        return _intrinsic(lambda typing, a, b: (signature, code))
    return _intrinsic(lambda typing, a, b, c: (signature, code))


def _call(name: str, operands: int) -> Callable[..., Any]:
    """Make a call of LLVM's vector function."""

    def compute(builder: Any, *values: Any) -> Any:
        kind = ir.FunctionType(_LANE, [_LANE] * operands)
        function = builder.module.globals.get(f"llvm.{name}.v{LANES}f64")
        return builder.call(function or ir.Function(builder.module, kind, f"llvm.{name}.v{LANES}f64"), values)

    return compute


def _sign(builder: Any, a: Any) -> Any:
    minus, zero, plus = (ir.Constant(_LANE, [value] * LANES) for value in (-1.0, 0.0, 1.0))
    below = builder.select(builder.fcmp_ordered("<", a, zero), minus, a)  # zero and nan stay what they are
    return builder.select(builder.fcmp_ordered(">", a, zero), plus, below)


add = _operation(2, lambda builder, a, b: builder.fadd(a, b))
subtract = _operation(2, lambda builder, a, b: builder.fsub(a, b))
multiply = _operation(2, lambda builder, a, b: builder.fmul(a, b))
divide = _operation(2, lambda builder, a, b: builder.fdiv(a, b))
negate = _operation(1, lambda builder, a: builder.fneg(a))
square_root = _operation(1, _call("sqrt", 1))
absolute = _operation(1, _call("fabs", 1))
maximum = _operation(2, _call("maximum", 2))  # nan if either is, so that a test on it fails
sign = _operation(1, _sign)
multiply_add = _operation(3, _call("fma", 3))  # a b + c
multiply_subtract = _operation(3, lambda builder, a, b, c: _call("fma", 3)(builder, a, b, builder.fneg(c)))  # a b - c
subtract_product = _operation(3, lambda builder, a, b, c: _call("fma", 3)(builder, builder.fneg(a), b, c))  # c - a b


@_intrinsic
def undefined(typing):  # type: ignore[no-untyped-def]
    """Return a lane of undefined numbers."""
    return _lane(), lambda context, builder, signature, arguments: ir.Constant(_LANE, ir.Undefined)


@_intrinsic
def load(typing, address):  # type: ignore[no-untyped-def]
    """Load the lane at an address."""

    def code(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return builder.load(builder.inttoptr(arguments[0], _LANE.as_pointer()), align=8)

    return _lane(types.int64), code


@_intrinsic
def store(typing, address, value):  # type: ignore[no-untyped-def]
    """Store a lane at an address."""

    def code(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        builder.store(arguments[1], builder.inttoptr(arguments[0], _LANE.as_pointer()), align=8)
        return context.get_dummy_value()

    return types.void(types.int64, _lane), code


def _pointer(kind: Any, stored: ir.Type) -> Any:
    """Make a function that turns an address into a pointer to numbers of a kind."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], stored.as_pointer())

    return _intrinsic(lambda typing, address: (types.CPointer(kind)(types.int64), code))


to_doubles = _pointer(types.float64, _DOUBLE)
to_words = _pointer(types.uint32, ir.IntType(32))
to_addresses = _pointer(types.int64, ir.IntType(64))
to_flags = _pointer(types.boolean, ir.IntType(8))
to_followers = _pointer(numba.from_dtype(FOLLOWER), ir.ArrayType(ir.IntType(8), FOLLOWER.itemsize))


def _local(kind: Any, stored: ir.Type) -> Any:
    """Make a function that returns a pointer to LANES numbers of a kind on the stack of its caller."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return cgutils.alloca_once(builder, stored, LANES)

    return _intrinsic(lambda typing: (types.CPointer(kind)(), code))


doubles = _local(types.float64, _DOUBLE)
flags = _local(types.boolean, ir.IntType(8))


@_intrinsic
def transpose(typing, sources, targets):  # type: ignore[no-untyped-def]
    """Put the columns of WIDE by WIDE doubles, whose rows' addresses are at ``sources``, at those at ``targets``."""

    def code(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        vector = ir.VectorType(_DOUBLE, WIDE)

        def place(addresses, k):  # type: ignore[no-untyped-def]
            pointer = builder.inttoptr(addresses, ir.IntType(64).as_pointer())
            address = builder.load(builder.gep(pointer, [ir.Constant(ir.IntType(64), k)]))
            return builder.inttoptr(address, vector.as_pointer())

        rows = [builder.load(place(arguments[0], k), align=8) for k in range(WIDE)]
        for half in (4, 2, 1):  # swap the off-diagonal blocks, ever smaller
            index = np.arange(WIDE)
            low = np.where(index & half, index - half + WIDE, index)
            masks = [ir.Constant(ir.VectorType(ir.IntType(32), WIDE), mask.tolist()) for mask in (low, low + half)]
            for k in index[(index & half) == 0]:
                pair = rows[k], rows[k + half]
                rows[k], rows[k + half] = (builder.shuffle_vector(*pair, mask) for mask in masks)
        for k, row in enumerate(rows):
            builder.store(row, place(arguments[1], k), align=8)
        return context.get_dummy_value()

    return types.void(types.int64, types.int64), code


@_intrinsic
def call(typing, function, code, count, rows):  # type: ignore[no-untyped-def]
    """Call the function at an address with three whole numbers."""

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        number = ir.IntType(64)
        kind = ir.FunctionType(ir.VoidType(), [number] * 3).as_pointer()
        builder.call(builder.inttoptr(arguments[0], kind), arguments[1:])
        return context.get_dummy_value()

    return types.void(*[types.int64] * 4), generate


@_intrinsic
def _fma(typing, a, b, c):  # type: ignore[no-untyped-def]
    def code(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return builder.fma(*arguments)

    return types.float64(types.float64, types.float64, types.float64), code


@_intrinsic
def _bits(typing, x):  # type: ignore[no-untyped-def]
    def code(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return builder.bitcast(arguments[0], ir.IntType(64))

    return types.int64(types.float64), code


@compiled
def lane(address):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """View the lane at an address as an array (LANES,)."""
    return numba.carray(to_doubles(address), (LANES,))  # type: ignore[attr-defined]


# pi/2 in three parts, and polynomials in r^2 on |r| <= pi/4 that interpolate at Chebyshev's points:
# sin r = r + r^3 S(r^2) to 2e-17 and cos r = 1 - r^2/2 + r^4 C(r^2) to 7e-19 of their values
_P1, _P2, _P3 = 1.5707963267948966, 6.123233995736766e-17, -1.4973849048591698e-33
_S0, _S1, _S2 = -0.16666666666666666, 0.008333333333330925, -0.00019841269836722437
_S3, _S4, _S5 = 2.755731608382574e-06, -2.505112794596564e-08, 1.591784866512194e-10
_C0, _C1, _C2 = 0.041666666666666664, -0.0013888888888887382, 2.480158729874308e-05
_C3, _C4, _C5 = -2.755731726001471e-07, 2.0876143829213935e-09, -1.1382456865840483e-11
_ROUND = 6755399441055744.0  # 1.5 * 2^52: what is added to it is rounded to an integer
_FAR = 1e9  # rad: beyond, the quadrant needs more digits than this reduction keeps


@compiled
def sine_cosine(sines, cosines, angles):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Compute sine and cosine (LANES,) of angles, to about a unit in the last place."""
    far = False
    for n in range(LANES):
        x = angles[n]
        far |= abs(x) > _FAR
        shifted = _fma(x, 2 / np.pi, _ROUND)
        turns = shifted - _ROUND
        quadrant = _bits(shifted)
        r = _fma(-turns, _P3, _fma(-turns, _P2, _fma(-turns, _P1, x)))
        z = r * r
        s = _fma(z, _fma(z, _fma(z, _fma(z, _fma(z, _S5, _S4), _S3), _S2), _S1), _S0)
        s = _fma(r * z, s, r)
        c = _fma(z, _fma(z, _fma(z, _fma(z, _fma(z, _C5, _C4), _C3), _C2), _C1), _C0)
        half = 0.5 * z
        w = 1.0 - half
        c = w + _fma(z * z, c, (1.0 - w) - half)
        odd = (quadrant & 1) != 0
        sine, cosine = (c, s) if odd else (s, c)
        sines[n] = -sine if (quadrant & 2) != 0 else sine
        cosines[n] = -cosine if ((quadrant + 1) & 2) != 0 else cosine
    if far:
        for n in range(LANES):
            if abs(angles[n]) > _FAR:
                sines[n], cosines[n] = np.sin(angles[n]), np.cos(angles[n])
