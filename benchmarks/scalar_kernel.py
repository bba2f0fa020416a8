"""How much faster the SIMD kernel is than the same step in plain scalar Numba code.

Both run the same generated source. For the scalar version, `load`, `where`, `fma` and the other functions of
a register are functions of one number, and the loop goes over machines one at a time. One core each, timed
alternately.

    python -m benchmarks.scalar_kernel
"""

from __future__ import annotations

import ast
import inspect
import math
import time
from typing import Any

import numpy as np
from numba import njit

from hframe_gym.dynamics import LANES, in_blocks, kernel_for, kernel_source_text
from hframe_gym.dynamics.physics import friction
from hframe_gym.dynamics.simulation import parameter_batch
from hframe_gym.effects import EFFECTS
from hframe_gym.machine import BUILTIN_MACHINES, Machine

MACHINES = 512
STEPS = 40
REPEATS = 200
STEP = 0.25e-3  # s

_inlined = njit(forceinline=True, nogil=True, error_model="numpy", fastmath={"contract"})
_SCALAR = {
    "load": lambda array, row: array[row],
    "where": lambda condition, yes, no: yes if condition else no,
    "fma": lambda a, b, c: a * b + c,
    "copysign": lambda size, sign: math.copysign(size, sign),
    "absolute": lambda a: abs(a),
    "any_of": lambda condition: condition,
    "minimum": lambda a, b: a if a < b else b,
    "maximum": lambda a, b: a if a > b else b,
    "exp": lambda a: math.exp(a),
    "sin": lambda a: math.sin(a),
    "cos": lambda a: math.cos(a),
    "align_stack": lambda: None,
}


def _store(array: Any, row: int, value: float) -> None:
    array[row] = value


def scalar_functions(machine: Machine) -> tuple[Any, Any]:
    """Compile the generated `prepare` and a loop around `advance` for plain numbers.

    Returns:
        `prepare_all` and `advance_all`; their arrays have shape (machines, rows).
    """
    scope: dict[str, Any] = {name: _inlined(function) for name, function in _SCALAR.items()}
    scope |= {"store": _inlined(_store), "_SMALL": friction._SMALL, "Any": Any}
    functions = inspect.getmembers(
        friction, lambda f: inspect.isfunction(f) and f.__module__ == friction.__name__
    )
    texts = [inspect.getsource(function) for _, function in functions]
    text = kernel_source_text(machine)
    for source in (*texts, text[text.index("def prepare(") :]):
        for node in ast.parse(source).body:
            if isinstance(node, ast.FunctionDef):
                for argument in node.args.args:
                    argument.annotation = None
                exec(ast.unparse(node), scope)
                scope[node.name] = _inlined(scope[node.name])
    loops = """
def prepare_all(parameters, derived, h):
    for b in range(len(parameters)):
        prepare(parameters[b], derived[b], h)

def advance_all(state, parameters, derived, inputs, external_forces, h, steps):
    for b in range(len(state)):
        advance(state[b], parameters[b], derived[b], inputs[b], external_forces, h, steps)
"""
    exec(loops, scope)
    compiled = njit(nogil=True, error_model="numpy", boundscheck=False, fastmath={"contract"})
    return compiled(scope["prepare_all"]), compiled(scope["advance_all"])


def compare(machine: Machine) -> tuple[float, float, float]:
    """Return ns per machine and step of SIMD and scalar kernel, and the largest difference of travel, m."""
    kernel, (prepare, advance) = kernel_for(machine), scalar_functions(machine)
    table = np.tile(parameter_batch(machine), (MACHINES, 1))
    inputs = np.random.default_rng(0).uniform(-9.0, 9.0, (MACHINES, len(machine.drives)))
    derived, count = np.zeros((MACHINES, len(kernel.layout.derived))), len(machine.coordinates)
    prepare(table, derived, STEP)
    blocks = [in_blocks(a) for a in (np.zeros((MACHINES, kernel.states)), table, derived, inputs)]
    state, external_forces = np.zeros((MACHINES, kernel.states)), np.zeros(count)
    times: dict[str, list[float]] = {"simd": [], "scalar": []}
    for repeat in range(REPEATS):
        if repeat % 8 == 0:
            blocks[0][:] = 0.0
            state[:] = 0.0
        start = time.perf_counter()
        kernel.advance_blocks(*blocks, STEP, STEPS, 0, MACHINES // LANES)
        middle = time.perf_counter()
        advance(state, table, derived, inputs, external_forces, STEP, STEPS)
        if repeat:
            times["simd"].append(middle - start)
            times["scalar"].append(time.perf_counter() - middle)
    simd, scalar = (1e9 * float(np.quantile(t, 0.1)) / (MACHINES * STEPS) for t in times.values())
    difference = blocks[0].transpose(0, 2, 1).reshape(MACHINES, -1)[:, :count] - state[:, :count]
    return simd, scalar, float(np.abs(difference).max())


def main() -> None:
    """Print a table."""
    hframe = BUILTIN_MACHINES["hframe"]()
    friction_effects = (
        EFFECTS["stribeck_friction"].at("x", dF=3.0, vs=0.04),
        EFFECTS["cogging"].at("motor1", A=0.03, n=23.6, p=0.5),
    )
    machines = {
        "hframe": hframe,
        "hframe-order20": BUILTIN_MACHINES["hframe-order20"](),
        "hframe with Stribeck friction and cogging": hframe.with_effects(*friction_effects),
    }
    print(f"{'machine':45}{'SIMD, ns':>10}{'scalar, ns':>12}{'ratio':>8}{'difference, m':>16}")
    for name, machine in machines.items():
        simd, scalar, difference = compare(machine)
        print(f"{name:45}{simd:10.2f}{scalar:12.2f}{scalar / simd:8.2f}{difference:16.1e}")


if __name__ == "__main__":
    main()
