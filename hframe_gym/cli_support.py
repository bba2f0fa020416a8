"""Support for the `hframe` commands: one-line error messages, help texts from the registries, and printed tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.markup import escape
from rich.table import Table
from typer.core import TyperCommand

from .effects import EFFECTS
from .errors import InputError
from .machine import BUILTIN_MACHINES, mode_frequencies
from .registry import PLUGIN_VARIABLE, load_plugins

if TYPE_CHECKING:
    from .identification import IdentificationResult
    from .identification.formulas import TableComparison

INPUT_AT_FAULT, INTERNAL_ERROR = 2, 1
DEBUG_VARIABLE = "HFRAME_DEBUG"  # if set, errors keep their traceback


def registered_choices() -> dict[str, str]:
    """List the names that the commands accept for agents, algorithms, controllers, randomizations, sensors and tasks.

    Returns:
        Names separated by commas, by the placeholder in the help texts, for example {"tasks": "reach, track"}.
    """
    from .agents import recipe_names, shipped_agent_names
    from .controllers import CONTROLLERS
    from .envs import RANDOMIZATION_PRESETS, SENSOR_PRESETS, TASKS

    load_plugins()
    algorithms = sorted({name.rpartition("_")[0] for name in recipe_names()})
    choices: dict[str, Iterable[str]] = {
        "agents": shipped_agent_names(),
        "algorithms": algorithms,
        "controllers": CONTROLLERS,
        "randomizations": RANDOMIZATION_PRESETS,
        "sensors": SENSOR_PRESETS,
        "tasks": TASKS,
    }
    return {placeholder: ", ".join(names) for placeholder, names in choices.items()}


class CommandWithChoices(TyperCommand):
    """Typer command whose help texts may contain placeholders of `registered_choices`, for example {tasks}.

    They are replaced when the help is printed, so that no other command waits for the imports of the registries.
    """

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Replace the placeholders in the help texts of all options, then write the help page.

        Args:
            ctx: Click context of the command.
            formatter: Click formatter that receives the text.
        """
        choices = registered_choices()
        for parameter in self.params:
            help_text = getattr(parameter, "help", None)
            if help_text:
                parameter.help = help_text.format(**choices)  # type: ignore[attr-defined]
        super().format_help(ctx, formatter)


def require_folder(path: Path) -> Path:
    """Check that a path is a folder or does not exist yet.

    Args:
        path: Value of the option --out.

    Returns:
        The same path.

    Raises:
        InputError: If the path is a file.
    """
    if path.exists() and not path.is_dir():
        raise InputError(f"--out {path}: is a file, but must be a folder")
    return path


def task_with_path(name: str, path: str | None) -> Any:
    """Build the task that the options --task and --path select.

    Args:
        name: Name of a registered task.
        path: Value of --path: name of a path or a CSV file; None for the task's default path.

    Returns:
        Task object for a task that follows a path, else the name of the task.

    Raises:
        InputError: If the task is unknown, or if a path is given for a task that does not follow one.
    """
    from .envs import TASKS

    task_class: Any = TASKS.get(name)
    follows_path = is_dataclass(task_class) and "path" in {field.name for field in fields(task_class)}
    if path is not None and not follows_path:
        raise InputError(f"--path {path}: the task {name} follows no path")
    if not follows_path:
        return name
    return task_class() if path is None else task_class(path=path)


@contextmanager
def value_errors_as_input_errors() -> Iterator[None]:
    """Convert each ValueError raised inside a `with` block to an InputError with the same message.

    Yields:
        Nothing.

    Raises:
        InputError: If the block raises a ValueError.
    """
    try:
        yield
    except ValueError as error:
        raise InputError(str(error)) from error


def describe_failure(error: Exception) -> tuple[int, str]:
    """Convert an exception to an exit code and a message of one line.

    Args:
        error: Exception that a command raised.

    Returns:
        code: `INPUT_AT_FAULT` (2) for errors in input, files or installation, else `INTERNAL_ERROR` (1).
        message: Text for the user, without a line break.
    """
    from .dynamics import NotFiniteError

    text = " ".join(str(error).split())
    if isinstance(error, InputError | ImportError):
        return INPUT_AT_FAULT, text
    if isinstance(error, NotFiniteError):
        return INPUT_AT_FAULT, f"{text}: check the inputs and the machine's parameters"
    if isinstance(error, OSError) and error.filename is not None:
        return INPUT_AT_FAULT, f"{error.filename}: {error.strerror}"
    hint = f"set {DEBUG_VARIABLE}=1 to see the traceback"
    return INTERNAL_ERROR, f"internal error, please report it ({hint}): {type(error).__name__}: {text}"


BANDS = ("1mm", "0.2mm", "0.05mm")
BOUND_BAND = "0.2mm"  # band of the time-optimal bound
PATH_ERRORS = {"contour_mm": "contour", "tracking_mm": "tracking"}
LISTED_MODES = 3


def identification_table(report: Mapping[str, Any], channels: Sequence[str]) -> Table:
    """Format the simulation errors of an identification on held-out recordings as a table.

    Args:
        report: Contents of report.json.
        channels: Names of the machine's output channels (sensors).

    Returns:
        Table with one row per channel: root-mean-square error in the channel's unit, and in parentheses as a multiple
        of the sensor noise, for the declared machine, the refitted machine, and the machine with added effects.
    """
    title = "simulation error on held-out recordings: rmse (multiple of the sensor noise)"
    table = Table(title=title, title_justify="left")
    table.add_column("channel", no_wrap=True)
    for column in ("declared", "before (refitted)", "after (with effects)"):
        table.add_column(column, justify="right")
    errors = [report[stage]["held_out"] for stage in ("declared", "before", "after")]
    for channel in channels:
        if errors[0][channel]["rmse"] is None:
            table.add_row(channel, *["not measured"] * len(errors))
        else:
            cells = (e[channel] for e in errors)
            table.add_row(channel, *(f"{cell['rmse']:.3g} ({cell['noise_ratio']:.3g}x)" for cell in cells))
    if "force_error" in errors[0]:
        table.add_row("force, relative", *(f"{100 * e['force_error']:.2f} %" for e in errors))
    return table


def proposed_formulas(result: IdentificationResult, log: Callable[[str], None]) -> tuple[TableComparison, ...]:
    """Propose formulas for the tables of an identified machine, where scikit-learn is installed.

    Args:
        result: Result of `identify`.
        log: Called with a line of text for every formula, or with the reason why there is none.

    Returns:
        One comparison of formulas with the table per table; empty without tables or without scikit-learn.
    """
    from .identification.formulas import compare_formulas

    try:
        return compare_formulas(result, log)
    except ImportError as error:
        log(f"no formulas proposed for the tables: {error}")
        return ()


def write_new_effect(folder: Path, name: str, path: Path, number: int, table: str, log: Callable[[str], None]) -> None:
    """List the formulas proposed for a table of a saved identification and write one as an effect.

    Args:
        folder: Folder that `hframe identify` wrote.
        name: Name of the new effect.
        path: Python file to write; it must not exist.
        number: Number of the formula in the list, from 1; 0 for the recommended one.
        table: Label of the table; empty for the first one.
        log: Called with a line of text for every formula and for the file.

    Raises:
        InputError: If the folder has no such table or formula, or the name or the file cannot be used.
    """
    from .effects.formulas import write_effect_file
    from .identification.formulas import formulas_of_folder

    proposed = formulas_of_folder(folder, name, table)
    for index, p in enumerate(proposed, start=1):
        error = f", {p.noise_ratio:.3g} times the noise on held-out runs" if p.held_out else ""
        form = p.effect.formula
        mark = " (recommended)" if p.recommended else ""
        log(f"{index}. {p.effect.text}: {form.name}, {form.complexity} parameters{error}{mark}")
    if number > len(proposed):
        raise InputError(f"--formula {number}: the formulas are numbered from 1 to {len(proposed)}")
    chosen = proposed[number - 1] if number else next(p for p in proposed if p.recommended)
    write_effect_file(chosen.effect, path)
    log(f"wrote {path}; review it, then use it with {PLUGIN_VARIABLE}={path} in the environment of a command")


def score_table(scores: Mapping[str, Any]) -> Table:
    """Format the scores of controllers as a table.

    Numbers are never truncated; a name that is too long for the terminal continues on the next line.

    Args:
        scores: Contents of scores.json.

    Returns:
        Table with one row per controller: success in each settling band, %; then for a fixed goal mean settling times,
        s, and their ratio to the time-optimal bound; for a path contour and tracking errors, mm.
    """
    task = scores["task"].partition("(")[0].lower()
    title = (
        f"{task}: {scores['episodes']} episodes, {scores['machine']}, randomize {scores['randomize']}, "
        f"sensors {scores['sensors']}, seed {scores['seed']}"
    )
    controllers = scores["controllers"]
    fixed_goal = all("settling_s" in score for score in controllers.values())
    columns = [f"in\n{band}\n%" for band in BANDS]
    if fixed_goal:
        columns += [*(f"until\n{band}\ns" for band in BANDS), "over\nthe\nbound"]
    else:
        columns += [f"{label}\n{kind}\nmm" for label in PATH_ERRORS.values() for kind in ("rms", "max")]
    table = Table(title=title, title_justify="left", collapse_padding=True)
    table.add_column("controller", overflow="fold")
    for column in columns:
        table.add_column(column, justify="right", no_wrap=True, min_width=max(map(len, column.split("\n"))))
    for name, score in controllers.items():
        success = (f"{100 * score['success'][band]:.1f}" for band in BANDS)
        table.add_row(escape(name), *success, *(_settling_cells(score) if fixed_goal else _path_cells(score)))
    return table


def _settling_cells(score: Mapping[str, Any]) -> list[str]:
    """Return the mean settling times, s, and the ratio of the mean settling time to the mean time-optimal bound."""
    times = [f"{score['settling_s'][band]['mean']:.3f}" for band in BANDS]
    over_bound = (score.get("over_bound") or {}).get(BOUND_BAND) or {}
    ratio = (over_bound.get("ratio_of_means") or {}).get("mean")
    return [*times, f"{ratio:.3f}" if ratio else "-"]


def _path_cells(score: Mapping[str, Any]) -> list[str]:
    """Return contour and tracking errors, rms and maximum, means over the episodes, mm."""
    return [f"{score[key][kind]['mean']:.3f}" for key in PATH_ERRORS for kind in ("rms", "max")]


def unknown_bound_reasons(scores: Mapping[str, Any]) -> list[str]:
    """Explain why episodes have no time-optimal bound.

    Args:
        scores: Contents of scores.json.

    Returns:
        Distinct reasons as text, in the order of the controllers; empty if all bounds are known.
    """
    reasons = (score.get("over_bound_reason") for score in scores["controllers"].values())
    return list(dict.fromkeys(reason for reason in reasons if reason))


def machine_table() -> Table:
    """Format the built-in machines as a table.

    Returns:
        Table with one row per machine: name, numbers of coordinates and belts, lowest belt modes in Hz, description.
    """
    table = Table("name", "coordinates", "belts", "belt modes, Hz", "description")
    table.columns[0].no_wrap = True
    for name, make_machine in BUILTIN_MACHINES.items():
        machine = make_machine()
        frequencies = [f for f in mode_frequencies(machine) if f > 0]
        modes = ", ".join(f"{f:.1f}" for f in frequencies[:LISTED_MODES])
        more = ", ..." if len(frequencies) > LISTED_MODES else ""
        counts = (str(len(machine.coordinates)), str(len(machine.belts)))
        table.add_row(name, *counts, modes + more or "-", machine.description)
    return table


def effect_table() -> Table:
    """Format the library's effects (additional physical terms that identification can select) as a table.

    Names are never wrapped or truncated, so that the output can be searched in a pipe.

    Returns:
        Table with one row per effect: name, site (the kind of component it acts on), parameters with units, formula.
        Plugins are loaded first.
    """
    load_plugins()
    table = Table("effect", "site", "parameters", "formula")
    name_column = table.columns[0]
    name_column.no_wrap, name_column.min_width = True, max(map(len, EFFECTS))
    for column in table.columns[1:]:
        column.overflow = "fold"
    for effect in EFFECTS.values():
        parameters = ", ".join(f"{p.name} ({p.unit})" for p in effect.parameters)
        table.add_row(effect.name, effect.site, escape(parameters), escape(effect.formula))
    return table
