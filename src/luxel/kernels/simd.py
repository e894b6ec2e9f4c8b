"""Sixteen lanes of float32, int32, uint64 and booleans as Numba types with Python's operators.

Kernels read like the formulas: ``t = b - sqrt(disc)``, ``hit = (t > lo) & (t < hi)``. Scalars mix in and are broadcast.
The types are LLVM vectors, so one source serves AVX-512 (one register), AVX2 (two) and NEON (four).
Arithmetic on vectors assumes no NaN and no infinity (LLVM's nnan, ninf): use `FAR` for "nothing there".
"""

from __future__ import annotations

import operator

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.imputils import lower_builtin, lower_cast
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, models, register_model

__all__ = [
    "FAR", "LANES", "any_lane", "bits", "fma", "fma_one", "fnma", "lane_max", "lane_min", "lane_number", "load", "mask_from_bits",
    "popcount", "select", "splat", "splat_int", "store", "to_float", "to_int", "top_fraction", "trailing_zeros", "vabs", "vfloor", "vmax", "vmin", "vrint", "vsqrt", "with_lane_numbers",
]  # fmt: skip

LANES = 16
FAR = np.float32(1e30)

_F32, _I32, _I1, _I64 = ir.FloatType(), ir.IntType(32), ir.IntType(1), ir.IntType(64)
_FLAGS = ("nnan", "ninf", "nsz", "contract", "arcp")


class _Lanes(types.Type):
    """A vector type; scalars convert to it by broadcasting."""

    def __init__(self, name: str, element: ir.Type) -> None:
        self.vector = ir.VectorType(element, LANES)
        super().__init__(name=f"{name}x{LANES}")


class _FloatLanes(_Lanes):
    pass


class _IntLanes(_Lanes):
    pass


class _WordLanes(_Lanes):
    pass


class _MaskLanes(_Lanes):
    pass


F32 = _FloatLanes("f32", _F32)
I32 = _IntLanes("i32", _I32)
U64 = _WordLanes("u64", _I64)
MASK = _MaskLanes("mask", _I1)


@register_model(_FloatLanes)
@register_model(_IntLanes)
@register_model(_WordLanes)
@register_model(_MaskLanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager, lanes):
        super().__init__(manager, lanes, lanes.vector)


def _broadcast(builder, value, vector):
    undefined = ir.Constant(vector, ir.Undefined)
    first = builder.insert_element(undefined, value, ir.Constant(_I32, 0))
    zeros = ir.Constant(ir.VectorType(_I32, LANES), [0] * LANES)
    return builder.shuffle_vector(first, undefined, zeros)


@lower_cast(types.Float, F32)
@lower_cast(types.Integer, F32)
def _scalar_to_f32(context, builder, source, target, value):
    return _broadcast(builder, context.cast(builder, value, source, types.float32), F32.vector)


@lower_cast(types.Integer, I32)
def _scalar_to_i32(context, builder, source, target, value):
    return _broadcast(builder, context.cast(builder, value, source, types.int32), I32.vector)


@lower_cast(types.Integer, U64)
def _scalar_to_u64(context, builder, source, target, value):
    return _broadcast(builder, context.cast(builder, value, source, types.uint64), U64.vector)


def _is_scalar(kind):
    return isinstance(kind, types.Float | types.Integer)


def _operate(op, lanes, result, emit):
    """Give `op` a meaning for `lanes`, with scalars on either side broadcast."""

    @infer_global(op)
    class _Template(AbstractTemplate):
        def generic(self, args, kws):
            if len(args) == 2 and lanes in args and all(a == lanes or _is_scalar(a) for a in args):
                return signature(result, lanes, lanes)
            return None

    @lower_builtin(op, lanes, lanes)
    def _lower(context, builder, sig, args):
        return emit(builder, *args)


def _arithmetic(name):
    return lambda builder, a, b: getattr(builder, name)(a, b, flags=_FLAGS)


for _op, _name in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _operate(_op, F32, F32, _arithmetic(_name))
for _op, _sign in ((operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">=")):
    _operate(_op, F32, MASK, lambda b, x, y, s=_sign: b.fcmp_ordered(s, x, y))
for _op, _sign in ((operator.eq, "=="), (operator.ne, "!="), (operator.ge, ">="), (operator.lt, "<")):
    _operate(_op, I32, MASK, lambda b, x, y, s=_sign: b.icmp_signed(s, x, y))
for _op, _name in (
    (operator.add, "add"),
    (operator.mul, "mul"),
    (operator.xor, "xor"),
    (operator.rshift, "lshr"),
):
    _operate(_op, U64, U64, lambda b, x, y, name=_name: getattr(b, name)(x, y))
_operate(operator.and_, MASK, MASK, lambda b, x, y: b.and_(x, y))
_operate(operator.or_, MASK, MASK, lambda b, x, y: b.or_(x, y))


@infer_global(operator.neg)
class _NegateTemplate(AbstractTemplate):
    def generic(self, args, kws):
        return signature(F32, F32) if args == (F32,) else None


@lower_builtin(operator.neg, F32)
def _negate(context, builder, sig, args):
    return builder.fneg(args[0])


def _call(builder, name, result, args):
    function = cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(result, [a.type for a in args]), name
    )
    return builder.call(function, args)


def _pointer(context, builder, array_type, array, offset, vector):
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [offset]), vector.as_pointer())


def _lanes_of(array):
    return {types.float32: F32, types.int32: I32, types.uint64: U64}.get(array.dtype)


@intrinsic
def load(typingctx, array, offset):
    """Load sixteen elements of a flat float32, int32 or uint64 array from `offset` on."""
    lanes = _lanes_of(array)

    def emit(context, builder, sig, args):
        pointer = _pointer(context, builder, sig.args[0], args[0], args[1], lanes.vector)
        return builder.load(pointer, align=4, typ=lanes.vector)

    return lanes(array, types.intp), emit


@intrinsic
def store(typingctx, array, offset, value):
    """Store sixteen lanes into a flat array from `offset` on."""

    def emit(context, builder, sig, args):
        vector = sig.args[2].vector
        builder.store(args[2], _pointer(context, builder, sig.args[0], args[0], args[1], vector), align=4)
        return context.get_dummy_value()

    return types.none(array, types.intp, value), emit


@intrinsic
def splat(typingctx, x):
    """Broadcast a number to float lanes."""
    return F32(types.float32), lambda context, builder, sig, args: _broadcast(builder, args[0], F32.vector)


@intrinsic
def splat_int(typingctx, x):
    """Broadcast a whole number to int lanes."""
    return I32(types.int32), lambda context, builder, sig, args: _broadcast(builder, args[0], I32.vector)


@intrinsic
def top_fraction(typingctx, word):
    """The top 24 bits of each lane as a fraction in [0, 1)."""

    def emit(context, builder, sig, args):
        top = builder.lshr(args[0], ir.Constant(U64.vector, [40] * LANES))
        whole = builder.sitofp(builder.trunc(top, I32.vector), F32.vector)
        return builder.fmul(whole, ir.Constant(F32.vector, [2.0**-24] * LANES), flags=_FLAGS)

    return F32(U64), emit


def _ternary(name, negate):
    @intrinsic
    def operation(typingctx, a, b, c):
        def emit(context, builder, sig, args):
            x, y, z = args
            return _call(
                builder, f"llvm.fma.v{LANES}f32", F32.vector, [builder.fneg(x) if negate else x, y, z]
            )

        return F32(F32, F32, F32), emit

    operation.__name__ = name
    return operation


fma = _ternary("fma", negate=False)  # a*b + c
fnma = _ternary("fnma", negate=True)  # c - a*b


@intrinsic
def fma_one(typingctx, a, b, c):
    """a·b + c of single numbers, rounded once on every processor, and added up in the order in which it is written."""

    def emit(context, builder, sig, args):
        return _call(builder, "llvm.fma.f32", _F32, list(args))

    return types.float32(types.float32, types.float32, types.float32), emit


def _unary(name, intrinsic_name):
    @intrinsic
    def operation(typingctx, a):
        return F32(F32), lambda context, builder, sig, args: _call(
            builder, intrinsic_name, F32.vector, list(args)
        )

    operation.__name__ = name
    return operation


vsqrt = _unary("vsqrt", f"llvm.sqrt.v{LANES}f32")
vabs = _unary("vabs", f"llvm.fabs.v{LANES}f32")
vfloor = _unary("vfloor", f"llvm.floor.v{LANES}f32")
vrint = _unary("vrint", f"llvm.rint.v{LANES}f32")


def _extremum(name, sign):
    @intrinsic
    def operation(typingctx, a, b):
        def emit(context, builder, sig, args):
            return builder.select(builder.fcmp_ordered(sign, *args), *args)

        return F32(F32, F32), emit

    operation.__name__ = name
    return operation


vmin = _extremum("vmin", "<")
vmax = _extremum("vmax", ">")


@intrinsic
def select(typingctx, mask, a, b):
    """Lanes of `a` where the mask is set, of `b` elsewhere."""
    return a(MASK, a, a), lambda context, builder, sig, args: builder.select(*args)


@intrinsic
def bits(typingctx, mask):
    """The mask as an integer, lane 0 in bit 0."""

    def emit(context, builder, sig, args):
        return builder.zext(builder.bitcast(args[0], ir.IntType(LANES)), _I64)

    return types.int64(MASK), emit


@intrinsic
def mask_from_bits(typingctx, value):
    """Inverse of `bits`."""

    def emit(context, builder, sig, args):
        return builder.bitcast(builder.trunc(args[0], ir.IntType(LANES)), MASK.vector)

    return MASK(types.int64), emit


@intrinsic
def with_lane_numbers(typingctx, a):
    """Positive floats whose last four bits tell their lanes: the least of them tells where it was, see `lane_number`."""

    def emit(context, builder, sig, args):
        words = builder.bitcast(args[0], I32.vector)
        words = builder.and_(words, ir.Constant(I32.vector, [-LANES] * LANES))
        return builder.bitcast(builder.or_(words, ir.Constant(I32.vector, list(range(LANES)))), F32.vector)

    return F32(F32), emit


@intrinsic
def lane_number(typingctx, x):
    """The lane that a number comes from, see `with_lane_numbers`."""

    def emit(context, builder, sig, args):
        word = builder.and_(builder.bitcast(args[0], _I32), ir.Constant(_I32, LANES - 1))
        return builder.zext(word, _I64)

    return types.int64(types.float32), emit


@intrinsic
def to_int(typingctx, a):
    """Whole part of each lane, rounded towards zero; it must fit 32 bits."""
    return I32(F32), lambda context, builder, sig, args: builder.fptosi(args[0], I32.vector)


@intrinsic
def to_float(typingctx, a):
    """Lanes of whole numbers as floats."""
    return F32(I32), lambda context, builder, sig, args: builder.sitofp(args[0], F32.vector)


@intrinsic
def any_lane(typingctx, mask):
    """Whether any lane is set."""

    def emit(context, builder, sig, args):
        word = builder.bitcast(args[0], ir.IntType(LANES))
        return builder.icmp_unsigned("!=", word, ir.Constant(ir.IntType(LANES), 0))

    return types.boolean(MASK), emit


@intrinsic
def trailing_zeros(typingctx, value):
    """Index of the lowest set bit; undefined for 0."""

    def emit(context, builder, sig, args):
        return _call(builder, "llvm.cttz.i64", _I64, [args[0], ir.Constant(_I1, 1)])

    return types.int64(types.int64), emit


@intrinsic
def popcount(typingctx, value):
    """Number of set bits."""
    return types.int64(types.int64), lambda context, builder, sig, args: _call(
        builder, "llvm.ctpop.i64", _I64, [args[0]]
    )


def _reduction(name, which):
    @intrinsic
    def operation(typingctx, a):
        def emit(context, builder, sig, args):
            call = _call(builder, f"llvm.vector.reduce.{which}.v{LANES}f32", _F32, [args[0]])
            call.fastmath.add("nnan")
            return call

        return types.float32(F32), emit

    operation.__name__ = name
    return operation


lane_min = _reduction("lane_min", "fmin")
lane_max = _reduction("lane_max", "fmax")
