"""Elementary functions that let one formula serve NumPy, CasADi and the simulation kernel.

The equations of motion of a machine (the simulated mechanical system) and the formulas of effects are written
once with these functions. The types of the operands decide what a function does:

    operand                       action
    number, NumPy array           call NumPy's function
    CasADi expression (SX, MX)    call CasADi's function; CasADi is imported at the first such operand
    traced expression             compute nothing; return a new traced expression, which records the operation
    SIMD register                 a vector instruction or a formula of them, in generated code

A traced expression (class `Expression`) stands for a value that a generated function will compute.
`kernel_source` evaluates the equations with traced expressions and writes the recorded operations as source
text. Compiled by LLVM, this text is the simulation kernel. It simulates several machines side by side: a SIMD
register holds one number per machine. Below, "symbolic expression" means a CasADi expression or a traced
expression.

CasADi (KeyError) and formulas of the simulation kernel (`LaneCompileError`) lack some functions:

    function              NumPy    CasADi    formulas of the kernel
    rint                  yes      no        yes
    pow2, any_of          yes      no        no, but the kernel's helper functions and conditions use them
    all other functions   yes      yes       yes
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from .tracing import Expression

__all__ = [
    "absolute",
    "any_of",
    "copysign",
    "cos",
    "exp",
    "floor",
    "fma",
    "log",
    "maximum",
    "minimum",
    "named",
    "pow2",
    "rint",
    "sign",
    "sin",
    "sqrt",
    "tanh",
    "update_if_any",
    "where",
]

# `_apply` skips operands of these types, before tests that take longer.
_NUMPY_TYPES = (float, int, np.ndarray, np.generic)


def exp(x: Any) -> Any:
    """Return e**x.

    In a simulation kernel the result is never infinite: 0 for x < -700, and e**700 = 1.01e304 for x > 700.
    """
    return _apply("exp", x)


def log(x: Any) -> Any:
    """Return the natural logarithm of a positive number.

    In a simulation kernel the number is limited to 1e-300 to 1e300, so that the result is finite.
    """
    return _apply("log", x)


def sin(x: Any) -> Any:
    """Return the sine of an angle, rad.

    In a simulation kernel the error is below 5e-16 for |x| <= 1e12 rad; beyond 1e16 rad the result is
    meaningless.
    """
    return _apply("sin", x)


def cos(x: Any) -> Any:
    """Return the cosine of an angle, rad, with the errors of `sin`."""
    return _apply("cos", x)


def tanh(x: Any) -> Any:
    """Return the hyperbolic tangent."""
    return _apply("tanh", x)


def sqrt(x: Any) -> Any:
    """Return the square root."""
    return _apply("sqrt", x)


def absolute(x: Any) -> Any:
    """Return |x|."""
    return _apply("absolute", x)


def sign(x: Any) -> Any:
    """Return -1 for x < 0, 0 for x = 0, 1 for x > 0; `copysign(1.0, x)` is never 0."""
    return _apply("sign", x)


def minimum(a: Any, b: Any) -> Any:
    """Return the smaller of two values. If one is NaN, arrays give NaN, and a simulation kernel gives `b`."""
    return _apply("minimum", a, b)


def maximum(a: Any, b: Any) -> Any:
    """Return the larger of two values. If one is NaN, arrays give NaN, and a simulation kernel gives `b`."""
    return _apply("maximum", a, b)


def copysign(magnitude: Any, sign_of: Any) -> Any:
    """Return |magnitude| with the sign of `sign_of`; unlike in `sign`, 0.0 is positive, -0.0 negative."""
    return _apply("copysign", magnitude, sign_of)


def where(condition: Any, yes: Any, no: Any) -> Any:
    """Return `yes` where the condition holds and `no` elsewhere, element by element."""
    return _apply("where", condition, yes, no)


def fma(a: Any, b: Any, c: Any) -> Any:
    """Return a * b + c: rounded once in a simulation kernel (fused multiply-add), twice elsewhere."""
    return _apply("fma", a, b, c)


def polynomial(x: Any, coefficients: Sequence[float]) -> Any:
    """Evaluate a polynomial by Horner's scheme; the coefficients begin with that of the highest power."""
    value: Any = coefficients[0]
    for coefficient in coefficients[1:]:
        value = fma(x, value, coefficient)
    return value


def rint(x: Any) -> Any:
    """Return the nearest integer, ties to even, as a float (not available for CasADi expressions).

    The kernel's `exp`, `sin` and `cos` use it, and environments round measurements to the sensor's resolution
    with it.
    """
    return _apply("rint", x)


def floor(x: Any) -> Any:
    """Return the largest integer that does not exceed x: a float; since NumPy 2.1, an int if x is one."""
    return _apply("floor", x)


def pow2(n: Any) -> Any:
    """Return 2**n for integers n in [-1022, 1023], exactly; the kernel's `exp` is e**x = 2**n e**r."""
    return _apply("pow2", n)


def any_of(condition: Any) -> Any:
    """Return whether a condition holds in at least one element; the kernel's `if` and `while` use it.

    Where it is true, the kernel takes the branch for all machines of the register.
    """
    return _apply("any_of", condition)


def named(role: str, index: int, value: Any) -> Any:
    """Name a value `role_index`, such as "extension_0", in the source text of a kernel; return the value.

    The names make this text, which `hframe kernel` prints, readable; they do not change results.
    """
    return value.trace.let(role, index, value) if isinstance(value, Expression) else value


def update_if_any(
    condition: Callable[[], Any], values: Sequence[Any], update: Callable[[Sequence[Any]], Sequence[Any]]
) -> list[Any]:
    """Return `update(values)`; a simulation kernel skips the update where it has no effect.

    The kernel calls `update` if the condition is true for at least one of the machines that it simulates side
    by side; the call then applies to all of them.

    Args:
        condition: Function without arguments that returns the condition; it is called only to generate a
            kernel.
        values: Values to update.
        update: Function from the values to the new values. For a machine whose condition is false it must
            return that machine's values unchanged.
    """
    # Only a kernel can skip the update; NumPy and CasADi evaluate it in any case.
    traced = next((value for value in values if isinstance(value, Expression)), None)
    if traced is not None:
        return list(traced.trace.update_if_any(condition(), values, update))
    return list(update(values))


def _apply(name: str, *operands: Any) -> Any:
    """Call the implementation of the first traced or CasADi operand; without such an operand, NumPy's."""
    for operand in operands:
        if isinstance(operand, _NUMPY_TYPES):
            continue
        if isinstance(operand, Expression):
            return operand.trace.node(name, *operands)
        if type(operand).__module__.partition(".")[0] == "casadi":
            return _casadi_functions()[name](*operands)
    return _NUMPY[name](*operands)


def _multiply_add(a: Any, b: Any, c: Any) -> Any:
    """Return a * b + c with two roundings."""
    return a * b + c


def _numpy_where(condition: Any, yes: Any, no: Any) -> Any:
    """Return a scalar for scalar operands, where `np.where` gives an array without dimensions."""
    return np.where(condition, yes, no)[()]


_NUMPY: Mapping[str, Callable[..., Any]] = {
    "exp": np.exp,
    "log": np.log,
    "sin": np.sin,
    "cos": np.cos,
    "tanh": np.tanh,
    "sqrt": np.sqrt,
    "absolute": np.abs,
    "sign": np.sign,
    "minimum": np.minimum,
    "maximum": np.maximum,
    "copysign": np.copysign,
    "where": _numpy_where,
    "fma": _multiply_add,
    "rint": np.rint,
    "floor": np.floor,
    "pow2": np.exp2,
    "any_of": np.any,
}


@functools.cache
def _casadi_functions() -> Mapping[str, Callable[..., Any]]:
    """Return CasADi's functions by name; CasADi is imported on use only, because the import takes 0.1 s."""
    import casadi

    return {
        "exp": casadi.exp,
        "log": casadi.log,
        "sin": casadi.sin,
        "cos": casadi.cos,
        "tanh": casadi.tanh,
        "sqrt": casadi.sqrt,
        "absolute": casadi.fabs,
        "sign": casadi.sign,
        "minimum": casadi.fmin,
        "maximum": casadi.fmax,
        "copysign": casadi.copysign,
        "where": casadi.if_else,
        "fma": _multiply_add,
        "floor": casadi.floor,
    }
