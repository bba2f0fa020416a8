"""Commands on machines and effects: machines, effects, kernel, simulate."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from ..errors import InputError
from .app import MachineOption, app, console, log

app.add_typer(effects_app := typer.Typer(), name="effects")


@app.command()
def simulate(
    inputs: Annotated[Path, typer.Option(help="A recording; the columns time_s and the voltages suffice.")],
    out: Annotated[Path, typer.Option(help="File for the simulated recording (.csv or .csv.gz).")],
    machine: MachineOption = "hframe",
) -> None:
    """Simulate a machine with the inputs of a recording; the output has the same columns and times.

    Example:  hframe simulate --machine hframe --inputs examples/rig_b/run_01.csv.gz --out predicted.csv
    """
    from ..identification import simulate_recording
    from ..recordings import load_machine, load_recording, write_trajectory

    if not str(out).endswith((".csv", ".csv.gz")):
        raise InputError(f"--out {out}: must end in .csv or .csv.gz")
    declared = load_machine(machine)
    recording = load_recording(inputs, declared, outputs_needed=False)
    simulation = simulate_recording(declared, recording)
    for warning in simulation.initial.warnings:
        log(f"warning: {warning}")
    write_trajectory(out, simulation.trajectory, recording.inputs, declared)
    log(f"wrote {out}: {len(recording.time_s)} rows of {declared.name}")


@app.command()
def machines() -> None:
    """List the built-in machines.

    Example:  hframe machines
    """
    from .tables import machine_table

    console.print(machine_table())


@effects_app.callback(invoke_without_command=True)
def effects(context: typer.Context) -> None:
    """List the effects that identification can find; a force is in N at x or y and in Nm at a motor.

    Example:  hframe effects
    """
    if context.invoked_subcommand is None:
        from .tables import effect_table

        console.print(effect_table())
        log("If none fits, lookup tables: smooth_force[VARIABLE], smooth_friction[VARIABLE]")


@effects_app.command("new")
def new_effect(
    name: Annotated[str, typer.Argument(help="Name of the effect: lower-case letters, digits, underscores.")],
    folder: Annotated[Path, typer.Option("--from", help="A folder that `hframe identify` wrote, with a table.")],
    out: Annotated[Path | None, typer.Option(help="Python file to write (default: NAME.py).")] = None,
    formula: Annotated[int, typer.Option(min=0, help="Number of the formula (0: the recommended one).")] = 0,
    table: Annotated[str, typer.Option(help="Label of the table (default: the first one).")] = "",
) -> None:
    """Write the formula that is proposed for a table as an effect, a Python file to review.

    Example:  hframe effects new rail_catch --from out/rig
    """
    from .support import write_new_effect

    write_new_effect(folder, name, out or Path(f"{name}.py"), formula, table, log)


@app.command()
def kernel(
    machine: Annotated[str, typer.Argument(help="A machine.json or a built-in name (see `hframe machines`).")],
) -> None:
    """Print the source of the integrator that is generated for a machine.

    Example:  hframe kernel hframe
    """
    from ..dynamics import kernel_source_text
    from ..recordings import load_machine

    sys.stdout.write(kernel_source_text(load_machine(machine)))
