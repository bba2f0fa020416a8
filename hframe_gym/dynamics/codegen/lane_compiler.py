"""Compile functions of SIMD registers from their Python source to LLVM's intermediate representation (IR).

The functions of a simulation kernel are short and of one kind: arithmetic on SIMD registers ("vectors":
`LANES` float64 numbers, one per simulated machine), loads and stores of rows, and a few branches that any
machine of the register can take. A general compiler spends most of its time on finding out what it sees; this
one knows. It compiles a kernel about ten times as fast as Numba (docs/decisions/0032).

    statement       x = value;  x, y = f(...);  store(rows, k, value);  if any_of(mask):  while any_of(mask):
                    for i in range(n):  return value (last statement of a formula)
    value           number, name, load(rows, k), + - * /, comparison, & and | of masks, calls
    function        of `_PRIMITIVES`, one vector instruction each; or a formula: a Python function in the same
                    subset, which is inlined
    argument        of an exported function: rows of `LANES` numbers, or annotated as `float` or `int`

Operations on two numbers are computed by Python, operations on scalars (h, steps) once for all machines. LLVM
contracts and re-associates nothing, and a fused multiply-add happens only where `fma` is called: a machine's
results have the same bits in every lane, batch size, register width and number of threads.
"""

from __future__ import annotations

import ast
import inspect
import operator
import textwrap
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, reduce
from typing import Any

from llvmlite import ir

_F64, _I64, _I32 = ir.DoubleType(), ir.IntType(64), ir.IntType(32)
_KINDS = {"float": _F64, "int": _I64}  # types of annotated arguments; others are rows
_ALIGN = 8  # bytes; rows of a work array start on 8-byte boundaries only

_ARITHMETIC: Mapping[type, tuple[Callable[[Any, Any], Any], str, str]] = {
    ast.Add: (operator.add, "fadd", "add"),
    ast.Sub: (operator.sub, "fsub", "sub"),
    ast.Mult: (operator.mul, "fmul", "mul"),
    ast.Div: (operator.truediv, "fdiv", ""),
}
_COMPARISONS = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}
_INTRINSICS = {  # functions that are an intrinsic of LLVM, with their numbers of operands
    "absolute": ("fabs", 1),
    "sqrt": ("sqrt", 1),
    "rint": ("rint", 1),
    "floor": ("floor", 1),
    "copysign": ("copysign", 2),
    "fma": ("fma", 3),
}

Value = Any  # a Python number, or a value of LLVM


class LaneCompileError(SyntaxError):
    """A function contains something that is not in the subset of Python that kernels use."""


def compile_lanes(text: str, formulas: Mapping[str, Callable[..., Any]], lanes: int) -> ir.Module:
    """Compile the functions of a source text.

    Args:
        text: Python source of functions in the subset that this module describes; imports in it are ignored.
        formulas: Python functions that the text calls, by name; they are inlined and may call each other.
        lanes: Number of lanes of the registers: machines that one instruction advances.

    Returns:
        Module with one exported function, which returns nothing, per function of the text.

    Raises:
        LaneCompileError: If the text or a formula contains something else.
    """
    module = ir.Module(name="kernel")
    for node in ast.parse(text).body:
        if isinstance(node, ast.FunctionDef):
            _Function(module, node, formulas, lanes)
    return module


@lru_cache(maxsize=256)
def _syntax_tree(function: Callable[..., Any]) -> ast.FunctionDef:
    """Return the syntax tree of a formula."""
    node = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
    assert isinstance(node, ast.FunctionDef)
    return node


@lru_cache(maxsize=1024)
def _vector_constant(number: str, lanes: int) -> ir.Constant:
    """Return a number in all lanes; composing its long text takes time, so it is kept.

    The number is given in hexadecimal, because 0.0 and -0.0 would be the same key.
    """
    element = ir.Constant(_F64, float.fromhex(number))
    return ir.Constant(ir.VectorType(_F64, lanes), [element] * lanes)


class _Scope:
    """Names of one function or inlined formula.

    Args:
        arguments: Values of the arguments, which are never assigned to.
        constants: Global names of the formula's module.
    """

    def __init__(self, arguments: Mapping[str, Value], constants: Mapping[str, Any]) -> None:
        self.arguments = dict(arguments)
        self.constants = constants
        self.variables: dict[str, Any] = {}  # addresses; LLVM turns them into registers


class _Function:
    """Emits the instructions of one exported function."""

    def __init__(
        self, module: ir.Module, node: ast.FunctionDef, formulas: Mapping[str, Callable[..., Any]], lanes: int
    ) -> None:
        self._module, self._formulas, self._lanes = module, formulas, lanes
        self._vector = ir.VectorType(_F64, lanes)
        self._mask = ir.VectorType(ir.IntType(1), lanes)
        self._rows, self._vector_pointer = _F64.as_pointer(), self._vector.as_pointer()
        kinds = [_KINDS[ast.unparse(a.annotation)] if a.annotation else self._rows for a in node.args.args]
        self._function = ir.Function(module, ir.FunctionType(ir.VoidType(), kinds), node.name)
        self._builder = ir.IRBuilder(self._function.append_basic_block("entry"))
        names = [a.arg for a in node.args.args]
        self._block(node.body, _Scope(dict(zip(names, self._function.args, strict=True)), {}))
        self._builder.ret_void()

    # -- statements ------------------------------------------------------------------------------------------

    def _block(self, statements: Sequence[ast.stmt], scope: _Scope) -> Value:
        """Emit statements; return the value of a `return` at their end."""
        for statement in statements:
            if isinstance(statement, ast.Return) and statement.value is not None:
                return self._value(statement.value, scope)
            self._statement(statement, scope)
        return None

    def _statement(self, statement: ast.stmt, scope: _Scope) -> None:
        match statement:
            case ast.Expr(ast.Constant()):  # a docstring
                pass
            case ast.Expr(ast.Call(ast.Name("store"), [rows, row, value])):
                self._builder.store(
                    self._as_vector(self._value(value, scope)), self._row(rows, row, scope), align=_ALIGN
                )
            case ast.Expr(ast.Call(ast.Name("align_stack"), [])):
                self._align_stack()
            case ast.Assign([ast.Name(name)], value):
                self._assign(name, self._value(value, scope), scope)
            case ast.Assign([ast.Tuple(targets)], value):
                for target, part in zip(targets, self._value(value, scope), strict=True):
                    assert isinstance(target, ast.Name)
                    self._assign(target.id, part, scope)
            case ast.If(test, body, []):
                with self._builder.if_then(self._value(test, scope)):
                    self._block(body, scope)
            case ast.While(test, body):
                self._while(lambda: self._value(test, scope), lambda: self._block(body, scope))
            case ast.For(ast.Name(name), ast.Call(ast.Name("range"), [count]), body):
                self._for(name, self._as_type(self._value(count, scope), _I64), body, scope)
            case _:
                raise LaneCompileError(f"a kernel cannot contain the statement {ast.unparse(statement)!r}")

    def _assign(self, name: str, value: Value, scope: _Scope) -> None:
        """Give a variable a value."""
        if not isinstance(value, ir.Value):
            value = ir.Constant(_F64, float(value))
        if name in scope.arguments:
            raise LaneCompileError(f"a kernel cannot assign to the argument {name}")
        if name not in scope.variables:
            with self._builder.goto_entry_block():
                scope.variables[name] = self._builder.alloca(value.type)
        address = scope.variables[name]
        if address.allocated_type == self._vector:
            value = self._as_vector(value)
        if value.type != address.allocated_type:
            raise LaneCompileError(f"the variable {name} cannot hold values of several types")
        self._builder.store(value, address)

    def _while(self, condition: Callable[[], Value], body: Callable[[], Any]) -> None:
        """Emit a loop."""
        test, inside, after = (self._function.append_basic_block(name) for name in ("test", "body", "after"))
        self._builder.branch(test)
        self._builder.position_at_end(test)
        self._builder.cbranch(condition(), inside, after)
        self._builder.position_at_end(inside)
        body()
        self._builder.branch(test)
        self._builder.position_at_end(after)

    def _for(self, name: str, count: Value, body: Sequence[ast.stmt], scope: _Scope) -> None:
        """Emit a loop over the integers below `count`."""
        self._assign(name, ir.Constant(_I64, 0), scope)
        counter = scope.variables[name]

        def step() -> None:
            self._block(body, scope)
            self._builder.store(self._builder.add(self._builder.load(counter), ir.Constant(_I64, 1)), counter)

        self._while(lambda: self._builder.icmp_signed("<", self._builder.load(counter), count), step)

    def _align_stack(self) -> None:
        """Align the stack frame to 64 bytes: a saved register must not extend over two cache lines."""
        with self._builder.goto_entry_block():
            slot = self._builder.alloca(self._vector)
            slot.align = 64
        # The slot must reach code generation: an empty instruction that nothing can see through keeps it.
        kind = ir.FunctionType(ir.VoidType(), [slot.type])
        self._builder.asm(kind, "", "r,~{memory}", [slot], side_effect=True)

    # -- values ----------------------------------------------------------------------------------------------

    def _value(self, node: ast.expr, scope: _Scope) -> Value:
        match node:
            case ast.Constant(int() | float() as number):
                return number
            case ast.Name(name):
                return self._name(name, scope)
            case ast.Tuple(elements):
                return tuple(self._value(element, scope) for element in elements)
            case ast.Subscript(value, index):
                return self._value(value, scope)[self._value(index, scope)]
            case ast.UnaryOp(ast.USub(), operand):
                value = self._value(operand, scope)
                return self._builder.fneg(value) if isinstance(value, ir.Value) else -value
            case ast.BinOp(left, ast.BitAnd() | ast.BitOr() as sign, right):
                masks = self._value(left, scope), self._value(right, scope)
                return (
                    self._builder.and_(*masks) if isinstance(sign, ast.BitAnd) else self._builder.or_(*masks)
                )
            case ast.BinOp(left, sign, right) if type(sign) in _ARITHMETIC:
                return self._operation(type(sign), self._value(left, scope), self._value(right, scope))
            case ast.Compare(left, [sign], [right]) if type(sign) in _COMPARISONS:
                operands = (
                    self._as_vector(self._value(left, scope)),
                    self._as_vector(self._value(right, scope)),
                )
                return self._builder.fcmp_ordered(_COMPARISONS[type(sign)], *operands)
            case ast.Call(ast.Name("load"), [rows, row]):
                return self._builder.load(self._row(rows, row, scope), align=_ALIGN)
            case ast.Call(ast.Name(name), arguments, []):
                return self._call(name, [self._value(argument, scope) for argument in arguments])
        raise LaneCompileError(f"a kernel cannot contain {ast.unparse(node)!r}")

    def _name(self, name: str, scope: _Scope) -> Value:
        """Return the value of a variable, an argument or a constant."""
        if name in scope.variables:
            return self._builder.load(scope.variables[name])
        if name in scope.arguments:
            return scope.arguments[name]
        constant = scope.constants.get(name)
        if not isinstance(constant, int | float | tuple):
            raise LaneCompileError(f"the name {name} is unknown in a kernel")
        return constant

    def _operation(self, sign: type, left: Value, right: Value) -> Value:
        """Return the result of an arithmetic operation: on numbers, integers, scalars or vectors."""
        in_python, on_floats, on_integers = _ARITHMETIC[sign]
        values = [v for v in (left, right) if isinstance(v, ir.Value)]
        if not values:
            return in_python(left, right)
        integers = (
            all(v.type == _I64 for v in values)
            and not isinstance(left, float)
            and not isinstance(right, float)
        )
        if integers and on_integers:
            return getattr(self._builder, on_integers)(self._as_type(left, _I64), self._as_type(right, _I64))
        convert = self._as_vector if any(v.type == self._vector for v in values) else self._as_scalar
        return getattr(self._builder, on_floats)(convert(left), convert(right))

    def _call(self, name: str, operands: Sequence[Value]) -> Value:
        """Return the value of a vector instruction or of a formula."""
        if name in _INTRINSICS:
            intrinsic, arity = _INTRINSICS[name]
            return self._intrinsic(intrinsic, self._vectors(name, operands, arity))
        match name:
            case "minimum" | "maximum":  # if a value is NaN, the second one
                first, second = self._vectors(name, operands, 2)
                smaller = self._builder.fcmp_ordered("<" if name == "minimum" else ">", first, second)
                return self._builder.select(smaller, first, second)
            case "polynomial":
                x, coefficients = operands
                return reduce(lambda p, c: self._call("fma", [x, p, c]), coefficients)
            case "where":
                mask, yes, no = operands
                return self._builder.select(mask, self._as_vector(yes), self._as_vector(no))
            case "any_of":
                bits = ir.IntType(self._lanes)
                return self._builder.icmp_unsigned(
                    "!=", self._builder.bitcast(operands[0], bits), ir.Constant(bits, 0)
                )
            case "pow2":
                return self._pow2(*self._vectors(name, operands, 1))
        if name not in self._formulas:
            raise LaneCompileError(f"the function {name} is unknown in a kernel")
        formula = self._formulas[name]
        node = _syntax_tree(formula)
        names = [argument.arg for argument in node.args.args]
        return self._block(node.body, _Scope(dict(zip(names, operands, strict=True)), formula.__globals__))

    def _vectors(self, name: str, operands: Sequence[Value], arity: int) -> list[Value]:
        """Return the operands of an instruction as vectors."""
        if len(operands) != arity:
            raise LaneCompileError(f"{name} takes {arity} operands, not {len(operands)}")
        return list(map(self._as_vector, operands))

    def _intrinsic(self, name: str, operands: Sequence[Value]) -> Value:
        """Return the result of an intrinsic function of LLVM on vectors."""
        full_name = f"llvm.{name}.v{self._lanes}f64"
        function = self._module.globals.get(full_name)
        if function is None:
            kind = ir.FunctionType(self._vector, [self._vector] * len(operands))
            function = ir.Function(self._module, kind, full_name)
        return self._builder.call(function, operands)

    def _pow2(self, n: Value) -> Value:
        """Return 2**n: the float64 with the exponent bits n + 1023 and the mantissa 1."""
        integers = ir.VectorType(_I64, self._lanes)
        bias, shift = (ir.Constant(integers, [number] * self._lanes) for number in (1023, 52))
        exponent = self._builder.add(self._builder.fptosi(n, integers), bias)
        return self._builder.bitcast(self._builder.shl(exponent, shift), self._vector)

    def _row(self, rows: ast.expr, row: ast.expr, scope: _Scope) -> Value:
        """Return the address of a row."""
        first = self._value(rows, scope)
        if not isinstance(first, ir.Value) or first.type != self._rows:
            raise LaneCompileError(f"{ast.unparse(rows)} is no array of rows")
        index = self._operation(ast.Mult, self._value(row, scope), self._lanes)
        address = self._builder.gep(first, [self._as_type(index, _I64)])
        return self._builder.bitcast(address, self._vector_pointer)

    def _as_type(self, value: Value, kind: Any) -> Value:
        """Return a number as a constant of LLVM; other values unchanged."""
        return value if isinstance(value, ir.Value) else ir.Constant(kind, value)

    def _as_scalar(self, value: Value) -> Value:
        """Return a number or an integer as a float64."""
        if not isinstance(value, ir.Value):
            return ir.Constant(_F64, float(value))
        return self._builder.sitofp(value, _F64) if value.type == _I64 else value

    def _as_vector(self, value: Value) -> Value:
        """Return a scalar as a vector with the same number in all lanes."""
        if not isinstance(value, ir.Value):
            return _vector_constant(float(value).hex(), self._lanes)
        if value.type == self._vector:
            return value
        undefined = ir.Constant(self._vector, ir.Undefined)
        first = self._builder.insert_element(undefined, self._as_scalar(value), ir.Constant(_I32, 0))
        zeros = ir.Constant(ir.VectorType(_I32, self._lanes), [0] * self._lanes)
        return self._builder.shuffle_vector(first, undefined, zeros)
