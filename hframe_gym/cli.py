"""The `hframe` command: thin wrappers that read files, call the library and print.

Exit codes: 0 done, 2 the input is at fault (one line says where), 1 we are.
"""

from __future__ import annotations

import sys
import webbrowser
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from .errors import InputError

app = typer.Typer(
    help="H-frame stages: simulate, identify from measured data, train and evaluate controllers.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
console = Console(soft_wrap=True)

Preset = Literal["none", "default", "wide", "identified"]
MachineOption = Annotated[str, typer.Option(help="A machine.json or a built-in name (see `hframe machines`).")]
OutOption = Annotated[Path, typer.Option(help="Folder for the results; made if it is not there.")]


def say(line: str) -> None:
    """A plain line, at once, on a terminal or in a log."""
    console.print(line, markup=False, highlight=False)


def require_folder(path: Path) -> Path:
    """The path, if it can be a folder.  Raises InputError when a file is in the way."""
    if path.exists() and not path.is_dir():
        raise InputError(f"--out {path}: is a file, must be a folder")
    return path


@app.command()
def simulate(
    inputs: Annotated[Path, typer.Option(help="A recording, or time_s and voltages alone.")],
    out: Annotated[Path, typer.Option(help="The predicted run (.csv or .csv.gz).")],
    machine: MachineOption = "hframe",
) -> None:
    """The recording's inputs through a machine: same columns, same times.

    Example:  hframe simulate --machine hframe --inputs examples/rig_b/run_01.csv.gz --out predicted.csv
    """
    from .dynamics import simulate as run
    from .identification import estimate_initial_state
    from .recordings import load_machine, load_recording, write_trajectory

    if not str(out).endswith((".csv", ".csv.gz")):
        raise InputError(f"--out {out}: must end in .csv or .csv.gz")
    declared = load_machine(machine)
    recording = load_recording(inputs, declared, outputs_needed=False)
    start = estimate_initial_state(recording, declared)
    trajectory = run(declared, recording.time_s, recording.inputs, start.state, offset=start.offset)
    write_trajectory(out, trajectory, recording.inputs, declared)
    say(f"wrote {out}: {len(recording.time_s)} rows of {declared.name}")


@app.command()
def check(
    runs_dir: Annotated[Path, typer.Argument(help="A folder of recordings, one run a file.")],
    machine: MachineOption = "hframe",
    json: Annotated[Path | None, typer.Option(help="Write the findings to this file as well.")] = None,
) -> None:
    """What recordings can tell and what is odd about them: clock, sensors, wiring, excitation, parameters.

    Example:  hframe check examples/rig_a
    """
    from .data_validation import check_recordings as run
    from .data_validation.findings_output import show, write_json
    from .recordings import load_machine, load_recordings

    declared = load_machine(machine)
    found = run(load_recordings(runs_dir, declared), declared)
    show(found, console)
    if json is not None:
        write_json(found, json)
        say(f"wrote {json}")


@app.command()
def identify(
    runs_dir: Annotated[Path, typer.Argument(help="A folder of recordings, one run a file.")],
    out: OutOption,
    machine: MachineOption = "hframe",
    hold_out: Annotated[list[str] | None, typer.Option(help="A run to judge on; repeat for more.")] = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Threads (default: all cores).")] = None,
    seed: Annotated[int, typer.Option(help="Reserved for steps that draw; the search itself is deterministic.")] = 0,
) -> None:
    """Fit a machine to its recordings, find what it lacks, and judge on runs never fitted.

    Example:  hframe identify examples/rig_a --out out/rig_a
    """
    import os

    from .data_validation import warnings_of
    from .identification import identify as run
    from .identification.report import build_report, verdict_sentence
    from .identification.result_output import write_answer
    from .recordings import load_machine, load_recordings

    if jobs:
        os.environ["HFRAME_THREADS"] = str(jobs)
    declared = load_machine(machine)
    require_folder(out)
    recordings = load_recordings(runs_dir, declared)
    warnings = [str(finding) for recording in recordings for finding in warnings_of(recording, declared)]
    for warning in warnings:
        say(f"warning: {warning}")
    answer = run(recordings, declared, held_out=hold_out or (), say=say)
    write_answer(answer, out, warnings)
    print_result(answer.as_json(), list(declared.output_channels))
    say(verdict_sentence(answer.as_json(), list(declared.output_channels)))
    try:
        say(f"wrote {build_report(out)}")
    except ImportError as error:
        say(f"report.html not written: {error}")


def print_result(report: dict[str, Any], channels: list[str]) -> None:
    """The error on held-out runs as a table."""
    table = Table(title="error on runs never fitted (rmse, over the sensor's noise)", title_justify="left")
    for column in ("channel", "declared", "before (refitted)", "after (with effects)"):
        table.add_column(column, justify="left" if column == "channel" else "right")
    stages = [report[s]["held_out"] for s in ("declared", "before", "after")]
    for c in channels:
        if stages[0][c]["rmse"] is None:
            table.add_row(c, *["not measured"] * 3)
        else:
            table.add_row(c, *(f"{e[c]['rmse']:.3g} ({e[c]['noise_ratio']:.3g}x)" for e in stages))
    if "force_error" in stages[0]:
        table.add_row("force, relative", *(f"{100 * e['force_error']:.2f} %" for e in stages))
    console.print(table)


@app.command()
def report(
    folder: Annotated[Path, typer.Argument(help="A folder that `hframe identify` wrote.")],
    open: Annotated[bool, typer.Option("--open", help="Show it in the browser.")] = False,
) -> None:
    """Build report.html, self-contained, from an answer's files.

    Example:  hframe report out/rig_a --open
    """
    from .identification.report import build_report

    page = build_report(folder)
    say(f"wrote {page}")
    if open:
        webbrowser.open(page.resolve().as_uri())


@app.command()
def train(
    algorithm: Annotated[str, typer.Argument(help="A recipe: ppo, sac, residual (on the PID) or sac_her (sparse).")],
    out: OutOption,
    machine: MachineOption = "hframe",
    task: Annotated[str, typer.Option(help="What to learn: reach or track.")] = "reach",
    randomize: Annotated[Preset | None, typer.Option(help="What each episode draws (default: the recipe's).")] = None,
    steps: Annotated[int | None, typer.Option(min=1, help="Environment steps in all (default: the recipe's).")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the network, the draws and the environment.")] = 0,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the checkpoint in the folder.")] = False,
) -> None:
    """Train an agent by the recipe of its algorithm and task.

    The folder holds the agent, its card with the learning curve, TensorBoard logs and the checkpoint; all but the logs
    appear whole, so a run may be killed at any time.

    Example:  hframe train ppo --out out/ppo
    """
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    from .agents import train as run
    from .recordings import load_machine

    declared = load_machine(machine)
    with Progress(
        BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), console=console, disable=not console.is_terminal
    ) as bar:
        shown = bar.add_task("", total=None)

        def advance(done: int, total: int) -> None:
            bar.update(shown, completed=done, total=total)

        try:
            run(algorithm, declared, task, steps, seed, resume, require_folder(out), say, advance, randomize)
        except ValueError as error:
            raise InputError(str(error)) from None
    say(f"wrote {out}")


@app.command()
def evaluate(
    controllers: Annotated[
        list[str], typer.Argument(help="pid, adaptive-pid, textbook-pid, ppo, sac, or an agent's folder.")
    ],
    out: OutOption,
    machine: MachineOption = "hframe",
    task: Annotated[Literal["reach", "track"], typer.Option(help="What to do.")] = "reach",
    path: Annotated[str, typer.Option(help="To track: circle, square, lissajous or a CSV of x_m,y_m.")] = "circle",
    randomize: Annotated[Preset, typer.Option(help="What each episode draws; identified: by the file.")] = "default",
    sensors: Annotated[Literal["state", "rig"], typer.Option(help="What controllers see.")] = "state",
    period: Annotated[float, typer.Option(help="Of control, s.")] = 0.01,
    episodes: Annotated[int, typer.Option(min=1, help="Draws; the same for every controller.")] = 512,
    seed: Annotated[int, typer.Option(help="Of the draws: starts, goals, machine parameters.")] = 0,
) -> None:
    """Score controllers on identical draws: scores.json, and a picture of each one's first episode.

    Example:  hframe evaluate pid textbook-pid --episodes 64 --out out/scores
    """
    from .envs import Track
    from .evaluation import Scenario, make_controller, write_scores
    from .evaluation import evaluate as run
    from .recordings import load_machine

    declared = load_machine(machine)
    require_folder(out)
    try:
        chosen_task = Track(path=path) if task == "track" else task
        trial = Scenario(declared, chosen_task, randomize, sensors, episodes, seed, period)
        chosen = {name: make_controller(name, trial) for name in dict.fromkeys(controllers)}
        answer, recorded = run(chosen, trial)
    except ValueError as error:
        raise InputError(str(error)) from None
    written = write_scores(out, answer)
    show_scores(answer)
    say(f"wrote {written}")
    try:
        from .evaluation.plotting import save

        for name, episode in recorded.items():
            picture = out / f"{Path(name).name}.png"
            save(picture, episode, title=f"{Path(name).name} on {declared.name}")
            say(f"wrote {picture}")
    except ImportError as error:
        say(f"no pictures: {error}")


def show_scores(answer: dict[str, Any]) -> None:
    """Success of each controller, and settling times or errors along the path, as a table."""
    task = answer["task"].partition("(")[0].lower()
    title = (
        f"{task}: {answer['episodes']} episodes, {answer['machine']}, randomize {answer['randomize']}, "
        f"sensors {answer['sensors']}, seed {answer['seed']}"
    )
    table = Table(title=title, title_justify="left")
    table.add_column("controller", no_wrap=True)
    bands = ("1mm", "0.2mm", "0.05mm")
    errors = {"contour_mm": "off the path", "tracking_mm": "off the goal"}
    settles = all("settling_s" in score for score in answer["controllers"].values())
    last = (
        [f"s to {b}" for b in bands] if settles else [f"{n}, mm {k}" for n in errors.values() for k in ("rms", "max")]
    )
    if settles:
        last.append("over the bound")
    for column in (*(f"in {b}" for b in bands), *last):
        table.add_column(column, justify="right")
    for name, score in answer["controllers"].items():
        shares = (f"{100 * score['success'][b]:.1f} %" for b in bands)
        if settles:
            numbers = [score["settling_s"][b]["mean"] for b in bands]
        else:
            numbers = [score[key][kind]["mean"] for key in errors for kind in ("rms", "max")]
        over = (score.get("over_bound") or {}).get("0.2mm") or {}
        means = over.get("ratio_of_means") or {}
        ratio = [f"{means['mean']:.3f}" if means.get("mean") else "-"] if settles else []
        table.add_row(name, *shares, *(f"{number:.3f}" for number in numbers), *ratio)
    console.print(table)


@app.command()
def machines() -> None:
    """The built-in machines.

    Example:  hframe machines
    """
    from .machine import BUILTIN_MACHINES, mode_frequencies

    table = Table("name", "coordinates", "belts", "belt modes, Hz", "what it is")
    for name, make in BUILTIN_MACHINES.items():
        m = make()
        modes = [f for f in mode_frequencies(m) if f > 0]
        shown = ", ".join(f"{f:.1f}" for f in modes[:3]) + (", ..." if len(modes) > 3 else "")
        table.add_row(name, str(len(m.coordinates)), str(len(m.belts)), shown or "-", m.description)
    console.print(table)


@app.command()
def effects() -> None:
    """The effects that identification knows; units in words follow the site (a force is N at x, Nm at a motor).

    Example:  hframe effects
    """
    from .effects import EFFECTS

    table = Table("effect", "family", "site", "parameters", "formula")
    for e in EFFECTS.values():
        parameters = ", ".join(f"{p.name} ({p.unit})" for p in e.parameters)
        table.add_row(e.name, e.family, e.site, parameters, escape(e.formula))
    console.print(table)
    say("beside them: smooth_force[VARIABLE] and smooth_friction[VARIABLE], tables of what has no formula here")


def main() -> None:
    """Entry point: turns what is wrong with the input into one line and exit code 2."""
    try:
        app()
    except (InputError, ImportError) as error:
        print(f"hframe: {error}", file=sys.stderr)
        raise SystemExit(2) from None
