"""Elementary functions for numbers, arrays, symbolic expressions and SIMD registers.

"Compiled simulation kernel" below is the Numba code that `kernel_source` generates for a machine. The equations of
motion and the formulas of effects are written once with these functions. What a function does follows from the type of
its operands:

    NumPy arrays and plain numbers   NumPy's function
    traced expressions               a node of the expression graph (`tracing`) from which a kernel is generated
    CasADi SX and MX                 CasADi's function
    SIMD registers in a kernel       vector instructions, which `simd` registers with Numba

CasADi is imported only when an operand is a CasADi value.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

_PLAIN = (float, int, np.ndarray, np.generic)


def exp(x: Any) -> Any:
    """Return e**x; in a compiled simulation kernel (generated code) x < -700 gives zero, and x is limited to 700.

    Args:
        x: Exponent, dimensionless: number, array of any shape, SIMD register, or expression (CasADi, or traced to
            generate a kernel).

    Returns:
        e**x, with the type and shape of the operand.
    """
    return _apply("exp", x)


def sin(x: Any) -> Any:
    """Return the sine of an angle; in a compiled simulation kernel (generated code) only for |x| up to 1e6 rad.

    Args:
        x: Angle, rad: number, array of any shape, or symbolic expression.

    Returns:
        Sine, in [-1, 1], element by element, in the shape of x.
    """
    return _apply("sin", x)


def cos(x: Any) -> Any:
    """Return the cosine of an angle; in a compiled simulation kernel (generated code) only for |x| up to 1e6 rad.

    Args:
        x: Angle, rad: number, array of any shape, or symbolic expression.

    Returns:
        Cosine, in [-1, 1], element by element, in the shape of x.
    """
    return _apply("cos", x)


def tanh(x: Any) -> Any:
    """Return the hyperbolic tangent (not available in a compiled simulation kernel, the generated code).

    Args:
        x: Operand, dimensionless: number, array of any shape, or symbolic expression.

    Returns:
        Hyperbolic tangent, in [-1, 1], element by element, in the shape of x.
    """
    return _apply("tanh", x)


def sqrt(x: Any) -> Any:
    """Return the square root.

    Args:
        x: Operand, not negative, any unit: number, array of any shape, or symbolic expression.

    Returns:
        Square root, element by element, in the shape of x.
    """
    return _apply("sqrt", x)


def absolute(x: Any) -> Any:
    """Return |x|.

    Args:
        x: Operand, any unit: number, array of any shape, or symbolic expression.

    Returns:
        Absolute value, element by element, in the unit and shape of x.
    """
    return _apply("absolute", x)


def sign(x: Any) -> Any:
    """Return the sign of a value; generated simulation code does not have this function and uses `copysign`.

    Args:
        x: Operand, any unit: number, array of any shape, or symbolic expression.

    Returns:
        -1 for x < 0, 0 for x = 0, 1 for x > 0, element by element, in the shape of x.
    """
    return _apply("sign", x)


def minimum(a: Any, b: Any) -> Any:
    """Return the smaller of two values.

    Args:
        a: First operand, any unit: number, array of any shape, or symbolic expression.
        b: Second operand, in the same unit, of the same or a broadcastable shape.

    Returns:
        The smaller value, element by element, in the common shape.
    """
    return _apply("minimum", a, b)


def maximum(a: Any, b: Any) -> Any:
    """Return the larger of two values.

    Args:
        a: First operand, any unit: number, array of any shape, or symbolic expression.
        b: Second operand, in the same unit, of the same or a broadcastable shape.

    Returns:
        The larger value, element by element, in the common shape.
    """
    return _apply("maximum", a, b)


def copysign(size: Any, sign_of: Any) -> Any:
    """Return |size| with the sign of `sign_of`.

    Args:
        size: Number, array of any shape, or symbolic expression, any unit; its sign is ignored.
        sign_of: Operand whose sign is used, of a broadcastable shape; 0.0 counts as positive, -0.0 as negative.

    Returns:
        |size| with the sign of `sign_of`, in the common shape.
    """
    return _apply("copysign", size, sign_of)


def where(condition: Any, yes: Any, no: Any) -> Any:
    """Return `yes` where the condition holds and `no` elsewhere, element by element.

    Args:
        condition: Truth value, array of truth values of any shape, or symbolic condition.
        yes: Value where the condition holds, any unit: number, array of a broadcastable shape, or expression.
        no: Value elsewhere, in the same unit: number, array of a broadcastable shape, or expression.

    Returns:
        The selected values, in the common shape.
    """
    return _apply("where", condition, yes, no)


def fma(a: Any, b: Any, c: Any) -> Any:
    """Return a * b + c: rounded once in a compiled simulation kernel (fused multiply-add), twice elsewhere.

    Args:
        a: First factor, any unit: number, array of any shape, SIMD register, or symbolic expression.
        b: Second factor, of a broadcastable shape.
        c: Summand in the unit of a * b, of a broadcastable shape.

    Returns:
        a * b + c, in the common shape.
    """
    return _apply("fma", a, b, c)


def rint(x: Any) -> Any:
    """Return the nearest integer, ties to even.

    Args:
        x: Operand, dimensionless: number, array of any shape, or traced expression, but no CasADi expression.

    Returns:
        Nearest integer, as a floating-point value, in the shape of x.
    """
    return _apply("rint", x)


def floor(x: Any) -> Any:
    """Return the largest integer that does not exceed x.

    Args:
        x: Operand, dimensionless: number, array of any shape, or symbolic expression.

    Returns:
        Largest integer that does not exceed x, as a floating-point value, in the shape of x.
    """
    return _apply("floor", x)


def pow2(n: Any) -> Any:
    """Return 2**n for integers n, exactly.

    Args:
        n: Exponent in [-1022, 1023], an integer as a floating-point value: number or array of any shape.

    Returns:
        2**n, in the shape of n.
    """
    return _apply("pow2", n)


def any_of(condition: Any) -> Any:
    """Return whether a condition holds in at least one element (for SIMD registers: for at least one machine).

    Args:
        condition: Truth value, array of truth values of any shape, or SIMD mask (one truth value per machine).

    Returns:
        One truth value.
    """
    return _apply("any_of", condition)


def named(role: str, index: int, value: Any) -> Any:
    """Give a value the name `role_index` in the source text of the generated simulation code; elsewhere do nothing.

    Args:
        role: First part of the name: what the value is, for example "extension".
        index: Index of the coordinate, belt, drive, sensor or effect, for example 0 for "extension_0".
        value: Value to name, in any unit. Only a traced expression, from which code is generated, takes a name.

    Returns:
        The same value.
    """
    return value.name_as(role, index) if hasattr(value, "name_as") else value


def reciprocals(values: Sequence[Any]) -> list[Any]:
    """Return the reciprocal of each value.

    In generated simulation code, three values share one division, which costs as much as ten multiplications: with the
    product P = a b c, 1/a = b c / P and so on.

    Args:
        values: Numbers, arrays of one common shape (...) or symbolic expressions, none of them zero, in any units.

    Returns:
        1/value for each value, in the same order, shape (...) each.
    """
    if not any(hasattr(v, "traced_function") for v in values):
        return [1.0 / v for v in values]
    results: list[Any] = []
    for group in (values[i : i + 3] for i in range(0, len(values), 3)):
        if len(group) == 1:
            results.append(1.0 / group[0])
            continue
        first, second, *third = group
        pair = first * second
        if third:
            reciprocal = 1.0 / (pair * third[0])
            reciprocal_pair = reciprocal * third[0]
            results += [reciprocal_pair * second, reciprocal_pair * first, reciprocal * pair]
        else:
            reciprocal_pair = 1.0 / pair
            results += [reciprocal_pair * second, reciprocal_pair * first]
    return results


def update_if_any(
    condition: Callable[[], Any], values: Sequence[Any], update: Callable[[Sequence[Any]], Sequence[Any]]
) -> list[Any]:
    """Return `update(values)`; in generated simulation code, behind an `if` that skips it where it has no effect.

    Generated code computes several machines side by side. It calls `update` if the condition is true for at least one.

    Args:
        condition: Function without arguments that returns the condition; it is called only to generate code.
        values: Numbers, arrays of one common shape (...) or symbolic expressions to update, in any units.
        update: Function from the values to the new values. It must not change values whose condition is false.

    Returns:
        The updated values, in the order, units and shape (...) of `values`.
    """
    # Only traced expressions (from which code is generated) can write the `if`; other algebras update in any case.
    traced = next((v for v in values if hasattr(v, "traced_function")), None)
    if traced is not None:
        return list(traced.trace.update_if_any(condition(), values, update))
    return list(update(values))


def _apply(name: str, *operands: Any) -> Any:
    """Call the function of that name in the algebra of the operands."""
    for operand in operands:
        if isinstance(operand, _PLAIN):
            continue
        if hasattr(operand, "traced_function"):
            return operand.traced_function(name, operands)
        if type(operand).__module__.partition(".")[0] == "casadi":
            return _casadi_functions()[name](*operands)
    return _NUMPY[name](*operands)


def _numpy_where(condition: Any, yes: Any, no: Any) -> Any:
    """Return a scalar for scalar operands, where `np.where` gives an array without dimensions."""
    return np.where(condition, yes, no)[()]


_NUMPY: Mapping[str, Callable[..., Any]] = {
    "exp": np.exp,
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
    "fma": lambda a, b, c: a * b + c,
    "rint": np.rint,
    "floor": np.floor,
    "pow2": np.exp2,
    "any_of": np.any,
}


def _casadi_functions() -> Mapping[str, Callable[..., Any]]:
    """Return CasADi's functions; the import costs 0.1 s, hence only on use."""
    import casadi

    return {
        "exp": casadi.exp,
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
        "fma": lambda a, b, c: a * b + c,
        "floor": casadi.floor,
    }
