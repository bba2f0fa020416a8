"""Do proposed formulas replace the tables of forces and frictions that the library does not know?

python -m benchmarks.formulas            # identify every rig, propose formulas, fit them in place of the
                                         tables
python -m benchmarks.formulas NAME ...   # some rigs only

Each rig hides a force or a friction against one variable, which the library of effects lacks, in the
independent simulator. Identification is restricted to tables (`max_effects=0`); `benchmarks.identification`
measures the search for effects of the library. Formula and table are compared on the held-out runs.
"""

from __future__ import annotations

import json
import math
import os
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.results_file import write_results
from hframe_gym.files import write_text
from hframe_gym.identification import SelectionCriteria, identify, write_result
from hframe_gym.identification.report.content.formulas import TableComparison, compare_formulas
from tests.reference_simulator import COORDINATES
from tests.rigs.cases import Case
from tests.rigs.hidden_effects import Build, HiddenEffect, change_site
from tests.rigs.recording_sessions import Session, record
from tools.command_line import command_line

FOLDER = Path("out/formulas")
RUNS = 12  # of 2 s; three are held out
WITHIN = 1.2  # acceptance: error of the formula over that of the table


def _kinds() -> dict[str, tuple[str, Build]]:
    """Return the hidden force or friction of each rig by name: label of the right table, and the build."""
    x, y = (partial(change_site, sites=COORDINATES, site=site) for site in "xy")
    period = 2 * np.pi / 0.2  # rad/m
    return {
        "magnetic catch": (
            "smooth_force[position of x]@x",
            partial(x, catch_force=8.0, catch_position=0.06, catch_width=0.012),
        ),
        "rail magnets, two harmonics": (
            "smooth_force[position of x]@x",
            partial(x, wave_force=2.0, wave_second=0.5, wave_number=period, wave_phase=0.4),
        ),
        "lifting cable": ("smooth_force[position of y]@y", partial(y, spring_square=80.0, spring_rest=-0.15)),
        "warm-up": ("smooth_friction[time]@x", partial(x, friction_cold=1.5)),
        "bent rail": ("smooth_friction[position of y]@x", partial(x, friction_cross_position=10.0)),
        "stale grease": (
            "smooth_friction[path of x]@x",
            partial(x, friction_stale=2.0, friction_stale_path=0.15),
        ),
    }


def cases() -> dict[str, Case]:
    """Return the rigs by name."""
    rigs = {}
    for name, (label, build) in _kinds().items():
        hidden = (HiddenEffect(label, build, (label,), {}),)
        rigs[name] = Case(f"formula: {name}", "formulas", "outside", "full", hidden, RUNS)
    return rigs


def measure(session: Session) -> dict[str, Any]:
    """Identify a rig and compare its formulas with its table.

    Returns:
        The right table and the identified ones, their mean error on the held-out runs in units of the noise,
        and the recommended formula with its error; times, s.
    """
    began = time.perf_counter()
    result = identify(
        session.recordings(),
        session.machine(),
        criteria=SelectionCriteria(max_effects=0),
        log=print,
        budget=math.inf,
    )
    identified = time.perf_counter()
    comparisons = compare_formulas(result, print)
    write_result(result, session.folder / "result", (), comparisons)
    found = {
        "right": session.case.hidden_effects[0].label,
        "tables": [c.table.label for c in comparisons],
        "seconds": {
            "identify": round(identified - began, 1),
            "formulas": round(time.perf_counter() - identified, 1),
        },
    }
    return found | (_row(comparisons[0]) if comparisons else {"within": False})


def _row(comparison: TableComparison) -> dict[str, Any]:
    """Return the errors of a table and of its formulas."""
    chosen = next(f for f in comparison.formulas if f.recommended)
    return {
        "table_error": comparison.mean_noise_ratio,
        "formula": chosen.effect.text,
        "terms": chosen.effect.formula.name,
        "parameters": chosen.effect.values,
        "complexity": chosen.effect.formula.complexity,
        "formula_error": chosen.mean_noise_ratio,
        "within": chosen.mean_noise_ratio <= WITHIN * comparison.mean_noise_ratio,
        "considered": {f.effect.formula.name: f.mean_noise_ratio for f in comparison.formulas},
    }


def main() -> None:
    """Measure the rigs that the command line names."""
    every = cases()
    parser = command_line(__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"any of: {', '.join(every)}")
    names = parser.parse_args().names or list(every)
    rigs = {}
    for name in names:
        session = record(every[name], FOLDER)
        rigs[name] = measure(session)
        write_text(session.folder / "formulas.json", json.dumps(rigs[name], indent=1) + "\n")
        print(name, json.dumps(rigs[name]), flush=True)
    print(
        f"within {100 * (WITHIN - 1):.0f} % of the table: "
        f"{sum(r['within'] for r in rigs.values())} of {len(rigs)}"
    )
    if set(rigs) == set(every) and not os.environ.get("HFRAME_NO_RESULTS"):
        print(f"wrote {write_results('formulas', {'runs': RUNS, 'rigs': rigs}, seed=None)}")


if __name__ == "__main__":
    main()
