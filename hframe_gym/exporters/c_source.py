"""C99 source of feedforward, friction compensation and the textbook PID of a machine, with a test bench."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from typing_extensions import override

from ..machine import Machine
from .base import EXPORTERS, Files, MachineExporter, option
from .source.c99 import C99, c_comment, constants, declaration, definition, function_text, helper_functions
from .source.formula import Formula
from .source.inverse_dynamics import BISECTIONS
from .source.language import write_body
from .source.motion_formulas import MotionFormulas, Vectors, check_prefix, motion_formulas

VECTORS, SEED = 200, 0
TOLERANCE = 1e-9  # relative; the same operations in another order differ by some 1e-15
# Errors are relative to the expected value, but at least to this fraction of the largest one: a small voltage
# may be the difference of two large ones.
SMALLEST_SCALE = 1e-3


@EXPORTERS.register("c")
@dataclass(frozen=True, kw_only=True)
class CExporter(MachineExporter):
    """Write C99 source for a motion controller: feedforward, friction compensation and a PID step.

    PREFIX.h and PREFIX.c have the voltages that a motion of the tool needs (inertia, viscous friction and
    back-EMF, dry friction with its identified effects, forces of effects; gain, offset and dead band of the
    amplifier are inverted), the part against friction alone, the motor positions with stretched belts, and
    one step of the textbook PID. They are written from the equations of the simulator. PREFIX_test.c compares
    them with values that the equations give: cc -std=c99 PREFIX.c PREFIX_test.c -lm && ./a.out

    Example:  hframe export c --machine hframe --period 0.001 --out out/c
    """

    separable: ClassVar[bool] = False

    period: float = option(0.01, "Control period of the PID in seconds, 1e-5 to 10.")
    prefix: str = option("stage", "Beginning of the names of files and functions.")

    @override
    def files(self, machine: Machine) -> Files:
        """Write PREFIX.h, PREFIX.c and PREFIX_test.c."""
        prefix = check_prefix(self.prefix)
        motion = motion_formulas(machine, self.period)
        comment = c_comment(self.header(machine, *motion.statements()))
        return {
            f"{prefix}.h": comment + _header(motion, prefix),
            f"{prefix}.c": comment + _source(motion, prefix),
            f"{prefix}_test.c": comment + _test_bench(motion, prefix),
        }


def _header(motion: MotionFormulas, prefix: str) -> str:
    """Return the header file."""
    guard = f"{prefix.upper()}_H"
    lines = [f"#ifndef {guard}", f"#define {guard}", "", "#ifdef __cplusplus", 'extern "C" {', "#endif", ""]
    lines += [declaration(formula, prefix) for formula in motion.formulas]
    lines += ["#ifdef __cplusplus", "}", "#endif", "", "#endif"]
    return "\n".join(lines) + "\n"


def _source(motion: MotionFormulas, prefix: str) -> str:
    """Return the source file: parameters and helper functions that occur, then the functions."""
    language = C99(prefix)
    used: set[str] = set()
    blocks = []
    for j, amplifier in motion.amplifiers.items():
        body = write_body(amplifier, language)
        used |= body.used
        lines = [line if not line.startswith("result = ") else f"return {line[9:]}" for line in body.lines]
        blocks.append(function_text(f"static double {prefix}_amplifier_{j}(double command)", lines))
        blocks.append(_inverse(prefix, j, float(motion.dynamics.limits[j])))
    for formula in motion.formulas:
        text, names = definition(formula, language)
        used |= names
        blocks.append(text)
    parts = [f'#include "{prefix}.h"\n\n#include <math.h>\n', constants(motion.parameters, used)]
    return "\n".join([*parts, *helper_functions(language), *blocks])


def _inverse(prefix: str, j: int, limit: float) -> str:
    """Return the function that inverts an amplifier, `InverseDynamics.command` in C."""
    return f"""/* Smallest command in magnitude for a voltage at motor {j}, V, within the drive's limit. */
static double {prefix}_command_{j}(double voltage)
{{
    double low = 0.0, high = {limit!r};
    const double at_rest = {prefix}_amplifier_{j}(0.0);
    const double side = voltage > at_rest ? 1.0 : -1.0;
    int i;
    if (voltage == at_rest)
        return 0.0;
    for (i = 0; i < {BISECTIONS}; i++) {{
        const double middle = 0.5 * (low + high);
        if (side * {prefix}_amplifier_{j}(side * middle) < side * voltage)
            low = middle;
        else
            high = middle;
    }}
    return side * high;
}}
"""


def _test_bench(motion: MotionFormulas, prefix: str) -> str:
    """Return a program that compares the functions with vectors of the simulator's equations."""
    blocks = [
        f'#include <math.h>\n#include <stdio.h>\n\n#include "{prefix}.h"\n',
        f"#define VECTORS {VECTORS}\n",
    ]
    calls = []
    for formula in motion.formulas:
        vectors = motion.vectors(formula, VECTORS, SEED)
        blocks += [
            _array(f"{formula.name}_in", vectors.inputs),
            _array(f"{formula.name}_out", vectors.outputs),
        ]
        calls += _comparison(formula, vectors, prefix)
    lines = ["double worst = 0.0;", "int i, k;", *calls]
    lines += [f"return worst <= {TOLERANCE!r} ? 0 : 1;"]
    return "\n".join([*blocks, function_text("int main(void)", lines)])


def _comparison(formula: Formula, vectors: Vectors, prefix: str) -> list[str]:
    """Return the lines that call one function for every vector and print its largest error."""
    states = set(formula.states)
    offset, arguments, declarations = 0, [], []
    for s in formula.inputs:
        if s in states:
            declarations.append(f"double {s.name}[{s.size}] = {{0}};")
            arguments.append(s.name)
            continue
        row = f"{formula.name}_in[i]"
        arguments.append(f"{row} + {offset}" if s.size else f"{row}[{offset}]")
        offset += s.size or 1
    outputs = vectors.outputs.shape[1]
    scale = SMALLEST_SCALE * float(np.abs(vectors.outputs).max()) or 1.0
    return [
        "{",
        *(f"    {line}" for line in declarations),
        "    double largest = 0.0;",
        "    for (i = 0; i < VECTORS; i++) {",
        f"        double result[{outputs}];",
        f"        {prefix}_{formula.name}({', '.join([*arguments, 'result'])});",
        f"        for (k = 0; k < {outputs}; k++) {{",
        f"            const double expected = {formula.name}_out[i][k];",
        f"            const double error = fabs(result[k] - expected) / fmax(fabs(expected), {scale!r});",
        "            if (!(error <= largest))",
        "                largest = error;",
        "        }",
        "    }",
        f'    printf("{formula.name}: largest relative error %.3g\\n", largest);',
        "    if (!(largest <= worst))",
        "        worst = largest;",
        "}",
    ]


def _array(name: str, values: np.ndarray) -> str:
    """Return a constant two-dimensional array."""
    rows = [f"    {{{', '.join(map(repr, row))}}}," for row in values.tolist()]
    return (
        f"static const double {name}[{values.shape[0]}][{values.shape[1]}] = {{\n"
        + "\n".join(rows)
        + "\n};\n"
    )
