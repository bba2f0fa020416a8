"""Read the folder that `write_result` wrote, and check that its files are complete and consistent."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from ....arrays import Array
from ....effects import EFFECTS
from ....errors import InputError
from ....files import complete_commit, newest, read_arrays, read_document
from ....machine import Machine
from ....recordings import load_machine
from .document import STAGES, ChannelErrors, Report
from .formulas import ProposedFormula, mean_error, propose_formulas, tables_of
from .result_curves import ResultCurves


@dataclass(frozen=True)
class SavedResult:
    """A result read from its folder.

    Attributes:
        machine: Identified machine with the selected effects.
        declared: Machine as declared.
        curves: Curves of the plots.
    """

    report: Report
    machine: Machine
    declared: Machine
    curves: ResultCurves


def load_result(folder: Path) -> SavedResult:
    """Read an identification result from its folder and check that its files are consistent.

    Args:
        folder: Folder that `write_result` wrote.

    Returns:
        Report, machines and curves of the plots.

    Raises:
        InputError: If a file is missing, damaged or inconsistent with another file; the message names the
            file.
    """
    report = read_report(folder)
    for name in ("machine.json", "declared.json"):
        if not newest(folder / name).is_file():
            raise _damaged(folder / name, "is missing")
    with warnings.catch_warnings():
        # What is not plausible about the machine was said when its declaration was read.
        warnings.simplefilter("ignore", UserWarning)
        machine, declared = (
            load_machine(newest(folder / name)) for name in ("machine.json", "declared.json")
        )
    arrays = _load_arrays(folder / "evidence.npz")
    _check_report(report, machine, declared, folder / "report.json")
    _check_arrays(arrays, report, machine, folder / "evidence.npz")
    return SavedResult(report, machine, declared, ResultCurves.from_arrays(arrays, report.runs.held_out))


def read_report(folder: Path) -> Report:
    """Read report.json from the folder of an identification result.

    Args:
        folder: Folder that `write_result` wrote.

    Raises:
        InputError: If the file is missing or damaged.
    """
    complete_commit(folder)
    if not newest(folder / "report.json").is_file():
        raise InputError(f"{folder}: no report.json here; run `hframe identify RUNS --out {folder}` first")
    try:
        return Report.model_validate_json(read_document(newest(folder / "report.json")))
    except ValidationError as error:
        first = error.errors()[0]
        # Where a field may be of two kinds, pydantic names the one that it tried.
        field = (
            ".".join(str(part) for part in first["loc"] if part != ChannelErrors.__name__) or "is not valid"
        )
        raise _damaged(folder / "report.json", f"{field}: {first['msg']}") from None


def formulas_of_folder(folder: Path, name: str, table: str = "") -> tuple[ProposedFormula, ...]:
    """Return formulas that can take the place of a table of a saved identification.

    A table is a force or friction level interpolated over one variable. The formulas are those that
    `hframe identify` compared with it, with their fitted parameters and the errors of the machine with each
    formula on the recorded runs. If it compared none, formulas are fitted to the values of the table; their
    errors on runs are then unknown.

    Args:
        folder: Folder that `write_result` wrote.
        name: Name of the effect that each formula defines: a Python identifier in lower case, different from
            the names of existing effects.
        table: Label of the table, for example "smooth_force[position of x]@x". Default: the first one.

    Returns:
        Formulas by increasing number of parameters; one is recommended.

    Raises:
        InputError: If the folder has no result or no such table, or the name cannot be used.
        ImportError: If the formulas must be fitted and scikit-learn is not installed.
    """
    saved = load_result(folder)
    tables = {e.label: e for e in tables_of(saved.machine)}
    if not tables:
        raise InputError(
            f"{folder}: the identified machine has no table for which a formula could be proposed"
        )
    label = table or next(iter(tables))
    if label not in tables:
        raise InputError(f"--table {label}: no such table; the identified machine has {', '.join(tables)}")
    if name in EFFECTS:
        raise InputError(f"{name}: an effect of this name exists; choose another name")
    compared = next((t for t in saved.report.proposed_formulas if t.table == label), None)
    proposed = [
        ProposedFormula.from_entry(formula, saved.machine, tables[label])
        for formula in (compared.formulas if compared else ())
    ]
    table_error = mean_error(compared.held_out if compared else {})
    return tuple(
        p.with_name(name, table_error) for p in proposed or propose_formulas(saved.machine, tables[label])
    )


def _damaged(path: Path, problem: str) -> InputError:
    """Return the error for a file of a result that cannot be used."""
    return InputError(f"{path}: {problem}; run `hframe identify` again to write the folder anew")


def _load_arrays(path: Path) -> dict[str, Array]:
    """Read evidence.npz."""
    source = newest(path)
    if not source.is_file():
        raise _damaged(path, "is missing")
    try:
        arrays = read_arrays(source)
    except InputError as error:
        raise _damaged(path, str(error).removeprefix(f"{source}: ")) from None
    for name, values in arrays.items():
        if not np.issubdtype(values.dtype, np.floating):
            raise _damaged(path, f"{name} holds {values.dtype}, not floating-point numbers")
    return arrays


def _check_report(report: Report, machine: Machine, declared: Machine, path: Path) -> None:
    """Raise InputError if report.json does not fit the machines."""
    channels = machine.output_channels
    if declared.output_channels != channels:
        raise _damaged(path.with_name("declared.json"), "has other sensors than machine.json")
    for stage, evaluation in report.machines.items():
        for channel in channels:
            if channel not in evaluation.channels:
                raise _damaged(path, f"{stage}.held_out has no errors of {channel}")
        has_force = "force_error" in evaluation.held_out
        if stage in STAGES and has_force != ("force_error" in report.after.held_out):
            raise _damaged(path, "force_error is given for some of declared, before and after only")
        if has_force and evaluation.force_error is None:
            raise _damaged(path, f"{stage}.held_out.force_error is not a number")
    if report.channels != list(channels):
        raise _damaged(path, "declared.held_out has other channels than machine.json, or in another order")
    labels = {e.label for e in machine.effects}
    for effect in report.effects:
        if f"{effect.name}@{effect.site}" not in labels:
            raise _damaged(path, f"effect {effect.name} at {effect.site} is not in machine.json")
    for table in report.proposed_formulas:
        if table.table not in labels:
            raise _damaged(path, f"proposed_formulas: {table.table} is not in machine.json")
    drives = (drive.name for drive in machine.drives)
    known = {*machine.coordinate_names, *drives, *machine.output_channels, "drives", "belts"}
    for dependence in report.residual.depends_on:
        coordinate = dependence.coordinate
        names = {coordinate, dependence.variable.partition(" of ")[2] or coordinate}
        if not names <= known or coordinate not in machine.coordinate_names:
            raise _damaged(
                path, f"residual.depends_on: machine.json has no coordinate {' or '.join(sorted(names))}"
            )


def _check_arrays(arrays: Mapping[str, Array], report: Report, machine: Machine, path: Path) -> None:
    """Raise InputError if the arrays of evidence.npz do not fit report.json and the machine."""
    channels = len(machine.output_channels)
    needed: dict[str, int] = {}  # dimensions by name
    for run in report.runs.held_out:
        needed |= {f"{run}/time_s": 1}
        needed |= {f"{run}/{name}": 2 for name in ("measured", *STAGES)}
        if f"{run}/plain" in arrays:  # results of older versions have none
            needed |= {f"{run}/plain": 2}
    if "force/variable" in arrays:
        needed |= {"force/variable": 1, "force/before": 1, "force/after": 1}
        if not report.residual.depends_on:
            raise _damaged(path, "has a residual force, for which report.json has no variable")
    needed |= {name: 1 for name in arrays if name.startswith("coverage/")}
    for name, dimensions in needed.items():
        if name not in arrays:
            raise _damaged(path, f"has no array {name}")
        values = arrays[name]
        rows = len(arrays[f"{name.rpartition('/')[0]}/time_s"]) if dimensions == 2 else None
        if values.ndim != dimensions or not len(values) or (rows and values.shape != (rows, channels)):
            raise _damaged(path, f"array {name} has the shape {values.shape}")
        if dimensions == 1 and not np.isfinite(values).all():
            raise _damaged(path, f"array {name} has values that are not finite")
        if name.startswith("force/") and len(values) != len(arrays["force/variable"]):
            raise _damaged(path, f"array {name} has another length than force/variable")
        coordinate = name.partition(" of ")[2]
        if name.startswith("coverage/") and coordinate and coordinate not in machine.coordinate_names:
            raise _damaged(path, f"array {name}: machine.json has no coordinate {coordinate}")
    for run in report.runs.held_out:
        inputs = arrays.get(f"{run}/inputs")  # results of older versions have none
        shape = (len(arrays[f"{run}/time_s"]), len(machine.input_channels))
        if inputs is not None and inputs.shape != shape:
            raise _damaged(path, f"array {run}/inputs has the shape {inputs.shape}")
