"""SIMD registers as a Numba type: every arithmetic instruction computes `LANES` simulated machines side by side.

Numba does not vectorize a time-stepping loop with friction by itself, so the simulation kernels compute with explicit
vectors. A `SimdVector` (a SIMD register, in other docstrings) holds `LANES` float64 numbers, one per machine; LLVM
distributes it over as many registers of the processor (AVX-512, AVX2, NEON) as it needs. A `SimdMask` holds the truth
values of a comparison. This module registers with Numba what arithmetic and the functions of `elementwise` do with
them; `exp`, `sin` and `cos` follow in `simd_math`. LLVM contracts and re-associates nothing, and a fused multiply-add
happens only where `fma` is called. Therefore a machine's results have the same bits in every lane (column of a
register), batch size and number of threads.
"""

from __future__ import annotations

import itertools
import operator
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from llvmlite import ir
from llvmlite.binding import get_host_cpu_features
from numba import njit, types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, models, register_model

from .elementwise import absolute, any_of, copysign, floor, fma, maximum, minimum, pow2, rint, sqrt, where

__all__ = [
    "LANES",
    "absolute",
    "align_stack",
    "any_of",
    "copysign",
    "floor",
    "fma",
    "helper",
    "inlined",
    "load",
    "maximum",
    "minimum",
    "pow2",
    "rint",
    "sqrt",
    "store",
    "where",
]

Function = TypeVar("Function", bound=Callable[..., Any])
# Options of functions that only compiled code calls; without wrappers for Python and C they compile faster.
_OPTIONS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
}
helper: Any = njit(**_OPTIONS)  # decorator of a separate function
inlined: Callable[[Function], Function] = njit(forceinline=True, **_OPTIONS)  # LLVM copies it to its callers

# With AVX-512, two registers of 8 numbers: instructions on one run while those on the other wait for their results.
# Other processors have too few registers for 16 numbers per variable.
LANES = 16 if get_host_cpu_features().get("avx512f") else 8

_F64 = ir.DoubleType()
_I64 = ir.IntType(64)
_VECTOR = ir.VectorType(_F64, LANES)
_FLOAT32_VECTOR = ir.VectorType(ir.FloatType(), LANES)
_IVECTOR = ir.VectorType(_I64, LANES)
_BITS = ir.VectorType(ir.IntType(1), LANES)
# Bytes. Rows of a work array start on 8-byte boundaries only; instructions for a larger alignment would fault.
_ALIGN = 8


class SimdVector(types.Type):
    """Numba type of a SIMD register: `LANES` float64 numbers side by side, one per machine."""

    def __init__(self) -> None:
        super().__init__(name=f"lane{LANES}")


class SimdMask(types.Type):
    """Numba type of `LANES` truth values, one per machine: the result of comparing two `SimdVector` values."""

    def __init__(self) -> None:
        super().__init__(name=f"mask{LANES}")


# The types as they occur in Numba's signatures.
lane = SimdVector()
mask = SimdMask()


@register_model(SimdVector)
class _LaneModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, _VECTOR)


@register_model(SimdMask)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, _BITS)


# -- functions that exist in kernels only ------------------------------------------------------------------------------


def load(rows: Any, k: Any) -> Any:
    """Load a row of an array into one SIMD register; callable in Numba-compiled code only.

    Args:
        rows: Contiguous array of float64, any unit, shape (n, LANES): n quantities, one machine per column; LANES is
            the number of machines that one SIMD register holds.
        k: Index of the row, integer, 0 <= k < n (not checked).

    Returns:
        `SimdVector` (one SIMD register) with the `LANES` values of the row, in their unit.

    Raises:
        NotImplementedError: If it is called from the Python interpreter.
    """
    raise NotImplementedError


def store(rows: Any, k: Any, value: Any) -> None:
    """Write a SIMD register to a row of an array; callable in Numba-compiled code only.

    Args:
        rows: Contiguous array of float64 or float32 (values are rounded), any unit, shape (n, LANES): n quantities, one
            machine per column; changed in place. LANES is the number of machines that one SIMD register holds.
        k: Index of the row, integer, 0 <= k < n (not checked).
        value: `SimdVector` (one SIMD register) to write, or one number for all columns.

    Raises:
        NotImplementedError: If it is called from the Python interpreter.
    """
    raise NotImplementedError


def align_stack() -> None:
    """Align the stack frame of the calling compiled function to 64 bytes, the size of an AVX-512 register.

    The compiler saves registers on the stack. Without the alignment, such a register can extend over two cache lines of
    64 bytes, which slows down every access to it. In the Python interpreter the call has no effect.
    """


# -- vector instructions -----------------------------------------------------------------------------------------------

_SCALAR = (types.Float, types.Integer)


def _is_operand(ty: types.Type) -> bool:
    """Return whether a type is a vector or a plain number."""
    return ty == lane or isinstance(ty, _SCALAR)


def _as_vector(context: Any, builder: Any, value: Any, ty: types.Type) -> Any:
    """Return a vector unchanged, and a plain number as a vector with this number in all lanes."""
    if ty == lane:
        return value
    scalar = context.cast(builder, value, ty, types.float64)
    undefined = ir.Constant(_VECTOR, ir.Undefined)
    first = builder.insert_element(undefined, scalar, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(first, undefined, zeros)


def _operation(function: Any, arity: int, result: types.Type, emit: Callable[..., Any]) -> None:
    """Register a function of vectors with Numba; plain numbers among its operands are copied to all lanes."""

    @infer_global(function)
    class _Template(AbstractTemplate):
        def generic(self, args: Sequence[types.Type], kws: Any) -> Any:
            if not kws and len(args) == arity and lane in args and all(map(_is_operand, args)):
                return signature(result, *args)
            return None

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        vectors = [_as_vector(context, builder, a, t) for a, t in zip(args, sig.args, strict=True)]
        return emit(builder, *vectors)

    # Numba lowers operations on plain numbers itself; only signatures with a vector are registered here.
    kinds = (SimdVector, *_SCALAR)
    for operands in itertools.product(kinds, repeat=arity):
        if SimdVector in operands:
            lower_builtin(function, *operands)(lower)


def _llvm(name: str) -> Callable[..., Any]:
    """Return the emitter of LLVM's vector intrinsic of that name."""

    def emit(builder: Any, *args: Any) -> Any:
        kind = ir.FunctionType(_VECTOR, [_VECTOR] * len(args))
        function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{LANES}f64")
        return builder.call(function, args)

    return emit


def _arithmetic(instruction: str) -> Callable[..., Any]:
    """Return the emitter of the LLVM instruction of that name."""
    return lambda builder, *args: getattr(builder, instruction)(*args)


def _comparison(sign: str) -> Callable[..., Any]:
    """Return the emitter of a comparison; with NaN it is false, and unlike in Python so is NaN != x."""
    return lambda builder, a, b: builder.fcmp_ordered(sign, a, b)


def _choice(sign: str) -> Callable[..., Any]:
    """Return the emitter of the smaller ("<") or larger (">") of two vectors; if a value is NaN, of the second."""
    return lambda builder, a, b: builder.select(builder.fcmp_ordered(sign, a, b), a, b)


def _emit_pow2(builder: Any, n: Any) -> Any:
    """Emit 2**n: the float64 with the exponent bits n + 1023 and the mantissa 1."""
    bias = ir.Constant(_IVECTOR, [1023] * LANES)
    shift = ir.Constant(_IVECTOR, [52] * LANES)
    return builder.bitcast(builder.shl(builder.add(builder.fptosi(n, _IVECTOR), bias), shift), _VECTOR)


for _function, _instruction in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _operation(_function, 2, lane, _arithmetic(_instruction))
for _function, _sign in (
    (operator.lt, "<"),
    (operator.le, "<="),
    (operator.gt, ">"),
    (operator.ge, ">="),
    (operator.eq, "=="),
    (operator.ne, "!="),
):
    _operation(_function, 2, mask, _comparison(_sign))
_operation(operator.neg, 1, lane, _arithmetic("fneg"))
_operation(absolute, 1, lane, _llvm("fabs"))
_operation(sqrt, 1, lane, _llvm("sqrt"))
_operation(rint, 1, lane, _llvm("rint"))
_operation(floor, 1, lane, _llvm("floor"))
_operation(pow2, 1, lane, _emit_pow2)
_operation(minimum, 2, lane, _choice("<"))
_operation(maximum, 2, lane, _choice(">"))
_operation(copysign, 2, lane, _llvm("copysign"))
_operation(fma, 3, lane, _llvm("fma"))


@infer_global(where)
class _Where(AbstractTemplate):
    def generic(self, args: Sequence[types.Type], kws: Any) -> Any:
        if len(args) == 3 and args[0] == mask and all(map(_is_operand, args[1:])):
            return signature(lane, *args)
        return None


@lower_builtin(where, SimdMask, types.Any, types.Any)
def _lower_where(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    yes, no = (_as_vector(context, builder, a, t) for a, t in zip(args[1:], sig.args[1:], strict=True))
    return builder.select(args[0], yes, no)


def _mask_operation(function: Any, instruction: str) -> None:
    """Register `&` or `|` of two masks with Numba."""

    @infer_global(function)
    class _Template(AbstractTemplate):
        def generic(self, args: Sequence[types.Type], kws: Any) -> Any:
            return signature(mask, *args) if tuple(args) == (mask, mask) else None

    @lower_builtin(function, SimdMask, SimdMask)
    def _lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return getattr(builder, instruction)(*args)


_mask_operation(operator.and_, "and_")
_mask_operation(operator.or_, "or_")


@infer_global(any_of)
class _AnyOf(AbstractTemplate):
    def generic(self, args: Sequence[types.Type], kws: Any) -> Any:
        return signature(types.boolean, mask) if tuple(args) == (mask,) else None


@lower_builtin(any_of, SimdMask)
def _lower_any_of(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    bits = ir.IntType(LANES)
    return builder.icmp_unsigned("!=", builder.bitcast(args[0], bits), ir.Constant(bits, 0))


def _is_rows(ty: types.Type, *dtypes: types.Type) -> bool:
    """Return whether a type is a contiguous two-dimensional array of one of some number types."""
    return isinstance(ty, types.Array) and ty.dtype in dtypes and ty.ndim == 2 and ty.layout == "C"


@infer_global(load)
class _Load(AbstractTemplate):
    def generic(self, args: Sequence[types.Type], kws: Any) -> Any:
        return signature(lane, *args) if len(args) == 2 and _is_rows(args[0], types.float64) else None


@infer_global(store)
class _Store(AbstractTemplate):
    def generic(self, args: Sequence[types.Type], kws: Any) -> Any:
        fits = len(args) == 3 and _is_rows(args[0], types.float64, types.float32) and _is_operand(args[2])
        return signature(types.none, *args) if fits else None


def _row_pointer(context: Any, builder: Any, sig: Any, args: Any, vector: Any = _VECTOR) -> Any:
    """Return the address of a row of `LANES` numbers; args: array and index of the row."""
    array = context.make_array(sig.args[0])(context, builder, args[0])
    row = context.cast(builder, args[1], sig.args[1], types.intp)
    offset = builder.mul(row, context.get_constant(types.intp, LANES))
    return builder.bitcast(builder.gep(array.data, [offset]), vector.as_pointer())


@lower_builtin(load, types.Array, types.Integer)
def _lower_load(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.load(_row_pointer(context, builder, sig, args), align=_ALIGN)


@lower_builtin(store, types.Array, types.Integer, types.Any)
def _lower_store(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    value = _as_vector(context, builder, args[2], sig.args[2])
    if sig.args[0].dtype == types.float32:
        rounded = builder.fptrunc(value, _FLOAT32_VECTOR)
        builder.store(rounded, _row_pointer(context, builder, sig, args, _FLOAT32_VECTOR), align=_ALIGN // 2)
    else:
        builder.store(value, _row_pointer(context, builder, sig, args), align=_ALIGN)
    return context.get_dummy_value()


@infer_global(align_stack)
class _AlignStack(AbstractTemplate):
    def generic(self, args: Sequence[types.Type], kws: Any) -> Any:
        return signature(types.none) if not args else None


@lower_builtin(align_stack)
def _lower_align_stack(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    with builder.goto_entry_block():
        slot = builder.alloca(_VECTOR)
        slot.align = 64
    # The slot must reach code generation: an empty instruction that nothing can see through keeps it.
    asm = ir.FunctionType(ir.VoidType(), [_VECTOR.as_pointer()])
    builder.asm(asm, "", "r,~{memory}", [slot], side_effect=True)
    return context.get_dummy_value()
