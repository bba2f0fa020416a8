"""Do the reported standard deviations hold? True parameters against their intervals, without a search.

    python -m benchmarks.coverage                          # 40 rigs, about 4 minutes on two cores
    python -m benchmarks.coverage --count 10 --seed 102 --rigs

Random rigs (`tests.rigs.random_rigs`) with at most one effect are fitted from the declared machine and a
disturbed start of the effect, in the steps that `identify` takes once the effect is named. The effect is
given: the coverage of `benchmarks.random_rigs` also contains the errors of the search.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.random_rigs_summary import coverage
from benchmarks.results_file import write_results
from benchmarks.rig_score import intervals
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import fit, hold_out, prepare
from hframe_gym.identification.fit.covariance import with_uncertainty
from hframe_gym.identification.fit.estimation import Fit
from hframe_gym.identification.fit.model_error import fit_with_model_error, polish
from hframe_gym.identification.fit.start_estimation import refine_dataset
from hframe_gym.identification.predict.free_parameters import default_free_parameters
from hframe_gym.identification.predict.prediction import SEARCH_BANDWIDTH
from hframe_gym.identification.propose.candidates import effect_parameters
from hframe_gym.identification.propose.typical_scales import typical_scales
from hframe_gym.machine import BUILTIN_MACHINES, AppliedEffect
from hframe_gym.preparation.dataset import Dataset
from hframe_gym.recordings import without_outliers
from tests.rigs.random_effects import library_parameters
from tests.rigs.random_rigs import RandomRig, draw_rig
from tools.command_line import command_line

SEED = 101  # neither the development set nor the final set of `benchmarks.random_rigs`
COUNT = 40
# A sensor's range is measured before any fit; idlers change what the declared parameters mean.
_EXCLUDED = ("sensor_range", "idler_inertia")
_KINDS = ("mass", "coulomb", "viscous", "Ke", "Kt", "EA", "rest_length")


class Fitted(NamedTuple):
    """A fitted rig.

    Attributes:
        rig: The rig.
        fit: Fit with its true effect.
        data: Runs that were fitted.
    """

    rig: RandomRig
    fit: Fit
    data: Dataset


def suitable(rig: RandomRig) -> bool:
    """Return whether a rig has at most one effect, of the library, and no run with a changed gain."""
    effects = rig.hidden_effects
    if rig.residue.bad_gain is not None:
        return False
    return (
        rig.kind in ("none", "library")
        and len(effects) <= 1
        and not any(e.name in _EXCLUDED for e in effects)
    )


def starting_effects(rig: RandomRig) -> list[AppliedEffect]:
    """Return the effects of a rig with parameters that are off the true ones, as a search would start them.

    An effect that the refitted parameters absorb is left out.
    """
    rng = np.random.default_rng([rig.seed, rig.index, 3])
    applied = []
    for effect in rig.hidden_effects:
        if effect.absorbed:
            continue
        definition, true = EFFECTS[effect.name], library_parameters(effect, rig.stage[0])
        for site in effect.library_sites():
            values = {}
            for p in definition.parameters:
                value = true[p.name]
                factor = 1.0 + (0.003 if p.role in ("rate", "period") else 0.15) * rng.standard_normal()
                if p.role == "phase":
                    value += 0.2 * rng.standard_normal()
                elif p.role != "fixed":
                    value *= factor
                values[p.name] = float(np.clip(value, p.lower, p.upper))
            applied.append(definition.at(site, **values))
    return applied


def fit_rig(rig: RandomRig) -> Fitted:
    """Fit the machine of a rig with its effect, in the steps of `identify`."""
    declared = BUILTIN_MACHINES["hframe"]()
    recordings = [without_outliers(recording, declared) for recording in rig.record().recordings]
    kept = hold_out(recordings)
    data = prepare(recordings, declared).with_runs([r.name for r in recordings if r.name not in kept])
    free = default_free_parameters(declared)
    base = fit(declared, free, data, SEARCH_BANDWIDTH)
    effects = starting_effects(rig)
    fitted = base
    if effects:
        scales = typical_scales(base, data)
        machine = declared.with_effects(*effects)
        added = [p for e in machine.effects for p in effect_parameters(e, machine, scales)]
        theta = np.concatenate([base.theta, np.zeros(len(added))])
        fitted = fit(machine, (*free, *added), data, SEARCH_BANDWIDTH, theta=theta)
    fitted = fit_with_model_error(fitted, data)
    data = refine_dataset(data, fitted.machine)
    return Fitted(rig, polish(fitted, data), data)


def suitable_rigs(seed: int, count: int) -> Iterator[RandomRig]:
    """Yield the first `count` suitable rigs of a set."""
    index = 0
    while count:
        rig = draw_rig(seed, index)
        if suitable(rig):
            yield rig
            count -= 1
        index += 1


def score(fitted: Fitted) -> dict[str, Any]:
    """Return the intervals of a rig's parameters with the true values, and what describes the rig."""
    began = time.perf_counter()
    machine = with_uncertainty(fitted.fit, fitted.data)
    rig = fitted.rig
    return {
        "rig": rig.name,
        "truth": rig.describe(),
        "residue": rig.residue.kind,
        "bandwidth": fitted.fit.bandwidth,
        "chi2": fitted.fit.chi2,
        "seconds": time.perf_counter() - began,
        "intervals": intervals(rig, machine),
    }


def summarize(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the coverage over all rigs, clean ones, ones with residue, and by kind of parameter."""
    groups = {
        "all": rows,
        "clean": [r for r in rows if not r["residue"]],
        "residue": [r for r in rows if r["residue"]],
    }
    content = {name: coverage(some, lambda i: True) for name, some in groups.items()}
    for kind in _KINDS:
        content[kind] = coverage(
            rows, lambda i, kind=kind: i["name"].endswith(f".{kind}") and not i["effect"]
        )
    content["effects"] = coverage(rows, lambda i: i["effect"])
    return content


def show(console: Console, content: dict[str, Any]) -> None:
    """Print the coverage as a table."""
    table = Table("parameters", "values", "inside 68 %", "inside 95 %", "root mean square error / std")
    for name, found in content.items():
        if found["parameters"]:
            numbers = f"{found['68']:.0%}", f"{found['95']:.0%}", f"{found['rms']:.2f}"
            table.add_row(name, str(found["parameters"]), *numbers)
    console.print(table)


def line(row: dict[str, Any]) -> str:
    """Format a rig in one line, with the parameters that are off by more than three standard deviations."""
    off = ", ".join(f"{i['name']} {i['z']:+.1f}" for i in row["intervals"] if abs(i["z"]) > 3.0)
    return (
        f"{row['rig']} {row['truth']}: chi2 {row['chi2']:.3g} at {row['bandwidth']:g} rad/s; "
        f"off: {off or 'none'}"
    )


def main() -> None:
    """Fit the rigs that the command line names, and print and write the coverage of their intervals."""
    parser = command_line(__doc__)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--rigs", action="store_true", help="print a line for each rig")
    arguments = parser.parse_args()
    console = Console(width=150)
    rows = []
    for rig in suitable_rigs(arguments.seed, arguments.count):
        rows.append(score(fit_rig(rig)))
        if arguments.rigs:
            print(line(rows[-1]), flush=True)
    content = summarize(rows)
    show(console, content)
    if (arguments.seed, arguments.count) == (SEED, COUNT):
        write_results("coverage", {"summary": content, "rigs": rows}, seed=SEED)


if __name__ == "__main__":
    main()
