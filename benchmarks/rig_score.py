"""Score the identification of a random rig: names, errors on unseen runs, standard deviations, stability."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatch
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from benchmarks.scoring import score_names
from benchmarks.timed_identification import timed_identification
from hframe_gym.arrays import Array
from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import IdentificationResult, simulate_recording
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from hframe_gym.recordings import Recording, load_machine, load_recordings, save_machine
from tests.reference_simulator.sensors import ENCODER_STEP_RAD, LASER_NOISE_M
from tests.rigs.random_effects import DrawnEffect
from tests.rigs.random_rigs import RandomRig, RandomSession
from tests.rigs.true_machine import identified_values, true_machine

# Noise of phi1, phi2, rad; x, y, m.
NOISE = np.array([ENCODER_STEP_RAD / math.sqrt(12.0)] * 2 + [LASER_NOISE_M] * 2)
# Random rated voltages that the written machine has to survive.
_HISTORIES, _HISTORY_S, _HOLD_S = 3, 2.0, 0.02


def score_rig(
    session: RandomSession, result: IdentificationResult, seconds: dict[str, float]
) -> dict[str, Any]:
    """Return the row of a rig in the results.

    Args:
        seconds: Duration of the identification, s, by "wall" and "cpu".
    """
    rig = session.rig
    report = result.as_json()
    named = {f"{e['name']}@{e['site']}": e for e in report["effects"]}
    names = score_names(
        rig.hidden_effects, result.verdict, {label: e.get("rivals", ()) for label, e in named.items()}
    )
    declared, truth = BUILTIN_MACHINES["hframe"](), true_machine(rig)
    machines = {
        "declared": declared, "before": result.before.machine, "after": result.after.machine, "true": truth,
    }  # fmt: skip
    extra = [label for label in names.extra if not _is_residue(label, rig)]
    right = all(names.identified) and not extra
    return {
        "rig": rig.name,
        "index": rig.index,
        "kind": rig.kind,
        "simulator": rig.simulator,
        "runs": rig.runs,
        "rate_hz": rig.rate_hz,
        "updates": rig.closed_loop.updates if rig.closed_loop else None,
        "residue": rig.residue.kind,
        "truth": rig.describe(),
        "hidden": [
            _hidden(effect, i) | {"trace": trace(session, effect)}
            for effect, i in zip(rig.hidden_effects, names.identified, strict=True)
        ],
        "verdict": result.verdict,
        "named": [
            {
                "label": label,
                "family": e["family"],
                "rivals": list(e.get("rivals", ())),
                "gain": e.get("held_out_gain"),
                "extra": label in extra,
            }
            for label, e in named.items()
        ],
        "complete": all(names.identified),
        "extra": extra,
        "held_out": {name: _mean_ratio(report[name]["held_out"]) for name in ("declared", "before", "after")},
        "explained": report.get("explained"),
        "left": report.get("left"),
        "considered": report.get("considered"),
        "unseen": {
            name: machine and unseen_errors(machine, session.unseen) for name, machine in machines.items()
        },
        "intervals": intervals(rig, result.after.machine)
        if right and rig.kind in ("none", "library")
        else [],
        "stable": survives_rated_voltage(result.after.machine),
        "consistency": _consistency(session.recordings, result),
        "seconds": {name: round(value, 2) for name, value in seconds.items()},
    }


def _is_residue(label: str, rig: RandomRig) -> bool:
    """Return whether an effect is the rig's residue, a small hysteresis that the library can describe."""
    return rig.residue.hysteresis is not None and fnmatch(label, f"*hysteresis*@{rig.residue.hysteresis[0]}")


def _hidden(effect: DrawnEffect, identified: bool) -> dict[str, Any]:
    """Return a hidden effect as plain data."""
    return {
        "label": effect.label,
        "family": EFFECTS[effect.name].family if effect.in_library else effect.name,
        "site": effect.site,
        "size": effect.size,
        "off_form": effect.off_form,
        "absorbed": effect.absorbed,
        "identified": identified,
    }


def trace(session: RandomSession, effect: DrawnEffect) -> float | None:
    """Return how much an effect changes the measurements of the fitted runs, beside other effects.

    No method can find an effect without a trace: a controller that follows programs need not reach the
    current at which a drive saturates. What other parameters could make up for is not subtracted.

    Args:
        effect: One of its hidden effects.

    Returns:
        Sum of the squared changes in units of the noise, over all measurements, dimensionless; infinite if a
        simulation diverges. None if the machine with or without the effect cannot be described by the
        library.
    """
    rig = session.rig
    others = tuple(other for other in rig.hidden_effects if other is not effect)
    complete = true_machine(rig)
    if complete is None or effect.name == "idler_inertia":  # without idlers, the belts run differently
        return None
    reduced = true_machine(dataclasses.replace(rig, hidden_effects=others))
    assert reduced is not None
    updates, total = rig.closed_loop.updates if rig.closed_loop else 1, 0.0
    for recording in session.recordings:
        with_it, without = (simulation_error(m, recording, updates) for m in (complete, reduced))
        total += float(np.nansum(((with_it - without) / NOISE) ** 2))
    return total if math.isfinite(total) else math.inf


def _mean_ratio(errors: dict[str, Any]) -> float | None:
    """Return the mean over the channels of an error in report.json, in multiples of the noise."""
    ratios = [
        e["noise_ratio"] for e in errors.values() if isinstance(e, dict) and e["noise_ratio"] is not None
    ]
    return float(np.mean(ratios)) if ratios else None


def simulation_error(machine: Machine, recording: Recording, updates: int = 1) -> Array:
    """Simulate a machine over a recording as `hframe simulate` does, from the measurements at rest.

    Args:
        updates: How many times the controller changes the voltages from one row to the next.

    Returns:
        Measured minus simulated values, NaN where not measured, shape (n, sensors); infinite if the
        simulation diverges.
    """
    try:
        return simulate_recording(machine, recording, updates=updates).error
    except ArithmeticError:
        return np.full(recording.outputs.shape, np.inf)


def root_mean_square(
    machine: Machine, recordings: Iterable[Recording], updates: Mapping[str, int] | None = None
) -> Array:
    """Return the error of a machine on some runs.

    Args:
        updates: Changes of the voltages from one row to the next, by the name of the run. Default: one.

    Returns:
        Root mean square error by channel, in the channels' units, shape (sensors,).
    """
    changes = updates or {}
    error = np.concatenate([simulation_error(machine, r, changes.get(r.name, 1)) for r in recordings])
    with np.errstate(invalid="ignore"):
        return np.asarray(np.sqrt(np.nanmean(error**2, axis=0)))


def unseen_errors(machine: Machine, unseen: Sequence[Recording]) -> dict[str, float]:
    """Return the error of a machine on the unseen runs, in multiples of the sensors' noise.

    Returns:
        Mean over the channels, and the worst channel.
    """
    ratios = root_mean_square(machine, unseen) / NOISE
    return {"mean": float(min(ratios.mean(), 1e9)), "worst": float(min(ratios.max(), 1e9))}


def _consistency(recordings: Sequence[Recording], result: IdentificationResult) -> float:
    """Return the largest relative difference of the errors of `hframe simulate` from those of the report.

    Both are those of the corrected machine on the held-out runs, by channel.
    """
    updates = {run.name: run.updates for run in result.held_out.runs}
    held_out = [recording for recording in recordings if recording.name in updates]
    errors = root_mean_square(result.after.machine, held_out, updates)
    reported = [e.rmse for e in result.after.held_out.channels.values()]
    differences = [abs(e / r - 1.0) for e, r in zip(errors, reported, strict=True) if r]
    return float(min(max(differences, default=0.0), 1e9))


class IdentifiedRig(NamedTuple):
    """Answer to the recordings of a rig in a folder.

    Attributes:
        result: Result of the identification.
        machines: The machine as declared, before and after the search for effects, by stage.
        unseen: Runs for the error of the answer.
        row: What every table of rigs says about it, as plain data.
        seconds: Duration of the identification, s, by "wall" and "cpu".
    """

    result: IdentificationResult
    machines: dict[str, Machine]
    unseen: list[Recording]
    row: dict[str, Any]
    seconds: dict[str, float]


def identify_rig(
    folder: Path, declared: Machine, truth: Sequence[DrawnEffect], *, log: bool
) -> IdentifiedRig:
    """Identify the rig in a folder with `runs`, `unseen`, `truth.json`, and compare names with the truth.

    Args:
        folder: Folder of the rig.
        declared: Machine to start from.
        truth: What the rig hides.
        log: Whether to print the progress of the identification, with the processor time.
    """
    recordings, unseen = (load_recordings(folder / name, declared) for name in ("runs", "unseen"))
    result, seconds = timed_identification(recordings, declared, log=log)
    report = result.as_json()
    named = {f"{e['name']}@{e['site']}": list(e.get("rivals", ())) for e in report["effects"]}
    names = score_names(truth, result.verdict, named)
    row = {
        "rig": folder.name,
        **json.loads((folder / "truth.json").read_text()),
        "verdict": result.verdict,
        "named": named,
        "complete": all(names.identified),
        "extra": list(names.extra),
        "left": report.get("left"),
        "stable": survives_rated_voltage(result.after.machine),
    }
    machines = {"declared": declared, "before": result.before.machine, "after": result.after.machine}
    rounded = {clock: round(value, 2) for clock, value in seconds.items()}
    return IdentifiedRig(result, machines, unseen, row, rounded)


def survives_rated_voltage(machine: Machine) -> bool:
    """Check whether a machine, written and read, stays finite under random voltages up to the rated ones.

    Args:
        machine: Machine to write.
    """
    with TemporaryDirectory() as folder:
        path = Path(folder) / "machine.json"
        save_machine(machine, path)
        written = load_machine(path)
    rng = np.random.default_rng(0)
    time_s = np.arange(round(_HISTORY_S * 1000)) * 1e-3
    rated = np.array([d.rated_voltage for d in written.drives])
    for _ in range(_HISTORIES):
        levels = rng.uniform(-1.0, 1.0, (round(_HISTORY_S / _HOLD_S), len(rated))) * rated
        inputs = np.repeat(levels, round(_HOLD_S * 1000), axis=0)
        try:
            if not np.isfinite(simulate(written, time_s, inputs).outputs).all():
                return False
        except ArithmeticError:
            return False
    return True


def intervals(rig: RandomRig, machine: Machine) -> list[dict[str, Any]]:
    """Return the estimates with standard deviations and true values, for all parameters that have both."""
    rows: list[dict[str, Any]] = []
    if machine.uncertainty is None:
        return rows
    parameters, true = machine.parameters, identified_values(rig)
    for name in machine.uncertainty.names:
        std = machine.uncertainty.std(name)
        if std is None or not np.isfinite(std) or std <= 0.0 or name not in true or name not in parameters:
            continue
        value, expected = _same_sign(name, parameters, true)
        error = value - expected
        if name.endswith(".p"):
            error = (error + math.pi) % (2.0 * math.pi) - math.pi
        unit = 1.0 if name.endswith(".p") else abs(expected)
        rows.append(
            {
                "name": name,
                "relative_std": std / unit if unit else None,
                "z": error / std,
                "effect": "@" in name,
            }
        )
    return rows


def _same_sign(name: str, parameters: dict[str, float], true: dict[str, float]) -> tuple[float, float]:
    """Return estimate and true value of a parameter; a sine's negative amplitude shifts its phase by pi."""
    label, _, key = name.rpartition(".")
    value = parameters[name]
    if f"{label}.p" in parameters and "@" in label:
        amplitude = "e" if f"{label}.e" in parameters else "A"
        if parameters[f"{label}.{amplitude}"] < 0.0:
            value = abs(value) if key == amplitude else value + math.pi if key == "p" else value
    return value, true[name]
