"""Call machine code, which is known by its address, from functions that Numba compiles."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic


def _emit_call(context: Any, builder: Any, signature: Any, values: Any) -> Any:
    """Emit the call of the function whose address is the first argument."""
    address, packed = values
    operands = []
    for value, kind in zip(cgutils.unpack_tuple(builder, packed), signature.args[1], strict=True):
        if isinstance(kind, types.Array):
            operands.append(context.make_array(kind)(context, builder, value).data)
        else:
            number = types.float64 if isinstance(kind, types.Float) else types.int64
            operands.append(context.cast(builder, value, kind, number))
    function = ir.FunctionType(ir.VoidType(), [operand.type for operand in operands])
    builder.call(builder.inttoptr(address, function.as_pointer()), operands)
    return context.get_dummy_value()


@intrinsic
def call_at(typing_context: Any, address: Any, *arguments: Any) -> Any:
    """Call machine code of a `LaneProgram` by its address, from functions that Numba compiles.

    Arguments are contiguous arrays of rows, shape (n, LANES), and numbers. The machine code receives the
    address of each array, and numbers as float64 or int64. Neither the number of arguments nor the arrays'
    sizes are checked.
    """
    return types.void(types.int64, types.StarArgTuple(arguments)), _emit_call
