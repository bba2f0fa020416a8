"""FMU (functional mock-up unit) of a machine for co-simulation by FMI 3.0, as C source.

`templates/fmi3.c` has the functions of FMI and the integrator; both are the same for all machines. `model.c`
has the functions that the integrator calls, traced from the equations of motion of the machine. An importer
is a program that loads the FMU.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

from typing_extensions import override

from ..dynamics import Equations, MotionPoint, resolved_step
from ..dynamics.physics.parameterized_machine import Value
from ..dynamics.simulation import LONGEST_STEP
from ..errors import InputError
from ..machine import Machine, rest_positions_per_axis
from .base import EXPORTERS, Files, MachineExporter, indented, plain, refuse_drive_laws, require_linear_axes
from .source.c99 import C99, c_comment, constants, declaration, definition, helper_functions
from .source.formula import Formula, Signal, parameters_of, trace_formula

_FIRST_INPUT, _FIRST_OUTPUT, _FIRST_START = 1, 1001, 2001  # value references
_UNITS = {"m": 'm="1"', "rad": 'rad="1"', "V": 'kg="1" m="2" s="-3" A="-1"', "s": 's="1"'}
_DATE = (1980, 1, 1, 0, 0, 0)  # of the files in the archive: equal exports are equal
# Formulas of effects that the FMU does not have: a delay needs earlier values of a signal, and the angle of
# an eccentric pulley at rest is not a linear function of the start position.
_UNSUPPORTED_FORMULAS = ("delay", "measurement_delay", "clock", "rest_angle_offset")


@EXPORTERS.register("fmu")
@dataclass(frozen=True, kw_only=True)
class FmuExporter(MachineExporter):
    """Write a functional mock-up unit (FMI 3.0, co-simulation) of a machine as C source.

    Inputs are the drive voltages, V, held over each communication step; outputs are the sensors without
    noise, m or rad. The stage starts at rest; the parameters start_x, start_y and so on, one per tool axis,
    are the start position, m. The FMU has the equations of motion, with the effects of the machine, and the
    integrator of this package. The importer compiles the source, FMPy for example by
    `fmpy compile stage.fmu`.

    Example:  hframe export fmu --machine hframe --out stage.fmu
    """

    @override
    def files(self, machine: Machine) -> Files:
        """Write stage.fmu, an archive of the model's description and its C source.

        Raises:
            InputError: If the machine has a drive with a law, delays, eccentric pulleys, a rotary tool axis,
                no sensor, or one that does not measure a position.
        """
        refuse_drive_laws(machine, "an FMU")
        unsupported = [
            effect.label
            for effect in machine.effects
            if any(getattr(effect.definition, formula) for formula in _UNSUPPORTED_FORMULAS)
        ]
        if unsupported:
            raise InputError(
                f"machine {machine.name!r}: "
                f"an FMU has no place for {', '.join(unsupported)} (delays, eccentric pulleys); "
                "remove it from a copy of the machine and add a delay in the program that imports the FMU"
            )
        require_linear_axes(machine, "an FMU")
        if not machine.tool_axes or not machine.sensors:
            raise InputError(
                f"machine {machine.name!r}: an FMU needs tool axes, whose start it sets, and sensors"
            )
        others = [sensor.channel for sensor in machine.sensors if not sensor.of_position]
        if others:
            raise InputError(
                f"machine {machine.name!r}: the outputs of an FMU are positions; "
                f"leave {', '.join(others)} out of a copy of the machine"
            )
        token = self.provenance(machine)["machine_sha256"]
        comment = c_comment(self.header(machine))
        functions = _model_functions(machine)
        contents = {
            "modelDescription.xml": self._description(machine, token),
            "sources/buildDescription.xml": _BUILD,
            "sources/fmi3.c": (resources.files(__package__) / "templates" / "fmi3.c").read_text("utf-8"),
            "sources/model.h": comment + _header(functions),
            "sources/model.c": comment + _source(machine, functions),
            "sources/sizes.h": comment + _sizes(machine, token),
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
        for j, sensor in enumerate(machine.sensors):
            variables.append(
                f'<Float64 name={quoteattr(sensor.channel)} valueReference="{_FIRST_OUTPUT + j}" '
                f'causality="output" unit="{machine.sensor_unit(sensor)}"/>'
            )
        for k, axis in enumerate(machine.tool_axes):
            variables.append(
                f'<Float64 name={quoteattr("start_" + axis)} valueReference="{_FIRST_START + k}" '
                'causality="parameter" variability="fixed" start="0.0" unit="m"/>'
            )
        outputs = range(_FIRST_OUTPUT, _FIRST_OUTPUT + len(machine.sensors))
        structure = "".join(f'<Output valueReference="{reference}"/>' for reference in outputs)
        structure += "".join(f'<InitialUnknown valueReference="{reference}"/>' for reference in outputs)
        units = "".join(f'<Unit name="{name}"><BaseUnit {base}/></Unit>' for name, base in _UNITS.items())
        about = " | ".join(self.header(machine))
        text = (
            f'<fmiModelDescription fmiVersion="3.0" modelName={quoteattr(plain(machine.name) or "stage")} '
            f'instantiationToken="{token}" description={quoteattr(about)} '
            f"generationTool={quoteattr(self.provenance(machine)['software'])} "
            'variableNamingConvention="flat">'
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


class _EffectInput(NamedTuple):
    """A quantity of the force balance on which the state of an effect depends.

    Attributes:
        effect: Index of the effect in `Equations.instances`.
        name: "level", the Coulomb friction force, N or Nm, or "i", the current of the drive, A.
    """

    effect: int
    name: str


def _effect_inputs(machine: Machine) -> list[_EffectInput]:
    """Return the inputs of all effects with a state, in the order of the array `effect_input` of model.c."""
    equations = Equations(machine)
    zeros = [0.0] * len(machine.coordinates)
    arguments = equations.balance(MotionPoint(zeros, zeros), [0.0] * len(machine.drives)).arguments
    return [_EffectInput(k, name) for k in equations.states for name in arguments.get(k, {})]


class _StepSignals:
    """Quantities of a step of the integrator; points and quantities have the names of `reference_step`."""

    def __init__(self, machine: Machine) -> None:
        count = len(machine.coordinates)
        self.time = Signal("time", 0, "time in the middle of the step, s")
        self.half_way_travel = Signal("half_way_travel", count, "belt travel p + h/2 v, m")
        self.correction = Signal(
            "correction", count, "h^2/12 a, m, which leads from the half-way to the corrected point"
        )
        self.speed = Signal("speed", count, "speed v at the beginning of the step, m/s")
        self.mean_speed = Signal("mean_speed", count, "mean speed in the step, v + h/2 a, m/s")
        self.traveled = Signal("traveled", count, "change of the belt travel in the step, m")
        self.half_step = Signal("half_step", 0, "h/2, s: time from the beginning of the step to the point")
        self.step = Signal("step", 0, "length h of the step, s")
        self.voltage = Signal("voltage", len(machine.drives), "commanded voltage of each drive, V")
        self.force = Signal("force", count, "sum of all forces but viscous and Coulomb friction, N")
        self.coulomb = Signal("coulomb", count, "Coulomb friction force F, a magnitude, N")
        # Arrays of C have at least one entry.
        states = max(len(Equations(machine).states), 1)
        self.effect_state = Signal(
            "effect_state", states, "states of the effects at the beginning of the step, SI"
        )
        self.next_effect_state = Signal(
            "effect_state", states, "states of the effects, SI, which are advanced"
        )
        self.effect_input = Signal(
            "effect_input",
            max(len(_effect_inputs(machine)), 1),
            "Coulomb friction forces, N or Nm, and drive currents, A, on which states of effects depend",
        )
        self.travel = Signal("travel", count, "belt travel of each coordinate, m")
        self.reading = Signal("reading", len(machine.sensors), "reading of each sensor, m or rad")


def _model_functions(machine: Machine) -> list[Formula]:
    """Trace the functions of model.c, in the order in which a step of the integrator calls them.

    `reference_step` states the steps 1 to 4.
    """
    parameters, of = parameters_of(machine), _StepSignals(machine)

    def traced(
        name: str,
        comment: str,
        arguments: Sequence[Signal],
        results: Sequence[Signal],
        function: Callable[..., list[Value]],
    ) -> Formula:
        def of_parameters(values: Mapping[str, Value], *entries: Value) -> list[Value]:
            return function(Equations(machine, values), *entries)

        return trace_formula(name, comment, arguments, results, of_parameters, parameters)

    return [
        traced(
            "forces_at_half_way_point",
            "Step 1: forces along the belt travel of each coordinate at the half-way point.",
            (of.time, of.half_way_travel, of.speed, of.effect_state, of.half_step, of.voltage),
            (of.force, of.coulomb),
            _forces_at_half_way_point,
        ),
        traced(
            "forces_at_corrected_point",
            "Step 2: forces along the belt travel of each coordinate at the corrected point.",
            (
                *(of.time, of.half_way_travel, of.correction, of.mean_speed),
                *(of.effect_state, of.half_step, of.voltage),
            ),
            (of.force, of.coulomb, of.effect_input),
            _forces_at_corrected_point,
        ),
        traced(
            "next_effect_state",
            "Step 4: states of the effects at the end of the step.",
            (of.next_effect_state, of.effect_input, of.traveled, of.mean_speed, of.step),
            (of.next_effect_state,),
            _next_effect_state,
        ),
        traced("sensors", "Readings of the sensors without noise.", (of.travel,), (of.reading,), _sensors),
    ]


def _forces_at_half_way_point(
    equations: Equations,
    time: Value,
    half_way_travel: Sequence[Value],
    speed: Sequence[Value],
    effect_state: Sequence[Value],
    half_step: Value,
    voltage: Sequence[Value],
) -> list[Value]:
    """Return the forces, then the Coulomb friction forces, in step 1 of `reference_step`, N."""
    states = dict(zip(equations.states, effect_state, strict=False))
    point = MotionPoint(half_way_travel, speed, time, states, half_step)
    balance = equations.balance(point, voltage)
    return [*balance.forces, *balance.coulomb]


def _forces_at_corrected_point(
    equations: Equations,
    time: Value,
    half_way_travel: Sequence[Value],
    correction: Sequence[Value],
    mean_speed: Sequence[Value],
    effect_state: Sequence[Value],
    half_step: Value,
    voltage: Sequence[Value],
) -> list[Value]:
    """Return forces, Coulomb friction forces, N, and the effects' inputs in step 2 of `reference_step`."""
    states = dict(zip(equations.states, effect_state, strict=False))
    travel = [p + dp for p, dp in zip(half_way_travel, correction, strict=True)]
    gained = [6.0 / half_step * dp for dp in correction]
    point = MotionPoint(travel, mean_speed, time, states, half_step, gained)
    motor_voltages = equations.motor_voltages(voltage)
    if equations.nonlinear_belts:
        belt_forces = equations.belt_forces(point, equations.belt_states(point))
    else:  # f1 - G' k G h^2/12 a, with the stiffness k at the half-way point
        half_way = MotionPoint(half_way_travel, mean_speed, time, states, half_step)
        belts = equations.belt_states(half_way)
        belt_forces = equations.belt_forces(half_way, belts)
        for belt, row in zip(belts, equations.extension_rows, strict=True):
            tension_change = belt.stiffness * sum(g * correction[i] for i, g in row.items())
            belt_forces = [
                force - row[i] * tension_change if i in row else force for i, force in enumerate(belt_forces)
            ]
    forces = equations.add_drive_forces(belt_forces, motor_voltages)
    balance = equations.force_balance(point, motor_voltages, forces)
    inputs = [balance.arguments[k][name] for k, name in _effect_inputs(equations.machine)]
    return [*balance.forces, *balance.coulomb, *(inputs or [0.0])]


def _next_effect_state(
    equations: Equations,
    effect_state: Sequence[Value],
    effect_input: Sequence[Value],
    traveled: Sequence[Value],
    mean_speed: Sequence[Value],
    step: Value,
) -> list[Value]:
    """Return the states of the effects in step 4 of `reference_step`, SI."""
    inputs: dict[int, dict[str, Value]] = {k: {} for k in equations.states}
    for (k, name), value in zip(_effect_inputs(equations.machine), effect_input, strict=False):
        inputs[k][name] = value
    if not equations.states:
        return list(effect_state)
    return [
        equations.next_state(k, state, inputs[k], traveled, mean_speed, step)
        for k, state in zip(equations.states, effect_state, strict=True)
    ]


def _sensors(equations: Equations, travel: Sequence[Value]) -> list[Value]:
    """Return the readings of the sensors, m or rad."""
    return equations.sensor_readings([p * equations.per_radius(i) for i, p in enumerate(travel)])


def _header(functions: Sequence[Formula]) -> str:
    """Return model.h."""
    about = c_comment(
        [
            "Functions of the machine for the integrator, whose steps fmi3.c states.",
            "Forces and speeds are along the belt travel of a coordinate, "
            "which is radius * angle for a pulley.",
        ]
    )
    declarations = "\n".join(declaration(function, "model") for function in functions)
    return f"#ifndef MODEL_H\n#define MODEL_H\n\n{about}\n{declarations}\n#endif\n"


def _source(machine: Machine, functions: Sequence[Formula]) -> str:
    """Return model.c."""
    language, used, definitions = C99("model"), set[str](), []
    for function in functions:
        text, names = definition(function, language)
        used |= names
        definitions.append(text)
    parts = [
        '#include "model.h"\n\n#include <math.h>\n',
        constants(parameters_of(machine).values(), used),
        *helper_functions(language),
        *definitions,
    ]
    return "\n".join(parts)


def _sizes(machine: Machine, token: str) -> str:
    """Return sizes.h: numbers of quantities, value references, and constants of the coordinates."""
    equations = Equations(machine)
    coordinates = range(len(machine.coordinates))
    mass = [float(equations.mass(i)) for i in coordinates]
    viscous = [[float(equations.viscous(i, side)) for side in (1.0, -1.0)] for i in coordinates]
    per_axis = (rest_positions_per_axis(machine) * machine.travel_per_unit[:, None]).tolist()
    macros = {
        "COORDINATES": len(machine.coordinates),
        "DRIVES": len(machine.drives),
        "SENSORS": len(machine.sensors),
        "AXES": len(machine.tool_axes),
        "EFFECT_STATES": len(equations.states),
        "EFFECT_INPUTS": len(_effect_inputs(machine)),
        "FIRST_INPUT": f"{_FIRST_INPUT} /* value references, of drives, sensors and start positions */",
        "FIRST_OUTPUT": _FIRST_OUTPUT,
        "FIRST_START": _FIRST_START,
        "LONGEST_STEP": f"{resolved_step(machine, LONGEST_STEP)!r} /* of the integrator, s */",
        "INSTANTIATION_TOKEN": f'"{token}"',
    }
    lines = [f"#define {name} {value}" for name, value in macros.items()]
    lines += [
        "",
        "/* Mass of each coordinate along its belt travel, kg. */",
        f"static const double MASS[COORDINATES] = {_c_list(mass)};",
        "/* Viscous friction of each coordinate, with the back-EMF, forward and backward, Ns/m. */",
        f"static const double VISCOUS[COORDINATES][2] = {_c_list(map(_c_list, viscous))};",
        "/* Belt travel of each coordinate per travel of each tool axis, with unstretched belts, m/m. */",
        f"static const double TRAVEL_PER_AXIS[COORDINATES][AXES] = {_c_list(map(_c_list, per_axis))};",
    ]
    return "#ifndef SIZES_H\n#define SIZES_H\n\n" + "\n".join(lines) + "\n\n#endif\n"


def _c_list(values: Iterable[float | str]) -> str:
    """Return values as an initializer of C."""
    return "{" + ", ".join(map(str, values)) + "}"
