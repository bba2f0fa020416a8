"""Formulas for the tables of an identification that was saved in a folder, named as effects of the user.

`identification/formulas.py` explains tables, formulas and their errors.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

from ..effects import EFFECTS
from ..effects.smooth_table import KNOTS
from ..errors import InputError
from .formulas import ProposedFormula, mean_error, propose_formulas, tables_of
from .saved_result import SavedResult, load_result


def formulas_of_folder(folder: Path, name: str, table: str = "") -> tuple[ProposedFormula, ...]:
    """Return formulas that can take the place of a table of a saved identification.

    A table is a force or friction level interpolated over one variable. The formulas are those that `hframe identify`
    compared with it, with their fitted parameters and the errors of the machine with each formula on the recorded runs.
    If it compared none, formulas are fitted to the values of the table. Their errors on runs are then unknown: `fitted`
    is None and `held_out` is empty.

    Args:
        folder: Folder that `write_result` wrote.
        name: Name of the effect that each formula defines: a Python identifier in lower case, different from the names
            of existing effects.
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
        raise InputError(f"{folder}: the identified machine has no table for which a formula could be proposed")
    label = table or next(iter(tables))
    if label not in tables:
        raise InputError(f"--table {label}: no such table; the identified machine has {', '.join(tables)}")
    if name in EFFECTS:
        raise InputError(f"{name}: an effect of this name exists; choose another name")
    entries = [e for t in saved.report["proposed_formulas"] if t["table"] == label for e in t["formulas"]]
    if entries:
        proposed = tuple(ProposedFormula.from_json(entry, saved.machine, tables[label]) for entry in entries)
    else:
        proposed = propose_formulas(saved.machine, tables[label])
    renamed = []
    for p in proposed:
        try:
            effect = dataclasses.replace(p.effect, name=name, notes=_notes(p, saved))
        except ValueError as error:
            raise InputError(str(error)) from None
        renamed.append(dataclasses.replace(p, effect=effect))
    return tuple(renamed)


def _notes(proposed: ProposedFormula, saved: SavedResult) -> tuple[str, ...]:
    """Return what the file of an effect says about its accuracy."""
    if proposed.fitted is None:
        return ("It was fitted to the table alone; identify the machine with it to see its error on held-out runs.",)
    label, complexity = proposed.effect.table.label, proposed.effect.formula.complexity
    table_error = mean_error(next(t["held_out"] for t in saved.report["proposed_formulas"] if t["table"] == label))
    return (
        f"Error on the held-out runs: {proposed.mean_noise_ratio:.3g} times the sensor noise with this formula of "
        f"{complexity} parameters, {table_error:.3g} with the table of {KNOTS} values.",
    )
