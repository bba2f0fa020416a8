"""The `hframe` command: thin wrappers that read files, call the library and print.

Exit codes: 0 done, 2 the input is at fault (one line says where), 1 we are.
"""

from __future__ import annotations

import sys
import webbrowser
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from .files import InputError

app = typer.Typer(
    help="H-frame stages: simulate, identify from measured data, train and evaluate controllers.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
out = Console(soft_wrap=True)

MachineOption = Annotated[str, typer.Option(help="A machine.json or a built-in name (see `hframe machines`).")]
OutOption = Annotated[Path, typer.Option(help="Folder for the results; made if it is not there.")]


def say(line: str) -> None:
    """A plain line, at once, on a terminal or in a log."""
    out.print(line, markup=False, highlight=False)


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
    from .files import load_machine, read_recording, write_trajectory
    from .identify import start_of
    from .machine import simulate as run

    if not str(out).endswith((".csv", ".csv.gz")):
        raise InputError(f"--out {out}: must end in .csv or .csv.gz")
    declared = load_machine(machine)
    recording = read_recording(inputs, declared, outputs_needed=False)
    start = start_of(recording, declared)
    trajectory = run(declared, recording.time_s, recording.inputs, start.state, offset=start.offset)
    write_trajectory(out, trajectory, recording.inputs, declared)
    say(f"wrote {out}: {len(recording.time_s)} rows of {declared.name}")


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

    from .files import load_machine, read_recordings
    from .identify import identify as run
    from .identify.output import write_answer
    from .identify.report import build_report, verdict_sentence

    if jobs:
        os.environ["HFRAME_THREADS"] = str(jobs)
    declared = load_machine(machine)
    require_folder(out)
    recordings = read_recordings(runs_dir, declared)
    answer = run(recordings, declared, held_out=hold_out or (), say=say)
    write_answer(answer, out)
    show_answer(answer.as_json(), list(declared.output_channels))
    say(verdict_sentence(answer.as_json(), list(declared.output_channels)))
    try:
        say(f"wrote {build_report(out)}")
    except ImportError as error:
        say(f"report.html not written: {error}")


def show_answer(report: dict[str, Any], channels: list[str]) -> None:
    """The error on held-out runs as a table."""
    table = Table(title="error on runs never fitted (rmse, over the sensor's noise)", title_justify="left")
    for column in ("channel", "declared", "before (refitted)", "after (with effects)"):
        table.add_column(column, justify="left" if column == "channel" else "right")
    stages = [report[s]["held_out"] for s in ("declared", "before", "after")]
    for c in channels:
        table.add_row(c, *(f"{e[c]['rmse']:.3g} ({e[c]['noise_ratio']:.3g}x)" for e in stages))
    if "force_error" in stages[0]:
        table.add_row("force, relative", *(f"{100 * e['force_error']:.2f} %" for e in stages))
    out.print(table)


@app.command()
def report(
    folder: Annotated[Path, typer.Argument(help="A folder that `hframe identify` wrote.")],
    open: Annotated[bool, typer.Option("--open", help="Show it in the browser.")] = False,
) -> None:
    """Build report.html, self-contained, from an answer's files.

    Example:  hframe report out/rig_a --open
    """
    from .identify.report import build_report

    page = build_report(folder)
    say(f"wrote {page}")
    if open:
        webbrowser.open(page.resolve().as_uri())


@app.command()
def machines() -> None:
    """The built-in machines.

    Example:  hframe machines
    """
    from .machine import BUILTIN, mode_frequencies

    table = Table("name", "coordinates", "belts", "belt modes, Hz", "what it is")
    for name, make in BUILTIN.items():
        m = make()
        modes = [f for f in mode_frequencies(m) if f > 0]
        shown = ", ".join(f"{f:.1f}" for f in modes[:3]) + (", ..." if len(modes) > 3 else "")
        table.add_row(name, str(len(m.coordinates)), str(len(m.belts)), shown or "-", m.description)
    out.print(table)


@app.command()
def effects() -> None:
    """The effects that identification knows.

    Example:  hframe effects
    """
    from .effects import LIBRARY

    table = Table("effect", "family", "site", "formula", "parameters", "source")
    for e in LIBRARY.values():
        table.add_row(e.name, e.family, e.site, e.formula, ", ".join(p.name for p in e.parameters), e.source)
    out.print(table)


def main() -> None:
    """Entry point: turns what is wrong with the input into one line and exit code 2."""
    try:
        app()
    except (InputError, ImportError) as error:
        print(f"hframe: {error}", file=sys.stderr)
        raise SystemExit(2) from None
