"""The `hframe` command: read files, call the library, print.

Exit codes: 0 done, 2 the input is at fault (one line says where), 1 internal error, or `hframe check` found a fault.
"""

from __future__ import annotations

import os
import sys
import warnings
import webbrowser
from importlib import import_module, metadata
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from .cli_support import (
    DEBUG_VARIABLE,
    FAULT_FOUND,
    CommandWithChoices,
    describe_failure,
    print_warning,
    require_folder,
    task_with_path,
    value_errors_as_input_errors,
)
from .errors import InputError

app = typer.Typer(
    help="H-frame stages: simulate, identify from measured data, train and evaluate controllers.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
app.add_typer(effects_app := typer.Typer(), name="effects")
console = Console(soft_wrap=True)

MachineOption = Annotated[str, typer.Option(help="A machine.json or a built-in name (see `hframe machines`).")]
OutOption = Annotated[Path, typer.Option(help="Folder for the results; created if it does not exist.")]
TaskOption = Annotated[str, typer.Option(help="Task: {tasks}, or module:name.")]
RandomizeOption = Annotated[str, typer.Option(help="Randomization of each episode's machine: {randomizations}.")]
RecordingsArgument = Annotated[Path, typer.Argument(help="A folder of recordings, one run per file.")]


def _log(line: str) -> None:
    """Print a plain line immediately, on a terminal or in a log."""
    console.print(line, markup=False, highlight=False)


def _print_version(requested: bool) -> None:
    """Print the version and exit if --version is given."""
    if requested:
        _log(f"hframe_gym {metadata.version('hframe_gym')}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """H-frame stages: simulate, identify from measured data, train and evaluate controllers."""


@app.command()
def simulate(
    inputs: Annotated[Path, typer.Option(help="A recording; the columns time_s and the voltages suffice.")],
    out: Annotated[Path, typer.Option(help="File for the simulated recording (.csv or .csv.gz).")],
    machine: MachineOption = "hframe",
) -> None:
    """Simulate a machine with the inputs of a recording; the output has the same columns and times.

    Example:  hframe simulate --machine hframe --inputs examples/rig_b/run_01.csv.gz --out predicted.csv
    """
    from .identification import simulate_recording
    from .recordings import load_machine, load_recording, write_trajectory

    if not str(out).endswith((".csv", ".csv.gz")):
        raise InputError(f"--out {out}: must end in .csv or .csv.gz")
    declared = load_machine(machine)
    recording = load_recording(inputs, declared, outputs_needed=False)
    simulation = simulate_recording(declared, recording)
    for warning in simulation.initial.warnings:
        _log(f"warning: {warning}")
    write_trajectory(out, simulation.trajectory, recording.inputs, declared)
    _log(f"wrote {out}: {len(recording.time_s)} rows of {declared.name}")


@app.command()
def check(
    runs_dir: RecordingsArgument,
    machine: MachineOption = "hframe",
    json: Annotated[Path | None, typer.Option(help="Also write the findings to this file.")] = None,
) -> None:
    """Check recordings before a fit: clock, sensors, wiring, excitation and which parameters can be estimated.

    The exit code is 1 if a fault is found (the data contradict themselves), else 0.

    Example:  hframe check examples/rig_a
    """
    from .data_validation import check_recordings, print_findings, write_findings
    from .recordings import load_machine, load_recordings

    declared = load_machine(machine)
    findings = check_recordings(load_recordings(runs_dir, declared), declared)
    print_findings(findings, console)
    if json is not None:
        write_findings(findings, json)
        _log(f"wrote {json}")
    if any(finding.severity == "fault" for finding in findings):
        raise typer.Exit(FAULT_FOUND)


@app.command()
def identify(
    runs_dir: RecordingsArgument,
    out: OutOption,
    machine: MachineOption = "hframe",
    hold_out: Annotated[
        list[str] | None, typer.Option(help="A run to evaluate on instead of fitting it; repeat for more runs.")
    ] = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Number of threads (default: all cores).")] = None,
    seed: Annotated[int, typer.Option(help="Accepted for scripts; identification is deterministic.")] = 0,
    force: Annotated[
        bool, typer.Option("--force", help="Fit although `hframe check` finds faults in the data.")
    ] = False,
) -> None:
    """Fit a machine to its recordings, find the effects that its model lacks, and verify them on held-out runs.

    The recordings are checked first; faults (see `hframe check`) stop the command before anything is fitted. Every
    fourth run is held out unless --hold-out names others: it is not fitted and gives the errors of the report. The
    folder --out receives report.json, the declared, refitted and corrected machine, report.html and its plots.

    Example:  hframe identify examples/rig_a --out out/rig_a
    """
    from .cli_support import check_recordings_before_fit, proposed_formulas
    from .cli_tables import identification_table
    from .identification import identify as run_identification
    from .identification import write_result
    from .identification.report import build_report, verdict_sentence
    from .recordings import load_machine, load_recordings

    if jobs:
        os.environ["HFRAME_THREADS"] = str(jobs)
    declared = load_machine(machine)
    require_folder(out)
    recordings = load_recordings(runs_dir, declared)
    findings = check_recordings_before_fit(recordings, declared, None if force else runs_dir, _log)
    result = run_identification(recordings, declared, held_out=hold_out or (), log=_log)
    write_result(result, out, findings, proposed_formulas(result, _log))
    contents, channels = result.as_json(), list(declared.output_channels)
    console.print(identification_table(contents, channels))
    _log(verdict_sentence(contents, channels))
    try:
        _log(f"wrote {build_report(out)}")
    except ImportError as error:
        _log(f"report.html not written: {error}")


@app.command()
def report(
    folder: Annotated[Path, typer.Argument(help="A folder that `hframe identify` wrote.")],
    open: Annotated[bool, typer.Option("--open", help="Open the report in the browser.")] = False,
) -> None:
    """Build report.html, one self-contained page, from the files of an identification.

    Example:  hframe report out/rig_a --open
    """
    from .identification.report import build_report

    page = build_report(folder)
    _log(f"wrote {page}")
    if open:
        webbrowser.open(page.resolve().as_uri())


@app.command(cls=CommandWithChoices)
def train(
    algorithm: Annotated[str, typer.Argument(help="Recipe: {algorithms}.")],
    out: OutOption,
    machine: MachineOption = "hframe",
    task: TaskOption = "reach",
    randomize: Annotated[
        str | None, typer.Option(help="Randomization: {randomizations} (default: the recipe's).")
    ] = None,
    steps: Annotated[
        int | None, typer.Option(min=1, help="Environment steps in total (default: the recipe's).")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the network, the episodes and the algorithm.")] = 0,
    resume: Annotated[bool, typer.Option("--resume", help="Continue from the checkpoint in the folder.")] = False,
) -> None:
    """Train an agent by the recipe of an algorithm and a task.

    The folder receives the best agent so far, its card with the learning curve, TensorBoard logs and a checkpoint.
    A run may be killed at any time and continued with --resume.

    Example:  hframe train ppo --out out/ppo
    """
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    from .agents import train as run_training
    from .recordings import load_machine

    declared = load_machine(machine)
    columns = BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    bar = Progress(*columns, console=console, disable=not console.is_terminal)
    with bar, value_errors_as_input_errors():
        bar_task = bar.add_task("", total=None)

        def progress(done: int, total: int) -> None:
            bar.update(bar_task, completed=done, total=total)

        run_training(algorithm, declared, task, steps, seed, resume, require_folder(out), _log, progress, randomize)
    _log(f"wrote {out}")


@app.command(cls=CommandWithChoices)
def evaluate(
    controllers: Annotated[
        list[str],
        typer.Argument(
            help="Controllers: {controllers}, a shipped agent ({agents}), the folder of a trained "
            "agent, or module:name."
        ),
    ],
    out: OutOption,
    machine: MachineOption = "hframe",
    task: TaskOption = "reach",
    path: Annotated[
        str | None,
        typer.Option(help="Path to follow, for the task track: circle, square, lissajous or a CSV of x_m,y_m."),
    ] = None,
    randomize: RandomizeOption = "default",
    sensors: Annotated[
        str, typer.Option(help="What controllers observe: {sensors}; state is exact, the others are measurements.")
    ] = "state",
    period: Annotated[float, typer.Option(help="Control period in seconds.")] = 0.01,
    episodes: Annotated[int, typer.Option(min=1, help="Number of episodes; the same for every controller.")] = 512,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the starts, goals and machine parameters.")] = 0,
) -> None:
    """Score controllers on identical episodes; writes scores.json and a plot of each one's first episode.

    Example:  hframe evaluate pid textbook-pid --episodes 64 --out out/scores
    """
    from .cli_tables import score_table, unknown_bound_reasons
    from .evaluation import evaluate as run_evaluation
    from .evaluation import write_scores
    from .recordings import load_machine

    # Registers the agents as controllers, also where the package is used without its installed entry points.
    import_module("hframe_gym.agents")
    declared = load_machine(machine)
    require_folder(out)
    options: dict[str, Any] = {"randomize": randomize, "sensors": sensors, "episodes": episodes, "seed": seed}
    with value_errors_as_input_errors():
        built_task = task_with_path(task, path)
        scores, recorded = run_evaluation(controllers, declared, task=built_task, period=period, **options)
    written = write_scores(out, scores)
    console.print(score_table(scores))
    for reason in unknown_bound_reasons(scores):
        _log(reason)
    _log(f"wrote {written}")
    try:
        from .evaluation import save_plot

        for name, episode in recorded.items():
            label = Path(name).name.replace(":", "-")  # of a folder the last part; no colon in a file name
            plot = out / f"{label}.png"
            save_plot(plot, episode, title=f"{label} on {declared.name}")
            _log(f"wrote {plot}")
    except ImportError as error:
        _log(f"no plots: {error}")


@app.command()
def machines() -> None:
    """List the built-in machines.

    Example:  hframe machines
    """
    from .cli_tables import machine_table

    console.print(machine_table())


@effects_app.callback(invoke_without_command=True)
def effects(context: typer.Context) -> None:
    """List the effects that identification can find; a force is in N at x or y and in Nm at a motor.

    Example:  hframe effects
    """
    if context.invoked_subcommand is None:
        from .cli_tables import effect_table

        console.print(effect_table())
        _log("If none of them fits: smooth_force[VARIABLE] and smooth_friction[VARIABLE], lookup tables.")


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
    from .cli_support import write_new_effect

    write_new_effect(folder, name, out or Path(f"{name}.py"), formula, table, _log)


@app.command()
def kernel(
    machine: Annotated[str, typer.Argument(help="A machine.json or a built-in name (see `hframe machines`).")],
) -> None:
    """Print the source of the integrator that is generated for a machine.

    Example:  hframe kernel hframe
    """
    from .dynamics import kernel_source_text
    from .recordings import load_machine

    sys.stdout.write(kernel_source_text(load_machine(machine)))


def main() -> None:
    """Run the `hframe` command; exceptions are printed as one line, unless the variable `DEBUG_VARIABLE` is set.

    Raises:
        SystemExit: With exit code 0 (success), 1 (internal error) or 2 (faulty input or arguments).
    """
    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = print_warning
        try:
            app()
        except Exception as error:
            if os.environ.get(DEBUG_VARIABLE):
                raise
            code, line = describe_failure(error)
            print(f"hframe: {line}", file=sys.stderr)
            raise SystemExit(code) from None
