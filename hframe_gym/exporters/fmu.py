"""FMU for co-simulation (FMI 3.0, C source) of a machine."""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass
from importlib import resources
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from ..dynamics import Equations, MotionPoint, resolved_step
from ..dynamics.simulation import LONGEST_STEP
from ..errors import InputError
from ..machine import Machine, rest_positions_per_axis
from .base import EXPORTERS, Files, MachineExporter, indented, plain
from .c_source import function_block, helper_functions
from .formula_source import C99, Formula, Signal, parameters_of, trace_formula, write_body

_FIRST_INPUT, _FIRST_OUTPUT, _FIRST_START = 1, 1001, 2001  # value references
_UNITS = {"m": 'm="1"', "rad": 'rad="1"', "V": 'kg="1" m="2" s="-3" A="-1"', "s": 's="1"'}
_DATE = (1980, 1, 1, 0, 0, 0)  # of the files in the archive: equal exports are equal
_DELAYS = ("delay", "measurement_delay", "rest_angle_offset")


@EXPORTERS.register("fmu")
@dataclass(frozen=True, kw_only=True)
class FmuExporter(MachineExporter):
    """Write a functional mock-up unit (FMI 3.0, co-simulation) of a machine as C source.

    Inputs are the drive voltages, held over each communication step; outputs are the sensors without noise; the
    parameters start_AXIS place the tool, at rest. It has the equations and the integrator of this package, effects
    included. The tool that imports it compiles it: FMPy does with `fmpy compile stage.fmu`.

    Example:  hframe export fmu --machine hframe --out stage.fmu
    """

    def files(self, machine: Machine) -> Files:
        """Return the archive."""
        unsupported = [e.label for e in machine.effects if any(getattr(e.definition, h) for h in _DELAYS)]
        if unsupported:
            raise InputError(
                f"machine {machine.name!r}: an FMU has no place for {', '.join(unsupported)} (delays, eccentric "
                "pulleys); remove it from a copy of the machine and add a delay in the tool that imports the FMU"
            )
        if not machine.tool_axes or not machine.sensors:
            raise InputError(
                f"machine {machine.name!r}: an FMU needs tool axes, whose start it sets, and sensors"
            )
        others = [sensor.channel for sensor in machine.sensors if not sensor.of_position]
        if others:
            raise InputError(
                f"machine {machine.name!r}: the outputs of an FMU are positions; leave {', '.join(others)} out of a "
                "copy of the machine"
            )
        token = self.provenance(machine)["machine_sha256"]
        comment = "/*\n" + "".join(f" * {line}\n" for line in self.header(machine)) + " */\n"
        formulas = _formulas(machine)
        contents = {
            "modelDescription.xml": self._description(machine, token),
            "sources/buildDescription.xml": _BUILD,
            "sources/fmi3.c": (resources.files(__package__) / "templates" / "fmi3.c").read_text("utf-8"),
            "sources/model.h": comment + _header(formulas),
            "sources/model.c": comment + _source(machine, formulas),
            "sources/sizes.h": comment + _sizes(machine, formulas, token),
        }
        archive = io.BytesIO()
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
            for name, text in contents.items():
                file.writestr(zipfile.ZipInfo(name, _DATE), text, zipfile.ZIP_DEFLATED)
        return {"stage.fmu": archive.getvalue()}

    def _description(self, machine: Machine, token: str) -> str:
        """Return modelDescription.xml."""
        variables = ['<Float64 name="time" valueReference="0" causality="independent" unit="s"/>']
        for j, channel in enumerate(machine.input_channels):
            variables.append(
                f'<Float64 name={quoteattr(channel)} valueReference="{_FIRST_INPUT + j}" causality="input" '
                'variability="discrete" start="0.0" unit="V"/>'
            )
        outputs = []
        for j, sensor in enumerate(machine.sensors):
            reference, unit = _FIRST_OUTPUT + j, machine.sensor_unit(sensor)
            variables.append(
                f'<Float64 name={quoteattr(sensor.channel)} valueReference="{reference}" causality="output" '
                f'unit="{unit}"/>'
            )
            outputs.append(reference)
        for k, axis in enumerate(machine.tool_axes):
            variables.append(
                f'<Float64 name={quoteattr("start_" + axis)} valueReference="{_FIRST_START + k}" causality="parameter" '
                'variability="fixed" start="0.0" unit="m"/>'
            )
        structure = "".join(f'<Output valueReference="{r}"/>' for r in outputs)
        structure += "".join(f'<InitialUnknown valueReference="{r}"/>' for r in outputs)
        units = "".join(f'<Unit name="{name}"><BaseUnit {base}/></Unit>' for name, base in _UNITS.items())
        about = " | ".join(self.header(machine))
        text = (
            f'<fmiModelDescription fmiVersion="3.0" modelName={quoteattr(plain(machine.name) or "stage")} '
            f'instantiationToken="{token}" description={quoteattr(about)} '
            f'generationTool={quoteattr(self.provenance(machine)["software"])} variableNamingConvention="flat">'
            '<CoSimulation modelIdentifier="stage" canHandleVariableCommunicationStepSize="true"/>'
            f"<UnitDefinitions>{units}</UnitDefinitions>"
            '<DefaultExperiment startTime="0" stopTime="1" stepSize="0.001"/>'
            f"<ModelVariables>{''.join(variables)}</ModelVariables>"
            f"<ModelStructure>{structure}</ModelStructure></fmiModelDescription>"
        )
        return '<?xml version="1.0" encoding="UTF-8"?>\n' + indented(text)


_BUILD = """<?xml version="1.0" encoding="UTF-8"?>
<fmiBuildDescription fmiVersion="3.0">
  <BuildConfiguration modelIdentifier="stage">
    <SourceFileSet language="C99">
      <SourceFile name="fmi3.c"/>
      <SourceFile name="model.c"/>
    </SourceFileSet>
  </BuildConfiguration>
</fmiBuildDescription>
"""


def _formulas(machine: Machine) -> list[Formula]:
    """Trace the parts of `dynamics.reference_step` that depend on the machine."""
    parameters = parameters_of(machine)
    count, drives = len(machine.coordinates), len(machine.drives)
    numeric = Equations(machine)
    states = len(numeric.states)
    definitions = [e.definition for e in machine.effects]
    nonlinear_belts = any(d.tension or d.belt_travel for d in definitions)
    time, elapsed = Signal("time", 0, "s"), Signal("elapsed", 0, "time since the states were valid, s")
    travel, speed = Signal("travel", count, "belt travel, m"), Signal("speed", count, "its rate, m/s")
    shift = Signal("shift", count, "correction of the travel, m")
    state = Signal("state", max(states, 1), "states of effects, SI")
    voltage = Signal("voltage", drives, "commanded voltages, V")
    force, level = Signal("force", count, "forces, N"), Signal("level", count, "Coulomb friction, N")
    keys: list[tuple[int, str]] = []

    def point(equations: Equations, t: Any, p: Any, v: Any, z: Any, dt: Any) -> MotionPoint:
        return MotionPoint(p, v, t, dict(zip(equations.states, z, strict=False)), dt)

    def half_way(values: Any, t: Any, p: Any, v: Any, z: Any, dt: Any, u: Any) -> list[Any]:
        equations = Equations(machine, values)
        here, volts = point(equations, t, p, v, z, dt), equations.motor_voltages(u)
        belts = equations.belt_forces(here, equations.belt_states(here))
        balance = equations.force_balance(here, volts, equations.add_drive_forces(belts, volts))
        return [*balance.forces, *balance.coulomb]

    def corrected(values: Any, t: Any, p: Any, dp: Any, v: Any, z: Any, dt: Any, u: Any) -> list[Any]:
        equations = Equations(machine, values)
        volts = equations.motor_voltages(u)
        there = point(equations, t, [a + b for a, b in zip(p, dp, strict=True)], v, z, dt)
        if nonlinear_belts:
            belts = equations.belt_forces(there, equations.belt_states(there))
        else:  # the stiffness at the half-way point serves again, as in the simulator
            here = point(equations, t, p, v, z, dt)
            found = equations.belt_states(here)
            belts = equations.belt_forces(here, found)
            for belt, row in zip(found, equations.extension_rows, strict=True):
                change = belt.stiffness * sum(g * dp[i] for i, g in row.items())
                belts = [f - row[i] * change if i in row else f for i, f in enumerate(belts)]
        balance = equations.force_balance(there, volts, equations.add_drive_forces(belts, volts))
        keys[:] = [(k, name) for k in equations.states for name in balance.arguments.get(k, {})]
        values_of = [balance.arguments[k][name] for k, name in keys] or [0.0]
        return [*balance.forces, *balance.coulomb, *values_of]

    def next_state(values: Any, z: Any, arguments: Any, traveled: Any, v: Any, dt: Any) -> list[Any]:
        equations = Equations(machine, values)
        of_effect: dict[int, dict[str, Any]] = {}
        for (k, name), value in zip(keys, arguments, strict=False):
            of_effect.setdefault(k, {})[name] = value
        found = [
            equations.next_state(k, z[row], of_effect.get(k, {}), traveled, v, dt)
            for row, k in enumerate(equations.states)
        ]
        return found or [z[0]]

    def sensors(values: Any, p: Any) -> list[Any]:
        equations = Equations(machine, values)
        return equations.sensor_readings([p[i] * equations.per_radius(i) for i in range(count)])

    first = trace_formula(
        "half_way",
        "Forces at the half-way point.",
        (time, travel, speed, state, elapsed, voltage),
        (force, level),
        half_way,
        parameters,
    )
    # The number of arguments of the effects' states is known after a trace.
    trace_arguments = Signal("arguments", 1, "inputs of the states of effects")
    inputs = (time, travel, shift, speed, state, elapsed, voltage)
    second = trace_formula(
        "corrected",
        "Forces at the corrected point.",
        inputs,
        (force, level, trace_arguments),
        corrected,
        parameters,
    )
    arguments = Signal("arguments", max(len(keys), 1), "inputs of the states of effects")
    second.outputs = (force, level, arguments)
    third = trace_formula(
        "next_state",
        "States of effects after a step.",
        (state, arguments, Signal("traveled", count, "m"), speed, Signal("dt", 0, "s")),
        (state,),
        next_state,
        parameters,
    )
    readings = Signal("output", len(machine.sensors), "readings of the sensors, m or rad")
    fourth = trace_formula("sensors", "Readings of the sensors.", (travel,), (readings,), sensors, parameters)
    return [first, second, third, fourth]


def _header(formulas: list[Formula]) -> str:
    """Return model.h."""
    lines = [function_block(f, C99("model"))[0] + ";" for f in formulas]
    return "#ifndef MODEL_H\n#define MODEL_H\n\n" + "\n".join(lines) + "\n\n#endif\n"


def _source(machine: Machine, formulas: list[Formula]) -> str:
    """Return model.c."""
    language, used, blocks = C99("model"), set[str](), []
    for formula in formulas:
        used |= write_body(formula, language).used
        signature, block = function_block(formula, language)
        blocks.append(f"/* {formula.comment} */\n{signature}\n{block}")
    constants = [
        f"static const double {p.identifier} = {p.value!r}; /* {p.comment} */"
        for p in parameters_of(machine).values()
        if p.identifier in used
    ]
    parts = [
        '#include "model.h"\n\n#include <math.h>\n',
        "\n".join(constants) + "\n",
        *helper_functions(language),
        *blocks,
    ]
    return "\n".join(parts)


def _sizes(machine: Machine, formulas: list[Formula], token: str) -> str:
    """Return sizes.h: numbers of quantities, and coefficients of the coordinates."""
    equations = Equations(machine)
    count = len(machine.coordinates)
    arguments = next(s for f in formulas for s in f.inputs if s.name == "arguments")
    rigid = rest_positions_per_axis(machine) * machine.travel_per_unit[:, None]
    numbers = {
        "COORDINATES": count,
        "DRIVES": len(machine.drives),
        "SENSORS": len(machine.sensors),
        "AXES": len(machine.tool_axes),
        "STATES": len(equations.states),
        "ARGUMENTS": arguments.size,
        "FIRST_INPUT": _FIRST_INPUT,
        "FIRST_OUTPUT": _FIRST_OUTPUT,
        "FIRST_START": _FIRST_START,
    }
    viscous = [[float(equations.viscous(i, side)) for side in (1.0, -1.0)] for i in range(count)]
    mass = [float(equations.mass(i)) for i in range(count)]
    lines = [f"#define {name} {value}" for name, value in numbers.items()]
    lines += [
        f"#define LONGEST_STEP {resolved_step(machine, LONGEST_STEP)!r}",
        f'#define TOKEN "{token}"',
        "",
    ]
    lines += [
        f"static const double MASS[{count}] = {{{', '.join(map(repr, mass))}}}; /* of the belt travel, kg */"
    ]
    for name, rows, about in (
        ("VISCOUS", viscous, "Ns/m, forward and backward"),
        ("RIGID", np.asarray(rigid).tolist(), "belt travel per travel of each axis"),
    ):
        entries = ", ".join("{" + ", ".join(map(repr, row)) + "}" for row in rows)
        lines.append(f"static const double {name}[{count}][{len(rows[0])}] = {{{entries}}}; /* {about} */")
    return "#ifndef SIZES_H\n#define SIZES_H\n\n" + "\n".join(lines) + "\n\n#endif\n"
