"""Recordings of real machines through the same loop as any rig: fit, residual, trace, before and after.

    python -m benchmarks.real_machines emps

The data are not ours to redistribute.  They are read from the folder named by the environment variable HFRAME_DATA, or
from ../shared/data; what is not there is skipped and said.  EMPS: Janot, Gautier and Brunot, Data Set and Reference
Models of EMPS, Workshop on Nonlinear System Identification Benchmarks 2019 (ask at nonlinearbenchmark.org), as
emps/emps_train.csv and emps/emps_test_pulses.csv with columns t_s, qm_meas_m, vir_V.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.results_file import write_results
from hframe_gym.effects import LIBRARY
from hframe_gym.files import load_machine, read_recordings
from hframe_gym.identify import identify
from hframe_gym.identify.residual import force_error

MACHINES = Path(__file__).parent / "machines"
# Janot et al. 2019: textbook friction and an offset, least squares on the first record.
PUBLISHED = {"train": 0.04083, "test": 0.05982}
PUBLISHED_OFFSET = -3.165  # N, on the side of the inertia: a force of the opposite sign


def data_folder() -> Path:
    """Where recordings of real machines lie."""
    return Path(os.environ.get("HFRAME_DATA") or Path(__file__).parents[1] / ".." / "shared" / "data")


def convert_emps(source: Path, target: Path) -> None:
    """Write both EMPS records in the recordings' format: time_s, v_V, x_m."""
    target.mkdir(parents=True, exist_ok=True)
    for name in ("emps_train", "emps_test_pulses"):
        table = np.genfromtxt(source / f"{name}.csv", delimiter=",", names=True)
        columns = np.column_stack([table["t_s"], table["vir_V"], table["qm_meas_m"]])
        np.savetxt(target / f"{name}.csv", columns, fmt="%.9g", delimiter=",", header="time_s,v_V,x_m", comments="")


def emps(console: Console) -> None:
    """EMPS as a one-coordinate machine: relative force error of the second record, declared, before and after."""
    source = data_folder() / "emps"
    if not source.is_dir():
        console.print(f"emps: skipped, no folder {source} (see the head of this script for where to get the data)")
        return
    machine = load_machine(MACHINES / "emps.json")
    with tempfile.TemporaryDirectory() as folder:
        convert_emps(source, Path(folder))
        recordings = read_recordings(folder, machine)
    answer = identify(recordings, machine, held_out=("emps_test_pulses",), say=console.print)
    textbook = machine.with_effects(LIBRARY["constant_force"].at("x", size=-PUBLISHED_OFFSET))
    rows = {
        "declared (textbook friction, no offset)": machine,
        "declared with the published offset": textbook,
        "before: refitted": answer.before.machine,
        "after: with the effects found": answer.after.machine,
    }
    table = Table("EMPS, relative force error", "first record (fitted)", "second record (held out)")
    table.add_row("published, textbook with offset", *(f"{100 * PUBLISHED[k]:.2f} %" for k in ("train", "test")))
    results = {"published": PUBLISHED}
    for name, m in rows.items():
        errors = {"train": force_error(m, answer.fitted), "test": force_error(m, answer.held_out)}
        results[name] = {k: float(v or np.nan) for k, v in errors.items()}
        table.add_row(name, *(f"{100 * v:.2f} %" for v in results[name].values()))
    console.print(table)
    effects = Table("effect", "parameter", "value", "std", "unit", "held-out gain")
    for e in answer.as_json()["effects"]:
        for key, p in e["parameters"].items():
            numbers = (f"{p['value']:.4g}", f"{p['std']:.2g}", p["unit"], f"{e['held_out_gain']:.3f}")
            effects.add_row(f"{e['name']}@{e['site']}", key, *numbers)
    console.print(effects)
    console.print(f"verdict {answer.verdict} in {answer.seconds:.1f} s")
    write_results("real_machines_emps", {"force_error": results, "answer": answer.as_json()}, seed=None)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("machine", choices=["emps"])
    parser.parse_args()
    emps(Console(width=110))


if __name__ == "__main__":
    main()
