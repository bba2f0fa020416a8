"""Reverse-mode derivatives of a traced function.

A `ReverseTrace` records a function as `Trace` does, but without variables: each value is one expression of
the function's arguments. `adjoints` then goes through the expressions from the last to the first and adds, by
the chain rule, the expressions of the derivatives of one weighted sum of the results with respect to every
argument. They are written and compiled as any other traced function.

A condition selects a branch, and the derivative is that of this branch. Where a branch is seldom taken
(`update_if_any`), the derivative skips it as the function does.
"""

from __future__ import annotations

import types
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from typing_extensions import override

from ..physics import friction
from ..symbolic.elementwise import copysign, cos, fma, sin, where
from ..symbolic.tracing import Expression, Statement, Trace

# Operations whose derivative is zero, or which give a condition.
_CONSTANT = {
    "number",
    "variable",
    "load",
    "<",
    "<=",
    ">",
    ">=",
    "==",
    "!=",
    "&",
    "|",
    "sign",
    "rint",
    "floor",
}
# Formulas of the kernel that are one operation here, with the formula of the derivative.
_SLOPES = {"decay_integral": "decay_integral_slope", "end_weight": "end_weight_slope", "ramp": "ramp_slope"}


def _operation(name: str) -> Callable[..., Any]:
    """Return the function that records an operation of this name on expressions."""
    return lambda *operands: next(o for o in operands if isinstance(o, Expression)).trace.node(
        name, *operands
    )


def _traceable(formula: Callable[..., Any]) -> Any:
    """Return a formula of the kernel as a function of expressions, which selects branches by `where`."""
    code: Any = formula
    operations = {name: _operation(name) for name in ("ramp", "static_friction")}
    names = {**code.__globals__, "any_of": lambda condition: True, **operations}
    return types.FunctionType(code.__code__, names)


_EXPANDED = {name: _traceable(getattr(friction, name)) for name in ("direction", "stop_or_reverse")}


@dataclass(frozen=True)
class _Guard:
    """Values that are updated only where a condition holds.

    Attributes:
        after: Expressions of the values within the branch.
        results: Variables that have either.
        first: Number of expressions that existed before the branch.
        statements: Statements that compute the results.
    """

    condition: Expression
    before: tuple[Expression, ...]
    after: tuple[Expression, ...]
    results: tuple[Expression, ...]
    first: int
    statements: tuple[Statement, ...]


class ReverseTrace(Trace):
    """Record of a function to differentiate; `store` keeps a result instead of writing it.

    Args:
        signature: Name and arguments of the generated function of the derivatives.
        friction: Derivative of static friction, see `derivatives.Friction`.

    Attributes:
        loaded: Expression of each row of an array argument that the function uses, by array and row.
        stored: Results of the function, by array and row.
    """

    def __init__(self, signature: str, *, friction: str = "exact") -> None:
        super().__init__(signature)
        self.friction = friction
        self.loaded: dict[tuple[str, int], Expression] = {}
        self.stored: dict[tuple[str, int], Expression] = {}
        self._guards: list[_Guard] = []

    @override
    def node(self, operation: str, *operands: Any) -> Expression:
        """Return the expression of an operation, as in `Trace`; formulas of friction are expanded.

        `direction`, `friction_force` and `update_speed` (`physics.friction`), each of which is one operation
        in a `Trace`, become the operations of their formulas, whose derivatives are known. `static_friction`
        remains one operation, with the derivative that the argument `friction` chooses.
        """
        if operation in _EXPANDED:
            value: Expression = _EXPANDED[operation](*operands)
            return value
        if operation == "friction_force":
            return self._friction_force(*operands)
        if operation == "update_speed":
            v, f, coulomb, decay, gain = operands
            return fma(gain, f - self._friction_force(v, f, coulomb), decay * v)  # type: ignore[no-any-return]
        return super().node(operation, *operands)

    def _friction_force(self, v: Expression, f: Expression, coulomb: Any) -> Expression:
        static = super().node("static_friction", f, coulomb)
        return where(v == 0.0, static, copysign(coulomb, v))  # type: ignore[no-any-return]

    @override
    def load(self, array: str, row: int | str, name: str, *, invariant: bool = True) -> Expression:
        """Return the expression that loads a row of an array argument, as in `Trace`."""
        value = super().load(array, row, name, invariant=invariant)
        self.loaded[array, int(row)] = value
        return value

    @override
    def store(self, array: str, row: int | str, value: Any) -> None:
        """Keep a result of the function, whose derivatives `adjoints` computes."""
        self.stored[array, int(row)] = self.expression(value)

    def operations(self, formula: str, *operands: Any) -> tuple[Expression, ...]:
        """Expand the friction formula "stop_or_reverse", which has several results, to single operations.

        Args:
            formula: "stop_or_reverse".
            *operands: Its arguments.

        Returns:
            Expression of each result, final speed and distance.
        """
        return tuple(_EXPANDED[formula](*operands))

    def read(self, array: str, row: int) -> Expression:
        """Return the expression that loads a row of an array of derivatives; it is not differentiated."""
        return super().load(array, row, "")

    def write(self, array: str, row: int, value: Expression) -> None:
        """Append a statement that writes a value to a row of an output array of derivatives."""
        super().store(array, row, value)

    def add_to(self, array: str, row: int, value: Expression) -> None:
        """Append a statement that adds a value to a row of an output array of derivatives."""
        super().store(array, row, self.read(array, row) + value)

    @override
    def variable(self, role: str, index: int | None, value: Expression) -> Expression:
        """Return the value itself, with a name, because a reverse trace has no variables."""
        return self.let(role, index, value)

    @override
    def assign(self, variable: Expression, value: Expression) -> Expression:
        """Return the new value itself, because a reverse trace has no variables."""
        return value

    @override
    def update_if_any(
        self, condition: Expression, values: Sequence[Any], update: Callable[[Sequence[Any]], Sequence[Any]]
    ) -> list[Expression]:
        """Append a block that updates values only if a condition is true, as in `Trace`."""
        before = tuple(map(self.expression, values))
        begin = len(self._block)
        variables = [
            super(ReverseTrace, self).variable("guarded", i, value) for i, value in enumerate(before)
        ]
        first = len(self._nodes)
        with self.block("if any_of({}):", condition):
            after = tuple(map(self.expression, update(before)))
            results = [super(ReverseTrace, self).assign(*pair) for pair in zip(variables, after, strict=True)]
        added = tuple(self._block[begin:])
        self._guards.append(_Guard(condition, before, after, tuple(results), first, added))
        return results

    def drop_unused_branches(self) -> None:
        """Remove the branches whose results no other statement uses; these are most branches."""
        dropped = {id(guard): guard for guard in self._guards}
        while True:
            unused = {id(s) for guard in dropped.values() for s in guard.statements}
            kept = [s for s in self.statements if id(s) not in unused]
            needed = _needed_by(kept)
            missing = [key for key, guard in dropped.items() if not needed.isdisjoint(guard.results)]
            if not missing:
                self.statements[:] = kept
                return
            for key in missing:
                del dropped[key]

    # -- derivatives -----------------------------------------------------------------------------------------

    def adjoints(
        self, seeds: Mapping[Expression, Expression], arguments: Iterable[Expression]
    ) -> dict[Expression, Expression]:
        """Append the derivatives of the sum of seed * result with respect to arguments of the function.

        Args:
            seeds: Factor of each result: expressions of this trace, loaded or constant.
            arguments: Expressions with respect to which the sum is differentiated, for example loaded rows.

        Returns:
            Expression of each derivative, by argument; arguments that do not change the results are left out.
        """
        wanted = set(arguments)
        nodes = list(self._nodes.values())
        active = self._active(nodes, wanted)
        found = self._backward(nodes, 0, dict(seeds), active)
        return {argument: found[argument] for argument in wanted if argument in found}

    def _active(self, nodes: Sequence[Expression], wanted: set[Expression]) -> set[Expression]:
        """Return the expressions whose value depends differentiably on one of the wanted arguments."""
        guards = {result: guard for guard in self._guards for result in guard.results}
        active: set[Expression] = set()
        for node in nodes:
            if node in guards:
                guard = guards[node]
                depends = any(value in active for value in (*guard.before, *guard.after))
            else:
                inner = () if node.operation in _CONSTANT else node.operands
                depends = node in wanted or any(operand in active for operand in inner)
            if depends:
                active.add(node)
        return active

    def _backward(
        self,
        nodes: Sequence[Expression],
        first: int,
        adjoint: dict[Expression, Expression],
        active: set[Expression],
    ) -> dict[Expression, Expression]:
        """Propagate adjoints from the last node to that with index `first`; return those of all others."""
        guards = {guard.results[-1]: guard for guard in self._guards}

        def add(node: Expression, value: Any) -> None:
            if node in active:
                adjoint[node] = adjoint[node] + value if node in adjoint else self.expression(value)

        for node in reversed(nodes[first:]):
            if node in guards and guards[node].first >= first:
                for value, change in self._through_guard(guards[node], nodes, adjoint, active):
                    add(value, change)
            elif node in adjoint and node.operation not in _CONSTANT:
                for operand, change in self._partial(node, adjoint.pop(node), active):
                    add(operand, change)
        return adjoint

    def _through_guard(
        self,
        guard: _Guard,
        nodes: Sequence[Expression],
        adjoint: dict[Expression, Expression],
        active: set[Expression],
    ) -> list[tuple[Expression, Expression]]:
        """Append a block with a branch's derivatives; return what it adds to those of earlier expressions."""
        seeds = [adjoint.pop(result, None) for result in guard.results]
        skipped: dict[Expression, Expression] = {}  # derivatives if the branch is not taken
        taken: dict[Expression, Expression] = {}
        for before, after, seed in zip(guard.before, guard.after, seeds, strict=True):
            if seed is not None:
                self.let("seed", None, seed)
                skipped[before] = skipped[before] + seed if before in skipped else seed
                taken[after] = taken[after] + seed if after in taken else seed
        if not taken:
            return []
        last = next(i for i in range(guard.first, len(nodes)) if nodes[i] is guard.results[0])
        taken = {node: seed for node, seed in taken.items() if node in active}
        taken = self._backward(nodes[:last], guard.first, taken, active)
        targets = [node for node in {**skipped, **taken} if node in active]
        # Zero for every machine: a register, which a number would not be.
        none = self.node("where", guard.condition, 0.0, 0.0)
        variables = [
            super(ReverseTrace, self).variable("derivative", None, skipped.get(node, none))
            for node in targets
        ]
        with self.block("if any_of({}):", guard.condition):
            inside = [self.let("taken", None, taken.get(node, self.expression(0.0))) for node in targets]
            results = [
                super(ReverseTrace, self).assign(*pair) for pair in zip(variables, inside, strict=True)
            ]
        return list(zip(targets, results, strict=True))

    def _partial(
        self, node: Expression, a: Expression, active: set[Expression]
    ) -> list[tuple[Expression, Any]]:
        """Return what an operation adds to the adjoints of its operands, if its adjoint is `a`."""
        x, y, z = (*node.operands, None, None)[:3]
        match node.operation:
            case "+":
                return [(x, a), (y, a)]
            case "-":
                return [(x, a), (y, -a)]
            case "*":
                return [(factor, a * other) for factor, other in ((x, y), (y, x)) if factor in active]
            case "/":
                ratio = a / y
                return [(x, ratio), (y, -ratio * node)] if y in active else [(x, ratio)]
            case "neg":
                return [(x, -a)]
            case "fma":
                return [(factor, a * other) for factor, other in ((x, y), (y, x)) if factor in active] + [
                    (z, a)
                ]
            case "exp":
                return [(x, a * node)]
            case "log":
                return [(x, a / x)]
            case "sin":
                return [(x, a * cos(x))]
            case "cos":
                return [(x, -a * sin(x))]
            case "tanh":
                return [(x, a * (1.0 - node * node))]
            case "sqrt":
                return [(x, where(node > 0.0, 0.5 * a / where(node > 0.0, node, 1.0), 0.0))]
            case "absolute":
                return [(x, where(x < 0.0, -a, a))]
            case "copysign":
                return [(x, where(x < 0.0, -a, a) * copysign(1.0, y))]
            case "minimum":
                return [(x, where(x < y, a, 0.0)), (y, where(x < y, 0.0, a))]
            case "maximum":
                return [(x, where(x > y, a, 0.0)), (y, where(x > y, 0.0, a))]
            case "where":
                return [(y, where(x, a, 0.0)), (z, where(x, 0.0, a))]
        if node.operation == "static_friction":
            return self._static_friction(x, y, a)
        if node.operation in _SLOPES:
            return [(x, a * self.node(_SLOPES[node.operation], x))]
        raise NotImplementedError(f"a kernel's function {node.operation!r} has no derivative")

    def _static_friction(
        self, f: Expression, coulomb: Expression, a: Expression
    ) -> list[tuple[Expression, Any]]:
        """Return what a resting coordinate's friction, f limited to +-coulomb, adds to the adjoints."""
        holds = abs(f) < coulomb
        by_coulomb = where(holds, 0.0, a * copysign(1.0, f))
        if self.friction == "sliding":
            return [(coulomb, by_coulomb)]
        kept = a
        if self.friction == "smoothed":
            kept = a * (1.0 - abs(f) / where(coulomb > 0.0, coulomb, 1.0))
        return [(f, where(holds, kept, 0.0)), (coulomb, by_coulomb)]


def _needed_by(statements: Iterable[Statement]) -> set[Expression]:
    """Return the expressions that some statements compute or use."""
    found: set[Expression] = set()
    values: list[Any] = [v for s in statements if s.text for v in s.values]
    for statement in statements:
        found |= _needed_by(statement.body)
    while values:
        value = values.pop()
        if isinstance(value, Expression) and value not in found:
            found.add(value)
            values += value.operands
    return found
