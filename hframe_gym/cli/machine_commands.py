"""Commands on machines and effects: machines, effects, kernel, simulate."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from ..errors import InputError
from ..registry import PLUGIN_VARIABLE
from .application import Application, CommandGroup, CommandWithChoices, app
from .options import MachineArgument, MachineOption
from .output import console, log

_EFFECTS_HELP = """List the effects that identification can add to a model (the default), or write a new one.

Example:  hframe effects
"""
_MACHINES_HELP = """List the built-in machines (the default), show or create one, or print the JSON Schema.

Example:  hframe machines
"""
app.add_typer(effects_app := Application(cls=CommandGroup, help=_EFFECTS_HELP), name="effects")
app.add_typer(machines_app := Application(cls=CommandGroup, help=_MACHINES_HELP), name="machines")

PLOT_SUFFIXES = (".png", ".svg", ".pdf")


@app.command()
def simulate(
    inputs: Annotated[Path, Option(help="A recording; the columns time_s and the voltages suffice.")],
    out: Annotated[Path, Option(help="File for the simulated recording (.csv or .csv.gz).")],
    machine: MachineOption = "hframe",
    updates: Annotated[
        int,
        Option(
            min=1,
            help="How often the controller changed the voltages from one row to the next; "
            "more than once, they are interpolated.",
        ),
    ] = 1,
) -> None:
    """Simulate a machine with the voltages of a recording; write what its sensors would have measured.

    The file --out has the times and voltages of --inputs and a simulated measurement of every sensor of the
    machine. Measurements in --inputs, if any, give the state at the beginning and the voltages of rows that
    the logger dropped; they do not correct the simulation otherwise.

    Example:  hframe simulate --machine hframe --inputs examples/rig_b/run_01.csv.gz --out predicted.csv
    """
    from ..identification import simulate_recording
    from ..recordings import load_machine, load_recording, write_trajectory

    if not str(out).endswith((".csv", ".csv.gz")):
        raise InputError(f"--out {out}: must end in .csv or .csv.gz")
    declared = load_machine(machine)
    recording = load_recording(inputs, declared, outputs_needed=False)
    simulation = simulate_recording(declared, recording, updates=updates)
    for warning in simulation.initial.warnings:
        log(f"warning: {recording.name}: {warning}")
    write_trajectory(out, simulation.trajectory, recording.inputs, declared)
    log(f"wrote {out}: {len(recording.time_s)} rows of {declared.name}")


@machines_app.command("list")
def list_machines() -> None:
    """List the built-in machines.

    Example:  hframe machines
    """
    from .tables.machines import machine_table

    console.print(machine_table())
    log("Yours: hframe machines new --like corexy --out my.json (see docs/machine.md)")


@machines_app.command("show")
def show_machine(
    machine: MachineArgument,
    plot: Annotated[Path | None, Option(help="Draw the machine into this file (.png, .svg or .pdf).")] = None,
) -> None:
    """Print a machine as tables with units; with --plot, also draw it.

    Example:  hframe machines show my.json --plot my.png
    """
    from ..recordings import load_machine
    from .tables.machines import belt_mode_line, machine_tables

    if plot is not None and plot.suffix not in PLOT_SUFFIXES:
        raise InputError(f"--plot {plot}: must end in one of {', '.join(PLOT_SUFFIXES)}")
    declared = load_machine(machine)
    log(f"{declared.name}: {declared.description}" if declared.description else declared.name)
    for table in machine_tables(declared):
        console.print(table)
    log(belt_mode_line(declared))
    if plot is not None:
        from ..files import atomic_file
        from ..machine import draw_machine

        figure = draw_machine(declared)
        with atomic_file(plot) as file:
            figure.savefig(file, dpi=120, format=plot.suffix[1:])
        log(f"wrote {plot}")


@machines_app.command("schema")
def print_schema() -> None:
    """Print the JSON Schema of machine.json, with which editors complete and check the fields.

    Example:  hframe machines schema > machine.schema.json
    """
    from ..recordings import machine_json_schema

    sys.stdout.write(json.dumps(machine_json_schema(), indent=1, ensure_ascii=False) + "\n")


@machines_app.command("new", cls=CommandWithChoices)
def new_machine_file(
    like: Annotated[
        str,
        Option(
            help="Template: hframe, corexy, printer, axis, belt-axis, xy-table, "
            "motor, pendulum, wheel or servo."
        ),
    ] = "",
    out: Annotated[Path | None, Option(help="File to write.")] = None,
    name: Annotated[str, Option(help="Name of the machine (default: name of the file).")] = "",
    travel: Annotated[str, Option(help="Travel along x and y, m, for example 0.3,0.2.")] = "",
    mass: Annotated[
        str, Option(help="Moving mass along x and y without rotors, kg, e.g. 0.4,1.2, or inertia, kg m^2.")
    ] = "",
    pulley_radius: Annotated[float | None, Option(help="Pitch radius of the motors' pulleys, m.")] = None,
    travel_per_turn: Annotated[
        float | None, Option(help="Travel per turn of a screw (its lead) or pulley, m: axis, xy-table.")
    ] = None,
    gear_ratio: Annotated[
        float | None, Option(help="Turns of the motor per turn of the pulley, screw or axis.")
    ] = None,
    rotor_inertia: Annotated[float | None, Option(help="Inertia of a motor's rotor, kg m^2.")] = None,
    torque_constant: Annotated[
        float | None, Option("--Kt", help="Torque constant, Nm/A; Ke becomes the same, in Vs/rad.")
    ] = None,
    resistance: Annotated[float | None, Option(help="Resistance of a motor, ohm.")] = None,
    rated_voltage: Annotated[float | None, Option(help="Rated voltage, V.")] = None,
    encoder_lines: Annotated[int | None, Option(help="Lines of the motors' encoders; 0: none.")] = None,
    linear_sensor: Annotated[bool | None, Option(help="Whether sensors measure x and y.")] = None,
    drive: Annotated[
        str,
        Option(help="What is commanded: voltage, duty-cycle, current, torque, position, speed or stepper."),
    ] = "",
    sensor: Annotated[
        list[str] | None,
        Option(
            help="Further sensor, KIND@PART, e.g. speed@x or current@motor1 "
            "(repeat for more): {sensor_kinds}."
        ),
    ] = None,
    values: Annotated[
        list[str] | None, Option("--set", help="PARAMETER=VALUE in SI, e.g. x.coulomb=2.")
    ] = None,
    force: Annotated[bool, Option("--force", help="Replace an existing file.")] = False,
) -> None:
    """Write a commented machine.json from a template; without --like or --out, ask for the values.

    Values that are not given are those of the template. For one axis, --travel and --mass are one number
    each; for a motor, pendulum, wheel or servo, --mass is the moment of inertia of what turns, kg m^2.

    Example:  hframe machines new --like corexy --travel 0.3,0.3 --mass 0.4,1.2 --out my.json
    """
    from .machine_questions import MachineAnswers, create_machine_file

    options = {
        "travel": travel,
        "mass": mass,
        "pulley_radius": pulley_radius,
        "travel_per_turn": travel_per_turn,
        "gear_ratio": gear_ratio,
        "rotor_inertia": rotor_inertia,
        "Kt": torque_constant,
        "resistance": resistance,
        "rated_voltage": rated_voltage,
        "encoder_lines": encoder_lines,
        "linear_sensor": linear_sensor,
        "drive": drive,
        "sensor": sensor,
        "values": values,
    }
    given = {name: value for name, value in options.items() if value not in ("", None)}
    answers = MachineAnswers(like, out, name, given)
    create_machine_file(answers, force=force, log=log)


@effects_app.command("list")
def list_effects() -> None:
    """List the effects (friction, delay, ...) that identification can add to a model, with their formulas.

    Forces are in N at x or y and in Nm at a motor.

    Example:  hframe effects
    """
    from .tables.machines import effect_table

    console.print(effect_table())
    log("If none fits, lookup tables: smooth_force[VARIABLE], smooth_friction[VARIABLE]")


@effects_app.command("new")
def new_effect(
    name: Annotated[str, Argument(help="Name of the effect: lower-case letters, digits, underscores.")],
    folder: Annotated[Path, Option("--from", help="A folder that `hframe identify` wrote, with a table.")],
    out: Annotated[Path | None, Option(help="Python file to write (default: NAME.py).")] = None,
    formula: Annotated[int, Option(min=0, help="Number of the formula (0: the recommended one).")] = 0,
    table: Annotated[str, Option(help="Label of the table (default: the first one).")] = "",
) -> None:
    """Write a new effect, a Python file, from a formula that `hframe identify` proposes for an unknown force.

    Where no known effect (deviation from the machine's model) explains a force, `hframe identify` describes
    it by a table of values and proposes formulas. Review the file, then name it in HFRAME_PLUGINS to use the
    effect.

    Example:  hframe effects new rail_catch --from out/rig
    """
    from ..effects.formulas import write_effect_file
    from ..identification.report.content.saved_result import formulas_of_folder

    proposed = formulas_of_folder(folder, name, table)
    for number, p in enumerate(proposed, start=1):
        error = f", {p.mean_noise_ratio:.3g} times the noise on held-out runs" if p.held_out else ""
        mark = " (recommended)" if p.recommended else ""
        form = p.effect.formula
        log(f"{number}. {p.effect.text}: {form.name}, {form.complexity} parameters{error}{mark}")
    if formula > len(proposed):
        raise InputError(f"--formula {formula}: the formulas are numbered from 1 to {len(proposed)}")
    chosen = proposed[formula - 1] if formula else next(p for p in proposed if p.recommended)
    path = out or Path(f"{name}.py")
    write_effect_file(chosen.effect, path)
    log(f"wrote {path}; review it, then use it with {PLUGIN_VARIABLE}={path} in the environment of a command")


@app.command()
def kernel(machine: MachineArgument) -> None:
    """Print the source of a machine's generated integrator: its compiled form runs all simulations.

    Example:  hframe kernel hframe
    """
    from ..dynamics import kernel_source_text
    from ..recordings import load_machine

    sys.stdout.write(kernel_source_text(load_machine(machine)))
