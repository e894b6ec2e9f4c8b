"""What Numba lacks about memory: whole cache lines, flat indices, asking for it ahead of time, a counter that several threads may share."""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from luxel.kernels.jit import kernel

__all__ = ["float_lines", "index", "int_lines", "item", "lines", "prefetch", "take"]

_BYTE, _I32 = ir.IntType(8), ir.IntType(32)
_LINE = 64  # bytes; sixteen lanes that straddle two of them take twice as long to load


def lines(shape: int | tuple[int, ...]) -> NDArray[np.float32]:
    """Return float32 memory of any contents that begins with a cache line; not a kernel."""
    count = int(np.prod(shape))
    raw: NDArray[Any] = np.empty(4 * count + _LINE, np.uint8)
    begin = -raw.ctypes.data % _LINE
    return raw[begin : begin + 4 * count].view(np.float32).reshape(shape)


@kernel
def float_lines(count):
    """Return (count,) float32 zeros that begin with a cache line."""
    raw = np.zeros(count + _LINE // 4, np.float32)
    begin = (-(raw.ctypes.data // 4)) % (_LINE // 4)
    return raw[begin : begin + count]


@kernel
def int_lines(count):
    """Return (count,) int32 zeros that begin with a cache line."""
    return float_lines(count).view(np.int32)


@kernel(inline=True, borrows=True)
def index(k):
    """Return a number that is not negative and fits 32 bits, as one of which the compiler knows that.

    Of others it asks whether they count from an array's end, which takes four instructions of every access.
    """
    return np.int64(np.uint32(k))


@intrinsic
def item(typingctx, array, k):
    """Element k of a contiguous array, counted through all its axes."""

    def emit(context, builder, sig, args):
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        return context.unpack_value(builder, sig.return_type, builder.gep(data, [args[1]]))

    return array.dtype(array, types.intp), emit


@intrinsic
def prefetch(typingctx, array, byte):
    """Ask for the cache line `byte` bytes behind the start of an array; harmless outside of it."""

    def emit(context, builder, sig, args):
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        pointer = builder.gep(builder.bitcast(data, _BYTE.as_pointer()), [args[1]])
        kind = ir.FunctionType(ir.VoidType(), [pointer.type, _I32, _I32, _I32])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        builder.call(function, [pointer, _I32(0), _I32(3), _I32(1)])  # to read, to keep, data
        return context.get_dummy_value()

    return types.none(array, types.intp), emit


@intrinsic
def take(typingctx, counter, step):
    """Add `step` to the first element of an int64 array in one indivisible step; return what it was before."""

    def emit(context, builder, sig, args):
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        return builder.atomic_rmw("add", data, args[1], "monotonic")

    return types.int64(counter, types.int64), emit
