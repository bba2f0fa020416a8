"""Find data, write recordings, print results and draw pictures for the studies of real machines."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.results_file import data_root
from hframe_gym.arrays import Array
from hframe_gym.files import atomic_file
from hframe_gym.identification import IdentificationResult
from hframe_gym.machine import Machine
from tools.repository import FIGURES, ROOT

MACHINES = ROOT / "benchmarks" / "machines"


def data_folder(name: str, console: Console) -> Path | None:
    """Find the data of a machine, see `data_root`.

    Args:
        name: Name of the machine's folder.
        console: Output for the message that the data are missing.

    Returns:
        The folder, or None if it does not exist.
    """
    if (folder := data_root() / name).is_dir():
        return folder
    console.print(
        f"{name}: skipped, no folder {name} in $HFRAME_DATA (docs/real_machines.md lists the sources)"
    )
    return None


def write_recording(path: Path, columns: Mapping[str, Array]) -> None:
    """Write a recording, completely or not at all; columns by name."""
    table = np.column_stack(list(columns.values()))
    with atomic_file(path) as file:
        np.savetxt(file, table, fmt="%.9g", delimiter=",", header=",".join(columns), comments="")


def machines_of(answer: IdentificationResult) -> dict[str, Machine]:
    """Return the declared, the refitted and the identified machine by the name that tables give them."""
    return {
        "declared": answer.declared.machine,
        "before: refitted": answer.before.machine,
        "after: with the identified effects": answer.after.machine,
    }


def print_errors(title: str, unit: str, errors: Mapping[str, Mapping[str, float]], console: Console) -> None:
    """Print errors by machine and set of records."""
    columns = list(next(iter(errors.values())))
    table = Table(title, *columns)
    for stage, values in errors.items():
        table.add_row(stage, *(f"{values[c]:.4g} {unit}" if np.isfinite(values[c]) else "-" for c in columns))
    console.print(table)


def print_effects(answer: IdentificationResult, console: Console) -> None:
    """Print the identified effects with their uncertainty, the verdict, and what the residual depends on."""
    report = answer.as_json()
    table = Table("effect", "parameter", "value", "std", "unit", "held-out gain", "rivals")
    for e in report["effects"]:
        for key, p in e["parameters"].items():
            std = "-" if p["std"] is None else f"{p['std']:.2g}"
            gain = f"{e['held_out_gain']:.3f}"
            table.add_row(
                f"{e['name']}@{e['site']}",
                key,
                f"{p['value']:.4g}",
                std,
                p["unit"],
                gain,
                ", ".join(e["rivals"]),
            )
    if report["effects"]:
        console.print(table)
    follows = ", ".join(
        f"{d['variable']} {100 * d['share']:.0f} %" for d in report["residual"]["depends_on"][:4]
    )
    console.print(
        f"verdict {report['verdict']} in {report['seconds']:.1f} s; "
        f"the residual force before depends on: {follows}"
    )


def picture(
    name: str,
    title: str,
    panels: Sequence[tuple[str, Array, Mapping[str, Array]]],
    console: Console,
    abscissa: str = "time, s",
) -> None:
    """Draw curves to docs/figures/real_NAME.png.

    Args:
        name: Name of the machine.
        panels: Label of the ordinate, abscissa, and curves by name, one per panel.
        console: Output for the message that matplotlib is missing.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        console.print("no picture: it needs the extra `report`")
        return
    figure = Figure(figsize=(9, 2.4 * len(panels)), layout="constrained")
    axes = figure.subplots(len(panels), 1, squeeze=False)[:, 0]
    for axis, (label, time_s, curves) in zip(axes, panels, strict=True):
        for curve, values in curves.items():
            axis.plot(time_s, values, label=curve, linewidth=0.9)
        axis.set_ylabel(label)
        if len(curves) > 1:  # beside the curves, which fill the panel
            axis.legend(
                fontsize=7, ncols=len(curves), loc="lower right", bbox_to_anchor=(1.0, 1.0), frameon=False
            )
    axes[-1].set_xlabel(abscissa)
    figure.suptitle(title, fontsize=10)
    with atomic_file(FIGURES / f"real_{name}.png") as file:
        figure.savefig(file, dpi=110)


def errors_by_machine(
    answer: IdentificationResult, measure: Callable[[Machine], dict[str, float]]
) -> dict[str, dict[str, float]]:
    """Return the errors of the declared, the refitted and the identified machine, by the name of each."""
    return {stage: measure(machine) for stage, machine in machines_of(answer).items()}
