"""Four dot products at once, of one record with the basis of four texels: what a lookup in a compressed texture comes to.

Whole numbers go eight at a time through the multiply-and-add of pairs that every vector unit has (x86 `pmaddwd`, NEON `smlal`); LLVM
finds it behind the plain widening product below. Floats go sixteen at a time. The four sums are then added up by one tree of shuffles.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.core.datamodel import models
from numba.extending import intrinsic, register_model

from luxel.kernels.simd import F32, I32, LANES

__all__ = [
    "dot8",
    "eight_bytes",
    "floors",
    "floors_of_lanes",
    "load_bytes",
    "load_four",
    "load_fours",
    "store_four",
]

_I8, _I16, _I32, _I64 = (ir.IntType(n) for n in (8, 16, 32, 64))
_EIGHT, _FOUR = ir.VectorType(_I32, 8), ir.VectorType(_I32, 4)
_FLAGS = ("nnan", "ninf", "nsz", "contract", "reassoc")


class _Four(types.Type):
    """Four int32: partial sums, or codes of four texels."""

    def __init__(self):
        super().__init__(name="i32x4")


FOUR = _Four()


@register_model(_Four)
class _FourModel(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, _FOUR)


def _address(context, builder, kind, array, at, vector):
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [at]), vector.as_pointer())


def _shuffled(builder, a, b, *places):
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(_I32, len(places)), list(places)))


def _everywhere(builder, value):
    first = builder.insert_element(ir.Constant(ir.VectorType(value.type, 4), ir.Undefined), value, _I32(0))
    return _shuffled(builder, first, first, 0, 0, 0, 0)


@intrinsic
def eight_bytes(typingctx, array, at):
    """Eight bytes of a contiguous uint8 array from byte `at` on, as one int64."""

    def emit(context, builder, sig, args):
        pointer = _address(context, builder, sig.args[0], args[0], args[1], _I64)
        return builder.load(pointer, align=1, typ=_I64)

    return types.int64(array, types.intp), emit


@intrinsic
def load_four(typingctx, array, at):
    """Four int32 from element `at` of a contiguous int16 array on."""

    def emit(context, builder, sig, args):
        pointer = _address(context, builder, sig.args[0], args[0], args[1], _FOUR)
        return builder.load(pointer, align=2, typ=_FOUR)

    return FOUR(array, types.intp), emit


@intrinsic
def store_four(typingctx, array, at, four):
    """Store to a contiguous int32 array from element `at` on."""

    def emit(context, builder, sig, args):
        builder.store(args[2], _address(context, builder, sig.args[0], args[0], args[1], _FOUR), align=4)
        return context.get_dummy_value()

    return types.none(array, types.intp, FOUR), emit


@intrinsic
def load_fours(typingctx, array):
    """First elements of sixteen fours at the start of an int32 array as int lanes, then the second ones, and so on."""

    def emit(context, builder, sig, args):
        size = 4 * LANES
        every = ir.VectorType(_I32, size)
        pointer = _address(context, builder, sig.args[0], args[0], ir.Constant(_I64, 0), every)
        words = builder.load(pointer, align=4, typ=every)
        lanes = [_shuffled(builder, words, words, *range(k, size, 4)) for k in range(4)]
        return context.make_tuple(builder, sig.return_type, lanes)

    return types.UniTuple(I32, 4)(array), emit


@intrinsic
def dot8(typingctx, sums, rows, at, factors):
    """Add to four sums the products of eight int16 of a contiguous array, from element `at` on, with the eight bytes of `factors`."""

    def emit(context, builder, sig, args):
        sums, rows, at, factors = args
        narrow = ir.VectorType(_I16, 8)
        pointer = _address(context, builder, sig.args[1], rows, at, narrow)
        a = builder.sext(builder.load(pointer, align=2, typ=narrow), _EIGHT)
        b = builder.zext(builder.bitcast(factors, ir.VectorType(_I8, 8)), _EIGHT)
        products = builder.mul(a, b, flags=("nsw",))
        pairs = builder.add(
            _shuffled(builder, products, products, 0, 2, 4, 6),
            _shuffled(builder, products, products, 1, 3, 5, 7),
        )
        return builder.add(sums, pairs)

    return FOUR(FOUR, rows, types.intp, types.int64), emit


@intrinsic
def floors(typingctx, a, b, c, d, shift):
    """Sum of each of four fours, over 2^`shift`, rounded down and clipped to 0..255."""

    def emit(context, builder, sig, args):
        def paired(x, y):
            return builder.add(_shuffled(builder, x, y, 0, 2, 4, 6), _shuffled(builder, x, y, 1, 3, 5, 7))

        *sums, shift = args
        total = paired(paired(*sums[:2]), paired(*sums[2:]))
        total = builder.ashr(total, _everywhere(builder, shift))
        for sign, bound in ((">", 0), ("<", 255)):
            limit = ir.Constant(_FOUR, [bound] * 4)
            total = builder.select(builder.icmp_signed(sign, total, limit), total, limit)
        return total

    return FOUR(FOUR, FOUR, FOUR, FOUR, types.int32), emit


@intrinsic
def load_bytes(typingctx, array, at):
    """Sixteen int8 of a contiguous array from element `at` on, as float lanes."""

    def emit(context, builder, sig, args):
        narrow = ir.VectorType(_I8, LANES)
        pointer = _address(context, builder, sig.args[0], args[0], args[1], narrow)
        return builder.sitofp(builder.load(pointer, align=1, typ=narrow), F32.vector)

    return F32(array, types.intp), emit


@intrinsic
def floors_of_lanes(typingctx, a, b, c, d, offsets, unit):
    """Sum of each of four float lanes and its one of four offsets, times `unit`, rounded down and clipped to 0..255."""

    def emit(context, builder, sig, args):
        *lanes, offsets, unit = args

        def added(x, y, low, high):
            """Of every four lanes of x (0..3) and of y (4..7): those in `low` plus those in `high`."""
            one, two = (
                [
                    4 * group + place % 4 + LANES * (place // 4)
                    for group in range(LANES // 4)
                    for place in places
                ]
                for places in (low, high)
            )
            return builder.fadd(_shuffled(builder, x, y, *one), _shuffled(builder, x, y, *two), flags=_FLAGS)

        top, low = (added(x, y, (0, 1, 4, 5), (2, 3, 6, 7)) for x, y in (lanes[:2], lanes[2:]))
        total = added(top, low, (0, 2, 4, 6), (1, 3, 5, 7))
        for size in (LANES // 2, LANES // 4):
            low, high = (_shuffled(builder, total, total, *range(n, n + size)) for n in (0, size))
            total = builder.fadd(low, high, flags=_FLAGS)
        start = ir.Constant(total.type, ir.Undefined)
        for k in range(4):
            start = builder.insert_element(start, builder.extract_value(offsets, k), _I32(k))
        value = builder.fmul(builder.fadd(total, start), _everywhere(builder, unit))
        for sign, bound in ((">", 0.0), ("<", 255.0)):  # what is no number becomes 0
            limit = ir.Constant(total.type, [bound] * 4)
            value = builder.select(builder.fcmp_ordered(sign, value, limit), value, limit)
        return builder.fptosi(value, _FOUR)

    quadruple = types.UniTuple(types.float32, 4)
    return FOUR(F32, F32, F32, F32, quadruple, types.float32), emit
